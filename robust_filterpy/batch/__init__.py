"""Many series, many filters at once.

* `series`: many recordings filtered, the noise of each learnt on request.

Imports from below: `influence`, `correction`, `kernel`, `filters`.
"""

from __future__ import annotations

from robust_filterpy._lazy import elsewhere
from robust_filterpy.batch.series import filter_series

__all__ = ["filter_series"]

__getattr__ = elsewhere(__name__)
