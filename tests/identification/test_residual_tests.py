"""validate and compare: nominal false alarms whatever the contamination, and what is missing is named."""

import re
from dataclasses import replace

import control
import numpy as np
import pytest
import support
from scipy.signal import lfilter
from statsmodels.stats.diagnostic import acorr_ljungbox

from robust_filterpy.identification import ARMAX, ARX, FIR, OutputError, compare, identify, validate
from robust_filterpy.identification.models.dependence import whitening_of
from robust_filterpy.influence import Linear

A, B = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5]
THETA = np.array([-1.5, 0.7, 1.0, 0.5])
LEVELS = (0.05, 0.2, 0.5)


def recorded(seed, share=0.1, length=400, noise=(1.0,), b=B):
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], length)
    wild = np.where(rng.random(length) < share, 10.0, 1.0)
    return lfilter(b, A, u) + lfilter([1.0], noise, 0.3 * rng.normal(size=length)) * wild, u


def assert_nominal(p_values):
    """Shares below each level within 5 standard errors."""
    p_values = np.array(p_values)
    for level in LEVELS:
        error = np.sqrt(level * (1.0 - level) / p_values.size)
        assert abs((p_values < level).mean() - level) < 5.0 * error, f"{(p_values < level).mean()} below {level}"


@pytest.fixture(scope="module")
def model():
    return identify(*recorded(0, length=2000), OutputError(2, 2))


# False alarms.


@support.draws(60, 300)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.2])
def test_the_false_alarm_rate_is_nominal_for_the_true_parameters(model, share, draws):
    truth = replace(model, theta=THETA, offset=0.0, P=np.zeros((4, 4)), offset_std=0.0, offset_covariance=np.zeros(4))
    found = [validate(truth, *recorded([1, seed], share), steps=1) for seed in range(draws)]
    assert_nominal([one.whiteness.p_value for one in found])
    assert_nominal([one.independence.p_value for one in found])
    outside = np.mean([np.abs(one.autocorrelation) > one.autocorrelation_bound for one in found])
    assert abs(outside - 0.01) < 5.0 * np.sqrt(0.01 / (20 * draws))
    outside = np.mean([np.abs(one.cross_correlation) > one.cross_bound for one in found])
    assert abs(outside - 0.01) < 5.0 * np.sqrt(0.01 / (21 * draws))


@support.draws(30, 150)
@pytest.mark.parametrize("share", [0.1, *(pytest.param(share, marks=pytest.mark.nightly) for share in (0.0, 0.2))])
def test_the_false_alarm_rate_is_nominal_after_the_fit_and_on_a_fresh_recording(share, draws):
    structure, same, fresh = FIR(3), [], []
    b = [0.0, 1.0, 0.5, 0.2]
    for seed in range(draws):
        y, u = moving(seed, share, b)
        one = identify(y, u, structure)
        same.append(validate(one, y, u, steps=1))
        fresh.append(validate(one, *moving(1000 + seed, share, b), steps=1))
    assert all(one.same_recording for one in same) and not any(one.same_recording for one in fresh)
    for found in (same, fresh):
        assert_nominal([one.whiteness.p_value for one in found])
        assert_nominal([one.independence.p_value for one in found])
    # The fit has made three of the 21 cross-correlations zero.
    assert {one.independence.degrees for one in same} == {18} and {one.independence.degrees for one in fresh} == {21}


def moving(seed, share, b, length=300):
    rng = np.random.default_rng([2, seed])
    u = rng.choice([-1.0, 1.0], length)
    return lfilter(b, [1.0], u) + 0.3 * np.where(rng.random(length) < share, 10.0, 1.0) * rng.normal(size=length), u


def test_gaps_raise_no_alarm(model):
    y, u = recorded(3, length=1000)
    y[np.random.default_rng(0).random(1000) < 0.3] = np.nan
    found = validate(model, y, u)
    assert found.verdict == "nothing is left in the residuals"
    assert found.samples == np.isfinite(model.residuals(y, u)).sum()


def test_one_wild_sample_moves_no_correlation(model):
    y, u = recorded(4)
    before = validate(model, y, u)
    y[200] = 1e9
    after = validate(model, y, u)
    np.testing.assert_allclose(after.autocorrelation, before.autocorrelation, atol=0.1)
    np.testing.assert_allclose(after.cross_correlation, before.cross_correlation, atol=0.1)
    assert after.verdict == before.verdict


def test_without_outliers_the_statistic_is_that_of_ljung_and_box():
    y, u = recorded(5, share=0.0, length=2000)
    one = identify(y, u, OutputError(2, 2), influence=Linear())
    found = validate(one, *recorded(6, share=0.0, length=2000), lags=10)
    residual = one.residuals(*recorded(6, share=0.0, length=2000))
    peer = acorr_ljungbox(residual[~np.isnan(residual)], lags=[10])
    assert found.whiteness.statistic == pytest.approx(float(peer.lb_stat.iloc[0]), rel=0.1)
    assert found.whiteness.degrees == 10


# What is wrong.


def test_missing_dynamics_are_named_with_their_lags():
    b = [0.0, 1.0, 0.5, 0.2, 0.4, 0.3]
    y, u = moving(1, 0.1, b, 2000)
    found = validate(identify(y, u, FIR(3)), y, u)
    assert re.match(r"dynamics are missing: residuals follow u at lags 4-5", found.verdict)
    assert "nothing is left" in validate(identify(y, u, FIR(5)), y, u).verdict


@support.draws(6, 20)
def test_bounds_hold_where_noise_and_input_are_coloured_alike(draws):
    """Without the residuals' autocorrelations a third of the chance correlations would lie outside."""
    outside, b = [], [0.0, 1.0, 0.5, 0.2]
    for seed in range(draws):
        rng = np.random.default_rng([12, seed])
        u = lfilter([1.0], [1.0, -0.9], rng.normal(size=600))
        y = lfilter(b, [1.0], u) + lfilter([1.0], [1.0, -0.9], 0.3 * rng.normal(size=600))
        truth = replace(
            identify(y, u, FIR(3)), theta=np.array(b[1:]), P=np.zeros((3, 3)), offset=0.0, offset_std=0.0,
            offset_covariance=np.zeros(3), weights=np.ones(600),
        )  # fmt: skip
        found = validate(truth, y, u, steps=1)
        outside.append(np.abs(found.cross_correlation) > found.cross_bound)
    assert np.mean(outside) < 0.05


def test_an_arx_model_of_its_own_noise_passes():
    rng = np.random.default_rng(8)
    u = rng.choice([-1.0, 1.0], 2000)
    y = lfilter(B, A, u) + lfilter([1.0], A, 0.3 * rng.normal(size=2000))
    assert validate(identify(y, u, ARX(2, 2)), y, u).verdict == "nothing is left in the residuals"
    assert "residuals follow" in validate(identify(y, u, ARX(1, 2)), y, u).verdict
    alone = validate(identify(y, None, ARX(4, 0)), y)
    assert alone.independence is None and [fit.kind for fit in alone.fits] == ["1 step", "10 steps"]


def test_fits_of_ordinary_samples_are_those_without_the_outliers(model):
    y, u = recorded(9, share=0.0, length=1000)
    wild = y.copy()
    wild[::50] += 50.0
    clean, found = validate(model, y, u), validate(model, wild, u)
    for one, other in zip(found.fits, clean.fits, strict=True):
        assert one.kind == other.kind
        assert one.ordinary == pytest.approx(other.ordinary, abs=0.2)
        assert one.all < other.all - 20.0
    assert clean.fits[-1].all == pytest.approx(model.fit(y, u))
    assert found.verdict in str(found) and "free run" in found.to_text()


def test_every_input_of_several_is_tested():
    rng = np.random.default_rng(10)
    u = rng.choice([-1.0, 1.0], (1000, 2))
    y = u[:, 0] + np.concatenate(([0.0, 0.0], 0.5 * u[:-2, 1])) + 0.3 * rng.normal(size=1000)
    found = validate(identify(y, u, FIR((2, 2), nk=0)), y, u)
    assert found.cross_correlation.shape == (2, 21)
    assert "residuals follow input 1 at lag 2" in found.verdict


# compare.


def test_models_are_sorted_by_their_fit_on_the_same_ordinary_samples(model):
    y, u = recorded(11, length=1000)
    y[:3] = np.nan
    models = {"small": identify(y, u, OutputError(1, 1)), "right": model, "late": identify(y, u, OutputError(2, 2, 3))}
    found = compare(models, y, u)
    assert found.rows[0].name == "right"
    assert [row.fit for row in found.rows] == sorted((row.fit for row in found.rows), reverse=True)
    residual = model.residuals(y, u)
    assert found.samples == np.isfinite(models["late"].residuals(y, u)).sum() < np.isfinite(residual).sum()
    good = np.abs(residual) < 3.0 * 1.4826 * np.nanmedian(np.abs(residual[4:]))
    assert found.ordinary == good[4:].sum()
    good[:4] = False
    expected = 100 * (1 - np.linalg.norm(residual[good]) / np.linalg.norm(y[good] - y[good].mean()))
    assert found.rows[0].fit == pytest.approx(expected)
    assert str(found).splitlines()[1].startswith("right")


# Bad input.


@pytest.mark.parametrize(("options", "error", "message"), [
    ({"lags": 0}, ValueError, "lags"), ({"lags": 200}, ValueError, "y: expected at least 804"),
    ({"level": 1.0}, ValueError, "level"), ({"steps": 1.5}, TypeError, "steps"),
])  # fmt: skip
def test_bad_options_are_refused_by_name(model, options, error, message):
    with pytest.raises(error, match=message):
        validate(model, *recorded(0), **options)


def test_what_is_no_model_is_refused_by_name(model):
    y, u = recorded(0)
    with pytest.raises(TypeError, match="model: expected a Model"):
        validate(OutputError(2, 2), y, u)
    with pytest.raises(TypeError, match=r"models\['a'\]: expected a Model"):
        compare({"a": 3}, y, u)
    with pytest.raises(TypeError, match="models: expected"):
        compare([model], y, u)
    with pytest.raises(ValueError, match="models: expected at least one"):
        compare({}, y, u)


@support.draws(1, 5)
@pytest.mark.parametrize("whose", support.by_night(["process", "measurement"], "measurement"))
def test_a_right_armax_is_not_condemned_for_outliers(whose, draws):
    a, b, c = [1.0, -1.5, 0.7], [0.0, 1.0, 0.5], [1.0, 0.7, 0.3]
    condemned = 0
    for seed in range(draws):
        rng = np.random.default_rng([77, seed])
        u, e = rng.choice([-1.0, 1.0], 1000), 0.3 * rng.normal(size=1000)
        wild = np.where(rng.random(1000) < 0.1, 3.0 * rng.normal(size=1000), 0.0)
        y = lfilter(b, a, u) + lfilter(c, a, e + wild * (whose == "process")) + wild * (whose == "measurement")
        model = identify(y, u, ARMAX(2, 2, 2))
        assert "another plant" not in {one.kind for one in model.findings}
        condemned += validate(model, y, u).verdict != "nothing is left in the residuals"
    assert condemned <= draws // 5


def test_a_wrong_armax_is_condemned_through_outliers():
    rng = np.random.default_rng(3)
    u, e = rng.choice([-1.0, 1.0], 400), 0.3 * rng.normal(size=400)
    wild = np.where(rng.random(400) < 0.1, 3.0 * rng.normal(size=400), 0.0)
    y = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + lfilter([1.0, 0.7, 0.3], [1.0, -1.5, 0.7], e + wild)
    for structure in (ARX(2, 2), ARMAX(1, 2, 1)):
        assert validate(identify(y, u, structure), y, u).verdict != "nothing is left in the residuals"


@pytest.mark.parametrize("a1, a2", [(0.0, 0.0), (-0.6, 0.0), (-0.9, 0.5), (0.3, -0.2)])
def test_noise_of_second_order_is_made_white_by_its_own_polynomial(a1, a2):
    r1 = -a1 / (1.0 + a2)
    found = whitening_of(np.array([4.0, 4.0 * r1, 4.0 * (-a1 * r1 - a2)]))
    np.testing.assert_allclose(found, [a1, a2], atol=0.05)


def test_where_there_is_no_noise_nothing_is_made_white():
    assert whitening_of(np.zeros(3)) == ()


# validate says of dynamics and of noise apart, and has a verdict for residuals that are rounding.




def plant(seed, n=600):
    """Input and noise-free output of a plant of order 2."""
    u = np.random.default_rng(seed).choice([-1.0, 1.0], n)
    return u, lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u)


@pytest.mark.parametrize(("structure", "step"), [(OutputError(2, 2), 0.1), (OutputError(2, 2), 8.0), (ARX(2, 2), 8.0)])
def test_a_sensor_that_rounds_gets_a_verdict(structure, step):
    u, w = plant(100)
    y = step * np.round(w / step)
    model = identify(y, u, structure, progress=False)
    found = validate(model, y[300:], u[300:])
    assert found.verdict and found.dynamics and found.noise


@pytest.mark.parametrize("seed", [11, 12])
def test_a_right_model_with_coloured_noise_has_right_dynamics(seed):
    u, w = plant(seed, 1200)
    noise = lfilter([1.0], [1.0, -0.8], 0.3 * np.random.default_rng(seed + 50).normal(size=w.size))
    found = validate(identify(w + noise, u, OutputError(2, 2), progress=False), w + noise, u)
    assert found.dynamics == "right: residuals do not follow the inputs"
    assert found.noise.startswith("not white: residuals follow one another at lag")
    assert found.verdict == f"the noise is {found.noise}"
    small = validate(identify(w + 0.1 * noise, u, OutputError(1, 1), progress=False), w + 0.1 * noise, u)
    assert small.dynamics.startswith("missing: residuals follow u at lag")
    assert small.verdict.startswith(f"dynamics are {small.dynamics}")
    for line in (found.dynamics, found.noise):
        assert line in found.to_text()


# validate and compare take transfer functions of python-control: those of a model give the model's numbers.


def delayed(seed=10005, size=1500):
    y, u = recorded(seed, length=size, b=[0.0, *B])
    return 40.0 + y, u


def test_that_of_a_model_is_judged_as_the_model():
    model = identify(*delayed(), OutputError(2, 2, nk=2))
    y, u = delayed(seed=10006)
    found = compare({"model": model, "transfer function": model.transfer_function(0.1)}, y, u)
    ours, theirs = sorted(found.rows)
    np.testing.assert_allclose(ours[1:], theirs[1:], atol=0.05)
    one, other = validate(model, y, u), validate(model.transfer_function(0.1), y, u)
    assert one.verdict == other.verdict == "nothing is left in the residuals"


def test_the_true_one_passes_and_a_wrong_one_is_named():
    y, u = delayed()
    y[100:110] = np.nan
    # python-control writes polynomials in z.
    right = control.TransferFunction([1.0, 0.5], [1.0, -1.5, 0.7, 0.0], True)
    late = control.TransferFunction([1.0, 0.5], [1.0, -1.5, 0.7, 0.0, 0.0], True)
    assert validate(right, y, u).verdict == "nothing is left in the residuals"
    assert validate(late, y, u).verdict.startswith("dynamics are missing")
    assert [row.name for row in compare({"late": late, "right": right}, y, u).rows] == ["right", "late"]


@pytest.mark.parametrize("system, error, message", [
    (control.TransferFunction([1.0], [1.0, 1.0]), ValueError, "discrete time"),
    (control.TransferFunction([[[1.0], [1.0]]], [[[1.0, 0.5], [1.0, 0.5]]], True), ValueError, "one input"),
    (control.TransferFunction([1.0, 0.0, 0.0], [1.0, 0.5], True), ValueError, "proper"),
    (3.0, TypeError, "StateSpaceModel or GreyBoxModel that identify found, or a control.TransferFunction"),
])  # fmt: skip
def test_what_cannot_be_judged_is_refused(system, error, message):
    y, u = delayed(size=200)
    with pytest.raises(error, match=message):
        validate(system, y, u)
    with pytest.raises(error, match=r"models\['it'\].*" + message):
        compare({"it": system}, y, u)


def test_another_period_than_that_of_the_recording_is_refused():
    pd = pytest.importorskip("pandas")
    y, u = delayed(size=300)
    index = pd.date_range("2026-01-01", periods=300, freq="100ms")
    system = control.TransferFunction([1.0, 0.5], [1.0, -1.5, 0.7, 0.0], 0.2)
    with pytest.raises(ValueError, match=r"0\.2"):
        validate(system, pd.Series(y, index), pd.Series(u, index))
