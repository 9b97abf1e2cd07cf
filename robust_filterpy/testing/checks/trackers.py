"""`check_tracker`: every promise that a recursive identifier should keep, tested by name."""

from __future__ import annotations

from robust_filterpy.testing.checks import common, tracker_contracts, tracker_parameters
from robust_filterpy.testing.checks.bench import Bench
from robust_filterpy.testing.checks.tracker_subject import TRACKER_TAGS, TrackerSubject

#: From what breaks everything to what only shows now and then, so that the first failure is the one to look at.
PROMISES = (
    *tracker_contracts.ARRAYS,
    *common.CONTRACTS,
    *tracker_parameters.PROMISES,
    *common.STEPS,
    *common.STATISTICS,
    *tracker_contracts.SAMPLES,
)
TRACKERS = Bench(TRACKER_TAGS, TrackerSubject, PROMISES)
check_tracker, tracker_checks = TRACKERS.check, TRACKERS.checks
