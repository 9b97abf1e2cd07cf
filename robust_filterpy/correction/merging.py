"""Hypotheses about the noise: correct a state under each, weigh them by their likelihood, merge by moments.

`correct_each` and `collapse` take any number of leading axes, so that several filters which run side by side
(interacting multiple models) are corrected in one call; `merge` is the case of one state.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.copies import collapse
from robust_filterpy.correction.whitening import Inverse, standardize

__all__ = ["EachCorrection", "Hypothesis", "Merged", "correct_each", "merge"]

_LOG_2PI = math.log(2.0 * math.pi)
# Standard deviations of the widest hypothesis up to which an innovation counts as what it is. Beyond, no part of
# the noise model says anything, and the score of a normal distribution would grow without bound.
_REACH = 8.0
# Hypotheses that one correction may have: two for each of eight sensors.
MOST_HYPOTHESES = 256


class Hypothesis(NamedTuple):
    """One way in which a measurement may have come about."""

    probability: float
    """Prior probability."""
    P: Array
    """Prior covariance of the state, shape (n, n)."""
    R: Array
    """Measurement noise covariance, shape (m, m)."""
    M: Array | None = None
    """Covariance of the state's error and the measurement noise, shape (n, m)."""


class Merged(NamedTuple):
    """Mean and covariance of the state over all hypotheses, and what the innovation told about them."""

    x: Array
    """Posterior mean, shape (n,)."""
    P: Array
    """Posterior covariance, shape (n, n)."""
    probabilities: Array
    """Posterior probabilities of the hypotheses, shape (h,)."""
    log_density: float
    """log p(y)."""
    score: Array
    """g(y) = -grad log p(y), shape (m,)."""
    information: Array
    """Its derivative, shape (m, m)."""


class EachCorrection(NamedTuple):
    """The correction under each hypothesis; the leading axes are those of the filters, then h hypotheses."""

    moves: Array
    """Posterior mean minus prior mean, shape (..., h, n)."""
    P: Array
    """Posterior covariances, shape (..., h, n, n)."""
    log_densities: Array
    """log N(y; 0, S), shape (..., h)."""
    y: Array
    """Innovations, none beyond 8 standard deviations of the widest hypothesis, shape (..., h, m)."""
    pulls: Array
    """S^-1 y, shape (..., h, m)."""
    inverses: Array
    """S^-1, shape (..., h, m, m)."""


def correct_each(
    y: Array, P: Array, H: Array, R: Array, M: Array | None = None, inv: Inverse | None = None
) -> EachCorrection:
    """Correct a state under each hypothesis, in Joseph's form.

    Parameters
    ----------
    y : ndarray, shape (..., h, m)
        Innovation z - H x under each hypothesis, finite. Here and below h = 1 if it is the same under all.
    P : ndarray, shape (..., h, n, n)
        Prior covariance.
    H : ndarray, shape (m, n) or (..., h, m, n)
        Measurement matrix.
    R : ndarray, shape (..., h, m, m)
        Covariance of the measurement noise.
    M : ndarray, shape (..., h, n, m), optional
        Covariance of the state's error and the measurement noise.
    inv : callable, optional
        What inverts S; by default a singular S is an error.

    Returns
    -------
    EachCorrection

    Raises
    ------
    SingularInnovationError
        If S is not positive definite and inv is not given.

    Notes
    -----
    An innovation beyond 8 standard deviations of every hypothesis is shortened to 8 first: it has no place in the
    model, and the influence stays bounded.
    """
    C = P @ np.swapaxes(H, -1, -2)
    S = H @ C + R
    if M is not None:
        C = C + M
        S = S + H @ M + np.swapaxes(H @ M, -1, -2)
    inverses, log_dets = _inverted(S, inv)
    y = _shortened(y, inverses)
    pulls = (inverses @ y[..., None])[..., 0]
    log_densities = -0.5 * ((pulls * y).sum(axis=-1) + log_dets + y.shape[-1] * _LOG_2PI)
    K = C @ inverses
    I_KH = np.eye(P.shape[-1]) - K @ H
    after = I_KH @ P @ np.swapaxes(I_KH, -1, -2) + K @ R @ np.swapaxes(K, -1, -2)
    if M is not None:
        mixed = I_KH @ M @ np.swapaxes(K, -1, -2)
        after = after - mixed - np.swapaxes(mixed, -1, -2)
    return EachCorrection((C @ pulls[..., None])[..., 0], after, log_densities, y, pulls, inverses)


def normalized(logs: Array) -> tuple[Array, float]:
    """Return exp(logs) divided by its sum, and the log of the sum."""
    peak = logs.max()
    weights = np.exp(logs - peak)
    total = weights.sum()
    return weights / total, float(peak) + math.log(total)


def merge(x: Array, y: Array, H: Array, hypotheses: list[Hypothesis], inv: Inverse | None = None) -> Merged:
    """Correct a state once for each hypothesis and merge by moments.

    Exact for the mean and the covariance of the posterior, which is a mixture of normal distributions; what is lost
    is its shape (generalised pseudo-Bayesian of order one).

    Parameters
    ----------
    x : ndarray, shape (n,)
        Prior mean, the same under every hypothesis.
    y : ndarray, shape (m,)
        Innovation z - H x, finite.
    H : ndarray, shape (m, n)
        Measurement matrix.
    hypotheses : list of Hypothesis
        The ways in which y may have come about.
    inv : callable, optional
        What inverts S; by default a singular S is an error.

    Returns
    -------
    Merged

    Raises
    ------
    SingularInnovationError
        If S is not positive definite and inv is not given.

    Examples
    --------
    >>> one = np.eye(1)
    >>> merged = merge(np.zeros(1), np.array([6.0]), one, [Hypothesis(0.9, one, one), Hypothesis(0.1, one, 100 * one)])
    >>> merged.probabilities.round(3), merged.x.round(2)
    (array([0.009, 0.991]), array([0.09]))
    """
    prior, P, R = (np.array([getattr(h, name) for h in hypotheses]) for name in ("probability", "P", "R"))
    M = None if hypotheses[0].M is None else np.array([h.M for h in hypotheses])
    each = correct_each(y[None], P, H, R, M, inv)
    probabilities, log_density = normalized(np.log(prior) + each.log_densities)
    move, covariance = collapse(probabilities, each.moves, each.P)
    g = probabilities @ each.pulls
    information = np.tensordot(probabilities, each.inverses, 1) - (each.pulls.T * probabilities) @ each.pulls
    return Merged(x + move, covariance, probabilities, log_density, g, information + np.outer(g, g))


def _inverted(S: Array, inv: Inverse | None) -> tuple[Array, Array]:
    """Return the inverses and log determinants of S, shapes (..., m, m) and (...)."""
    m = S.shape[-1]
    if inv is None:
        try:
            factors = np.linalg.cholesky(S)
        except np.linalg.LinAlgError:
            # It names the eigenvalue that is at fault, or finds that rounding alone was.
            T = np.array([standardize(one, "innovation")[0] for one in S.reshape(-1, m, m)]).reshape(S.shape)
            return np.swapaxes(T, -1, -2) @ T, -2.0 * np.linalg.slogdet(T)[1]
        diagonals = np.diagonal(factors, axis1=-2, axis2=-1)
        return np.asarray(np.linalg.inv(S), dtype=float), 2.0 * np.log(diagonals).sum(axis=-1)
    # Through `standardize`, which refuses what is no inverse of a covariance.
    inverses = np.array([standardize(one, "innovation", inv)[1] for one in S.reshape(-1, m, m)]).reshape(S.shape)
    values = np.linalg.eigvalsh(0.5 * (inverses + np.swapaxes(inverses, -1, -2)))
    # Directions that inv leaves out have no density.
    kept = values > m * np.finfo(float).eps * values[..., -1:]
    return inverses, -np.where(kept, np.log(np.where(kept, values, 1.0)), 0.0).sum(axis=-1)


def _shortened(y: Array, inverses: Array) -> Array:
    """Return y, shape (..., h, m), or the multiple that is 8 standard deviations of the widest hypothesis long."""
    peak = np.abs(y).max(axis=-1, keepdims=True)
    direction = y / np.where(peak > 0.0, peak, 1.0)
    squares = np.einsum("...i,...ij,...j->...", direction, inverses, direction)
    with np.errstate(over="ignore"):
        lengths = peak[..., 0] * np.sqrt(np.maximum(squares, 0.0))
    least = lengths.min(axis=-1)[..., None, None]
    if not (least > _REACH).any():
        return y
    return np.where(least > _REACH, y / peak * (peak / least) * _REACH, y)
