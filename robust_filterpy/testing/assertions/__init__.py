"""Theorems about estimators, as assertions whose failures say in figures and words what is wrong.

* `consistency`: NIS, NEES, bias, whiteness, a covariance that stays one.
* `robustness`: bounded influence, the way back from a jump, efficiency; units, order, missing samples.
* `contracts`: refused calls, copies, two filters that are the same.
* `tracking`: parameters found and followed, stable models, honest intervals.
"""

from __future__ import annotations

from robust_filterpy._lazy import elsewhere
from robust_filterpy.testing.assertions import consistency, contracts, robustness, tracking
from robust_filterpy.testing.assertions.consistency import *  # noqa: F403
from robust_filterpy.testing.assertions.contracts import *  # noqa: F403
from robust_filterpy.testing.assertions.robustness import *  # noqa: F403
from robust_filterpy.testing.assertions.tracking import *  # noqa: F403

__all__: list[str] = []
__all__ += consistency.__all__
__all__ += contracts.__all__
__all__ += robustness.__all__
__all__ += tracking.__all__

__getattr__ = elsewhere(__name__)
