"""Where the loss is not quadratic the covariance is that of the profile, and elsewhere the sandwich's."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import lfilter

from robust_filterpy.identification import ARX, OutputError, identify
from robust_filterpy.identification.estimation import estimate
from robust_filterpy.influence import Linear


@pytest.fixture
def linearized(monkeypatch):
    """Let each covariance by linearization be seen."""
    seen, profiled = [], estimate.profiled

    def watched(model, p, noise, rows, P, *others):
        seen.append(P)
        return profiled(model, p, noise, rows, P, *others)

    monkeypatch.setattr(estimate, "profiled", watched)
    return seen


def recording(seed, a, b, samples=300):
    """Return y and u of a plant with outliers."""
    rng = np.random.default_rng([27, seed])
    u = rng.choice([-1.0, 1.0], samples)
    noise = np.where(rng.random(samples) < 0.1, 3.0, 0.3) * rng.normal(size=samples)
    return lfilter([0.0, *b], a, u) + noise, u


def test_a_plant_that_the_recording_tells_keeps_its_linearization(linearized):
    y, u = recording(0, [1.0, -1.5, 0.7], [1.0, 0.5])
    model = identify(y, u, OutputError(2, 2), trend="constant")
    assert not model.profiled
    assert_array_equal(model.P, linearized[-1][:4, :4])
    assert "Intervals" not in model.summary().to_text()


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
    rng = np.random.default_rng(5)
    u = rng.choice([-1.0, 1.0], 60)
    y = lfilter([0.0, 0.1], [1.0, -0.9], u) + 0.6 * rng.normal(size=60)
    one = identify(y, u, OutputError(1, 1), trend="constant")
    other = identify(1e6 * y, 1e-3 * u, OutputError(1, 1), trend="constant")
    assert one.profiled
    assert other.profiled
    assert_allclose(other.std / [1.0, 1e9], one.std, rtol=1e-3)


def test_a_linear_model_has_nothing_to_profile():
    y, u = recording(2, [1.0, -0.8], [1.0])
    assert not identify(y, u, ARX(1, 1)).profiled
