"""Every promise of an estimator, tested by name.

* `filters`, `trackers`: `check_filter`, `check_tracker`, and lists of checks for pytest.
* `filter_contracts`, `filter_equations`, `filter_dependence`, `filter_display`, `filter_statistics`: the promises of a
  filter; `filter_subject` makes and moves it.
* `tracker_contracts`, `tracker_parameters`: the promises of a tracker; `tracker_subject` makes and moves it.
* `common`: the promises that both make.
* `bench`: `Bench`: names, claims, expected failures.
"""

from __future__ import annotations

from robust_filterpy.testing.checks.bench import Bench, Check, CheckResult, ChecksFailed
from robust_filterpy.testing.checks.filter_subject import FILTER_TAGS
from robust_filterpy.testing.checks.filters import check_filter, filter_checks
from robust_filterpy.testing.checks.tracker_subject import TRACKER_TAGS
from robust_filterpy.testing.checks.trackers import check_tracker, tracker_checks

__all__ = [
    "FILTER_TAGS",
    "TRACKER_TAGS",
    "Bench",
    "Check",
    "CheckResult",
    "ChecksFailed",
    "check_filter",
    "check_tracker",
    "filter_checks",
    "tracker_checks",
]
