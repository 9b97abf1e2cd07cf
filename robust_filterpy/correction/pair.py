"""Two sensors: the equations of `robust_filterpy.correction.correct` in floats, for scaling "innovation" and
grouping "component".

numpy's call overhead is most of what so small a filter costs: what has shape (2,) or (2, 2) is spelled out here, and
made into arrays only where it meets the state, or when somebody asks for it. The tests hold it to the definition.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.covariance import joseph
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.whitening import root_of_pair

# (v_11, v_12, v_22) of a symmetric matrix.
Triple = tuple[float, float, float]


class PairCorrection(NamedTuple):
    """`Correction` for m = 2: floats for what has shape (2,) or (2, 2) there, and C for K."""

    x: Array
    P: Array
    C: Array
    y: tuple[float, float]
    S: Triple
    T: Triple
    e: tuple[float, float]
    psi: tuple[float, float]
    psi_deriv: tuple[float, float]

    def as_arrays(self) -> Correction:
        """Return the same with arrays."""
        x, P, C, y, S, triple, e, psi, psi_deriv = self
        T, vectors = _square(triple), np.array([y, e, psi])
        K = C.dot(T).dot(T)
        return Correction(x, P, vectors[0], _square(S), None, K, T, vectors[1], vectors[2], list(psi_deriv))


def applies(y: list[float], choices: Choices) -> bool:
    """Whether `correct_pair` can take the place of `correct`, which also knows the rare cases."""
    return (
        choices.scaling == "innovation"
        and choices.grouping == "component"
        and choices.pointwise is not None
        # False for NaN, too. Up to here a product with T does not overflow.
        and -1e150 < y[0] < 1e150
        and -1e150 < y[1] < 1e150
    )


def correct_pair(
    x: Array, P: Array, y: list[float], H: Array, R: Array, choices: Choices, M: Array | None = None
) -> PairCorrection:
    """Correct by two observed numbers y: x has shape (n,), H (2, n); `applies` must be true."""
    C = P.dot(H.T)
    (a, b), (_, c) = H.dot(C).tolist()
    (ra, rb), (_, rc) = R.tolist()
    a, b, c = a + ra, b + rb, c + rc
    if M is not None:
        C = C + M
        (ma, mb), (mc, md) = H.dot(M).tolist()
        a, b, c = a + 2.0 * ma, b + mb + mc, c + 2.0 * md
    p, q, r = root_of_pair(a, b, c)
    v, w = y
    e = p * v + q * w, q * v + r * w
    psi, psi_deriv, (d, h) = _bound(e, choices)
    v, w = psi
    x_post = x + C.dot(np.array([p * v + q * w, q * v + r * w]))
    if d or h:
        # C T D T, the informed gain
        P_post = joseph(P, H, R, C.dot(_congruent(p, q, r, d, h)), M)
    else:
        P_post = P.copy()
    # D - D^2, what psi leaves unused
    d, h = d - d * d, h - h * h
    if d or h:
        P_post += C.dot(_congruent(p, q, r, d, h)).dot(C.T)
    return PairCorrection(x_post, P_post, C, (y[0], y[1]), (a, b, c), (p, q, r), e, psi, psi_deriv)


def _bound(e: tuple[float, float], choices: Choices) -> tuple[tuple[float, float], ...]:
    """Return psi(e), psi' and the diagonal of D, as `Choices.apply_influence` does."""
    function, a, b, c = choices.pointwise  # type: ignore[misc]
    (v, s), (w, t) = function(e[0], a, b, c), function(e[1], a, b, c)
    if choices.information == "realized":
        d, h = s, t
    elif choices.information == "expected":
        d = h = choices.expected
    else:
        d, h = v / e[0] if e[0] else 1.0, w / e[1] if e[1] else 1.0
    return (v, w), (s, t), (min(max(d, 0.0), 1.0), min(max(h, 0.0), 1.0))


def _congruent(p: float, q: float, r: float, d: float, h: float) -> Array:
    """Return T diag(d, h) T for T = [[p, q], [q, r]]."""
    off = p * d * q + q * h * r
    return np.array([[p * d * p + q * h * q, off], [off, q * d * q + r * h * r]])


def _square(triple: Triple) -> Array:
    """Return the symmetric matrix."""
    p, q, r = triple
    return np.array([[p, q], [q, r]])
