"""Recordings with everything known: the system, the truth, the labels, and what an estimator that knows them gets.

* `drawing`: `draw`, one function for all of them.
* `models`, `plants`: the systems by name: state estimation, identification.
* `contamination`: the ways in which a recording goes wrong.
* `runs`: what a filter or a tracker makes of a scenario, as arrays.
"""

from __future__ import annotations

from robust_filterpy._lazy import elsewhere
from robust_filterpy.testing.scenarios.drawing import draw
from robust_filterpy.testing.scenarios.runs import run_filter, run_tracker

__all__ = ["draw", "run_filter", "run_tracker"]

__getattr__ = elsewhere(__name__)
