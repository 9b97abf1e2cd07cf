"""What a correction by the kernel has left: the record of it, read."""

from __future__ import annotations

import math

import numpy as np

from robust_filterpy._arrays import regardless
from robust_filterpy._checks import Array
from robust_filterpy.correction.mixed import Mixed
from robust_filterpy.correction.options import length_and_direction
from robust_filterpy.correction.result import Correction, group_scaling
from robust_filterpy.kernel.series import SCALINGS

__all__ = ["judged_of", "log_density_of", "read", "weights_of"]

# A record: four numbers, rows of m numbers, then S and the transpose of C.
_N, _M, _KIND, _LOG_DENSITY, _HEAD = range(5)
_Y, _E, _WEIGHTS, _PSI_DERIV, _D, _SCORE, _ORDER, _JUDGED, _ROWS = range(9)
# That of a mixture has as many rows, weights in the same place, then mean, P, H, R, what no line explains of z, and M.
_MIXED_ROWS = 6


def read(values: Array, x: Array, P: Array) -> Correction | Mixed:
    """Return what a record of numbers says."""
    n, m, kind = (int(values[i]) for i in (_N, _M, _KIND))
    is_mixed = kind == len(SCALINGS)
    count = _MIXED_ROWS if is_mixed else _ROWS
    shapes = ((n,), (n, n), (m, n), (m, m), (m, m), (n, m)) if is_mixed else ((m, m), (m, n))
    flat, *flats = np.split(values[_HEAD:], np.cumsum([count * m, *map(math.prod, shapes[:-1])]))
    rows, parts = flat.reshape(count, m), [part.reshape(shape) for part, shape in zip(flats, shapes, strict=True)]
    if is_mixed:
        lags, outlying, weights, z, factors, leads = rows
        prior_x, prior_P, H, R, curvature, M = parts
        return Mixed(
            np.ravel(x), P, None, log_density_of(values), weights, outlying, prior_x, prior_P, H, R,
            M if M.any() else None, z, factors[:, None], lags, leads, curvature,
        )  # fmt: skip
    y, e, weights, psi_deriv, d, score, order, judged = rows
    S, C = parts
    groups, scaling = _groups(order[: np.count_nonzero(psi_deriv == psi_deriv)]), SCALINGS[kind]
    information = regardless(_information, S - np.diag(S.diagonal() - judged), e, d, groups, scaling)
    return Correction(
        np.ravel(x), P, C.T, y, S, score, information, e, weights, psi_deriv, tuple(map(tuple, groups)), scaling,
        log_density_of(values),
    )  # fmt: skip


def log_density_of(values: Array) -> float:
    """Return log p(z) alone."""
    return float(values[_LOG_DENSITY])


def weights_of(values: Array) -> Array:
    """Return the weights alone."""
    return judged_of(values)[1].copy()


def judged_of(values: Array) -> Array:
    """Return innovations and weights of a record, shape (2, m)."""
    m = int(values[_M])
    return values[_HEAD : _HEAD + (_WEIGHTS + 1) * m].reshape(_WEIGHTS + 1, m)[_Y::_WEIGHTS]


def _groups(order: Array) -> list[list[int]]:
    """Return the sensors in the order in which they were taken; -1 - i is taken together with the one before."""
    groups: list[list[int]] = []
    for place in map(int, order):
        if place < 0:
            groups[-1].append(-1 - place)
        else:
            groups.append([place])
    return groups


def _information(S: Array, e: Array, d: Array, groups: list[list[int]], scaling: str) -> Array:
    """Return B in P+ = P - C B C', which few look at; d: information along e, then across it."""
    S, W, B = S.copy(), np.eye(len(S)), np.zeros_like(S)
    for group in groups:
        T = group_scaling(S[np.ix_(group, group)], scaling)
        D = d[group[-1]] * np.eye(len(group))
        if len(group) > 1:
            _, direction = length_and_direction(e[group])
            D += (d[group[0]] - d[group[-1]]) * np.outer(direction, direction)
        q, w = S[:, group] @ T.T, W[:, group] @ T.T
        B += w @ D @ w.T
        W -= w @ D @ q.T
        S -= q @ D @ q.T
    return B
