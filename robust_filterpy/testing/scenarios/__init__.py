"""Recordings with everything known: the system, the truth, the labels, and what an estimator that knows them gets.

* `drawing`: `draw`, one function for all of them.
* `models`, `plants`: the systems by name: state estimation, identification.
* `contamination`: the ways in which a recording goes wrong.
* `runs`, `tracker_runs`: what a filter or a tracker makes of a scenario, as arrays.
"""

from __future__ import annotations

from robust_filterpy.testing.scenarios import drawing, models, plants, runs, tracker_runs
from robust_filterpy.testing.scenarios.drawing import *  # noqa: F403
from robust_filterpy.testing.scenarios.models import *  # noqa: F403
from robust_filterpy.testing.scenarios.plants import *  # noqa: F403
from robust_filterpy.testing.scenarios.runs import *  # noqa: F403
from robust_filterpy.testing.scenarios.tracker_runs import *  # noqa: F403

__all__: list[str] = []
__all__ += drawing.__all__
__all__ += models.__all__
__all__ += plants.__all__
__all__ += runs.__all__
__all__ += tracker_runs.__all__
