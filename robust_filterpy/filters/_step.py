"""One step of one filter by the kernel, where that serves."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import FLOAT, Array
from robust_filterpy.compiled import dispatch
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.whitening import standardize


class KernelCorrection(NamedTuple):
    """`Correction` as the kernel left it: y, e, psi, psi' (m,), S, T (m, m) and H P (m, n) in one array."""

    x: Array
    P: Array
    values: Array
    m: int
    scaling: str

    def as_arrays(self) -> Correction:
        """Return the same with arrays of their own."""
        x, P, values, m, scaling = self
        y, e, psi, psi_deriv = values[: 4 * m].reshape(4, m)
        S, T = values[4 * m : 4 * m + 2 * m * m].reshape(2, m, m)
        C = values[4 * m + 2 * m * m :].reshape(m, -1)
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
def _sizes(n: int, m: int) -> tuple[int, int]:
    """Return how many numbers the kernel works with, and how many of them `KernelCorrection` keeps."""
    from robust_filterpy.compiled.kernel import workspace_size

    return workspace_size(n, m), 4 * m + 2 * m * m + m * n


def _takes(*arrays: Any) -> bool:
    """Return whether the kernel takes these float arrays as they are: it would be compiled anew for a strided one."""
    for array in arrays:
        if not (array.dtype == FLOAT and array.flags.carray):
            return False
    return True


def predict(x: Array, P: Array, F: Array, Q: Array, Bu: Any, alpha_sq: float) -> tuple[Array, Array] | None:
    """Return F x + B u, in the shape of x, and alpha^2 F P F' + Q; None if that is for the definition."""
    steps = dispatch.online()
    if steps is None or not _takes(x, P, F, Q):
        return None
    n = len(x)
    control = _nothing(n) if Bu is None else np.ascontiguousarray(Bu).ravel()
    x_next, P_next = np.empty(n), np.empty((n, n))
    if not steps.predict(x.ravel(), P, F, Q, control, alpha_sq, x_next, P_next):
        return None
    return (x_next if x.ndim == 1 else x_next.reshape(n, 1)), P_next


def correct(x: Array, P: Array, z: Any, H: Array, R: Array, choices: Choices) -> KernelCorrection | None:
    """Correct by a complete measurement z, a float or of shape (m,); None if that is for the definition."""
    steps = dispatch.online()
    if steps is None or not dispatch.can_compile(choices) or not _takes(x, P, H, R):
        return None
    n, m = len(x), len(H)
    size, kept = _sizes(n, m)
    values, x_post, P_post = np.empty(size), np.empty(n), np.empty((n, n))
    values[:m] = z
    if not steps.correct(x.ravel(), P, H, R, dispatch.encoded(choices, m), x_post, P_post, values):
        return None
    return KernelCorrection(x_post, P_post, values[:kept], m, choices.scaling)
