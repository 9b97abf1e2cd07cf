"""Ctrl-C at any line inside any call of any filter: the call has happened, or it has not."""

import copy
from functools import partial

import numpy as np
import pytest
from interruption import half_steps
from support import Extended, by_night, of_matrices

from robust_filterpy import Contaminated, Learnt, RobustKalmanFilter, RobustUnscentedKalmanFilter, TukeyBiweight
from robust_filterpy.correction import Scales
from robust_filterpy.filters import RobustCubatureKalmanFilter
from robust_filterpy.filters.ensemble import RobustEnsembleKalmanFilter

F, H = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[1.0, 0.0]])


def ensemble():
    rng = np.random.default_rng(0)
    return RobustEnsembleKalmanFilter(np.zeros(2), np.eye(2), 1, 0.1, 10, lambda x: x[:1], lambda x, dt: F @ x, rng=rng)


FILTERS = {
    name: partial(of_matrices, kind, F, H, **options)
    for name, kind, options in (
        ("linear", RobustKalmanFilter, {}), ("by the definition", RobustKalmanFilter, {"influence": TukeyBiweight()}),
        ("patient", RobustKalmanFilter, {"influence": TukeyBiweight(), "patience": 2}),
        ("contaminated", RobustKalmanFilter, {"noise": Contaminated()}),
        ("learnt", RobustKalmanFilter, {"noise": Learnt(), "process": Scales()}), ("extended", Extended, {}),
        ("extended, learnt", Extended, {"noise": Learnt()}), ("unscented", RobustUnscentedKalmanFilter, {}),
        ("cubature", RobustCubatureKalmanFilter, {"patience": 2}),
    )
}  # fmt: skip
FILTERS["ensemble"] = ensemble


def update(kf, z):
    kf.update(None if z is None else np.array([z]))


CALLS = {
    "predict": lambda kf: kf.predict(), "update": lambda kf: update(kf, 0.5), "outlier": lambda kf: update(kf, 60.0),
    "missing": lambda kf: update(kf, None), "restore": None,
}  # fmt: skip
#: What the linear filter has besides.
LINEAR = {
    "predict with matrices": lambda kf: kf.predict(F=F, Q=np.eye(2)),
    "update with matrices": lambda kf: kf.update(0.5, R=2.0, H=2.0 * H),
    "sequential": lambda kf: kf.update_sequential(0, 0.5),
    "steady state": lambda kf: kf.update_steadystate(0.5),
    "predict, steady state": lambda kf: kf.predict_steadystate(),
    "get_update": lambda kf: kf.get_update(60.0),
    "correlated": lambda kf: kf.update_correlated(0.5),
    "recording": lambda kf: kf.batch_filter([0.1, 60.0, None]),
}


def seen(kf):
    """All that a call moves, and all that it shows."""
    found = {name: value for name, value in kf.state().items() if name != "format"}
    for name in ("x_prior", "P_prior", "x_post", "P_post", "y", "weights", "log_likelihood", "K", "S"):
        found[name] = np.asarray(getattr(kf, name), dtype=float)
    return found


CASES = [(name, call) for name in FILTERS for call in CALLS] + [("by the definition", call) for call in LINEAR]
BY_DAY = [
    (name, call) for name, call in CASES if name not in ("patient", "contaminated", "extended, learnt", "cubature")
]


@pytest.mark.parametrize(
    "name, call", [pytest.param(*case, marks=[] if case in BY_DAY else pytest.mark.nightly) for case in CASES]
)
@pytest.mark.parametrize("every", by_night([1, 3], 3))
def test_an_interrupt_leaves_no_half_step(name, call, every):
    kf = FILTERS[name]()
    kf.Q = 0.01 * np.eye(2)
    for z in (0.1, 0.2, 5.0, 0.1):
        kf.predict()
        update(kf, z)
    if call not in ("predict", "predict with matrices"):
        kf.predict()
    make = {**CALLS, **LINEAR}[call]
    if call == "restore":
        later = copy.deepcopy(kf)
        update(later, 0.3)
        make = lambda one: one.restore(later.state())  # noqa: E731
    half, lines = half_steps(kf, make, seen, every=every)
    assert half == [] and lines > 1
