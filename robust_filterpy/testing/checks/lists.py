"""`check_filter` and `check_tracker`: every promise of a filter or of a recursive identifier, tested by name."""

from __future__ import annotations

from robust_filterpy.testing.checks import (
    common,
    filter_contracts,
    filter_equations,
    tracker_contracts,
)
from robust_filterpy.testing.checks.bench import Bench
from robust_filterpy.testing.checks.filter_subject import FILTER_TAGS, FilterSubject
from robust_filterpy.testing.checks.tracker_subject import TRACKER_TAGS, TrackerSubject

#: From what breaks everything to what only shows in the long run, so that the first failure is the one to look at.
FILTER_PROMISES = (
    *filter_contracts.CONTRACTS,
    *common.CONTRACTS,
    *filter_equations.PROMISES,
    *common.STEPS,
    *filter_contracts.DEPENDENCE,
    *filter_contracts.SHOWN,
    *filter_contracts.STATISTICS,
    *common.STATISTICS,
)
TRACKER_PROMISES = (
    *tracker_contracts.ARRAYS,
    *common.CONTRACTS,
    *tracker_contracts.PARAMETERS,
    *common.STEPS,
    *common.STATISTICS,
    *tracker_contracts.SAMPLES,
)
FILTERS = Bench(FILTER_TAGS, FilterSubject, FILTER_PROMISES)
TRACKERS = Bench(TRACKER_TAGS, TrackerSubject, TRACKER_PROMISES)
check_filter, filter_checks = FILTERS.check, FILTERS.checks
check_tracker, tracker_checks = TRACKERS.check, TRACKERS.checks
