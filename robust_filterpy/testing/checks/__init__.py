"""Every promise of a filter, tested by name.

* `lists`: `check_filter`, and the checks for pytest.
* `filter_contracts`, `filter_equations`: the promises.
* `bench`: names, claims, expected failures, and what makes filters and moves them.
"""

from __future__ import annotations

from robust_filterpy.testing.checks.bench import ChecksFailed
from robust_filterpy.testing.checks.lists import check_filter, filter_checks

__all__ = ["ChecksFailed", "check_filter", "filter_checks"]
