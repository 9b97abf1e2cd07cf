"""A covariance that holds two standard deviations away, where the loss is not quadratic so far from its least.

Where a zero nearly cancels a pole, theta +- 2 std by linearization holds the truth in four recordings of five instead
of nineteen of twenty. So the loss is looked at along each principal axis of the covariance of C, D and F, with all that
is linear in the residuals (B, A, the constant, the start) at its best there: the profile of the likelihood. Where it
rises more slowly than a quadratic, the axis becomes as long as the farther of the two places at which it has risen by
2. Other ends that are nearly as likely count by their odds.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.uncertainty import principal_axes

# Two standard deviations away the loss has risen by 2, or is bent if it is off by more than this share of it.
_FAR: Final = 2.0
_BENT: Final = 0.2
# So many standard deviations are the most that an axis has, and it is found to two or three digits.
_FARTHEST: Final = 16.0
_HALVINGS: Final = 6
# Ends so much less likely than the best count.
_CLOSE: Final = 4.0
# Weights of the residuals and what is linear take turns.
_TURNS: Final = 2


def profiled(
    model: PolynomialModel, p: Array, noise: Noise, rows: Any, P: Array, held: Any, others: list[tuple[float, Array]],
    colour: float = 1.0,
) -> tuple[Array, bool]:  # fmt: skip
    """Return the covariance of the free parameters, wider where the loss bends, and whether it does."""
    loss = _Loss.of(model, p, noise, rows, held, colour)
    places = np.flatnonzero(loss.bent)
    if not places.size:
        return P, False
    own = P[np.ix_(places, places)]
    axes, least = principal_axes(own), loss.at(p[places])
    reach = np.array([max(_reach(loss, p[places], sign * axis, least) for sign in (-1.0, 1.0)) for axis in axes])
    close = [(excess, end) for excess, end in others if excess < _CLOSE]
    if (reach <= 1.0).all() and not close:
        return P, False
    longer = axes * np.maximum(reach, 1.0)[:, None]
    wider = longer.T @ longer
    total = 1.0 + sum(np.exp(-excess) for excess, _ in close)
    for excess, end in close:
        apart = end[places] - p[places]
        wider += np.exp(-excess) / total * np.outer(apart, apart)
    # What is linear follows as the linearization says.
    follows = P[:, places] @ np.linalg.pinv(own)
    return P + follows @ (wider - own) @ follows.T, True


def _reach(loss: _Loss, center: Array, axis: Array, least: float) -> float:
    """Return where the loss along an axis has risen as a quadratic would have in two standard deviations, over that."""

    def rise(t: float) -> float:
        return (loss.at(center + t * axis) - least) / (0.5 * _FAR**2)

    low, high = 0.0, _FAR
    if abs(rise(_FAR) - 1.0) < _BENT:
        return 1.0
    while high < _FARTHEST and rise(high) < 1.0:
        low, high = high, 2.0 * high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rise(middle) < 1.0 else (low, middle)
    return 0.5 * (low + high) / _FAR


class _Loss(NamedTuple):
    """What the residuals say of C, D and F, all that is linear at its best."""

    model: PolynomialModel
    p: Array
    noise: Noise
    rows: Any
    weights: Array
    counted: float
    bent: Any
    linear: Any

    @classmethod
    def of(cls, model: PolynomialModel, p: Array, noise: Noise, rows: Any, held: Any, colour: float) -> _Loss:
        """Return it, of which as much counts as the sandwich says."""
        places, bent = model.structure.polynomials, np.zeros(model.n, dtype=bool)
        for place in (places.f, places.c, places.d):
            bent[place] = True
        residual = model.residuals(p)[rows]
        square = max(float(np.mean(noise.psi(residual) ** 2)), np.finfo(float).tiny)
        counted = noise.slope(residual) / square * (1.0 - model.n / residual.size) / colour**2
        return cls(model, p, noise, rows, noise.weights(residual), counted, bent & ~held, ~bent & ~held)

    def at(self, bent: Array) -> float:
        """Return the least loss for these C, D and F, infinite where they are not stable."""
        p = self.p.copy()
        p[self.bent] = bent
        if not self.model.is_stable(p):
            return np.inf
        residual, X = self.model.residuals(p)[self.rows], self.model.jacobian(p).T[self.linear][:, self.rows]
        size = np.linalg.norm(X, axis=1)
        X = X / np.where(size > 0.0, size, 1.0)[:, None]
        for turn in range(_TURNS):
            weighted = X * (self.noise.weights(residual) if turn else self.weights)
            square = weighted @ X.T + 1e-12 * np.eye(size.size)
            residual = residual - np.linalg.solve(square, weighted @ residual) @ X
        return self.counted * self.noise.cost(residual)
