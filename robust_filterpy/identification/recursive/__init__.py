"""Parameters sample by sample, by any filter of filterpy's kind.

* `tracker`: theta in y = phi' theta + v; made of `setup` and `recursion`.
* `start`: a model from the first samples; `noise_scale`: an R that is followed; `watch`: whether the tracker is lost.
* `conditioning`: P repaired where it has lost digits.
* `tuned`: how fast the parameters drift, from a recording.
* `bank`: the same for many actuators at once, with `bank_setup`.
* `track`: the same recursion by the kernel.
* `river_adapter`: a tracker as a regressor of river.

Imports from below: `models`, `estimation`.
"""
