"""The filters of this package keep the promises of `robust_filterpy.testing`, each as far as it claims them."""

from functools import partial

import numpy as np
import pytest
import support
from filterpy.kalman import MerweScaledSigmaPoints

from robust_filterpy import (
    Hampel,
    Huber,
    Linear,
    NoiseMatchedKalmanFilter,
    RecoveringCubatureKalmanFilter,
    RecoveringExtendedKalmanFilter,
    RecoveringKalmanFilter,
    RecoveringUnscentedKalmanFilter,
    RobustCubatureKalmanFilter,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    StudentT,
    TukeyBiweight,
    TwoSidedKalmanFilter,
)
from robust_filterpy.testing import draw, filter_checks, run_filter
from robust_filterpy.testing.robustness import assert_efficient, assert_recovers_from_jump

pytestmark = pytest.mark.core


def of_a_linear_model(cls):
    """Make a sigma-point filter whose functions are its own F and H."""

    def make(dim_x, dim_z):
        functions = {"hx": lambda x: kf.H @ x, "fx": lambda x, dt: kf.F @ x}
        if issubclass(cls, RobustUnscentedKalmanFilter):
            functions["points"] = MerweScaledSigmaPoints(dim_x, 1.0, 2.0, 3.0 - dim_x)
        kf = cls(dim_x=dim_x, dim_z=dim_z, dt=1.0, **functions)
        kf.F, kf.H = np.eye(dim_x), np.zeros((dim_z, dim_x))
        return kf

    return make


SIGMA = ("memoryless", "pickle", "validates")
#: Factory, what it does not claim.
FILTERS = {
    "Linear": (partial(RobustKalmanFilter, influence=Linear()), ("robust",)),
    "Huber": (RobustKalmanFilter, ()),
    "Huber(.8)": (partial(RobustKalmanFilter, influence=Huber(0.8)), ()),
    "Huber, joint": (partial(RobustKalmanFilter, grouping="joint"), ()),
    "Huber, bounded": (partial(RobustKalmanFilter, scaling="bounded"), ("units",)),
    "Huber, weight": (partial(RobustKalmanFilter, information="weight"), ()),
    "Huber, expected": (partial(RobustKalmanFilter, information="expected"), ("recovers",)),
    "Hampel": (partial(RobustKalmanFilter, influence=Hampel()), ("recovers",)),
    "Student": (partial(RobustKalmanFilter, influence=StudentT()), ("recovers",)),
    "Tukey": (partial(RobustKalmanFilter, influence=TukeyBiweight()), ("recovers", "likelihood")),
    "extended": (RobustExtendedKalmanFilter, ()),
    "unscented": (of_a_linear_model(RobustUnscentedKalmanFilter), SIGMA),
    "cubature": (of_a_linear_model(RobustCubatureKalmanFilter), SIGMA),
    "recovering": (RecoveringKalmanFilter, ("likelihood", "memoryless")),
    "recovering extended": (RecoveringExtendedKalmanFilter, ("likelihood", "memoryless")),
    "recovering unscented": (of_a_linear_model(RecoveringUnscentedKalmanFilter), ("likelihood", *SIGMA)),
    "recovering cubature": (of_a_linear_model(RecoveringCubatureKalmanFilter), ("likelihood", *SIGMA)),
    "noise-matched": (NoiseMatchedKalmanFilter, ("recovers",)),
    "two-sided": (TwoSidedKalmanFilter, ("prediction", "memoryless")),
}
ROUNDING = "filterpy's P - K S K' loses its sign in rounding"
SIGMA_POINTS = "filterpy's sigma points are drawn before Q is added"
EXPECTED = {
    "unscented": {"covariance_stays_one": ROUNDING},
    "cubature": {
        "covariance_stays_one": ROUNDING,
        "state_keeps_its_shape": "filterpy's turns a flat x into a column",
        "innovation_and_its_covariance_are_shown": SIGMA_POINTS,
    },
}
EXPECTED |= {f"recovering {name}": EXPECTED[name] for name in ("unscented", "cubature")}
if not support.FILTERPY_2:
    EXPECTED["unscented"]["innovation_and_its_covariance_are_shown"] = SIGMA_POINTS


@pytest.mark.parametrize(
    ("name", "check"),
    [
        pytest.param(name, check, id=f"{name}-{check}")
        for name, (_, not_claimed) in FILTERS.items()
        for check in filter_checks(not_claimed=not_claimed, expected_failures=EXPECTED.get(name))
    ],
)
def test_promise(name, check):
    check(FILTERS[name][0])


def test_jumps_of_any_size_are_followed():
    for size in (5.0, -30.0, 60.0):
        assert_recovers_from_jump(RobustKalmanFilter, size=size, within=200)


def test_outliers_hurt_less_than_they_hurt_filterpy():
    """On the paper's problem and on a vehicle, relative to the filter that knows the labels."""
    for problem in ("paper", "constant velocity"):
        scenarios = [draw(problem, 80, contamination=("mixture", "missing"), rng=seed) for seed in range(20)]
        runs = [run_filter(s.load(RobustKalmanFilter(*s.model.dims[:2])), s) for s in scenarios]
        assert_efficient(runs, at_least=0.6, relative_to=[s.reference for s in scenarios])
