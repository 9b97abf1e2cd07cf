"""Filters and trackers on a microcontroller: one C99 file that steps exactly this one.

* `export`: what a user calls, and how a text and a table become C.
* `models`: from a filter or a tracker to what the file holds, or why it cannot.
* ``texts``: what stands with the headers of `robust_filterpy.kernel`; which of its lines, the model decides.

Imports from below: `correction`, `kernel`, `filters`, `identification`.
"""

from __future__ import annotations

from robust_filterpy.edge.export import export_c

__all__ = ["export_c"]
