"""Bands and regions: exact where the property is linear, Monte-Carlo's elsewhere, responses python-control's."""

from dataclasses import replace

import control
import numpy as np
import pytest
import support
from numpy.testing import assert_allclose, assert_array_equal
from recordings import THETA, A, B, assert_refused, binary, recording, unheard
from scipy.integrate import trapezoid
from scipy.signal import lfilter
from scipy.stats import norm

from robust_filterpy import ARX, OutputError, ParameterTracker, identify
from robust_filterpy.identification import AR, ARMAX, FIR, BoxJenkins, LinearRegression
from robust_filterpy.identification.estimation import estimate
from robust_filterpy.influence import Linear

Z = norm.ppf(0.975)
OMEGA = np.linspace(0.0, np.pi, 30)


def recorded(a=(1.0, -1.5, 0.7), b=(1.0, 0.5), length=500, seed=0, sigma=0.3):
    return recording(seed, length, sigma=sigma, a=a, b=[0.0, *b])


@pytest.fixture(scope="module")
def model():
    return identify(*recorded(), OutputError(2, 2))


@pytest.fixture(scope="module")
def ringing():
    """A model whose poles may lie on either side of the unit circle."""
    a = np.poly([0.99 * np.exp(0.6j), 0.99 * np.exp(-0.6j)]).real
    found = identify(*recorded(a, length=400), OutputError(2, 2))
    # As if from a few samples: poles known to .007.
    return replace(found, P=0.007**2 / np.trace(found.poles().covariance[0]) * found.P)


def drawn(model, count=20_000):
    """Parameters as sure as the model says, of stable models."""
    thetas = np.random.default_rng(3).multivariate_normal(model.theta, model.P, count)
    a1, a2 = thetas[:, 0], thetas[:, 1]
    return thetas[(np.abs(a2) < 1.0) & (np.abs(a1) < 1.0 + a2)]


@pytest.mark.parametrize("structure", [ARX(2, 2, 3), ARMAX(1, 2, 1), FIR(4), BoxJenkins(2, 0, 1, 2)], ids=str)
def test_the_frequency_response_of_every_structure_is_python_controls(structure):
    found = identify(*recorded(length=300), structure)
    expected = control.frequency_response(found.transfer_function(), OMEGA[1:-1]).complex
    np.testing.assert_allclose(found.frequency_response(OMEGA[1:-1]).response, expected, atol=1e-9)


def test_responses_are_those_of_python_control(model):
    found, plant = model.frequency_response(OMEGA / 0.1, dt=0.1), model.transfer_function(dt=0.1)
    expected = plant(np.exp(1j * OMEGA))
    np.testing.assert_allclose(found.response, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.magnitude * np.exp(1j * found.phase), expected, rtol=1e-9, atol=1e-12)
    data = found.to_control()
    assert isinstance(data, control.FrequencyResponseData) and data.dt == 0.1
    np.testing.assert_allclose(data.frdata[0, 0], expected, rtol=1e-9, atol=1e-12)
    step = model.step_response(40, dt=0.1)
    time, rise = control.step_response(plant, 0.1 * np.arange(40))
    np.testing.assert_allclose(step.response, rise, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(step.time, time)
    for ours, theirs in ((model.poles().values, plant.poles()), (model.zeros().values, plant.zeros())):
        np.testing.assert_allclose(np.sort_complex(ours), np.sort_complex(theirs), atol=1e-8)


def test_bands_of_what_is_linear_in_theta_are_exact():
    model = identify(*recorded([1.0], (1.0, 0.5)), FIR(2))
    step = model.step_response(4)
    ones = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 1.0]])
    std = np.sqrt(np.einsum("ij,jk,ik->i", ones, model.P, ones))
    for width in (step.upper - step.response, step.response - step.lower):
        np.testing.assert_allclose(width, Z * std, rtol=1e-8, atol=1e-12)
    assert not step.sampled.any()
    first = identify(*recorded([1.0, -0.8], (1.0,)), OutputError(1, 1))
    ends, pole = first.confidence_intervals(), first.poles()
    assert pole.values == pytest.approx(-first.theta[:1])
    edge = pole.ellipses(5)[0].real
    np.testing.assert_allclose([edge.min(), edge.max()], [-ends.upper[0], -ends.lower[0]], rtol=1e-8)


def test_bands_are_the_quantiles_of_monte_carlo(model):
    thetas = drawn(model)
    powers = np.exp(-1j * OMEGA[1:-1]) ** np.arange(3)[:, None]
    answers = (thetas[:, 2:] @ powers[1:]) / (1.0 + thetas[:, :2] @ powers[1:])
    found = model.frequency_response(OMEGA[1:-1])
    low, high = np.quantile(np.abs(answers), [0.025, 0.975], axis=0)
    np.testing.assert_allclose(found.magnitude_lower, low, atol=0.1 * (high - low).max(), rtol=0.01)
    np.testing.assert_allclose(found.magnitude_upper, high, atol=0.1 * (high - low).max(), rtol=0.01)
    left, right = np.quantile(np.angle(answers / found.response), [0.025, 0.975], axis=0)
    np.testing.assert_allclose(found.phase_upper - found.phase, right, rtol=0.12)
    np.testing.assert_allclose(found.phase_lower - found.phase, left, rtol=0.12)
    poles = np.array([np.roots([1.0, *theta[:2]]) for theta in thetas[:4000]])
    up, region = poles[poles.imag > 0.0], model.poles()
    first = int(region.values.imag.argmax())
    inside = [region.contains(np.where(np.arange(2) == first, p, region.values))[first] for p in up]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)


def test_next_to_the_unit_circle_the_bands_are_sampled(ringing):
    found = ringing.frequency_response([0.05, 0.6, 3.0])
    assert found.sampled[1]
    thetas = drawn(ringing)
    delays = np.exp([-0.6j, -1.2j])
    sizes = np.abs(thetas[:, 2:] @ delays / (1.0 + thetas[:, :2] @ delays))
    low, high = np.quantile(sizes, [0.025, 0.975])
    assert found.magnitude_lower[1] == pytest.approx(low, rel=0.1)
    assert found.magnitude_upper[1] == pytest.approx(high, rel=0.3)
    step = ringing.step_response(200)
    assert step.sampled.any() and np.isfinite(step.upper).all()


def test_a_double_pole_has_a_sampled_region_with_its_probability(model):
    double = replace(model, theta=np.array([-1.6, 0.64, 1.0, 0.5]))
    region = double.poles()
    assert region.sampled.all()
    draws = np.random.default_rng(5).multivariate_normal(double.theta, double.P, 4000)
    roots = np.array([np.roots([1.0, *theta[:2]]) for theta in draws])
    inside = np.mean([region.contains(r) | region.contains(r[::-1]) for r in roots])
    assert 0.9 < inside < 0.99


def test_the_noise_spectrum_has_the_power_of_the_noise():
    y = lfilter([1.0], [1.0, -0.8], np.random.default_rng(1).normal(size=4000))
    model = identify(y, None, AR(1))
    w = np.linspace(0.0, np.pi / 0.1, 4001)
    found = model.noise_spectrum(w, dt=0.1)
    # Two-sided, per Hz.
    assert 2.0 * trapezoid(found.density, w) / (2.0 * np.pi) == pytest.approx(np.var(y), rel=0.05)
    np.testing.assert_allclose(found.density[0], 0.1 * model.R / (1.0 + model.theta[0]) ** 2)
    # At the middle frequency the band is little more than that of the variance of 4000 samples.
    assert np.log(found.upper / found.density).min() == pytest.approx(Z * np.sqrt(2.0 / 4000), rel=0.25)


def test_several_inputs_have_a_row_each():
    rng = np.random.default_rng(1)
    u, noise = rng.normal(size=(400, 2)), 0.1 * rng.normal(size=400)
    y = lfilter([0.0, 1.0], [1.0, -0.8], u[:, 0]) + lfilter([0.5, 0.2], [1.0, -0.8], u[:, 1]) + noise
    model = identify(y, u, OutputError(1, (1, 2), nk=(1, 0)))
    found, plant = model.frequency_response([0.1, 1.0]), model.transfer_function(dt=1.0)
    assert found.response.shape == found.sampled.shape == found.phase_lower.shape == (2, 2)
    for i in range(2):
        np.testing.assert_allclose(found.response[i], plant[0, i](np.exp(1j * found.omega)), rtol=1e-9)
    assert found.to_control().frdata.shape == (1, 2, 2)
    assert list(model.step_response(5).to_frame().columns[:2]) == ["response[0]", "response[1]"]
    assert model.zeros(input=0).values.size == 0
    assert model.zeros(input=1).values == pytest.approx(-model.theta[3:4] / model.theta[2:3])
    # One without coefficients does nothing for sure.
    found = identify(y, u, FIR((1, 0))).frequency_response([0.1, 1.0])
    np.testing.assert_array_equal(found.magnitude_upper[1], 0.0)
    assert not found.sampled.any()


def test_a_tracker_has_the_bands_of_its_model(model):
    tracker = ParameterTracker(model)
    one, other = model.frequency_response(OMEGA[1:]), tracker.frequency_response(OMEGA[1:])
    np.testing.assert_allclose(other.magnitude_upper, one.magnitude_upper, rtol=1e-6)
    assert ParameterTracker(ARX(1, 1), theta=[-0.5, 1.0], P=0.0).poles().ellipses().std() == 0.0


def test_sampled_bands_come_again_and_follow_the_generator(ringing):
    def upper(rng=None):
        return ringing.frequency_response([0.6], rng=rng).phase_upper[0]

    assert upper() == upper() == upper(0)
    assert upper(np.random.default_rng(1)) == upper(1) != upper()


def test_bad_arguments_are_refused_by_name(model):
    wrong = {"omega": [[4.0], [-0.1], [np.nan], []], "dt": [0.0], "level": [0.0, 1.0]}
    assert_refused(model.frequency_response, {"omega": [0.1]}, wrong)
    assert_refused(model.poles, {}, {"level": [0.0]})
    assert_refused(model.step_response, {}, {"steps": [0]})
    assert_refused(model.zeros, {}, {"input": [1]})
    assert_refused(model.summary, {}, {"level": [0.0, 1.0, 95]})


def test_what_has_no_response_says_so():
    y, u = recorded(length=100)
    alone = identify(y, None, AR(1))
    for call in (lambda: alone.frequency_response([0.1]), alone.step_response, alone.zeros, alone.transfer_function):
        with pytest.raises(ValueError, match="expected a model with an input"):
            call()
    assert alone.poles().values == pytest.approx(-alone.theta)
    with pytest.raises(ValueError, match="expected a model with polynomials"):
        identify(y, u, LinearRegression(1)).poles()


# Where the loss is not quadratic the covariance is that of the profile, and elsewhere the sandwich's.


@pytest.fixture
def linearized(monkeypatch):
    """Let each covariance by linearization be seen."""
    seen, profiled = [], estimate.profiled

    def watched(model, p, noise, rows, P, *others):
        seen.append(P)
        return profiled(model, p, noise, rows, P, *others)

    monkeypatch.setattr(estimate, "profiled", watched)
    return seen


def profiled_recording(seed, a, b, samples=300):
    """Return y and u of a plant with outliers."""
    return recording([27, seed], samples, a=a, b=[0.0, *b])


def test_a_plant_that_the_recording_tells_keeps_its_linearization(linearized):
    y, u = profiled_recording(0, [1.0, -1.5, 0.7], [1.0, 0.5])
    model = identify(y, u, OutputError(2, 2), trend="constant")
    assert not model.profiled
    assert_array_equal(model.P, linearized[-1][:4, :4])
    assert "Intervals" not in model.summary().to_text()
    assert not identify(y, u, ARX(1, 1)).profiled


def squares(f, y, u):
    """Return the least sum of squares of an OutputError(1, 1) for a given pole, by numpy's least squares."""
    impulse = np.eye(1, y.size - 1).ravel()
    X = np.column_stack([lfilter([1.0], [1.0, f], s) for s in (u[:-1], impulse)] + [np.ones(y.size - 1)])
    return np.square(y[1:] - X @ np.linalg.lstsq(X, y[1:], rcond=None)[0]).sum()


def test_two_standard_deviations_away_the_loss_has_risen_by_two(linearized):
    bent = 0
    for seed in range(8):
        rng = np.random.default_rng([28, seed])
        u = rng.choice([-1.0, 1.0], 80)
        y = lfilter([0.0, 0.3], [1.0, -0.9], u) + 0.6 * rng.normal(size=80)
        model = identify(y, u, OutputError(1, 1), influence=Linear(), trend="constant", progress=False)
        if not model.profiled:
            continue
        bent, f = bent + 1, model.theta[0]
        least, count = squares(f, y, u), y.size - 1
        steps = [f + sign * 2.0 * model.std[0] for sign in (-1.0, 1.0)]
        rises = [0.5 * (count - 4) * (squares(at, y, u) / least - 1.0) for at in steps if abs(at) < 1.0]
        # At the farther of the two places; at the nearer one it has risen by more, or is 16 deviations away.
        assert min(rises) == pytest.approx(2.0, rel=0.1)
        assert model.P[0, 0] > linearized[-1][0, 0]
        assert "profile likelihood" in model.summary().to_text()
    assert bent >= 2


def test_units_do_not_matter_to_the_profile():
    rng, u = binary(5, 60)
    y = lfilter([0.0, 0.1], [1.0, -0.9], u) + 0.6 * rng.normal(size=60)
    one = identify(y, u, OutputError(1, 1), trend="constant")
    other = identify(1e6 * y, 1e-3 * u, OutputError(1, 1), trend="constant")
    assert one.profiled and other.profiled
    assert_allclose(other.std / [1.0, 1e9], one.std, rtol=1e-3)


def test_the_pole_that_nothing_tells_has_no_narrow_interval():
    """Of a plant of order 2, in a model of order 4."""
    model = identify(*recording(29, 300), OutputError(4, 4), trend="constant", progress=False)
    assert model.profiled
    assert "profile likelihood, at least" in model.summary().to_text()
    assert model.std[0] > 0.2
    assert np.linalg.eigvalsh(model.P).min() >= -1e-9 * np.trace(model.P)


@support.draws(6, 60)
@pytest.mark.parametrize("outliers", support.by_night(["of 4", "of 10", "of one size, 6"]))
def test_intervals_hold_where_three_samples_in_ten_are_outliers(outliers, draws):
    # A choice of outliers leaves small ones in the regressor: at 90 % it covers .75 to .84.
    z, size = [], float(outliers.split()[-1])
    for seed in range(draws):
        rng, u = binary([seed, 778], 500)
        wild = rng.choice([-1.0, 1.0], 500) if "one" in outliers else rng.normal(size=500)
        wild *= size * (rng.random(500) < 0.3)
        y = lfilter(B, A, u) + 0.3 * (lfilter([1.0], A, rng.normal(size=500)) + wild)
        with unheard(UserWarning):
            model = identify(y, u, ARX(2, 2), progress=False)
        z += [] if model.findings else [(model.theta - THETA) / model.std]
    # Where outliers are taken for the noise it is said.
    assert len(z) > 0.95 * draws
    assert np.mean(np.square(z)) < (2.0 if draws < 20 else 1.3)
    assert (np.abs(np.mean(z, axis=0)) < 4.0 / np.sqrt(draws)).all()


@pytest.mark.parametrize("seed", support.by_night(range(6), 3, 0))
def test_an_armax_is_right_through_three_outliers_in_ten(seed):
    # From every start of the seed 3 outliers were in all residuals, and nothing showed the noise.
    rng, u = binary([seed, 777], 800)
    e, wild = rng.normal(size=800), 10.0 * rng.normal(size=800)
    y = lfilter(B, A, u) + 0.3 * (lfilter([1.0, 0.7, 0.3], A, e) + np.where(rng.random(800) < 0.3, wild, 0.0))
    model = identify(y, u, ARMAX(2, 2, 2), progress=False)
    assert (np.abs(model.theta - [*THETA, 0.7, 0.3]) < 4.0 * model.std).all()
