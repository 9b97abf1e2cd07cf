"""Fleets: from one filter to ten million, on engines that exist.

* `packing`: states as bytes, without pickle.
* `models`: what all devices have in common, immutable: `FilterModel`, `TrackerModel`.
* `stepping`: one pure step, (model, state, batch) to (state, output), of any number of keys.
* `dask`, `spark`, `stream`: adapters to engines, imported by name.
* `table`: `step`, of one key or many, and whole tables.
* `states`: states of many keys in columns, as an Arrow table.
* `reading`: the forms a batch may have; late samples, duplicates and gaps.
"""

from robust_filterpy._state import pack, unpack
from robust_filterpy.fleet.models import FilterModel, TrackerModel
from robust_filterpy.fleet.states import States
from robust_filterpy.fleet.table import filter_table, step

__all__ = ["FilterModel", "States", "TrackerModel", "filter_table", "pack", "step", "unpack"]
