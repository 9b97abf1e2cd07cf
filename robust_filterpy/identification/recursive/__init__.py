"""Parameters sample by sample, by a robust filter with theta as its state.

* `tracker`: theta in y = phi' theta + v. `bank`: many actuators at once. Both hold a `State`, advanced by `track`.
* `standing`: the model of a tracker as it stands. `bank_results`: what a bank returns.
* `state`: what moves, immutable, for n actuators. `track`: the driver, by the kernel, else by `recursion`, the
  definition.
* `start`: samples that a model is made of. `handover`: from a model to a recursion. `watch`: whether an actuator is
  lost. `noise_scale`: an R that is followed. `conditioning`: P repaired where it
  has lost digits.
* `returning`: back to a state that was kept, or to the start.
* `setup`, `bank_setup`: from arguments to filters and arrays, and what is refused.
* `tuned`: how fast the parameters drift, from a recording.

Imports from below: `models`, `estimation`.
"""
