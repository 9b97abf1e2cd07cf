"""The robust correction: definition. The kernel is tested against it.

A state x and an innovation y are one Gaussian vector with covariances P = cov(x), C = cov(x, y), S = cov(y). It is
conditioned on one sensor (or group of sensors that fail together) after the other, the most plausible first, by the
scalar Masreliez-Martin step. With s the spread of that sensor's standardized innovations and t = S_ii^(-1/2)::

    e_i = t y_i                                    standardized innovation            (paper 29, 36)
    x  += C_i t s psi(e_i / s)                     bounded influence                  (26, 37, 42, 47)
    y  -= S_i t s psi(e_i / s)                     for the sensors still to come
    P  -= d C_i t t C_i'   (C and S likewise)      information d between 0 and 1      (28, 39, 44, 49)

With psi = identity this is the Kalman filter. A wild sensor is judged last, against what the others agree on, and
never touches a sensor that is uncorrelated with it.
"""

from __future__ import annotations

import math
import sys
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction import spread
from robust_filterpy.correction.options import Choices, length_and_direction
from robust_filterpy.correction.result import Correction, SingularInnovationError, group_scaling, is_cancelled, singular

__all__ = [
    "Innovation",
    "NotPositiveDefiniteError",
    "SingularInnovationError",
    "correct",
    "correct_by_typical",
    "innovation_moments",
    "nothing_observed",
]

_DEFAULT = Choices()
_LARGEST = sys.float_info.max
# What one group costs at most in log-likelihood, so that the sum over all is a number.
_COSTLIEST = 1e300


# LinAlgError is a ValueError from numpy 1.25 on.
class NotPositiveDefiniteError(np.linalg.LinAlgError, ValueError):
    """Say that scaling "unit" would make P indefinite: it is a filter only while H P H' < 1."""


def innovation_moments(P: Array, H: Array, R: Array, M: Array | None = None) -> tuple[Array, Array]:
    """Return C = P H' + M and S = H P H' + H M + M' H' + R."""
    C = P.dot(H.T)
    S = H.dot(C) + R
    if M is not None:
        C = C + M
        HM = H.dot(M)
        S += HM + HM.T
    if not np.isfinite(S).all():
        raise singular(S)
    return C, S


def correct(
    x: Array,
    P: Array,
    y: Array,
    C: Array,
    S: Array,
    choices: Choices = _DEFAULT,
    widths: Array | None = None,
    skip_singular: bool = False,
) -> Correction:
    """Correct a state by an innovation whose influence is bounded.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Prior mean.
    P : ndarray, shape (n, n)
        Prior covariance.
    y : ndarray, shape (m,)
        Innovation z - H x; NaN marks a missing component.
    C : ndarray, shape (n, m)
        Covariance of the state and the innovation, P H' for a linear sensor.
    S : ndarray, shape (m, m)
        Covariance of the innovation, H P H' + R.
    choices : Choices
        Influence function, scaling, information, grouping.
    widths : ndarray, shape (m,), optional
        s, the spread of each sensor's standardized innovations; 1 if not given.
    skip_singular : bool, default False
        Whether a sensor that the ones before it determine is left out; by default it is an error.

    Returns
    -------
    Correction

    Raises
    ------
    NotPositiveDefiniteError
        If scaling is "unit" and P+ would be indefinite.
    SingularInnovationError
        If S is not positive definite and skip_singular is False.

    Examples
    --------
    >>> one = np.eye(1)
    >>> c = correct(np.zeros(1), one, np.array([100.0]), one, 2.0 * one)
    >>> c.x.round(3), c.P, c.clipped
    (array([0.951]), array([[1.]]), array([ True]))
    """
    m = len(y)
    # Copies: they are conditioned in place. What is unsymmetric in P is rounding, which no correction damps and a state
    # that grows multiplies.
    halves = 0.5 * P + 0.5 * P.T
    joint = _Joint(x.astype(float), halves, y.astype(float), C.astype(float), S.astype(float), np.eye(m))
    seen = _Seen(np.zeros(m), np.full(m, np.nan), np.full(m, np.nan), np.zeros(m), np.zeros((m, m)))
    s = np.ones(m) if widths is None else widths
    left, order, log_density = choices.groups(y, C, S, P), [], 0.0
    with np.errstate(over="ignore", under="ignore"):
        while left:
            judged = [_judge(group, joint, S, choices, s, skip_singular) for group in left]
            chosen = min(range(len(left)), key=lambda k: judged[k].key)
            group, step = left.pop(chosen), judged[chosen]
            order.append(group)
            if step.T is None:
                # What the sensors before it determine teaches nothing.
                seen.e[group], seen.weights[group], seen.psi_deriv[group] = 0.0, 1.0, 1.0
                continue
            log_density += _log_density(joint.y[group], joint.S[np.ix_(group, group)], choices)
            seen.note(group, step, joint.W[:, group] @ step.T.T)
            joint.condition(group, step.T, step.psi, step.D)
    if choices.scaling == "unit":
        _require_positive(joint.P, P)
    y = np.where(np.isnan(y), 0.0, y)
    return Correction(
        joint.x, joint.P, np.array(C), y, np.array(S), seen.score, seen.information, seen.e, seen.weights,
        seen.psi_deriv, tuple(map(tuple, order)), choices.scaling, log_density,
    )  # fmt: skip


class Innovation(NamedTuple):
    """A measurement, how it differs from what was expected, and how it depends on the state."""

    #: Readings, shape (m,): one that repeats the one before is hardly evidence of a jump.
    z: Array
    #: Innovation, shape (m,); NaN where missing.
    y: Array
    #: Its covariance with the state, shape (n, m).
    C: Array
    #: Its covariance, shape (m, m).
    S: Array
    #: The part of S that is measurement noise.
    R: Array
    #: Derivative of the measurement, shape (m, n); None where only moments are known.
    H: Array | None = None


def correct_by_typical(
    memory: Array,
    x: Array,
    P: Array,
    innovation: Innovation,
    choices: Choices,
    skip_singular: bool = False,
) -> Correction:
    """Correct a state under scaling "learnt": judge each sensor by its own typical innovation, and learn that."""
    z, y, C, S, R, H = innovation
    judged = spread.prepared(memory, z, y, S, R, C, P, choices.patience)
    y = np.where(judged.held, np.nan, y)
    before, R = S, np.asarray(R)
    if (judged.growth > 1.0).any() or judged.opened.any():
        seen = np.linalg.lstsq(P, C, rcond=None)[0].T if H is None else H
        grown = _opened(P * np.outer(judged.growth, judged.growth), seen, judged.opened)
        gained = (grown - P) @ seen.T
        P, C, S = grown, C + gained, S + seen @ gained
    noisier = S + np.diag(judged.added) if judged.added.any() else S
    last = correct(x, P, y, C, noisier, choices, judged.spread(S), skip_singular)
    B = S - R
    rest = np.where(np.isnan(y), np.nan, last.y - B @ last.score)
    left = np.diag(B - B @ last.information @ B if H is None else H @ last.P @ H.T)
    # What is held is shown as it was read, with no weight.
    y, weights = np.where(judged.held, [innovation.y, np.zeros(len(y))], [last.y, last.weights])
    return last._replace(y=y, S=np.array(S), weights=weights, memory=spread.after(judged.memory, rest, left, before, R))


def _opened(P: Array, H: Array, variances: Array) -> Array:
    """Return P with larger variances of the states that a sensor sees and tells much of, where it has seen a jump."""
    # Nothing is said of the rest, which follows by its covariances. The order of the sensors does not matter.
    most = np.zeros(len(P))
    for h, variance in zip(H, variances, strict=True):
        p = np.where(spread.moved(P @ h, np.diag(P)), np.diag(P), 0.0)
        if variance > 0 and h**2 @ p > 0:
            most = np.maximum(most, variance / (h**2 @ p) * np.where(h != 0, p, 0.0))
    return P + np.diag(most)


class _Seen(NamedTuple):
    """What has become of each sensor, arrays of shape (m,) that are filled one sensor after the other."""

    e: Array
    weights: Array
    psi_deriv: Array
    #: v in x+ = x + C v, C as it was before.
    score: Array
    #: B in P+ = P - C B C', shape (m, m).
    information: Array

    def note(self, group: list[int], step: _Step, rows: Array) -> None:
        """Write down what became of a group; rows: its columns of T', in terms of the innovations as they were."""
        self.e[group], self.weights[group], self.psi_deriv[group] = step.e, step.weights, step.psi_deriv
        self.score[:] += rows @ step.psi
        self.information[:] += rows @ step.D @ rows.T


class _Step(NamedTuple):
    """How a group would be corrected by if it came next; k sensors."""

    #: How implausible its innovation is, and its length: the least comes first.
    key: tuple[float, ...]
    #: Scaling of the group, shape (k, k); None where its innovation is nothing but rounding.
    T: Array | None
    e: Array
    #: s psi(e / s), shape (k,).
    psi: Array
    #: Information, shape (k, k).
    D: Array
    weights: Array
    psi_deriv: Array


def _judge(group: list[int], joint: _Joint, S: Array, choices: Choices, widths: Array, skip_singular: bool) -> _Step:
    """Return how a group would be corrected by, given the ones before it."""
    block = joint.S[np.ix_(group, group)]
    if is_cancelled(block, S.diagonal()[group]):
        if not skip_singular:
            # Under "unit" the sensors before this one may have taken more than there was.
            taken = choices.scaling == "unit" and not is_cancelled(S, S.diagonal())
            raise _indefinite() if taken else singular(S)
        nothing = np.zeros(len(group))
        return _Step((math.inf, math.inf, 0.0), None, nothing, nothing, nothing, nothing, nothing)
    T, s = group_scaling(block, choices.scaling), max(float(widths[group].max()), np.finfo(float).tiny)
    e = np.clip(T @ joint.y[group], -_LARGEST, _LARGEST)
    psi, D, weights, psi_deriv, length = choices.influence_on(e, s)
    return _Step(_key(length / s, length, float(e[0]) if len(group) == 1 else 0.0), T, e, psi, D, weights, psi_deriv)


def _log_density(y: Array, S: Array, choices: Any) -> float:
    """Return log f(S^(-1/2) y) + log det S^(-1/2) of one group of sensors, given those before it."""
    # f(e) is proportional to exp(-rho(e)): normal for an infinite threshold, linear in |e| beyond a finite one. It is
    # standardized by the nominal S^(-1/2), whatever the scaling of the filter and whatever it learned, so that filters
    # with different models can be compared by it.
    # An influence function without a density of its own (redescending, or somebody else's) has f(e) =
    # exp(-rho(e))/sqrt(2 pi), which does not integrate to 1.
    k = len(y)
    T = group_scaling(S, "innovation")
    e = np.clip(T @ y, -_LARGEST, _LARGEST)
    loss = choices.rho_of(length_and_direction(e)[0])
    normalizer = getattr(choices.influence, "log_normalizer", None)
    constant = 0.5 * k * math.log(2.0 * math.pi) if normalizer is None else normalizer(k)
    return float(np.log(T.diagonal()).sum()) - min(loss, _COSTLIEST) - constant


def _key(*sizes: float) -> tuple[float, ...]:
    """Return what is compared between sensors: rounding must not choose the order of those that are equal."""
    return tuple(float(np.float32(max(min(size, 1e38), -1e38))) for size in sizes)


class _Joint(NamedTuple):
    """The Gaussian vector of the state and the innovations that are left, given those that were taken."""

    x: Array
    P: Array
    y: Array
    C: Array
    S: Array
    #: What is left of C, and of S's columns, is C W as it was before.
    W: Array

    def condition(self, group: list[int], T: Array, psi: Array, D: Array) -> None:
        """Condition everything on one group."""
        g, q, w = self.C[:, group] @ T.T, self.S[:, group] @ T.T, self.W[:, group] @ T.T
        self.x[:] += g @ psi
        self.y[:] -= q @ psi
        informed = q @ D
        # D is symmetric; the products are written so that P and S stay so to the last bit.
        self.P[:] -= _product(g, D)
        self.C[:] -= g @ informed.T
        self.W[:] -= w @ informed.T
        self.S[:] -= _product(q, D)


def _product(g: Array, D: Array) -> Array:
    """Return g D g', symmetric to the last bit."""
    if g.shape[1] == 1:
        return D[0, 0] * (g * g.T)
    product = g @ D @ g.T
    return 0.5 * (product + product.T)


def _require_positive(P: Array, prior: Array) -> None:
    """Raise if scaling "unit" made P indefinite, or singular where it was not."""
    if not P.size:
        return
    least = np.linalg.eigvalsh(P)[0] if np.isfinite(P).all() else -np.inf
    if least < -1e-13 * np.abs(P).max() or (least <= 0.0 < np.linalg.eigvalsh(prior)[0]):
        raise _indefinite()


def _indefinite() -> NotPositiveDefiniteError:
    """Return the error of a "unit" correction that would make P indefinite."""
    return NotPositiveDefiniteError(
        'scaling="unit" would make P indefinite: it needs H P H\' < 1 in the unit of the measurement squared; '
        'use scaling="bounded" or "innovation", a smaller P, or a larger unit of measurement'
    )


def nothing_observed(x: Array, P: Array, S: Array, m: int) -> Correction:
    """Return the correction by a measurement that is missing altogether."""
    zero, none = np.zeros(m), np.full(m, np.nan)
    square = np.zeros((m, m))
    return Correction(x, P, np.zeros((len(P), m)), zero, S, zero, square, zero, none, none, (), "innovation", 0.0)
