"""A recording of a linear filter, read once: from a filter and lists, as `batch_filter` takes them, to arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._arrays import control_term, measurement_rows, stack, state_of
from robust_filterpy._checks import Array

__all__ = ["Problem", "finite", "read"]


class Problem(NamedTuple):
    """A linear model with its data; matrices that stay have a first axis of length 1, the others of length N."""

    zs: Array
    """Measurements, NaN where missing, shape (N, m)."""
    F: Array
    """Shape (1 or N, n, n)."""
    Q: Array
    """Shape (1 or N, n, n)."""
    H: Array
    """Shape (1 or N, m, n)."""
    R: Array
    """Shape (1 or N, m, m)."""
    Bu: Array
    """What inputs add to the state, shape (1 or N, n)."""
    x: Array
    """State before the first prediction, shape (n,)."""
    P: Array
    """Its covariance, shape (n, n)."""
    alpha_sq: float = 1.0
    """Fading memory, >= 1."""
    log_narrowed: float = 0.0
    """What is added to a log-likelihood where P is narrower than the filter's."""

    def first(self, steps: int) -> Problem:
        """Return the beginning of the recording."""
        zs, F, Q, H, R, Bu = (part[:steps] for part in self[:6])
        return self._replace(zs=zs, F=F, Q=Q, H=H, R=R, Bu=Bu)


def read(
    kf: Any, zs: Any, Fs: Any = None, Qs: Any = None, Hs: Any = None, Rs: Any = None, Bs: Any = None, us: Any = None
) -> Problem:
    """Return the model and the data of a filter with x, P, F, H, Q, R as arrays, or raise and name what does not fit.
    """
    absent = [name for name in ("x", "P", "F", "H", "Q", "R") if not hasattr(kf, name)]
    if absent:
        raise TypeError(f"filter: expected a linear filter of filterpy's kind, got {type(kf).__name__}: no {absent[0]}")
    x, P = state_of(kf)
    n = len(x)
    m = stack("H", kf.H, Hs, None, (None, n)).shape[1]
    z = measurement_rows(zs, m)
    shapes = {"F": (Fs, (n, n)), "Q": (Qs, (n, n)), "H": (Hs, (m, n)), "R": (Rs, (m, m))}
    F, Q, H, R = (stack(name, getattr(kf, name), each, len(z), shape) for name, (each, shape) in shapes.items())
    Bu = _inputs(getattr(kf, "B", None), Bs, us, n, len(z))
    return Problem(z, F, Q, H, R, Bu, x.ravel(), P, float(getattr(kf, "_alpha_sq", 1.0)))


def finite(problem: Problem) -> Problem:
    """Return a problem, or raise if something was measured that is infinite."""
    infinite = np.isinf(problem.zs).any(axis=1)
    if infinite.any():
        raise ValueError(f"zs: expected finite numbers or NaN (missing), got infinity at step {infinite.argmax()}")
    return problem


def _inputs(B: Any, Bs: Any, us: Any, n: int, steps: int) -> Array:
    """Return B u of each step, (N or 1, n); None in us or Bs is no input, or the filter's own B."""
    if us is None:
        return np.zeros((1, n))
    us, Bs = _checks.entries("us", us), _checks.entries("Bs", Bs)
    for name, values in (("us", us), ("Bs", Bs)):
        if values is not None and (not hasattr(values, "__len__") or len(values) < steps):
            got = len(values) if hasattr(values, "__len__") else _checks.shown(values)
            raise ValueError(f"{name}: expected an entry for each of the {steps} measurements, got {got}")
    if B is None and Bs is None:
        raise ValueError("us: expected no inputs for a filter without B; set kf.B")
    matrices: Any
    us = us[:steps] if isinstance(us, np.ndarray) else list(us)[:steps]
    width = np.size(us[0])
    alike = np.ndim(B if Bs is None else Bs[0]) == 2 and all(u is not None and np.size(u) == width for u in us)
    if alike and (Bs is None or all(np.shape(one) == (n, width) for one in Bs)):
        matrices = stack("B", B, Bs, steps, (n, width))
        terms = np.einsum("kij,kj->ki", np.broadcast_to(matrices, (steps, n, width)), measurement_rows(us, width, "us"))
    else:
        matrices = [B] * steps if Bs is None else [B if one is None else one for one in list(Bs)[:steps]]
        pairs = zip(matrices, (0.0 if u is None else u for u in us), strict=True)
        terms = np.array([np.zeros(n) + control_term(b, u, (n,)) for b, u in pairs])
    if not np.isfinite(terms).all():
        raise ValueError("us: expected finite numbers, got NaN or infinity")
    return terms
