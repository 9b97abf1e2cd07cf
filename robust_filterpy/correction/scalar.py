"""One sensor: the equations of `robust_filterpy.correction.correct` in floats.

It serves where the kernel does not, and takes half of the general form's time there:
``python tests/benchmarks/filter_speed.py --scalar`` prints .47 (2 states), .48 (4), .50 (8).
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.covariance import _require_positive, identity, symmetrized
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.whitening import _singular

_LARGEST = sys.float_info.max


class ScalarCorrection(NamedTuple):
    """`Correction` for m = 1: what has shape (1,) or (1, 1) there is a float here, and x keeps its shape."""

    x: Array
    P: Array
    y: float
    S: float
    SI: float
    K: Array
    T: float
    e: float
    psi: float
    psi_deriv: float

    def as_arrays(self) -> Correction:
        """Return the same with arrays."""
        x, P, y, S, SI, K, T, e, psi, psi_deriv = self
        one, square = np.array([y, e, psi, psi_deriv])[:, None], np.array([S, SI, T])[:, None, None]
        return Correction(x.ravel(), P, one[0], square[0], square[1], K, square[2], one[1], one[2], [psi_deriv])


def correct_scalar(
    x: Array, P: Array, y: float, H: Array, r: float, choices: Choices, M: Array | None = None
) -> ScalarCorrection:
    """Correct by one observed number y: x has shape (n,) or (n, 1), H (1, n); choices.pointwise must exist."""
    C = P.dot(H.T)
    hph = H.dot(C).item()
    s = hph + r
    if M is not None:
        C = C + M
        s += 2.0 * H.dot(M).item()
    if not 0.0 < s < math.inf:
        raise _singular(np.array([[s]]), s)
    scaling, information = choices.scaling, choices.information
    # T^2 and 1 - T S T'
    t2, whitening_defect = 1.0 / s, 0.0
    if scaling == "unit":
        t2, whitening_defect = 1.0, 1.0 - s
    elif scaling == "bounded" and s < 1.0:
        t2, whitening_defect = 1.0, 1.0 - s
    t = math.sqrt(t2)
    e = t * y
    if not -_LARGEST <= e <= _LARGEST:
        e = math.copysign(_LARGEST, y)
    function, a, b, c = choices.pointwise  # type: ignore[misc]
    psi, psi_deriv = function(e, a, b, c)
    if information == "realized":
        d = min(max(psi_deriv, 0.0), 1.0)
    elif information == "expected":
        d = choices.expected
    else:
        d = min(max(psi / e, 0.0), 1.0) if e != 0.0 else 1.0
    K = C * t2
    # An innovation that is not bounded moves x by exactly what filterpy's arithmetic gives.
    moved = K * (y if psi == e else psi / t)
    x_post = x + (moved if x.ndim == 2 else moved.ravel())
    if d == 0.0:
        return ScalarCorrection(x_post, P.copy(), y, s, 1.0 / s, K, t, e, psi, psi_deriv)
    K_d = K if d == 1.0 else K * d
    I_KH = identity(len(P)) - K_d.dot(H)
    P_post = I_KH.dot(P).dot(I_KH.T)
    # With G = K/T the unused part G (d - d^2 + d^2 (1 - T S T')) G' joins the noise term d^2 K r K'.
    P_post += (K * (d * d * r + (d - d * d + d * d * whitening_defect) / t2)).dot(K.T)
    if M is not None:
        cross = I_KH.dot(M).dot(K_d.T)
        P_post -= cross + cross.T
    if scaling == "unit" and d * hph > 1.0 - 1e-9:
        _require_positive(P_post, [d], np.array([[hph]]))
    return ScalarCorrection(x_post, symmetrized(P_post), y, s, 1.0 / s, K, t, e, psi, psi_deriv)
