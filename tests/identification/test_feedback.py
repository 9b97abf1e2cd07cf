"""A recording from a closed loop is recognised, one from an open loop is not taken for one."""

import warnings

import numpy as np
import pytest
import support
from scipy.signal import lfilter

from robust_filterpy import ARX, OutputError, identify
from robust_filterpy.identification import BoxJenkins


def closed(seed, gain=0.5, outliers=0.0, samples=800):
    """A plant with coloured noise, under proportional control of its measured output."""
    rng = np.random.default_rng(seed)
    reference, v = (
        np.repeat(rng.choice([-1.0, 1.0], samples // 10), 10),
        lfilter([1.0], [1.0, -0.8], rng.normal(size=samples)),
    )
    wild = np.where(rng.random(samples) < outliers, 5.0, 0.0) * rng.normal(size=samples)
    u, w, y = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    for k in range(1, samples):
        w[k] = 0.8 * w[k - 1] + 0.5 * u[k - 1]
        y[k] = w[k] + 0.3 * v[k] + wild[k]
        u[k] = gain * (reference[k] - y[k])
    return y, u


def kinds(y, u, structure):
    """What was found."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return [(finding.kind, finding.text) for finding in identify(y, u, structure).findings]


@pytest.mark.pairwise(1)
@pytest.mark.parametrize(("structure", "says"), [
    (OutputError(1, 1), "is biased by that"),
    (BoxJenkins(1, 0, 1, 1), "as far as its noise model"),
    (ARX(2, 2), "right"),
], ids=str)  # fmt: skip
@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_feedback_is_found_and_what_it_means_is_said(structure, says, outliers):
    found = dict(kinds(*closed(1, outliers=outliers), structure))
    assert says in found["closed loop"]


@pytest.mark.pairwise(1)
@support.draws(1, 5)
@pytest.mark.parametrize("hold", [1, 4, 30])
@pytest.mark.parametrize("structure", [OutputError(1, 1), ARX(1, 1)], ids=str)
def test_an_open_loop_is_none(hold, structure, draws):
    for seed in range(draws):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.choice([-1.0, 1.0], 800 // hold + 1), hold)[:800]
        v = lfilter([1.0], [1.0, -0.9], rng.normal(size=800)) + np.where(rng.random(800) < 0.1, 5.0, 0.0)
        assert "closed loop" not in dict(kinds(lfilter([0.0, 0.5], [1.0, -0.8], u) + 0.3 * v, u, structure))
