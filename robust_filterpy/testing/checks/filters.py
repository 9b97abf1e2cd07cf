"""`check_filter`: every promise that a filter of filterpy's kind should keep, tested by name."""

from __future__ import annotations

from robust_filterpy.testing.checks import (
    common,
    filter_contracts,
    filter_dependence,
    filter_display,
    filter_equations,
    filter_statistics,
)
from robust_filterpy.testing.checks.bench import Bench
from robust_filterpy.testing.checks.filter_subject import FILTER_TAGS, FilterSubject

#: From what breaks everything to what only shows in the long run, so that the first failure is the one to look at.
PROMISES = (
    *filter_contracts.PROMISES,
    *common.CONTRACTS,
    *filter_equations.PROMISES,
    *common.STEPS,
    *filter_dependence.PROMISES,
    *filter_display.PROMISES,
    *filter_statistics.PROMISES,
    *common.STATISTICS,
)
FILTERS = Bench(FILTER_TAGS, FilterSubject, PROMISES)
check_filter, filter_checks = FILTERS.check, FILTERS.checks
