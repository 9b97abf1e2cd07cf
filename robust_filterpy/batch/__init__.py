"""Many series, many filters at once.

* `bank`: many filters advanced together online.
* `series`: many recordings filtered.
* `adaptive`: the same, and the noise of each learnt.

Imports from below: `influence`, `correction`, `kernel`, `filters`.
"""

from __future__ import annotations

from robust_filterpy.batch.adaptive import AdaptiveSeries, adaptive_series
from robust_filterpy.batch.bank import FilterBank
from robust_filterpy.batch.series import FilteredSeries, filter_series

__all__ = ["AdaptiveSeries", "FilterBank", "FilteredSeries", "adaptive_series", "filter_series"]
