"""Every name and module of `filterpy.common`, with `kinematic_kf` making robust filters.

`helpers` and `discretization` are filterpy's as they are: `Saver`, `Q_discrete_white_noise` and the others take our
filters. `kinematic` is ours.
"""

# ruff: noqa: F401, F403
from __future__ import annotations

import filterpy.common
from filterpy.common.discretization import *
from filterpy.common.helpers import *
from filterpy.common.kinematic import *

import robust_filterpy.common.discretization
import robust_filterpy.common.helpers
from robust_filterpy.common.kinematic import kinematic_kf

__all__ = [name for name in dir(filterpy.common) if not name.startswith("_")]
