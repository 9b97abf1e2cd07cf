"""Every promise of an estimator, tested by name.

* `lists`: `check_filter`, `check_tracker`, and lists of checks for pytest.
* `filter_contracts`, `filter_equations`: the promises of a filter;
  `filter_subject` makes and moves it.
* `tracker_contracts`: the promises of a tracker; `tracker_subject` makes and moves it.
* `common`: the promises that both make.
* `bench`: `Bench`: names, claims, expected failures.
"""

from __future__ import annotations

from robust_filterpy.testing.checks.bench import ChecksFailed
from robust_filterpy.testing.checks.lists import check_filter, check_tracker, filter_checks, tracker_checks

__all__ = ["ChecksFailed", "check_filter", "check_tracker", "filter_checks", "tracker_checks"]
