"""psi, rho and the information D of one measurement, for the compiled loops."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from robust_filterpy.compiled import workspace as at
from robust_filterpy.influence import scalar

# Only what a run enters by can be called from Python, has a file in numba's cache, and counts references to arrays.
_INNER: dict[str, Any] = {
    "nogil": True, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True, "_nrt": False
}  # fmt: skip
compiled = njit(**_INNER)
inlined = njit(forceinline=True, **_INNER)

_linear, _huber, _hampel = inlined(scalar.linear), inlined(scalar.huber), inlined(scalar.hampel)
_tukey, _student_t = inlined(scalar.tukey), inlined(scalar.student_t)
_linear_rho, _huber_rho = inlined(scalar.linear_rho), inlined(scalar.huber_rho)
_hampel_rho, _tukey_rho = inlined(scalar.hampel_rho), inlined(scalar.tukey_rho)
_student_t_rho = inlined(scalar.student_t_rho)

_LARGEST = float(np.finfo(float).max)


@compiled
def influence(kind, e, a, b, c):
    """Return psi, psi'."""
    if kind == 1:
        return _huber(e, a, b, c)
    if kind == 0:
        return _linear(e, a, b, c)
    if kind == 2:
        return _hampel(e, a, b, c)
    if kind == 3:
        return _tukey(e, a, b, c)
    return _student_t(e, a, b, c)


@compiled
def rho(kind, e, a, b, c):
    """Return rho, at most the largest float."""
    if kind == 1:
        r = _huber_rho(e, a, b, c)
    elif kind == 0:
        r = _linear_rho(e, a, b, c)
    elif kind == 2:
        r = _hampel_rho(e, a, b, c)
    elif kind == 3:
        r = _tukey_rho(e, a, b, c)
    else:
        r = _student_t_rho(e, a, b, c)
    return min(r, _LARGEST)


@inlined
def clip(d):
    """Return d in [0, 1]."""
    return min(max(d, 0.0), 1.0)


@inlined
def length_of(w, e, m, mask):
    """Return the length of e, of the components that the row mask marks, without overflow."""
    peak, total = 0.0, 0.0
    for i in range(m):
        if mask == 0 or w[mask, 0, i] != 0.0:
            peak = max(peak, abs(w[e, 0, i]))
    if peak == 0.0:
        return 0.0
    for i in range(m):
        if mask == 0 or w[mask, 0, i] != 0.0:
            total += (w[e, 0, i] / peak) ** 2
    return min(peak * math.sqrt(total), _LARGEST)


@inlined
def bound_components(w, r, m):
    """Write psi(e), psi(e)/e and the diagonal of D; return its least and its greatest entry."""
    least, most = 1.0, 0.0
    for i in range(m):
        e = w[at.E, 0, i]
        psi, slope = influence(r.kind, e, r.a, r.b, r.c)
        weight = 1.0 if psi == e else psi / e
        if r.information == 1:
            slope = r.expected
        elif r.information == 2:
            slope = weight
        d = clip(slope)
        w[at.PSI, 0, i], w[at.WEIGHT, 0, i], w[at.D_DIAGONAL, 0, i] = psi, weight, d
        least, most = min(least, d), max(most, d)
    return least, most


@compiled
def bound_length(w, r, m):
    """Let psi act on the length of the components that the state has a part in; return whether D is diagonal.

    psi, weights and d hold what `bound_components` wrote, which is right for the others. Also return the least and the
    greatest entry of D's diagonal.
    """
    visible = 0
    for i in range(m):
        visible += int(w[at.MASK, 0, i])
    length = length_of(w, at.E, m, at.MASK)
    along, slope = influence(r.kind, length, r.a, r.b, r.c)
    share = along / length if length > 0.0 else 1.0
    across = clip(share)
    if r.information == 1:
        across = w[at.EXPECTED, 0, visible - 1] if visible else r.expected
    radial = clip(slope) if r.information == 0 and length > 0.0 else across
    least, most = 1.0, 0.0
    for i in range(m):
        for j in range(m):
            w[at.D, i, j] = 0.0
        w[at.D, i, i] = w[at.D_DIAGONAL, 0, i]
        e = w[at.E, 0, i]
        if w[at.MASK, 0, i] != 0.0:
            psi = along * (e / length) if length > 0.0 else 0.0
            w[at.PSI, 0, i], w[at.WEIGHT, 0, i] = psi, psi / e if e != 0.0 else 1.0
            w[at.D, i, i] = across
            if radial != across:
                for j in range(m):
                    if w[at.MASK, 0, j] != 0.0:
                        w[at.D, i, j] += (radial - across) * (e / length) * (w[at.E, 0, j] / length)
            w[at.D_DIAGONAL, 0, i] = w[at.D, i, i]
        least, most = min(least, w[at.D_DIAGONAL, 0, i]), max(most, w[at.D_DIAGONAL, 0, i])
    return radial == across, least, most
