"""The recursion in plain numba, and when it serves.

* `dispatch`: whether the kernel or the definition serves a call; what the rest of the package calls.
* `stamp`: which kernels are in numba's cache on this machine.
* `kernel`: prediction and correction of one step.
* `whitening`, `psi`: T, and psi, rho and D, of one step.
* `loops`: the kernel over recordings and series, and entries for one step.
* `adaptive`: filters side by side, and the correction under noise that is learnt.
* `records`: what goes into the kernel over series and comes out of it.
* `warm`: calls that make numba compile each kernel.
* `jit`: compiler flags.

`dispatch` and `stamp` import no numba. Imports from below: `influence`, `correction.options`.
"""
