"""Every promise of a filter, tested by name.

* `lists`: `check_filter`, and the checks for pytest.
* `filter_contracts`, `filter_equations`, `common`: the promises; `filter_subject` makes filters and moves them.
* `bench`: names, claims, expected failures.
"""

from __future__ import annotations

from robust_filterpy.testing.checks.bench import ChecksFailed
from robust_filterpy.testing.checks.lists import check_filter, filter_checks

__all__ = ["ChecksFailed", "check_filter", "filter_checks"]
