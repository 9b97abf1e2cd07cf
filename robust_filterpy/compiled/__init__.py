"""When what numba compiles serves: the smoothing pass, until that is in the kernel in C, too.

* `dispatch`: whether the compiled form or the definition serves a call.
* `stamp`: what is in numba's cache on this machine.

Neither imports numba unless it is used. Imports from below: `influence`, `correction.options`.
"""
