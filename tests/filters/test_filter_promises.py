"""The filters of this package keep the promises of `robust_filterpy.testing`, each as far as it claims them."""

from functools import partial

import numpy as np
import pytest
import support
from support import RECOVERING, noise_given, recovering, two_sided

from robust_filterpy import (
    AdaptiveKalmanFilter,
    Contaminated,
    Huber,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    StudentT,
    TukeyBiweight,
)
from robust_filterpy.filters import RobustCubatureKalmanFilter
from robust_filterpy.influence import Hampel, Linear
from robust_filterpy.testing import filter_checks

pytestmark = pytest.mark.core


by_S = partial(RobustKalmanFilter, scaling="innovation")
learnt = partial(RobustKalmanFilter, noise="learnt", process="given")
#: Factory, what it does not claim. Under scaling "learnt", the default, what is typical of a sensor is remembered with
#: x and P, and a psi that is nowhere linear bends what is ordinary for a sensor, however small that is.
FILTERS = {
    "Linear": (partial(RobustKalmanFilter, influence=Linear()), ("robust",)),
    "Huber": (RobustKalmanFilter, ("memoryless",)),
    "Huber by S": (by_S, ()),
    "Huber(.8)": (partial(RobustKalmanFilter, influence=Huber(0.8)), ("memoryless",)),
    "Huber, joint": (partial(RobustKalmanFilter, grouping="joint"), ("memoryless",)),
    "Huber, joint by S": (partial(by_S, grouping="joint"), ()),
    "Huber, bounded": (partial(RobustKalmanFilter, scaling="bounded"), ("units",)),
    "Huber, weight": (partial(by_S, information="weight"), ()),
    "Huber, expected": (partial(by_S, information="expected"), ("recovers", "linear")),
    "Hampel": (partial(by_S, influence=Hampel()), ("recovers",)),
    "Student": (partial(by_S, influence=StudentT()), ("recovers",)),
    "Student, learnt": (partial(RobustKalmanFilter, influence=StudentT()), ("recovers", "memoryless", "linear")),
    "Tukey": (partial(by_S, influence=TukeyBiweight()), ("recovers", "likelihood")),
    "extended by S": (partial(RobustExtendedKalmanFilter, scaling="innovation"), ()),
    "recovering": (recovering, ("likelihood", "memoryless", "linear")),
    "noise-matched": (partial(noise_given, grouping="joint"), ("recovers",)),
    "noise-matched, each sensor": (noise_given, ("recovers", "linear")),
    "two-sided": (two_sided, ("linear", "prediction", "memoryless")),
    "two-sided, given": (partial(noise_given, process=Contaminated(0.01, 10.0)), ("linear", "prediction", "recovers")),
    "adaptive": (AdaptiveKalmanFilter, ("linear", "prediction", "memoryless")),
    "adaptive, joint": (partial(AdaptiveKalmanFilter, grouping="joint"), ("linear", "prediction", "memoryless")),
    "learnt": (learnt, ("linear", "memoryless", "recovers")),
    "learnt, process drawn": (
        partial(learnt, process=Contaminated(0.01, 10.0)), ("linear", "prediction", "memoryless", "recovers")
    ),
}  # fmt: skip


def nonlinear(kind, **options):
    """Make a nonlinear filter of a linear model: one of sigma points has functions of its own F and H."""
    return lambda dim_x, dim_z: support.of_matrices(kind, 1.0, np.zeros((dim_z, dim_x)), **options)


GIVEN, SIGMA = {"noise": Contaminated(0.1, 10.0)}, ("memoryless", "pickle", "validates")
for name, kind, own in (
    ("extended", RobustExtendedKalmanFilter, ("memoryless",)), ("unscented", RobustUnscentedKalmanFilter, SIGMA),
    ("cubature", RobustCubatureKalmanFilter, SIGMA),
):  # fmt: skip
    # The extended filter's own functions are asked for by its methods.
    make = nonlinear if own is SIGMA else partial
    FILTERS |= {
        name: (make(kind), own),
        f"recovering {name}": (make(kind, **RECOVERING), ("likelihood", "linear", *own)),
        f"{name} given": (make(kind, **GIVEN), ("linear", "recovers", *(SIGMA if own is SIGMA else ()))),
        f"{name} learnt": (make(kind, noise="learnt", process="given"), ("linear", "recovers", *own)),
        f"{name} adaptive": (make(kind, noise="learnt"), ("linear", "prediction", *own)),
    }
#: A policy of each kind on the linear filter and a shell keep every promise on every commit; of the
#: others each name keeps a sixth of them then, another sixth than the name before.
WHOLE = ("Huber", "extended", "learnt", "adaptive")
ROUNDING = "filterpy's P - K S K' loses its sign in rounding"
BEFORE_Q = (
    "innovation_and_its_covariance_are_shown", "innovations_are_judged_by_their_own_deviation",
    "small_innovations_are_believed",
)  # fmt: skip
SIGMA_POINTS = dict.fromkeys(BEFORE_Q, "filterpy's sigma points are drawn before Q is added")
EXPECTED = {"unscented": {"covariance_stays_one": ROUNDING}}
EXPECTED["cubature"] = {"state_keeps_its_shape": "filterpy's turns a flat x into a column", **SIGMA_POINTS}
EXPECTED["cubature"] |= EXPECTED["unscented"]
for name in ("unscented", "cubature"):
    kinds = (f"recovering {name}", *(f"{name} {noise}" for noise in ("given", "learnt", "adaptive")))
    EXPECTED |= dict.fromkeys(kinds, EXPECTED[name])
if not support.FILTERPY_2:
    EXPECTED["unscented"] |= SIGMA_POINTS


@pytest.mark.parametrize(("name", "check"), [
    pytest.param(
        name, check, id=f"{name}-{check}", marks=[] if name in WHOLE or (i + k) % 6 == 0 else [pytest.mark.nightly]
    )
    for i, (name, (_, not_claimed)) in enumerate(FILTERS.items())
    for k, check in enumerate(filter_checks(not_claimed=not_claimed, expected_failures=EXPECTED.get(name)))
])  # fmt: skip
def test_promise(name, check):
    check(FILTERS[name][0])
