"""Estimator unit tests: scenarios with everything known, assertions that are theorems, and checks with a name.

People who filter with something else can use them too: a filter is whatever has ``x, P, F, H, Q, R``, ``predict()`` and
``update(z)``, a tracker whatever has ``theta`` and ``update(y, u)``.

Scenarios

* `scenarios`: `draw`, one function for all of them.
* `models`, `plant_scenarios`: the systems by name: state estimation, identification.
* `contamination`: the ways in which a recording goes wrong.
* `runs`, `tracker_runs`: what a filter or a tracker makes of a scenario, as arrays.

Assertions

* `consistency`: NIS, NEES, bias, whiteness, a covariance that stays one.
* `robustness`: bounded influence, the way back from a jump, efficiency.
* `invariance`: units, the order of sensors, missing measurements.
* `contracts`: refused calls, copies, two filters that are the same.
* `tracking`: parameters found and followed, stable models, honest intervals.
* `bounds`: the exact bounds that these share, and their words.

Checks

* `filters`, `trackers`: `check_filter`, `check_tracker`, and lists of checks for pytest.
* `filter_contracts`, `filter_equations`, `filter_dependence`, `filter_display`, `filter_statistics`: the promises of a
  filter; `filter_subject` makes and moves it.
* `tracker_contracts`, `tracker_parameters`: the promises of a tracker; `tracker_subject` makes and moves it.
* `checks`: names, claims, expected failures.
* `shadow`: `side_by_side`, an unchanged program run with two filters.
* `page`: every scenario and every check with its theorem, as a page.

Imports from below: `influence`, `diagnostics`, `identification`, `plants`. pytest is not needed.
"""

from __future__ import annotations

from robust_filterpy.testing.checks import Check, CheckResult, ChecksFailed
from robust_filterpy.testing.consistency import (
    assert_consistent,
    assert_covariance_stays_one,
    assert_innovations_white,
    assert_unbiased,
)
from robust_filterpy.testing.contamination import (
    CONTAMINATIONS,
    Bursts,
    Missing,
    Mixture,
    OneSided,
    Sentinels,
    Stuck,
    Student,
)
from robust_filterpy.testing.contracts import (
    assert_close,
    assert_refused_call_changes_nothing,
    assert_same_filter,
    assert_state_round_trip,
    assert_unchanged,
    visible,
)
from robust_filterpy.testing.filter_subject import FILTER_TAGS
from robust_filterpy.testing.filters import check_filter, filter_checks
from robust_filterpy.testing.invariance import (
    assert_missing_is_no_information,
    assert_sensor_order_irrelevant,
    assert_unit_equivariant,
)
from robust_filterpy.testing.models import MODELS, StateModel
from robust_filterpy.testing.plant_scenarios import PLANTS, Plant, PlantScenario
from robust_filterpy.testing.robustness import (
    assert_bounded_influence,
    assert_efficient,
    assert_recovers_from_jump,
)
from robust_filterpy.testing.runs import FilterRun, load, run_filter
from robust_filterpy.testing.scenarios import Scenario, draw
from robust_filterpy.testing.shadow import FilterComparison, SideBySide, side_by_side
from robust_filterpy.testing.tracker_runs import TrackerRun, run_tracker
from robust_filterpy.testing.tracker_subject import TRACKER_TAGS
from robust_filterpy.testing.trackers import check_tracker, tracker_checks
from robust_filterpy.testing.tracking import (
    assert_interval_coverage,
    assert_recovers_parameters,
    assert_stable_model,
    assert_tracks,
)

__all__ = [
    "CONTAMINATIONS",
    "FILTER_TAGS",
    "MODELS",
    "PLANTS",
    "TRACKER_TAGS",
    "Bursts",
    "Check",
    "CheckResult",
    "ChecksFailed",
    "FilterComparison",
    "FilterRun",
    "Missing",
    "Mixture",
    "OneSided",
    "Plant",
    "PlantScenario",
    "Scenario",
    "Sentinels",
    "SideBySide",
    "StateModel",
    "Stuck",
    "Student",
    "TrackerRun",
    "assert_bounded_influence",
    "assert_close",
    "assert_consistent",
    "assert_covariance_stays_one",
    "assert_efficient",
    "assert_innovations_white",
    "assert_interval_coverage",
    "assert_missing_is_no_information",
    "assert_recovers_from_jump",
    "assert_recovers_parameters",
    "assert_refused_call_changes_nothing",
    "assert_same_filter",
    "assert_sensor_order_irrelevant",
    "assert_stable_model",
    "assert_state_round_trip",
    "assert_tracks",
    "assert_unbiased",
    "assert_unchanged",
    "assert_unit_equivariant",
    "check_filter",
    "check_tracker",
    "draw",
    "filter_checks",
    "load",
    "run_filter",
    "run_tracker",
    "side_by_side",
    "tracker_checks",
    "visible",
]
