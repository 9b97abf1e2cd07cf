"""Estimator unit tests: scenarios with everything known, assertions that are theorems, and checks with a name.

People who filter with something else can use them too: a filter is whatever has ``x, P, F, H, Q, R``, ``predict()`` and
``update(z)``, a tracker whatever has ``theta`` and ``update(y, u)``.

* `drawing`: `draw`, one function for all scenarios: the system, the truth, the labels, and what an estimator gets that
  knows them.
* `models`, `plants`: the systems by name: state estimation, identification.
* `contamination`: the ways in which a recording goes wrong.
* `runs`: what a filter or a tracker makes of a scenario, as arrays.
* `consistency`: NIS, NEES, bias, whiteness, efficiency, a covariance that stays one; parameters recovered, followed,
  honest intervals.
* `checks`: every promise of a filter, tested by name: `check_filter`, a list for pytest; the promises about calls.
* `filter_equations`, `filter_data`: the promises about equations and data.
* `bench`: names, claims, expected failures, and what makes filters and moves them.

Imports from below: `influence`, `diagnostics`, `identification`, `plants`. pytest is not needed.
"""

from __future__ import annotations

from robust_filterpy.identification.models.noise import fit_percent
from robust_filterpy.testing.bench import ChecksFailed
from robust_filterpy.testing.checks import check_filter, filter_checks
from robust_filterpy.testing.consistency import (
    assert_consistent,
    assert_innovations_white,
    assert_recovers_parameters,
    assert_tracks,
    assert_unbiased,
)  # fmt: skip
from robust_filterpy.testing.drawing import draw
from robust_filterpy.testing.runs import run_filter, run_tracker

__all__ = [
    "ChecksFailed", "assert_consistent", "assert_innovations_white", "assert_recovers_parameters", "assert_tracks",
    "assert_unbiased", "check_filter", "draw", "filter_checks", "fit_percent", "run_filter", "run_tracker",
]  # fmt: skip
