"""identify: the estimate that the truth would lead to, found from nothing; the same in any unit, whatever outliers."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
import statsmodels.api as sm
import support
from recordings import RIGHT, THETA, A, B, assert_refused, binary, recording, unheard, wild
from scipy.signal import lfilter
from statsmodels.tsa.statespace.sarimax import SARIMAX

from robust_filterpy import ARX, Huber, OutputError, identify
from robust_filterpy.correction.contaminated import Contaminated
from robust_filterpy.identification import ARMAX, FIR, GreyBox, LinearRegression, StateSpace, validate
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.influence import Linear


def random_plant(rng, order):
    poles = [rng.uniform(0.4, 0.95) * np.exp(1j * rng.uniform(0.2, 2.5)) for _ in range(order // 2)]
    return np.real(np.poly([*poles, *np.conj(poles)])), np.concatenate(([0.0], rng.normal(size=order)))


# The optimum, from nothing.


@support.draws(1, 3)
@pytest.mark.parametrize("order", [2, 4])
def test_the_cold_start_reaches_the_optimum_to_which_the_truth_leads_scipy(order, draws):
    for seed in range(draws):
        rng = np.random.default_rng([order, seed])
        a, b = random_plant(rng, order)
        y, u = recording(rng, 600, a=a, b=b)
        found = identify(y, u, OutputError(order, order), influence=Huber(1.345), R=0.09)
        model = PolynomialModel(OutputError(order, order), y, u[:, None], True)
        residual = lambda p, model=model: model.residuals(p) / (1.345 * 0.3)  # noqa: E731
        start = np.concatenate((a[1:], b[1:], np.zeros(1 + order)))
        best = scipy.optimize.least_squares(residual, start, loss="huber", xtol=1e-14, ftol=1e-14, gtol=1e-12)
        np.testing.assert_allclose(found.theta, best.x[: 2 * order], atol=1e-5)


def test_of_ends_that_a_robust_loss_hardly_tells_apart_the_noise_of_the_residuals_chooses():
    # Huber's loss is 3 units less with a model 5 points worse, whose residuals are 26 units less likely.
    a = [1.0, -1.082614545041752, 1.0350084852437031, -0.6492965479661003, 0.5924343275842809]
    b = [0.0, -0.32066528055244836, -0.02054432307540973, -0.31345983890173434, 0.10036707177345773]
    rng = np.random.default_rng([11, 4, 2])
    rng.uniform(size=4), rng.normal(size=4)
    u, wild, noise = rng.choice([-1.0, 1.0], 2000), rng.random(2000) < 0.1, rng.normal(size=2000)
    y = lfilter(b, a, u) + 0.3 * np.where(wild, 10.0, 1.0) * noise
    model = identify(y, u, OutputError(4, 4), influence=Huber())
    fresh = rng.choice([-1.0, 1.0], 2000)
    clean = lfilter(b, a, fresh)
    assert np.linalg.norm(model.simulate(fresh) - model.level - clean) < 0.03 * np.linalg.norm(clean)


@pytest.mark.parametrize("structure", [ARX(2, 2), FIR(3), LinearRegression(2), ARX(1, (1, 2), nk=(0, 2))], ids=str)
def test_without_robustness_linear_structures_are_least_squares(structure):
    rng = np.random.default_rng(1)
    u = rng.normal(size=(300, structure.n_inputs))
    y = lfilter([1.0], [1.0, -0.5], u[:, 0]) + 2.0 + 0.1 * rng.normal(size=300)
    X = np.column_stack((structure.regressors(u, y), np.ones(300)))
    first = PolynomialModel(structure, y, u, True).first
    expected = np.linalg.lstsq(X[first:], y[first:], rcond=None)[0]
    # No sample is wrong: R says that everything is ordinary.
    model = identify(y, u, structure, influence=Linear(), R=1e4)
    # A coefficient whose truth is 0 is compared on the scale of the others.
    np.testing.assert_allclose([*model.theta, model.offset], expected, rtol=1e-6, atol=1e-8)


def test_the_variance_counts_the_parameters_that_were_fitted():
    rng = np.random.default_rng(1)
    X = rng.normal(size=(40, 8))
    y = X @ np.arange(8.0) + rng.normal(size=40)
    for fixed in ({}, {"theta1": 0.0}):
        free = np.column_stack((X[:, len(fixed) :], np.ones(40)))
        residual = y - free @ np.linalg.lstsq(free, y, rcond=None)[0]
        expected = (1.4826 * np.median(np.abs(residual))) ** 2 * 40 / (40 - free.shape[1])
        model = identify(y, X, LinearRegression(8), influence=Linear(), fixed=fixed or None)
        assert model.R == pytest.approx(expected, rel=1e-3)


def test_a_robust_regression_is_statsmodels():
    rng = np.random.default_rng(2)
    X = rng.normal(size=(400, 3))
    y = X @ [1.0, -2.0, 0.5] + 4.0 + wild(rng, 400, share=0.15)
    expected = sm.RLM(y, sm.add_constant(X), M=sm.robust.norms.HuberT(1.345)).fit(tol=1e-10, maxiter=200)
    ours = identify(y, X, LinearRegression(3), influence=Huber(1.345))
    np.testing.assert_allclose([ours.offset, *ours.theta], expected.params, atol=1e-6)
    theirs = identify(y, X, LinearRegression(3), influence=sm.robust.norms.HuberT(1.345))
    np.testing.assert_allclose(theirs.theta, ours.theta, atol=1e-10)
    np.testing.assert_allclose(ours.weights, expected.weights, atol=1e-5)


@pytest.mark.parametrize(("structure", "c", "near"), [(ARX(2, 0), [1.0], 0.1), (ARMAX(2, 0, 1), [1.0, 0.5], 0.4)])
def test_missing_outputs_in_the_regressor_are_those_of_the_exact_likelihood(structure, c, near):
    """To a share of a standard deviation: C's own coefficient is not quite the most likely one."""
    for seed in range(2):
        rng = np.random.default_rng(seed)
        y = lfilter(c, A, 0.5 * rng.normal(size=4000))
        y[rng.random(4000) < 0.15] = np.nan
        theirs = SARIMAX(y, order=(2, 0, len(c) - 1))
        with theirs.fix_params({"sigma2": 0.25}):
            exact = theirs.fit(disp=0)
        expected = np.concatenate((-exact.params[:2], exact.params[2:-1]))
        found = identify(y, None, structure, influence=Linear(), R=0.25, offset=False)
        np.testing.assert_allclose(found.theta, expected, rtol=0.0, atol=near * exact.bse[:-1].min())
        np.testing.assert_allclose(found.std, exact.bse[:-1], rtol=0.25)


# Outliers.


def test_no_sample_moves_the_estimate_by_more_than_a_bounded_amount():
    y, u = recording(0, 400)
    base = identify(y, u, OutputError(2, 2))
    for k, size in ((0, 1e6), (1, 1e90), (200, 1e2), (200, 1e6), (len(y) - 1, 1e6)):
        wild = y.copy()
        wild[k] += size
        moved = identify(wild, u, OutputError(2, 2))
        assert np.abs(moved.theta - base.theta).max() < base.std.max()


def test_the_noise_is_that_of_the_recording():
    y, u = recording(0, 2000)
    model = identify(y, u, OutputError(2, 2))
    assert model.R == pytest.approx(0.09, rel=5 * np.sqrt(2 / 1800) + 0.02)
    assert model.noise.influence.contamination == pytest.approx(0.1, abs=5 * np.sqrt(0.09 / 2000) + 0.01)
    assert model.noise.influence.scale_ratio == pytest.approx(10.0, rel=0.25)
    # .05 of 10 standard deviations is within the ordinary.
    assert 0.05 < (model.weights < 0.5).mean() < 0.11


@support.draws(2, 6)
@pytest.mark.parametrize("share", support.by_night([0.02, 0.1], 0.1))
def test_outliers_in_the_regressor_cost_little(share, draws):
    errors = np.empty((draws, 3))
    for seed in range(draws):
        y, u = recording(seed, 1500, share=0.0, sigma=0.5, inside=True)
        rng = np.random.default_rng(seed)
        far = rng.random(1500) < share
        y[far] += 5.0 * rng.normal(size=far.sum())
        thetas = [identify(one, u, ARX(2, 2)).theta for one in (y, np.where(far, np.nan, y))]
        thetas.append(np.linalg.lstsq(ARX(2, 2).regressors(u, y), y, rcond=None)[0])
        errors[seed] = np.linalg.norm(np.array(thetas) - THETA, axis=1)
    ours, labels, plain = np.sqrt(np.mean(errors**2, axis=0))
    # What outliers cost least squares does not depend on us; of that cost hardly a thirtieth is left.
    assert ours < 1.5 * labels and ours - labels < 0.03 * (plain - labels)


def test_the_noise_of_a_model_is_that_of_the_outputs_it_will_predict():
    def recorded(seed):
        rng = np.random.default_rng(seed)
        u, wild = rng.choice([-1.0, 1.0], 1000), rng.random(1000) < 0.1
        v = 0.3 * rng.normal(size=1000)
        clean = lfilter(B, A, u) + lfilter([1.0, 0.5], A, v)
        return clean + 100.0 * 0.3 * rng.normal(size=1000) * wild, u, wild

    y, u, wild = recorded(3)
    model = identify(y, u, ARMAX(2, 2, 1))
    mixture = model.noise.influence
    assert mixture.contamination == pytest.approx(wild.mean(), abs=0.02)
    assert mixture.scale_ratio == pytest.approx(100.0, rel=0.25)
    assert pytest.approx(0.09, rel=0.15) == model.R
    # The outputs that stand in the regressor show nearly no outliers; who goes by them believes what is measured.
    cleaned = replace(model, noise=replace(model.noise, influence=Contaminated(0.001, 8.0)))
    errors = np.zeros(2)
    for y, u, wild in map(recorded, range(4, 8)):
        errors += [np.mean((one.predict(y, u) - y)[10:][~wild[10:]] ** 2) for one in (model, cleaned)]
    assert errors[0] < 0.8**2 * errors[1]


# Units, offsets, what was in motion.


@pytest.mark.parametrize("structure", support.by_night(
    [OutputError(2, 2), ARX(2, 2), ARMAX(2, 2, 1), FIR(4)], OutputError(2, 2), FIR(4)
), ids=str)  # fmt: skip
def test_neither_units_nor_the_offset_change_the_model(structure):
    y, u = recording(0, 300)
    y[100:110] = np.nan
    one = identify(y, u, structure)
    inputs = np.array([name.startswith("b") for name in structure.names])
    other = identify(y + 50.0, u, structure)
    np.testing.assert_allclose(other.theta, one.theta, atol=1e-6)
    assert other.level - one.level == pytest.approx(50.0, rel=1e-6)
    assert other.log_likelihood == pytest.approx(one.log_likelihood, abs=1e-4)
    unit, size = 1e-3, np.where(inputs, 1e-3, 1.0)
    other = identify(unit * y, u, structure)
    np.testing.assert_allclose(other.theta / size, one.theta, atol=1e-6)
    np.testing.assert_allclose(other.P / np.outer(size, size), one.P, rtol=1e-4, atol=1e-12)
    assert other.R == pytest.approx(unit**2 * one.R, rel=1e-6)
    np.testing.assert_allclose(identify(y, unit * u, structure).theta * size, one.theta, atol=1e-6)
    # Nor does a constant in u.
    other = identify(y, u + 1e4, structure)
    np.testing.assert_allclose(other.theta, one.theta, atol=1e-3 * one.std.min())
    assert other.fit(y, u + 1e4) == pytest.approx(one.fit(y, u), abs=1e-3)


# Uncertainty.


def test_the_endings_say_which_start_won_and_whether_others_agreed():
    y, u = recording(0, 500)
    model = identify(y, u, OutputError(2, 2))
    best = model.endings[0]
    assert best.excess == best.difference == 0.0 and "impulse response of 30 samples, 2 poles" in best.starts
    assert model.warning == ""
    assert sum(len(ending.starts) for ending in model.endings) >= 5


def test_models_that_differ_but_explain_as_much_are_reported():
    rng, u = binary(5, 60)
    y = lfilter(B, A, u) + 3.0 * rng.normal(size=60)
    with pytest.warns(UserWarning, match="almost equally well"):
        model = identify(y, u, OutputError(3, 3))
    assert "a longer recording" in model.warning
    assert any(e.excess < 3.0 and e.difference > 5.0 for e in model.endings[1:])


# Bad input.

NOISE, U = np.random.default_rng(0).normal(size=(2, 100))


def test_bad_arguments_are_refused_by_name():
    assert_refused(identify, {"y": NOISE, "u": U, "structure": ARX(2, 2)}, {
        "structure": ["ARX", 4],
        "influence": ["huber"],
        "offset": [3.0],
        "R": [-1.0, 10**400],
        "u": [None, U[:50], np.zeros(100)],
        "y": [np.full(100, np.nan), np.full(100, 3.0), np.where(NOISE > 9, 0, np.inf), [1.0] * 99 + [10**400]],
        "trend": ["quadratic"],
        "fixed": [{"a3": 1.0}, {"offset": 1.0}, {"a1": np.nan}, {"a1": "x"}, ["a1"],
                  dict.fromkeys(("a1", "a2", "b1", "b2"), 0.1)],
        "bounds": [{"a1": (1.0, 0.0)}, {"a1": 3.0}, {"a1": (None, "x")}],
    })  # fmt: skip


@pytest.mark.parametrize(("u", "structure", "options", "words"), [
    (U[:15], OutputError(4, 4), {}, "y: expected at least .* record more"),
    (U, FIR(2, nk=200), {}, "nk: expected a delay shorter than the recording"),
    (np.zeros(100), OutputError(1, 1), {}, "got 0 in every sample"),
    (np.ones(100), OutputError(1, 1), {}, "order 2 next to the offset, got .* excitation of order 0.*offset=False"),
    (np.ones(100), FIR(2), {"offset": False}, "order 2, got persistent excitation of order 1"),
    (np.sin(np.arange(100)), OutputError(2, 2), {}, "with order 4.*got .* of order 2"),
    (np.ones((100, 2)), LinearRegression(2), {}, "linearly independent.*offset=False"),
    (U, OutputError(1, 1), {"fixed": {"a1": -3.0}}, "limits that a stable model .* keeps"),
    (U, ARX(1, 1), {"fixed": {"a1": -0.5}, "bounds": {"a1": (-2.0, 0.0)}}, "that are not fixed, got 'a1'"),
    (U, ARX(1, 1), {"trend": "line", "offset": False}, 'expected "none" with offset=False'),
    (U, ARX(2, 1, integrated=True), {"fixed": {"d1": -0.5}}, "which has it at -1"),
    (U, StateSpace(1), {"fixed": {"a1": 1.0}}, "fixed: expected None"),
    (U, StateSpace(1), {"R": 1.0}, "R: expected None"),
    (U, GreyBox(lambda x, u, p: [u[0] - p[0] * x[0]], [1.0], x0=[0.0]), {"fixed": {"a1": 1.0}}, "fixed: expected None"),
])  # fmt: skip
def test_bad_input_is_refused_with_its_remedy(u, structure, options, words):
    with pytest.raises(ValueError, match=words):
        identify(NOISE[: len(u)], u, structure, **options)


@pytest.mark.parametrize("samples", [800, pytest.param(10_000, marks=pytest.mark.slow)])
def test_forty_parameters_of_a_clean_recording_are_those_of_least_squares(samples):
    """An output-error start takes many good samples for outliers, which then enter nearly every residual."""
    rng = np.random.default_rng([0, 4])
    poles = rng.uniform(0.3, 0.95, 10) * np.exp(1j * rng.uniform(0.1, 3.0, 10))
    a, b = np.real(np.poly([*poles, *poles.conj()])), rng.normal(size=20)
    u = rng.choice([-1.0, 1.0], 10_000)
    y = lfilter([0.0, *b], a, u) + lfilter([1.0], a, 0.3 * rng.normal(size=u.size))
    y, u, truth = y[:samples], u[:samples], np.append(a[1:], b)
    k = np.arange(20, samples)
    phi = np.column_stack([*(-y[k - i] for i in range(1, 21)), *(u[k - i] for i in range(1, 21))])
    plain = np.linalg.norm(np.linalg.lstsq(phi, y[k], rcond=None)[0] - truth)
    model = identify(y, u, ARX(20, 20))
    assert np.linalg.norm(model.theta[:40] - truth) < max(1.1 * plain, 0.02 * np.linalg.norm(truth))


@pytest.mark.parametrize("structure", [ARX(2, 2), ARMAX(2, 2, 1)], ids=repr)
@pytest.mark.parametrize("every", [2, 3])
def test_an_output_that_is_slower_than_the_input_is_refused_where_outputs_are_regressors(every, structure):
    y, u = recording(0, 600)
    y[np.arange(600) % every > 0] = np.nan
    with pytest.raises(ValueError, match=r"^y: expected somewhere 3 measured samples in a row"):
        identify(y, u, structure)


# Parameters that are given, as numbers or between bounds; noise that is summed up.


def quiet(**options):
    return recording([31, 0], 400, sigma=0.1, **options)


@pytest.mark.parametrize("structure", [OutputError(2, 2), ARX(2, 2)], ids=str)
def test_a_fixed_parameter_stays_has_no_variance_and_helps_the_others(structure):
    y, u = quiet(inside=structure.na > 0)
    free, held = identify(y, u, structure), identify(y, u, structure, fixed={"a1": -1.5})
    assert (held.theta[0], held.std[0]) == (-1.5, 0.0)
    assert (held.std[1:4] < [0.9, 1.05, 1.05] * free.std[1:4]).all()
    assert np.abs((held.theta - free.theta)[:4]).max() < 4.0 * free.std[:4].max()


def test_a_fixed_parameter_is_one_of_the_recording_as_it_was_measured():
    y, u = quiet()
    model = identify(1e3 * y + 7.0, 1e-2 * u + 50.0, OutputError(2, 2), fixed={"b2": 5e4})
    assert model.theta[3] == 5e4
    np.testing.assert_allclose(model.theta / [1.0, 1.0, 1e5, 1e5], THETA, atol=0.02)


def test_a_bound_that_binds_is_kept_and_named_and_another_changes_nothing():
    y, u = quiet()
    with pytest.warns(UserWarning, match="b2 ended at a bound"):
        bound = identify(y, u, OutputError(2, 2), bounds={"b2": (None, 0.4)})
    assert (bound.theta[3], bound.std[3]) == (0.4, 0.0)
    with unheard():
        fixed = identify(y, u, OutputError(2, 2), fixed={"b2": 0.4})
    free, loose = identify(y, u, OutputError(2, 2)), identify(y, u, OutputError(2, 2), bounds={"b2": (0.0, None)})
    for model, same in ((bound, fixed), (loose, free)):
        np.testing.assert_allclose(model.theta, same.theta, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(model.std, same.std, rtol=1e-3)


# Noise that is summed up.


def test_with_a_level_that_wanders_and_jumps_the_dynamics_are_found_from_differences():
    rng, u = binary([37, 0], 500)
    y = 40.0 + lfilter(B, A, u) + np.cumsum(wild(rng, 500, sigma=0.1, share=0.05, size=20.0))
    y[[100, 101, 300]] += [9.0, -7.0, 5.0]
    model = identify(y, u, OutputError(2, 2, integrated=True))
    np.testing.assert_allclose(model.theta, [*THETA, -1.0], atol=0.03)
    assert not model.findings
    assert model.std[4] == 0.0
    # The level is nobody's.
    assert np.isinf(model.offset_std)
    left = y - model.predict(y, u)
    assert np.nanmedian(np.abs(left[5:60])) < 0.15
    assert validate(model, y, u).verdict == RIGHT


def test_an_interruption_leaves_nothing_half_done(monkeypatch):
    y, u = recording(0, 300)
    before = y.copy(), u.copy()

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(PolynomialModel, "jacobian", interrupted)
        with pytest.raises(KeyboardInterrupt):
            identify(y, u, OutputError(2, 2))
    np.testing.assert_array_equal(before, (y, u))
    np.testing.assert_array_equal(identify(y, u, OutputError(2, 2)).theta, identify(y, u, OutputError(2, 2)).theta)
