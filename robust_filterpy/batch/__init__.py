"""Many series, many filters at once.

* `bank`: many filters advanced together online.
* `series`: many recordings filtered, the noise of each learnt on request.
* `arguments`: what the functions of many series take, checked.

Imports from below: `influence`, `correction`, `kernel`, `filters`.
"""

from __future__ import annotations

from robust_filterpy.batch.bank import FilterBank
from robust_filterpy.batch.series import filter_series

__all__ = ["FilterBank", "filter_series"]
