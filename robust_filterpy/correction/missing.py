"""Components that were not measured: placing what the observed ones gave among all."""

from __future__ import annotations

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.result import Correction


def nothing_observed(x: Array, P: Array, S: Array, m: int) -> Correction:
    """Return the correction by a measurement that is missing altogether."""
    zero, square = np.zeros(m), np.zeros((m, m))
    return Correction(x, P, zero, S, square, np.zeros((len(x), m)), square, zero, zero, np.full(m, np.nan))


def _embed(some: Correction, part: np.ndarray, S: Array) -> Correction:
    """Put the correction by the observed components where it belongs among all of them."""
    m, square = len(S), np.ix_(part, part)
    T, SI, K = np.zeros((m, m)), np.zeros((m, m)), np.zeros((some.x.size, m))
    T[square], SI[square], K[:, part] = some.T, some.inverse, some.K
    y, e, psi = (scatter(v, part, m) for v in (some.y, some.e, some.psi))
    return Correction(some.x, some.P, y, S, SI, K, T, e, psi, scatter(np.array(some.psi_deriv), part, m, np.nan))


def embed_block(before: Correction | None, some: Correction, part: slice, m: int) -> Correction:
    """Put the correction by one block of a measurement beside those by the blocks before it."""
    n = len(some.P)
    if before is None or before.T.shape != (m, m) or before.K.shape != (n, m):
        before = nothing_observed(some.x, some.P, np.zeros((m, m)), m)
    square = {}
    for name, block in (("S", some.S), ("SI", some.inverse), ("T", some.T)):
        whole = (before.inverse if name == "SI" else getattr(before, name)).copy()
        whole[part], whole[:, part] = 0.0, 0.0
        whole[part, part] = block
        square[name] = whole
    K = before.K.copy()
    K[:, part] = some.K
    vectors = {}
    for name in ("y", "e", "psi", "psi_deriv"):
        vectors[name] = np.array(getattr(before, name), dtype=float)
        vectors[name][part] = getattr(some, name)
    return Correction(some.x, some.P, K=K, **square, **vectors)


def scatter(values: Array, part: np.ndarray, m: int, rest: float = 0.0) -> Array:
    """Return m numbers: values at the places in part, rest elsewhere."""
    whole = np.full(m, rest)
    whole[part] = values
    return whole
