"""Models of the noise: ARMA is statsmodels', Box and Jenkins' is scipy's least squares, online as from a recording."""


import numpy as np
import pytest
import support
from recordings import binary, unheard
from scipy.integrate import quad
from scipy.optimize import least_squares
from scipy.signal import lfilter
from statsmodels.tsa.arima.model import ARIMA

from robust_filterpy import ARX, OutputError, ParameterTracker, identify
from robust_filterpy.correction.contaminated import START, Contaminated
from robust_filterpy.identification import AR, ARMA, BoxJenkins, validate
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.influence import Linear
from robust_filterpy.influence.regression import mad_scale

B, F, C, D = [1.0, 0.5], [-1.5, 0.7], [0.6], [-0.9]
THETA = np.array([*B, *F, *C, *D])
BJ = BoxJenkins(2, 1, 1, 2)


def series(a, c, length=1500, seed=0, level=5.0):
    """A stationary ARMA series."""
    return level + lfilter(c, a, np.random.default_rng(seed).normal(size=length + 500))[500:]


def recorded(length=1000, seed=0, share=0.1, c=C, d=D, sigma=0.3, level=0.0):
    """A recording with coloured noise inside it and outliers of the sensor."""
    rng, u = binary(seed, length)
    noise = lfilter([1.0, *c], [1.0, *d], sigma * rng.normal(size=length + 300))[300:]
    wild = 20.0 * sigma * rng.normal(size=length) * (rng.random(length) < share)
    return level + lfilter([0.0, *B], [1.0, *F], u) + noise + wild, u


# From a recording.


@pytest.mark.parametrize(("structure", "a", "c"), [
    (AR(2), [1.0, -1.5, 0.7], [1.0]),
    (ARMA(2, 1), [1.0, -1.5, 0.7], [1.0, 0.5]),
    (ARMA(0, 2), [1.0], [1.0, 0.8, 0.3]),
], ids=str)  # fmt: skip
def test_without_outliers_it_is_the_exact_likelihoods_arma_of_statsmodels(structure, a, c):
    y = series(a, c)
    model = identify(y, None, structure, influence=Linear())
    with unheard():
        reference = ARIMA(y, order=(len(a) - 1, 0, len(c) - 1)).fit()
    na = len(a) - 1
    exact = np.concatenate((-reference.arparams, reference.maparams)) if len(c) > 1 else -reference.arparams
    assert np.abs((model.theta - exact) / model.std).max() < 0.1
    # Learning the noise takes a few ordinary samples for outliers.
    assert np.abs((identify(y, None, structure).theta - exact) / model.std).max() < 1.5
    np.testing.assert_allclose(model.std, reference.bse[1 : 1 + na + len(c) - 1], rtol=0.2)
    assert model.level == pytest.approx(reference.params[0], abs=0.3 * reference.bse[0])
    # statsmodels divides by the number of samples, the noise here is the median's.
    assert pytest.approx(reference.params[-1], rel=0.06) == model.R


def test_additive_outliers_and_gaps_cost_an_arma_model_little():
    y = series([1.0, -1.5, 0.7], [1.0, 0.5], length=2000)
    clean = identify(y, None, ARMA(2, 1))
    rng = np.random.default_rng(1)
    spoilt = y + 20.0 * rng.normal(size=y.size) * (rng.random(y.size) < 0.05)
    spoilt[500:540] = np.nan
    model = identify(spoilt, None, ARMA(2, 1))
    assert np.abs((model.theta - clean.theta) / clean.std).max() < 2.0
    assert pytest.approx(clean.R, rel=0.15) == model.R
    assert np.abs((identify(spoilt, None, ARMA(2, 1), influence=Linear()).theta - clean.theta) / clean.std).max() > 5.0


def test_without_robustness_box_and_jenkins_is_least_squares():
    y, u = recorded(share=0.0)

    def residuals(p):
        w = lfilter([0.0, *p[:2]], [1.0, *p[2:4]], u)
        return lfilter([1.0, p[5]], [1.0, p[4]], y - w)

    model = identify(y, u, BJ, influence=Linear(), offset=False)
    found = least_squares(residuals, THETA)
    # The recording begins at rest, which scipy assumes and identify estimates.
    assert np.abs((model.theta - found.x) / model.std).max() < 0.25
    covariance = np.linalg.inv(found.jac.T @ found.jac) * 2.0 * found.cost / (y.size - 6)
    np.testing.assert_allclose(model.std, np.sqrt(covariance.diagonal()), rtol=0.1)


@pytest.mark.parametrize("share", support.by_night([0.0, 0.05], 0.05))
def test_box_and_jenkins_finds_plant_noise_and_level(share):
    y, u = recorded(1000, level=20.0, share=share)
    y[700:720] = np.nan
    model = identify(y, u, BJ)
    assert np.abs((model.theta - THETA) / model.std).max() < 3.5
    assert model.level == pytest.approx(20.0, abs=4.0 * model.offset_std)
    assert pytest.approx(0.09, rel=0.15) == model.R
    assert validate(model, y, u).verdict == "nothing is left in the residuals"


# The model.


@pytest.fixture(scope="module")
def model():
    return identify(*recorded(share=0.0, level=3.0), BJ)


def test_predictions_are_those_of_the_innovations_form(model):
    y, u = recorded(share=0.0, level=3.0)
    _, _, c, d, _ = model.coefficients
    w = model.free_run(y, u)[2:]
    residual = lfilter([1.0, *d], [1.0, *c], y[2:] - w)
    # Ordinary samples: the others have a part in the regressor that is less than 1.
    difference = np.abs(model.residuals(y, u)[302:] - residual[300:])
    assert np.median(difference) < 0.005 and difference.max() < 0.1
    # Far ahead nothing is known of the disturbance.
    np.testing.assert_allclose(model.predict(y, u, steps=400)[500:], w[498:], atol=0.02)
    assert model.fit(y, u) < 100.0 * (1.0 - np.std(model.residuals(y, u)[2:]) / np.std(y))


# Online.


def test_the_gradient_is_the_derivative_of_the_prediction():
    y, u = recorded(60)
    structure, step = BoxJenkins(2, 2, 2, 2), 1e-6
    theta = np.array([*B, *F, 0.6, 0.1, -0.9, 0.2])

    def tracker(shift):
        return support.paper_tracker(structure, theta=theta + shift, P=1e-30, Q=0.0)

    def last(shift):
        return tracker(shift).run(y, u).prediction[-1]

    derivative = [(last(step * e) - last(-step * e)) / (2.0 * step) for e in np.eye(8)]
    found = tracker(np.zeros(8))
    *_, correction = found.corrections(y, u)
    np.testing.assert_allclose(correction.H[0], derivative, rtol=1e-5, atol=1e-7)
    found.run(y, u)
    np.testing.assert_allclose(found.state()["gradients"][0], derivative, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(
    "structure", support.by_night([BJ, AR(2), ARMA(2, 1), ARX(2, 2), OutputError(2, 2)], ARMA(2, 1), ARX(2, 2)), ids=str
)
def test_the_tracker_of_a_model_predicts_the_next_sample(structure):
    y, u = recorded(301, level=20.0, share=0.0)
    if not structure.n_inputs:
        y, u = series([1.0, -1.5, 0.7], [1.0, 0.5], length=301), None
    model = identify(y[:-1], None if u is None else u[:-1], structure)
    started = ParameterTracker(structure, start=300)
    started.run(y[:-1], None if u is None else u[:-1])
    for tracker in (ParameterTracker(model), started):
        assert tracker.predict() == pytest.approx(model.predict(y, u)[-1], abs=0.02)
        assert tracker.offset == pytest.approx(model.offset) and tracker.level == pytest.approx(model.level)
        assert tracker.R == pytest.approx(model.R)
        np.testing.assert_allclose(tracker.theta, model.theta, atol=1e-6 * model.std.min())
        np.testing.assert_allclose(tracker.P, model.P, rtol=1e-6, atol=1e-15)


# The noise as it is learned: a density and the mixture that made the residuals.


E = np.linspace(-30.0, 30.0, 601)
MIXTURE = Contaminated(0.1, 7.0)


def density(e, share=0.1, ratio=7.0):
    """Normal, and one that is normal up to 3 standard deviations and exponential beyond."""
    wide = lambda z: np.exp(-np.where(np.abs(z) < 3.0, 0.5 * z**2, 3.0 * np.abs(z) - 4.5))  # noqa: E731
    total = quad(wide, -60, 60, points=[-3, 3])[0]
    return (1 - share) * np.exp(-0.5 * e**2) / np.sqrt(2 * np.pi) + share * wide(e / ratio) / ratio / total


def test_rho_normalizer_and_likelihood_are_the_density():
    np.testing.assert_allclose(-MIXTURE.rho(E) - MIXTURE.log_normalizer(1), np.log(density(E)), rtol=1e-7)
    within = np.linspace(-20.9, 20.9, 101)
    assert Noise(MIXTURE, 1.0).log_likelihood(within) == pytest.approx(np.log(density(within)).sum(), rel=1e-7)


def test_with_outliers_of_two_sizes_the_likelihood_tells_less_noise_from_more():
    rng = np.random.default_rng(11)
    r = np.where(rng.random(2000) < 0.1, 20.0, 1.0) * rng.normal(size=2000)
    gross = np.where(rng.random(2000) < 0.01, 1e6, 0.0) * rng.normal(size=2000)
    fitted = [Noise(START, mad_scale(one) ** 2).settled(one) for one in (r + gross, 10.0 * r + gross)]
    less, more = (noise.log_likelihood(one) for noise, one in zip(fitted, (r + gross, 10.0 * r + gross), strict=True))
    # Nearly log(10) a sample; the largest are the same in both.
    assert less - more == pytest.approx(2000 * np.log(10.0), rel=0.05)
