"""psi of the length of e: the equations of `robust_filterpy.correction.correct` without a root of S.

Under scaling "innovation" and grouping "joint" (or for psi = identity) e enters only through its length and direction::

    |e|^2 = y' s,   T e = s,   s = S^-1 y,   D = a I + (r - a) e e'/|e|^2

so that one Cholesky factor of S does for its eigenvalues and eigenvectors. T, e and psi are made when somebody asks
for them. The tests hold it to the definition.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg import blas, lapack

from robust_filterpy._checks import Array
from robust_filterpy.correction.covariance import innovation_moments, joseph
from robust_filterpy.correction.definition import correct
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.whitening import standardize

# Least ratio of the factor's pivots, above which S is far from singular.
_SURELY_REGULAR = 1e-3
# For |y| up to the one and pivots down to the other |e|^2 does not overflow.
_SAFE, _LEAST = 1e100, 1e-50


class JointCorrection(NamedTuple):
    """`Correction` under grouping "joint": the share psi(|e|)/|e| in place of T, e and psi."""

    x: Array
    P: Array
    y: Array
    S: Array
    K: Array
    share: float
    psi_deriv: float

    def as_arrays(self) -> Correction:
        """Return the same with T, e and psi."""
        x, P, y, S, K, share, psi_deriv = self
        T, SI, _ = standardize(S, "innovation")
        e = T.dot(y)
        return Correction(x, P, y, S, SI, K, T, e, share * e, [psi_deriv] * len(y))


def applies(size: float, H: Array, choices: Choices) -> bool:
    """Whether `correct_jointly` can take the place of `correct` for an innovation of this size, NaN if incomplete."""
    # A sensor that the state has no part in stands outside the group.
    return choices.by_length and size < _SAFE and (choices.is_linear or _all_seen(H.tobytes(), len(H)))


@lru_cache(maxsize=256)
def _all_seen(content: bytes, m: int) -> bool:
    """Whether the state has a part in every sensor: by the bytes of H, since most users never write into it."""
    return bool(np.frombuffer(content).reshape(m, -1).any(axis=1).all())


def correct_jointly(
    x: Array, P: Array, y: Array, H: Array, R: Array, choices: Choices, M: Array | None = None
) -> JointCorrection | Correction:
    """Correct by a measurement of which every component is observed; `applies` must be true."""
    C, S = innovation_moments(P, H, R, M)
    factor, gain, failed = lapack.dposv(S, C.T)
    pivots = factor.diagonal().tolist()
    if failed or not min(pivots) > max(_SURELY_REGULAR * max(pivots), _LEAST):
        return correct(x, P, y, H, R, choices, M)
    K = gain.T
    s = lapack.dpotrs(factor, y)[0]
    square = y.dot(s).item()
    along = length = math.sqrt(max(square, 0.0))
    psi_deriv = across = radial = 1.0
    if not choices.is_linear:
        along, psi_deriv, across, radial = choices.apply_to_length(length, len(y))
    share = along / length if length > 0.0 else 1.0
    step = K.dot(y)
    x_post = x + (step if share == 1.0 else share * step)
    if across == radial == 0.0:
        return JointCorrection(x_post, P.copy(), y, S, K, share, psi_deriv)
    if across == radial == 1.0:
        return JointCorrection(x_post, joseph(P, H, R, K, M), y, S, K, share, psi_deriv)
    # The informed gain C T D T, transposed.
    informed = across * gain
    if radial != across:
        informed = blas.dger((radial - across) / square, s, step, a=informed, overwrite_a=True)
    # D - D^2 = (1 - a) D + r (a - r) e e'/|e|^2, what psi leaves unused
    P_post = joseph(P, H, R, informed.T, M, (1.0 - across) * C)
    rest = radial * (across - radial)
    if rest:
        P_post += (rest / square * step[:, None]).dot(step[None])
    return JointCorrection(x_post, P_post, y, S, K, share, psi_deriv)
