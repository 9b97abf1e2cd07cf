"""Copies of a filter side by side that differ in what they take the process for (interacting multiple models).

q copies take the process noise for s_j Q; from one step to the next the scale stays with probability 1 - 1/dwell. One
more, the candidate, is for a state that has jumped, to which Q says nothing. It begins where an innovation is beyond
three standard deviations, at the place that the measurement tells (`with_candidate`). Since it is made to fit, that
measurement is no evidence for it, and no later one is worth more than a hundred to one, so that samples have to agree,
however wild. It is hidden until it is more likely than not (`merged`), taken over when it is all but certain
(`settled`) and dropped when it has lost, so that there is one at a time. A start is a jump from a guess: the first
candidate begins with a probability of .2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array

__all__ = ["Copies", "Scales", "collapse", "far_off", "merged", "predict", "settled", "start", "with_candidate"]

# Chance that the state is not where the start says.
_START = 0.2
# Standard deviations from which an innovation asks for a jump; farther than a million million it cannot tell where to.
_ASKS, _FARTHEST = 3.0, 1e12
# In variances of its noise: within that the sensor tells where a jump went.
_AROUND = 100.0
# A candidate that is so probable is taken over; one whose probability is this part of a jump's is dropped.
_TAKEN, _DROPPED = 0.999, 0.01


@dataclass(frozen=True)
class Scales:
    """Say which copies there are.

    Parameters
    ----------
    scales : sequence of float, default (1, 0.01, 0.1, 10, 100)
        Factors of the covariance Q, > 0; the first is where a process starts. ``(1,)`` trusts Q.
    dwell : float, default 1000
        Mean number of steps that the process keeps a scale, > 1.
    jump : float, default 1e-9
        Chance that the state jumps in a step, in [0, 1). Samples have to agree before a jump is believed, about eight
        with 1e-9, six with 1e-6; outliers that agree for longer are believed too. 0 means never, and then the start is
        trusted as P says.
    probabilities : sequence of float, optional
        Probabilities of the scales where each step draws its own; `dwell` means nothing then.

    Raises
    ------
    ValueError, TypeError
        If one is out of range.
    """

    scales: Sequence[float] = (1.0, 0.01, 0.1, 10.0, 100.0)
    dwell: float = 1000.0
    jump: float = 1e-9
    probabilities: Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Check the parameters."""
        scales = _checks.numbers("process_scales", self.scales)
        if scales.ndim != 1 or not scales.size or not (np.isfinite(scales) & (scales > 0.0)).all():
            raise ValueError(f"process_scales: expected one or more finite numbers > 0, got {self.scales!r}")
        if not _checks.positive("dwell", self.dwell) > 1.0:
            raise ValueError(f"dwell: expected a number of steps > 1, got {self.dwell!r}")
        object.__setattr__(self, "scales", tuple(scales.tolist()))
        object.__setattr__(self, "dwell", float(self.dwell))
        object.__setattr__(self, "jump", _checks.fraction("jump", self.jump))
        if self.probabilities is not None:
            told = _checks.probabilities("probabilities", self.probabilities, scales.size)
            object.__setattr__(self, "probabilities", tuple(told.tolist()))

    @property
    def count(self) -> int:
        """How many copies there are."""
        return len(self.scales) + (1 if self.jump > 0.0 else 0)

    @property
    def stay(self) -> float:
        """Probability that the scale stays."""
        return 1.0 - 1.0 / self.dwell if len(self.scales) > 1 else 1.0

    @property
    def moves(self) -> Array:
        """Probabilities of the next scale, a row for each scale, shape (q, q)."""
        q = len(self.scales)
        if self.probabilities is not None:
            return np.tile(self.probabilities, (q, 1))
        moves = np.full((q, q), (1.0 - self.stay) / max(q - 1, 1))
        np.fill_diagonal(moves, self.stay)
        return moves


class Copies(NamedTuple):
    """The copies: those of the scales of Q, then, if there are jumps, the candidate."""

    x: Array
    """Means, shape (q, n)."""
    P: Array
    """Covariances, shape (q, n, n)."""
    probabilities: Array
    """Shape (q,), with sum 1; that of the candidate is 0 while there is none."""
    unseen: float
    """Chance that the state has jumped since the last measurement."""


def start(x: Array, P: Array, process: Scales) -> Copies:
    """Return the copies before the first step, all at the same place.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Mean.
    P : ndarray, shape (n, n)
        Covariance.
    process : Scales
        Which copies there are.

    Returns
    -------
    Copies
    """
    q, count = len(process.scales), process.count
    # The first scale is where a process starts, the others have the chance of one change.
    probabilities = np.zeros(count)
    probabilities[:q] = 1.0 / process.dwell
    probabilities[0] = 1.0
    if process.probabilities is not None:
        probabilities[:q] = process.probabilities
    probabilities /= probabilities.sum()
    return Copies(np.tile(x, (count, 1)), np.tile(P, (count, 1, 1)), probabilities, _START if count > q else 0.0)


def predict(
    copies: Copies, F: Array, Q: Array, process: Scales, Bu: Array | None = None, alpha_sq: float = 1.0
) -> Copies:
    """Return the copies after a prediction: mixed as the scale may have changed, then moved.

    Parameters
    ----------
    copies : Copies
        Before the step.
    F : ndarray, shape (n, n)
        Transition matrix.
    Q : ndarray, shape (n, n)
        Covariance of the process noise.
    process : Scales
        Which copies there are.
    Bu : ndarray, shape (n,), optional
        What the control adds.
    alpha_sq : float, default 1
        Fading memory: F P F' is multiplied by it.

    Returns
    -------
    Copies
    """
    x, P, probabilities, unseen = copies
    q, scales = len(process.scales), np.array(process.scales)
    slow = probabilities[:q]
    # Row j: where copy j comes from.
    origin = (slow[:, None] * process.moves).T
    shares = origin.sum(axis=1)
    mixed_x, mixed_P = collapse(origin / shares[:, None], x[None, :q], P[None, :q])
    if process.jump > 0.0:
        usual = np.exp(shares @ np.log(scales) / shares.sum())
        scales, shares = np.append(scales, usual), np.append(shares, probabilities[q])
        mixed_x, mixed_P = np.concatenate([mixed_x, x[q:]]), np.concatenate([mixed_P, P[q:]])
        unseen += process.jump * (1.0 - unseen)
    moved = mixed_x @ F.T
    return Copies(
        moved if Bu is None else moved + Bu,
        alpha_sq * (F @ mixed_P @ F.T) + scales[:, None, None] * Q,
        shares,
        unseen,
    )


def with_candidate(copies: Copies, z: Array, H: Array, noise: Array, process: Scales) -> tuple[Copies, bool]:
    """Return the copies, with a candidate if there is none and an innovation asks for one, and whether it is new.

    Parameters
    ----------
    copies : Copies
        Before the correction.
    z : ndarray, shape (m,)
        Measurement, finite.
    H : ndarray, shape (m, n)
        Measurement matrix.
    noise : ndarray, shape (m,)
        Variances of ordinary noise.
    process : Scales
        Which copies there are.

    Returns
    -------
    copies : Copies
    new : bool
    """
    x, P, probabilities, unseen = copies
    q = len(process.scales)
    if process.jump == 0.0 or probabilities[q] >= _DROPPED * process.jump:
        return copies, False
    slow = probabilities[:q] / probabilities[:q].sum()
    at, spread = collapse(slow, x[:q], P[:q])
    chance = 0.0
    for _ in z:
        y, asks = _asked(at, spread, z, H, noise)
        i = int(np.argmax(asks))
        if not asks[i] > _ASKS:
            break
        # What the sensor sees of each state, as if they were independent: the others keep what they have.
        chance, d = unseen, spread.diagonal() * H[i]
        d = d / (H[i] @ d)
        at, spread = at + y[i] * d, spread + _AROUND * noise[i] * np.outer(d, d)
    return Copies(
        np.concatenate([x[:q], at[None]]),
        np.concatenate([P[:q], spread[None]]),
        np.append((1.0 - chance) * slow, chance),
        0.0,
    ), True


def far_off(copies: Copies, z: Array, H: Array, noise: Array, process: Scales) -> Array:
    """Return which sensors ask for a jump, shape (m,).

    Parameters
    ----------
    copies, z, H, noise, process
        As `with_candidate` takes them.

    Returns
    -------
    ndarray of bool, shape (m,)
    """
    x, P, probabilities, _ = copies
    q = len(process.scales)
    slow = probabilities[:q] / probabilities[:q].sum()
    return np.asarray(_asked(*collapse(slow, x[:q], P[:q]), z, H, noise)[1] > _ASKS)


def _asked(at: Array, spread: Array, z: Array, H: Array, noise: Array) -> tuple[Array, Array]:
    """Return innovations, and how many standard deviations off each is, 0 where none can tell."""
    with np.errstate(over="ignore"):
        y = z - H @ at
    seen = ((H @ spread) * H).sum(axis=1)
    asks = np.where(seen > 0.0, np.abs(y) / np.sqrt(np.where(seen > 0.0, seen + noise, 1.0)), 0.0)
    asks[~(asks < _FARTHEST)] = 0.0
    return y, asks


def settled(copies: Copies, process: Scales) -> Copies:
    """Return the copies after a correction: a candidate that is all but certain is where every copy goes on from.

    Parameters
    ----------
    copies : Copies
        Copies after the correction.
    process : Scales
        Which copies there are.

    Returns
    -------
    Copies
    """
    x, P, probabilities, _ = copies
    q = len(process.scales)
    if process.jump == 0.0 or not probabilities[q] > _TAKEN:
        return copies._replace(unseen=0.0)
    slow = np.append(probabilities[:q] / probabilities[:q].sum(), 0.0)
    return Copies(np.tile(x[q], (q + 1, 1)), np.tile(P[q], (q + 1, 1, 1)), slow, 0.0)


def merged(copies: Copies, process: Scales) -> tuple[Array, Array]:
    """Return mean and covariance of the state; a candidate is hidden until it is more likely than not.

    Parameters
    ----------
    copies : Copies
        Copies after a prediction or a correction.
    process : Scales
        Which copies there are.

    Returns
    -------
    mean : ndarray, shape (n,)
    covariance : ndarray, shape (n, n)
    """
    x, P, p, _ = copies
    q = len(process.scales)
    if process.jump > 0.0 and not p[q] > 0.5:
        x, P, p = x[:q], P[:q], p[:q] / p[:q].sum()
    return collapse(p, x, P)


def collapse(probabilities: Array, means: Array, covariances: Array) -> tuple[Array, Array]:
    """Return mean and covariance of a mixture, over the last axis of probabilities.

    Parameters
    ----------
    probabilities : ndarray, shape (..., h)
        Weights, with sum 1.
    means : ndarray, shape (..., h, n)
        Means of the parts.
    covariances : ndarray, shape (..., h, n, n)
        Their covariances.

    Returns
    -------
    mean : ndarray, shape (..., n)
        Overall mean.
    covariance : ndarray, shape (..., n, n)
        Overall covariance, that of the means among each other included.

    Examples
    --------
    >>> mean, covariance = collapse(np.array([0.5, 0.5]), np.array([[-1.0], [1.0]]), np.ones((2, 1, 1)))
    >>> mean, covariance
    (array([0.]), array([[2.]]))
    """
    weights = probabilities[..., None]
    mean = (weights * means).sum(axis=-2)
    apart = means - mean[..., None, :]
    within = (weights[..., None] * covariances).sum(axis=-3)
    return mean, within + np.swapaxes(apart * weights, -1, -2) @ apart
