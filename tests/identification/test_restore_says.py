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


SHARED = r"restore: Q of the state, 0, took the place of what was set, 0\.001; forgetting of the state, "
SAID = {
    tracker: {
        "forgetting": r"restore: forgetting of the state, 0\.99, took the place of what was set, 0\.9;",
        "Q": SHARED + r"0\.99, took the place of what was set, 1;",
    },
    bank: {
        "forgetting": r"forgetting of the state, array\(\[0\.99, 0\.99\]\), .* what was set, array\(\[0\.9, 0\.9\]\);",
        "Q": SHARED + r"array\(\[0\.99, 0\.99\]\), took",
    },
}


@pytest.mark.parametrize(("make", "said"), SAID.items())
def test_another_forgetting_or_q_is_said_with_both_values_and_the_same_is_not(make, said):
    one = make(forgetting=0.99)
    one.run(*((Y, U) if make is tracker else (np.tile(Y[:, None], 2), np.tile(U[:, None], 2))))
    state = one.state()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        make(forgetting=0.99).restore(state)
        one.reset()
    with pytest.warns(UserWarning, match=said["forgetting"]):
        make(forgetting=0.9).restore(state)
    with pytest.warns(UserWarning, match=said["Q"]):
        make(Q=1e-3).restore(state)
