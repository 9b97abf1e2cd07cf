"""What a state replaces is said: a tracker that was made with another forgetting does not keep it in silence."""

import warnings

import numpy as np
import pytest

from robust_filterpy import ARX, ParameterTracker
from robust_filterpy.identification import TrackerBank

RNG = np.random.default_rng(10_300)
Y, U = RNG.normal(size=(2, 50))


def tracker(**options):
    return ParameterTracker(ARX(1, 1), start=0, **options)


def bank(**options):
    return TrackerBank(2, ARX(1, 1), start=0, **options)


@pytest.mark.parametrize("make", [tracker, bank])
def test_another_forgetting_or_q_is_said_and_the_same_is_not(make):
    one = make(forgetting=0.99)
    one.run(*((Y, U) if make is tracker else (np.tile(Y[:, None], 2), np.tile(U[:, None], 2))))
    state = one.state()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make(forgetting=0.99).restore(state)
        one.reset()
    with pytest.warns(UserWarning, match="restore: forgetting of the state"):
        make(forgetting=0.9).restore(state)
    with pytest.warns(UserWarning, match="restore: Q"):
        make(Q=1e-3).restore(state)
