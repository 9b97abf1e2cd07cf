"""Filters and trackers on a microcontroller: one C99 file that steps exactly this one.

* `export`: what a user calls.
* `filter_model`, `mixture_model`, `tracker_model`: from a filter, one that weighs its noise or an extended one, or a
  tracker, to what the file holds, or why it cannot.
* `text`: the headers of `robust_filterpy.kernel` and, from ``texts``, a few lines beside them.

Imports from below: `correction`, `kernel`, `filters`, `identification`.
"""

from __future__ import annotations

from robust_filterpy.edge.export import export_c

__all__ = ["export_c"]
