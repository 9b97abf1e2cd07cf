"""What a correction by the kernel has left: the record of it, read."""

from __future__ import annotations

import numpy as np

from robust_filterpy._arrays import regardless
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import length_and_direction
from robust_filterpy.correction.result import Correction, group_scaling
from robust_filterpy.kernel.series import SCALINGS

__all__ = ["correction_of", "judged_of", "weights_of"]

# A record: four numbers, rows of m numbers, then S and the transpose of C.
_N, _M, _SCALING, _LOG_DENSITY, _HEAD = range(5)
_Y, _E, _WEIGHTS, _PSI_DERIV, _D, _SCORE, _ORDER, _JUDGED, _ROWS = range(9)


def _row(which: int, m: int) -> slice:
    """Return where a record has one of its rows; behind the last begins S."""
    return slice(_HEAD + which * m, _HEAD + (which + 1) * m)


def correction_of(values: Array, x: Array, P: Array) -> Correction:
    """Return what a record of numbers says."""
    n, m = int(values[_N]), int(values[_M])
    scaling, rest = SCALINGS[int(values[_SCALING])], values[_HEAD:]
    y, e, weights, psi_deriv, d, score, order, judged = rest[: _ROWS * m].reshape(_ROWS, m)
    S, C = rest[_ROWS * m : (_ROWS + m) * m].reshape(m, m), rest[(_ROWS + m) * m :].reshape(m, n).T
    groups = _groups(order[: np.count_nonzero(psi_deriv == psi_deriv)])
    information = regardless(_information, S - np.diag(S.diagonal() - judged), e, d, groups, scaling)
    return Correction(
        np.ravel(x), P, C, y, S, score, information, e, weights, psi_deriv,
        tuple(map(tuple, groups)), scaling, float(values[_LOG_DENSITY]),
    )  # fmt: skip


def weights_of(values: Array) -> Array:
    """Return the weights alone."""
    return values[_row(_WEIGHTS, int(values[_M]))].copy()


def judged_of(values: Array) -> tuple[Array, Array]:
    """Return weights and innovations of a record."""
    m = int(values[_M])
    return values[_row(_WEIGHTS, m)], values[_row(_Y, m)]


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
