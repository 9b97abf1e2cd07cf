"""Parameters sample by sample, by a robust filter with theta as its state.

* `tracker`: theta in y = phi' theta + v. `bank`: many actuators at once. Both are `Following` of `track`.
* `state`: what moves, immutable, for n actuators, and the samples that a model is made of. `track`: the driver, by the
  kernel, else by `recursion`, the definition, which follows R and repairs P; and from a model to a recursion.
* `watch`: whether an actuator is lost.
* `setup`: from arguments to filters and arrays, and what is refused.
* `tuned`: how fast the parameters drift, from a recording.

Imports from below: `models`, `estimation`.
"""
