"""validate says of dynamics and of noise apart, and has a verdict for residuals that are rounding."""

import numpy as np
import pytest
from scipy.signal import lfilter

from robust_filterpy.identification import ARX, OutputError, identify, validate

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


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
