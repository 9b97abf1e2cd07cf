"""Recordings of a plant of second order, and how what trackers and models say of them is held together."""

import re
import warnings
from contextlib import contextmanager, nullcontext

import numpy as np
from scipy.signal import lfilter

A, B = np.array([1.0, -1.5, 0.7]), np.array([0.0, 1.0, 0.5])
THETA = np.array([-1.5, 0.7, 1.0, 0.5])
RIGHT = "nothing is left in the residuals"


def binary(seed, *shape):
    """A generator and a binary input."""
    rng = np.random.default_rng(seed)
    return rng, rng.choice([-1.0, 1.0], shape)


def wild(rng, shape, sigma=0.3, share=0.1, size=10.0):
    """Noise of which a share is so many times as large."""
    return sigma * np.where(rng.random(shape) < share, size, 1.0) * rng.normal(size=shape)


def recording(seed, length=400, share=0.1, sigma=0.3, inside=False, a=A, b=B):
    """Output and input of the plant; the noise is of the sensor, or inside the loop, as ARX has it."""
    rng, u = binary(seed, length)
    noise = wild(rng, length, sigma, share)
    return lfilter(b, a, u) + (lfilter([1.0], a, noise) if inside else noise), u


STATES = np.array([[0.8, 0.4, 0.0], [-0.4, 0.8, 0.0], [0.0, 0.0, 0.6]])
INPUTS = np.array([[1.0, 0.3], [0.2, -0.6], [0.5, 1.0]])
OUTPUTS = np.array([[1.0, 0.0, 0.7], [0.3, -1.0, 0.4]])


def of_states(seed, samples=500, outliers=0.1, noise=0.2, driven=0.0, gain=1.0):
    """Two outputs at levels of their own, from a state that is not at rest, and two inputs."""
    rng = np.random.default_rng(seed)
    u, x, y = rng.choice([-1.0, 1.0], (samples, 2)), rng.normal(size=3), np.empty((samples, 2))
    for k in range(samples):
        y[k] = OUTPUTS @ x
        x = STATES @ x + gain * INPUTS @ u[k] + driven * rng.normal(size=3)
    return y + wild(rng, y.shape, noise, outliers) + [5.0, -300.0], u


@contextmanager
def silence(category=Warning):
    """Let a warning be an error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", category)
        yield


@contextmanager
def unheard(category=Warning):
    """Let warnings pass."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield


def same(one, other):
    """Hold states, by name, or columns together, to the last bit."""
    if hasattr(one, "keys"):
        assert one.keys() == other.keys()
        one, other = zip(*((value, other[name]) for name, value in one.items()), strict=True)
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))


@contextmanager
def unchanged(thing):
    """Hold the state of a tracker or a bank together with what it was."""
    before = thing.state()
    try:
        yield
    finally:
        same(before, thing.state())


def assert_refused(call, good, wrong, of=None):
    """The call takes good arguments; what is wrong for one is refused by its name, and changes nothing of a thing."""
    call(**good)
    taken = []
    for name, values in wrong.items():
        for value in values:
            try:
                with unchanged(of) if of is not None else nullcontext():
                    call(**{**good, name: value})
                taken.append((name, value))
            except (ValueError, TypeError) as error:
                if not re.search(rf"\b{name}\b", str(error)):
                    taken.append((name, value, str(error)))
    assert not taken, "\n".join(map(str, taken))
