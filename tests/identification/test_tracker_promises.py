"""The trackers of this package keep the promises of `robust_filterpy.testing`, each as far as it claims them."""

from functools import partial

import pytest
from filterpy.kalman import KalmanFilter
from support import told_tracker

from robust_filterpy import Linear, StudentT, TukeyBiweight
from robust_filterpy.testing import assert_recovers_parameters, draw, run_tracker, tracker_checks

#: Factory, what it does not claim.
TRACKERS = {
    "Huber": (told_tracker, ()),
    "Linear": (partial(told_tracker, influence=Linear()), ("robust",)),
    "filterpy's": (partial(told_tracker, filter=KalmanFilter), ("robust",)),
    "Student": (partial(told_tracker, influence=StudentT(4.0)), ()),
    "Tukey": (partial(told_tracker, influence=TukeyBiweight()), ()),
    "pseudolinear": (partial(told_tracker, gradient="pseudolinear"), ()),
    "unguarded": (partial(told_tracker, guard="none"), ("stable",)),
}
QUICK = ("Huber", "Linear")


@pytest.mark.parametrize(
    ("name", "check"),
    [
        pytest.param(name, check, id=f"{name}-{check}", marks=[] if name in QUICK else [pytest.mark.slow])
        for name, (_, not_claimed) in TRACKERS.items()
        for check in tracker_checks(not_claimed=not_claimed)
    ],
)
def test_promise(name, check):
    check(TRACKERS[name][0])


@pytest.mark.parametrize("contamination", ["mixture", "bursts", "student", ("mixture", "missing")], ids=str)
@pytest.mark.parametrize("plant", ["arx", "fir"])
def test_parameters_are_recovered_through_every_kind_of_outlier(plant, contamination):
    runs = []
    for seed in range(4):
        scenario = draw(plant, 300, contamination=contamination, rng=seed)
        runs.append(run_tracker(scenario.load(told_tracker(scenario.structure)), scenario))
    assert_recovers_parameters(runs, factor=4.0)
