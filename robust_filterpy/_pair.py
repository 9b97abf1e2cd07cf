"""Two sensors: the equations of `robust_filterpy.correction.correct` in floats, for scaling "innovation".

numpy's call overhead is most of what so small a filter costs: what has shape (2,) or (2, 2) is spelled out here, and
made into arrays only where it meets the state, or when somebody asks for it. The tests hold it to the definition.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.choices import Choices
from robust_filterpy.correction import Correction, joseph, root_of_pair

# (v_11, v_12, v_22) of a symmetric matrix.
Triple = tuple[float, float, float]


class PairCorrection(NamedTuple):
    """`Correction` for m = 2: floats for what has shape (2,) or (2, 2) there, C for K, and x in its own shape."""

    x: Array
    P: Array
    C: Array
    y: tuple[float, float]
    S: Triple
    T: Triple
    e: tuple[float, float]
    psi: tuple[float, float]
    slope: tuple[float, float]

    def as_arrays(self) -> Correction:
        """Return the same with arrays."""
        x, P, C, y, S, triple, e, psi, slope = self
        T, vectors = _square(triple), np.array([y, e, psi])
        K = C.dot(T).dot(T)
        return Correction(x.ravel(), P, vectors[0], _square(S), None, K, T, vectors[1], vectors[2], list(slope))


def applies(y: list[float], H: Array, choices: Choices) -> bool:
    """Whether `correct_pair` can take the place of `correct`, which also knows the rare cases."""
    return (
        choices.scaling == "innovation"
        and choices.pointwise is not None
        # False for NaN, too. Up to here a product with T does not overflow.
        and -1e150 < y[0] < 1e150
        and -1e150 < y[1] < 1e150
        # A sensor that the state has no part in stands outside the group.
        and (choices.grouping == "component" or all(map(any, H.tolist())))
    )


def correct_pair(
    x: Array, P: Array, y: list[float], H: Array, R: Array, choices: Choices, M: Array | None = None
) -> PairCorrection:
    """Correct by two observed numbers y: x has shape (n,) or (n, 1), H (2, n); `applies` must be true."""
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
    psi, slope, (d, g, h) = _bound(e, choices)
    v, w = psi
    moved = C.dot(np.array([p * v + q * w, q * v + r * w]))
    x_post = x + (moved[:, None] if x.ndim == 2 else moved)
    # T D T, which is the inverse of S where nothing was bounded, so that C T D T is the informed gain.
    td, tg, gr, hr = p * d + q * g, p * g + q * h, q * d + r * g, q * g + r * h
    off = td * q + tg * r
    if d or h:
        K = C.dot(np.array([[td * p + tg * q, off], [off, gr * q + hr * r]]))
        P_post = joseph(P, H, R, K, M)
    else:
        P_post = P.copy()
    # D - D^2, what psi leaves unused
    unused = d - d * d - g * g, g - g * (d + h), h - h * h - g * g
    if unused != (0.0, 0.0, 0.0):
        G = C.dot(_square((p, q, r)))
        P_post += G.dot(_square(unused)).dot(G.T)
    return PairCorrection(x_post, P_post, C, (y[0], y[1]), (a, b, c), (p, q, r), e, psi, slope)


def _bound(e: tuple[float, float], choices: Choices) -> tuple[tuple[float, float], tuple[float, float], Triple]:
    """Return psi(e), psi' and D, as `Choices.bound` does."""
    if choices.grouping == "joint":
        length = math.hypot(*e)
        along, slope, across, radial = choices._of_length(length, 2)
        i, j = (e[0] / length, e[1] / length) if length else (0.0, 0.0)
        more = radial - across
        return (along * i, along * j), (slope, slope), (across + more * i * i, more * i * j, across + more * j * j)
    function, a, b, c = choices.pointwise  # type: ignore[misc]
    (v, s), (w, t) = function(e[0], a, b, c), function(e[1], a, b, c)
    if choices.information == "realized":
        d, h = s, t
    elif choices.information == "expected":
        d = h = choices.expected
    else:
        d, h = v / e[0] if e[0] else 1.0, w / e[1] if e[1] else 1.0
    return (v, w), (s, t), (min(max(d, 0.0), 1.0), 0.0, min(max(h, 0.0), 1.0))


def _square(triple: Triple) -> Array:
    """Return the symmetric matrix."""
    p, q, r = triple
    return np.array([[p, q], [q, r]])
