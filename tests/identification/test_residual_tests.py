"""validate and compare: nominal false alarms whatever the contamination, and what is missing is named, by output."""

import re
from dataclasses import replace

import control
import numpy as np
import pandas as pd
import pytest
import support
from recordings import RIGHT, A, B, of_states, recording, wild
from scipy.linalg import expm
from scipy.signal import lfilter
from scipy.stats import binom
from statsmodels.stats.diagnostic import acorr_ljungbox

from robust_filterpy import ARX, OutputError, identify
from robust_filterpy.identification import ARMAX, FIR, GreyBox, StateSpace, compare, validate
from robust_filterpy.identification.judging.validate import Validation, Validations
from robust_filterpy.identification.models.dependence import whitening_of
from robust_filterpy.influence import Linear

MOVING = [0.0, 1.0, 0.5, 0.2]


def moving(seed, share=0.1, b=MOVING, length=300):
    """A recording of an FIR."""
    return recording([2, seed], length, share, a=[1.0], b=b)


@pytest.fixture(scope="module")
def model():
    return identify(*recording(0, 2000), OutputError(2, 2))


# False alarms.


@support.draws(30, 150)
@pytest.mark.parametrize("share", support.by_night([0.0, 0.1, 0.2], 0.1))
def test_the_false_alarm_rate_is_nominal_after_the_fit_and_on_a_fresh_recording(share, draws):
    models = [(identify(*moving(seed, share), FIR(3)), seed) for seed in range(draws)]
    same = [validate(one, *moving(seed, share), steps=1) for one, seed in models]
    fresh = [validate(one, *moving(1000 + seed, share), steps=1) for one, seed in models]
    assert all(one.same_recording for one in same) and not any(one.same_recording for one in fresh)
    # The fit has made three of the 21 cross-correlations zero.
    assert {one.independence.degrees for one in same} == {18} and {one.independence.degrees for one in fresh} == {21}
    levels = np.array([0.05, 0.2, 0.5])
    for judged in (same, fresh):
        values = np.array([(one.whiteness.p_value, one.independence.p_value) for one in judged])
        off = (values[:, :, None] < levels).mean(axis=0) - levels
        assert (np.abs(off) < 5.0 * np.sqrt(levels * (1.0 - levels) / draws)).all(), off
    for values, bounds in (("autocorrelation", "autocorrelation_bound"), ("cross_correlation", "cross_bound")):
        outside = np.concatenate([np.ravel(np.abs(getattr(one, values)) > getattr(one, bounds)) for one in fresh])
        assert abs(outside.mean() - 0.01) < 5.0 * np.sqrt(0.01 / outside.size)


def test_gaps_and_a_wild_sample_raise_no_alarm_and_move_no_correlation(model):
    y, u = recording(3, 1000)
    assert validate(model, y, u).verdict == RIGHT
    y[np.random.default_rng(0).random(1000) < 0.3] = np.nan
    after = validate(model, y, u)
    assert after.verdict == RIGHT and after.samples == np.isfinite(model.residuals(y, u)).sum()
    y[np.flatnonzero(np.isfinite(y))[300]] = 1e9
    wild = validate(model, y, u)
    np.testing.assert_allclose(wild.autocorrelation, after.autocorrelation, atol=0.1)
    np.testing.assert_allclose(wild.cross_correlation, after.cross_correlation, atol=0.1)
    assert wild.verdict == RIGHT


def test_without_outliers_the_statistic_is_that_of_ljung_and_box():
    one = identify(*recording(5, 2000, share=0.0), OutputError(2, 2), influence=Linear())
    y, u = recording(6, 2000, share=0.0)
    judged, residual = validate(one, y, u, lags=10), one.residuals(y, u)
    peer = acorr_ljungbox(residual[~np.isnan(residual)], lags=[10]).lb_stat.iloc[0]
    assert judged.whiteness.statistic == pytest.approx(float(peer), rel=0.1) and judged.whiteness.degrees == 10


# What is wrong.


@support.draws(6, 20)
def test_bounds_hold_where_noise_and_input_are_coloured_alike(draws):
    """Without the residuals' autocorrelations a third of the chance correlations would lie outside."""
    outside = []
    for seed in range(draws):
        rng = np.random.default_rng([12, seed])
        u = lfilter([1.0], [1.0, -0.9], rng.normal(size=600))
        y = lfilter(MOVING, [1.0], u) + lfilter([1.0], [1.0, -0.9], 0.3 * rng.normal(size=600))
        truth = replace(
            identify(y, u, FIR(3)), theta=np.array(MOVING[1:]), P=np.zeros((3, 3)), offset=0.0, offset_std=0.0,
            offset_covariance=np.zeros(3), weights=np.ones(600),
        )  # fmt: skip
        judged = validate(truth, y, u, steps=1)
        outside.append(np.abs(judged.cross_correlation) > judged.cross_bound)
    assert np.mean(outside) < 0.05


def test_fits_of_ordinary_samples_are_those_without_the_outliers(model):
    y, u = recording(9, 1000, share=0.0)
    wild = y.copy()
    wild[::50] += 50.0
    clean, judged = validate(model, y, u), validate(model, wild, u)
    for one, other in zip(judged.fits, clean.fits, strict=True):
        assert one.kind == other.kind
        assert one.ordinary == pytest.approx(other.ordinary, abs=0.2)
        assert one.all < other.all - 20.0
    assert clean.fits[-1].all == pytest.approx(model.fit(y, u))
    assert judged.verdict in str(judged) and "free run" in judged.to_text()


def test_every_input_of_several_is_tested():
    rng = np.random.default_rng(10)
    u = rng.choice([-1.0, 1.0], (1000, 2))
    y = u[:, 0] + lfilter([0.0, 0.0, 0.5, 0.4], [1.0], u[:, 1]) + 0.3 * rng.normal(size=1000)
    judged = validate(identify(y, u, FIR((2, 2), nk=0)), y, u)
    assert judged.cross_correlation.shape == (2, 21)
    assert "residuals follow input 1 at lags 2-3" in judged.verdict
    alone = validate(identify(y, None, ARX(4, 0)), y)
    assert alone.independence is None and [fit.kind for fit in alone.fits] == ["1 step", "10 steps"]


def test_models_are_sorted_by_their_fit_on_the_same_ordinary_samples(model):
    y, u = recording(11, 1000)
    y[:3] = np.nan
    models = {"small": identify(y, u, OutputError(1, 1)), "right": model, "late": identify(y, u, OutputError(2, 2, 3))}
    ranked = compare(models, y, u)
    assert ranked.rows[0].name == "right"
    assert [row.fit for row in ranked.rows] == sorted((row.fit for row in ranked.rows), reverse=True)
    residual = model.residuals(y, u)
    assert ranked.samples == np.isfinite(models["late"].residuals(y, u)).sum() < np.isfinite(residual).sum()
    good = np.abs(residual) < 3.0 * 1.4826 * np.nanmedian(np.abs(residual[4:]))
    assert ranked.ordinary == good[4:].sum()
    good[:4] = False
    expected = 100 * (1 - np.linalg.norm(residual[good]) / np.linalg.norm(y[good] - y[good].mean()))
    assert ranked.rows[0].fit == pytest.approx(expected)
    assert str(ranked).splitlines()[1].startswith("right")


def armax(seed, whose, length=1000):
    """A recording of an ARMAX(2, 2, 2) with outliers of the process or of the measurement."""
    rng, c = np.random.default_rng(seed), [1.0, 0.7, 0.3]
    u, e = rng.choice([-1.0, 1.0], length), 0.3 * rng.normal(size=length)
    wild = np.where(rng.random(length) < 0.1, 3.0 * rng.normal(size=length), 0.0)
    clean = lfilter(B, A, u)
    return clean + lfilter(c, A, e + wild * (whose == "process")) + wild * (whose == "measurement"), u


@support.draws(1, 5)
@pytest.mark.parametrize("whose", support.by_night(["process", "measurement"], "measurement"))
def test_a_right_armax_is_not_condemned_for_outliers(whose, draws):
    condemned = 0
    for seed in range(draws):
        y, u = armax([77, seed], whose)
        model = identify(y, u, ARMAX(2, 2, 2))
        assert "another plant" not in {one.kind for one in model.findings}
        condemned += validate(model, y, u).verdict != RIGHT
    assert condemned <= draws // 5


def test_a_wrong_armax_is_condemned_through_outliers():
    y, u = armax(3, "process", 400)
    for structure in (ARX(2, 2), ARMAX(1, 2, 1)):
        assert validate(identify(y, u, structure), y, u).verdict != RIGHT


@pytest.mark.parametrize("a1, a2", [(0.0, 0.0), (-0.6, 0.0), (-0.9, 0.5), (0.3, -0.2)])
def test_noise_of_second_order_is_made_white_by_its_own_polynomial(a1, a2):
    r1 = -a1 / (1.0 + a2)
    whitening = whitening_of(np.array([4.0, 4.0 * r1, 4.0 * (-a1 * r1 - a2)]))
    np.testing.assert_allclose(whitening, [a1, a2], atol=0.05)
    # Where there is no noise nothing is made white.
    assert whitening_of(np.zeros(3)) == ()


# Dynamics and noise are judged apart; residuals that are rounding have a verdict.


@pytest.mark.parametrize(("structure", "step"), [(OutputError(2, 2), 0.1), (OutputError(2, 2), 8.0), (ARX(2, 2), 8.0)])
def test_a_sensor_that_rounds_gets_a_verdict(structure, step):
    y, u = recording(100, 600, sigma=0.0)
    y = step * np.round(y / step)
    judged = validate(identify(y, u, structure, progress=False), y[300:], u[300:])
    assert judged.verdict and judged.dynamics and judged.noise


@pytest.mark.parametrize("structure", [ARX(2, 2), OutputError(2, 2)])
def test_inputs_that_explain_little_are_said(structure):
    """Blocks of the output were swapped: what is left follows no input, since nothing does."""
    y, u = recording(2, 900)
    y = y[np.r_[0:200, 500:800, 200:500, 800:900]]
    judged = validate(identify(y, u, structure, progress=False), y, u)
    assert re.fullmatch("right: .* inputs, which explain [0-9]+ % of the output", judged.dynamics), judged.dynamics


@pytest.mark.parametrize("seed", [11, 12])
def test_a_right_model_with_coloured_noise_has_right_dynamics(seed):
    w, u = recording(seed, 1200, sigma=0.0)
    noise = lfilter([1.0], [1.0, -0.8], 0.3 * np.random.default_rng(seed + 50).normal(size=w.size))
    judged = validate(identify(w + noise, u, OutputError(2, 2), progress=False), w + noise, u)
    assert judged.dynamics == "right: residuals do not follow the inputs"
    assert judged.noise.startswith("not white: residuals follow one another at lag")
    assert judged.verdict == f"the noise is {judged.noise}"
    small = validate(identify(w + 0.1 * noise, u, OutputError(1, 1), progress=False), w + 0.1 * noise, u)
    assert small.dynamics.startswith("missing: residuals follow u at lag")
    assert small.verdict.startswith(f"dynamics are {small.dynamics}")
    for line in (judged.dynamics, judged.noise):
        assert line in judged.to_text()


def test_a_transfer_function_is_judged_as_its_model_and_a_wrong_one_is_named():
    (y, u), (fresh, input_) = (recording(seed, 1500, b=[0.0, *B]) for seed in (10005, 10006))
    fresh[100:110] = np.nan
    model = identify(40.0 + y, u, OutputError(2, 2, nk=2))
    # python-control writes polynomials in z.
    late = control.TransferFunction([1.0, 0.5], [1.0, -1.5, 0.7, 0.0, 0.0], True)
    systems = {"late": late, "model": model, "system": model.transfer_function(0.1)}
    *right, last = compare(systems, 40.0 + fresh, input_).rows
    ours, theirs = sorted(right)
    assert last.name == "late"
    np.testing.assert_allclose(ours[1:], theirs[1:], atol=0.05)
    assert validate(systems["system"], 40.0 + fresh, input_).verdict == RIGHT
    assert validate(late, 40.0 + fresh, input_).verdict.startswith("dynamics are missing")


# Several outputs, and physics.


def judged(seed, outliers=0.1, driven=0.0, gain=1.0):
    """Two outputs of a plant of three states."""
    return of_states([41, *np.atleast_1d(seed)], 400, outliers, driven=driven, gain=gain)


def lag(x, u, p):
    """A lag of first order."""
    return [p[0] * (p[1] * u[0] - x[0])]


def two_lags(x, u, p):
    """Another one after it."""
    return [p[0] * (p[1] * u[0] - x[0]), p[2] * (x[0] - x[1])]


ONE = GreyBox(lag, {"rate": 0.7, "gain": 1.0}, x0=[0.0])
TWO = GreyBox(two_lags, {"rate": 0.7, "gain": 1.0, "second": 0.4}, x0=[0.0, 0.0], h=lambda x, u, p: x[-1:])


def cascade(seed, outliers=0.1, gain=2.0, samples=100):
    """Two lags at irregular times, of which the second is measured."""
    rng = np.random.default_rng([43, seed])
    t, u = np.cumsum(rng.uniform(0.2, 1.8, samples)), np.repeat(rng.normal(size=samples // 5), 5)
    F, x = np.array([[-0.5, 0.0], [0.3, -0.3]]), np.zeros((samples, 2))
    for k in range(samples - 1):
        x[k + 1] = gain * u[k] + expm(F * (t[k + 1] - t[k])) @ (x[k] - gain * u[k])
    return x[:, 1] + wild(rng, samples, 0.05, outliers), u, t


@pytest.fixture(scope="module")
def states():
    return identify(*judged(0), StateSpace(3))


@pytest.fixture(scope="module")
def box():
    y, u, t = cascade(0)
    return identify(y, u, TWO, t=t)


@support.draws(4, 12)
@pytest.mark.parametrize("outliers", support.by_night([0.0, 0.1], 0.1))
def test_p_values_of_right_states_are_uniform_on_their_own_and_on_fresh_recordings(outliers, draws):
    same, fresh = [], []
    for seed in range(draws):
        model = identify(*judged([1, seed], outliers), StateSpace(3))
        same += validate(model, *judged([1, seed], outliers))
        fresh += validate(model, *judged([2, seed], outliers))
    assert all(one.same_recording for one in same) and not any(one.same_recording for one in fresh)
    for some in (same, fresh):
        for values in np.transpose([(one.whiteness.p_value, one.independence.p_value) for one in some]):
            low, high = binom.interval(0.999, len(values), 0.5)
            assert low <= np.sum(values < 0.5) <= high and min(values) > 1e-4
            assert np.sum(values < 0.05) <= binom.ppf(0.9995, len(values), 0.05)
    # What the fit has made zero is no evidence.
    assert max(one.independence.degrees for one in same) < 42 == fresh[0].independence.degrees


@pytest.mark.parametrize("outliers", support.by_night([0.0, 0.1], 0.1))
def test_right_states_driven_by_noise_pass_and_without_it_said_they_do_not(outliers):
    first, second = judged(3, outliers, 0.3), judged(4, outliers, 0.3)
    model = identify(*first, StateSpace(3, disturbance=True))
    assert validate(model, *first).verdict == validate(model, *second).verdict == RIGHT
    assert "residuals follow one another" in validate(identify(*first, StateSpace(3)), *second).verdict


def test_gaps_fill_values_and_wild_samples_raise_no_alarm(states, box):
    y, u = judged(5)
    found = validate(states, np.where(np.random.default_rng(0).random(y.shape) < 0.2, 9999.0, y), u)
    assert found.verdict == RIGHT and found[0].samples < 360
    y, u, t = cascade(5)
    y[::7] = np.nan
    y[60] = 1e9
    assert validate(box, y, u, lags=10, t=t).verdict == RIGHT


def test_an_order_too_little_is_named_by_output_and_input(states):
    y, u = judged(6)
    small = identify(*judged(0), StateSpace(2))
    assert "output 0: dynamics are missing: residuals follow input" in validate(small, y, u).verdict
    right = validate(states, y, u, level=0.9801)
    assert right.verdict == RIGHT and "output 1: nothing is left" in str(right)
    assert isinstance(right, Validations) and all(isinstance(one, Validation) for one in right)
    assert [one.level for one in right] == pytest.approx([0.99, 0.99])
    assert right[1].cross_correlation.shape == (2, 21) and right[0].fits[-1].all == pytest.approx(states.fit(y, u)[0])
    assert right.to_frame()["output 1", "autocorrelation"][3] == right[1].autocorrelation[2]
    assert [row.name for row in compare({"small": small, "right": states}, y, u).rows] == ["right", "small"]


def test_only_the_output_that_is_wrong_is_named(states):
    y, u = judged(7)
    y[:, 1] = 1.5 * (y[:, 1] + 300.0) - 300.0
    verdict = validate(states, y, u).verdict
    assert verdict.startswith("output 1: dynamics are missing") and "output 0" not in verdict
    # Of a model that is far off all residuals are large, and large is not wild.
    one = identify(judged(0)[0][:, 0], judged(0)[1], OutputError(4, (4, 4)))
    assert validate(one, 1.5 * (y[:, 0] - 5.0) + 5.0, u).verdict.startswith("dynamics are missing")


@pytest.mark.nightly
def test_equations_that_lack_a_state_are_named(box):
    (y, u, t), fresh = cascade(0), cascade(9)
    simple = identify(y, u, ONE, t=t)
    assert validate(simple, *fresh[:2], lags=10, t=fresh[2]).verdict != RIGHT
    assert compare({"lag": simple, "two": box}, *fresh).rows[0].name == "two"


def test_another_level_is_said_and_is_no_missing_dynamics(states, model):
    y, u = judged(10)
    found = validate(states, y + [0.0, 40.0], u)
    assert found.verdict.startswith("output 1: the level is +40") and "dynamics" not in found.verdict
    assert found[1].shift == pytest.approx(40.0, abs=0.2)
    y, u = recording(12)
    plain = validate(model, y + 3.0, u)
    assert plain.verdict.startswith("the level is +") and "dynamics" not in plain.verdict
    assert plain.shift == pytest.approx(3.0, abs=0.1)


def test_physics_begins_where_the_recording_does(box):
    y, u, t = cascade(15, outliers=0.0)
    run = box.free_run(y[60:], u[60:], t[60:])
    assert np.abs(run - y[60:, None]).max() < 0.3
    np.testing.assert_allclose(box.residuals(y[60:], u[60:], t[60:]), y[60:, None] - run)
    assert box.fit(y[60:], u[60:], t[60:])[0] > 85.0


def test_every_kind_of_model_is_compared_with_physics_of_equal_steps():
    share, t = np.exp(-0.25), 0.5 * np.arange(100.0)
    y, u = recording(2, 100, share=0.0, sigma=0.05, a=[1.0, -share], b=[0.0, 2.0 * (1.0 - share)])
    models = {"physics": identify(y, u, ONE, t=t), "states": identify(y, u, StateSpace(1))}
    models["polynomials"] = identify(y, u, OutputError(1, 1))
    ranked = compare(models, y, u, t)
    assert ranked.measured.shape == (100,) and max(row.fit for row in ranked.rows) - ranked.rows[-1].fit < 0.5
    index = pd.to_datetime("2024-01-01") + pd.to_timedelta(t, unit="s")
    timed = compare(models, pd.Series(y, index), pd.Series(u, index))
    assert timed.index.equals(index) and timed.rows[0].fit == pytest.approx(ranked.rows[0].fit)


# Refusals.

SYSTEM = control.TransferFunction([1.0, 0.5], [1.0, -1.5, 0.7, 0.0], 0.2)
SYSTEMS = [
    (control.TransferFunction([1.0], [1.0, 1.0]), "discrete time"),
    (control.TransferFunction([[[1.0], [1.0]]], [[[1.0, 0.5], [1.0, 0.5]]], True), "one input"),
    (control.TransferFunction([1.0, 0.0, 0.0], [1.0, 0.5], True), "proper"),
    (OutputError(2, 2), "GreyBoxModel that identify found, or a control.TransferFunction"),
]
INDEX = pd.date_range("2026-01-01", periods=400, freq="100ms")


def test_what_cannot_be_judged_is_refused_by_name(model, states, box):
    y, u = recording(0)
    (several, inputs), t = judged(16), np.arange(400.0)
    one, both = identify(y, u, OutputError(1, 1)), np.column_stack((y, y))
    refused = [
        *((lambda it=it: validate(it, y, u), "model: .*" + says) for it, says in SYSTEMS),
        *((lambda it=it: compare({"it": it}, y, u), r"models\['it'\].*" + says) for it, says in SYSTEMS),
        (lambda: validate(model, y, u, lags=0), "lags"),
        (lambda: validate(model, y, u, lags=200), "y: expected at least 804"),
        (lambda: validate(model, y, u, level=1.0), "level"),
        (lambda: validate(model, y, u, steps=1.5), "steps"),
        (lambda: validate(SYSTEM, pd.Series(y, INDEX), pd.Series(u, INDEX)), r"0\.2"),
        (lambda: validate(states, [several, several], [inputs, inputs]), "expected one recording"),
        (lambda: validate(states, np.column_stack((several, y)), inputs), r"expected shape \(N, 2\)"),
        (lambda: validate(states, several * [1.0, np.nan], inputs), "at least 84 measured samples of output 1"),
        (lambda: validate(states, several, inputs, t=t**2), "t: expected equal steps"),
        (lambda: validate(states, several, inputs, t=t[:-1]), "t: expected 400 times"),
        (lambda: validate(box, y, u), "t: expected the times"),
        (lambda: validate(box, y, None, t=t), "u: expected the inputs that f takes"),
        (lambda: compare({}, y, u), "models: expected at least one"),
        (lambda: compare([one], y, u), "models: expected"),
        (lambda: compare({"box": box}, both, u, t), r"as y has, 2, got models\['box'\] of 1;"),
        (lambda: compare({"states": states}, y, inputs, t), r"as y has, 1, got models\['states'\] of 2;"),
        (lambda: compare({"states": states, "one": one}, both, inputs, t),
         r"as y has, 2, got models\['states'\] of 2, models\['one'\] of 1;"),
    ]  # fmt: skip
    for call, says in refused:
        with pytest.raises((ValueError, TypeError), match=says):
            call()
    assert len(compare({"one": one, "box": box}, y[:, None], u, t).rows) == 2
