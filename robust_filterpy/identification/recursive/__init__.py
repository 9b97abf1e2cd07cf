"""Parameters sample by sample, by a robust filter with theta as its state.

* `tracker`: theta in y = phi' theta + v, of one actuator and of many at once. `following`: what both are, n actuators
  with one state, a tracker's with n = 1: what may be set, a step, a recording, a state stored and restored.
* `recursion`: everything that n actuators go on from, immutable, the samples that a model is made of, and the
  definition of one sample, which follows R and repairs P. `track`: the driver, by the kernel, else by the definition;
  and from a model to a recursion.
* `watch`: whether an actuator is lost.
* `setup`: from arguments to a filter and arrays, samples as they are given, and what is refused.

Imports from below: `models`, `estimation`.
"""
