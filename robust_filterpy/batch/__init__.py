"""Many series, many filters at once.

* `bank`: many filters advanced together online.
* `series`: many recordings filtered.

Imports from below: `influence`, `correction`, `compiled`.
"""

from __future__ import annotations

from robust_filterpy.batch.bank import FilterBank
from robust_filterpy.batch.series import FilteredSeries, filter_series

__all__ = ["FilterBank", "FilteredSeries", "filter_series"]
