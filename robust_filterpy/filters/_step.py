"""One step of one filter by the kernel, where that serves."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.compiled import dispatch
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.whitening import standardize


class KernelCorrection(NamedTuple):
    """`Correction` as the kernel left it: values begin with y, e, psi, psi' (m,), S, T (m, m) and H P (m, n)."""

    x: Array
    P: Array
    values: Array
    m: int
    scaling: str

    @property
    def e(self) -> Array:
        """Standardized innovation, shape (m,)."""
        return self.values[self.m : 2 * self.m]

    @property
    def psi_deriv(self) -> Array:
        """psi'(e), shape (m,)."""
        return self.values[3 * self.m : 4 * self.m]

    def as_arrays(self) -> Correction:
        """Return the same with arrays of their own."""
        x, P, values, m, scaling = self
        x, n = x.ravel(), len(x)
        y, e, psi, psi_deriv = values[: 4 * m].reshape(4, m)
        S, T = values[4 * m : 4 * m + 2 * m * m].reshape(2, m, m)
        C = values[4 * m + 2 * m * m : 4 * m + 2 * m * m + m * n].reshape(m, n)
        SI = None
        if scaling != "innovation":
            whitening = standardize(S, "innovation")[0]
            SI = whitening.T.dot(whitening)
        return Correction(x, P, y, S, SI, C.T.dot(T.T).dot(T), T, e, psi, psi_deriv.tolist())


@lru_cache(maxsize=64)
def _nothing(n: int) -> Array:
    """Return zeros that nobody writes into (read-only ones would be another type to the kernel)."""
    return np.zeros(n)


@lru_cache(maxsize=64)
def _size(n: int, m: int) -> int:
    """Return how many numbers the kernel works with."""
    from robust_filterpy.compiled.kernel import workspace_size

    return workspace_size(n, m)


# The kernel takes writable arrays in C order alone: it would be compiled anew for others. All are of floats by now.


def predict(x: Array, P: Array, F: Array, Q: Array, Bu: Any, alpha_sq: float) -> tuple[Array, Array] | None:
    """Return F x + B u, in the shape of x, and alpha^2 F P F' + Q; None if that is for the definition."""
    steps = dispatch.online()
    if steps is None or not (x.flags.carray and P.flags.carray and F.flags.carray and Q.flags.carray):
        return None
    control = _nothing(len(x)) if Bu is None else np.ascontiguousarray(Bu).ravel()
    x_next, P_next = np.empty(x.shape), np.empty(P.shape)
    if not steps.predict(x.ravel(), P, F, Q, control, alpha_sq, x_next.ravel(), P_next):
        return None
    return x_next, P_next


def correct(x: Array, P: Array, z: Any, H: Array, R: Array, choices: Choices) -> KernelCorrection | None:
    """Correct by a complete measurement z, a float or of shape (m,); None if that is for the definition."""
    steps = dispatch.online()
    if steps is None or not (x.flags.carray and P.flags.carray and H.flags.carray and R.flags.carray):
        return None
    m, n = H.shape
    options = choices.derived.get(m)
    if options is None:
        if not dispatch.can_compile(choices):
            return None
        options = dispatch.encoded(choices, m)
    values, x_post, P_post = np.empty(_size(n, m)), np.empty(x.shape), np.empty(P.shape)
    values[:m] = z
    if not steps.correct(x.ravel(), P, H, R, options, x_post.ravel(), P_post, values):
        return None
    return KernelCorrection(x_post, P_post, values, m, choices.scaling)
