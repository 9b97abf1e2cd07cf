"""The correction under measurement noise that is learnt: one step as a pure function of arrays.

Several filters that differ in how large they take the process noise to be run side by side. Each is corrected under
every class of measurement noise; the probabilities of the classes, which all filters share, are learnt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.correction import adaptive_noise
from robust_filterpy.correction.merging import (
    MOST_HYPOTHESES,
    collapse,
    correct_each,
    normalized,
    score_and_information,
)
from robust_filterpy.correction.whitening import Inverse

__all__ = ["AdaptiveStep", "NoiseClasses", "correct_adaptively"]


@dataclass(frozen=True)
class NoiseClasses:
    """Say which classes of measurement noise there are, and how long what is learnt about them is remembered.

    Parameters
    ----------
    scales : sequence of float, default (1, 10, 100, 1000)
        Factors of the covariance R, ascending from 1.
    grouping : {"joint", "component"}
        Whether the sensors fail together, or each on its own: K^dim_z hypotheses, at most 256.
    memory : float, default 300
        Samples for which transitions between the classes are remembered, > 1.
    r_memory : float, default 30
        Ordinary samples for which the size of the noise is remembered, > 1.

    Raises
    ------
    ValueError, TypeError
        If one is out of range.
    """

    scales: Sequence[float] = adaptive_noise.DECADES
    grouping: str = "joint"
    memory: float = 300.0
    r_memory: float = 30.0

    def __post_init__(self) -> None:
        """Check the parameters."""
        scales = _checks.numbers("measurement_scales", self.scales)
        if scales.ndim != 1 or not scales.size or scales[0] != 1.0 or not (np.diff(scales) > 0.0).all():
            raise ValueError(f"measurement_scales: expected factors that ascend from 1, got {self.scales!r}")
        if not np.isfinite(scales).all():
            raise ValueError(f"measurement_scales: expected finite numbers, got {self.scales!r}")
        object.__setattr__(self, "scales", tuple(scales.tolist()))
        _checks.option("grouping", self.grouping, ("joint", "component"))
        for name in ("memory", "r_memory"):
            if not _checks.positive(name, getattr(self, name)) > 1.0:
                raise ValueError(f"{name}: expected a number of samples > 1, got {getattr(self, name)!r}")
            object.__setattr__(self, name, float(getattr(self, name)))

    def start(self, dim_z: int) -> Array:
        """Return what is known before the first sample, shape (1 or dim_z, ...); ValueError if dim_z is too large."""
        K = len(self.scales)
        if self.grouping == "component" and K**dim_z > MOST_HYPOTHESES:
            raise ValueError(
                f"grouping: expected 'joint' for dim_z={dim_z} and {K} measurement_scales, got 'component', which is "
                f"{K}^{dim_z} > {MOST_HYPOTHESES} hypotheses; or give fewer measurement_scales, such as (1, 100)"
            )
        return np.tile(adaptive_noise.start(K), (1 if self.grouping == "joint" else dim_z, 1))


class AdaptiveStep(NamedTuple):
    """The filters and the noise after a correction, and what the innovation told."""

    means: Array
    """Corrected means, shape (q, n)."""
    covariances: Array
    """Their covariances, shape (q, n, n)."""
    probabilities: Array
    """Probability of each filter, shape (q,)."""
    learnt: Array
    """What is known of the noise, shape (g, ...), as `robust_filterpy.correction.adaptive_noise.start` orders it."""
    log_density: float
    """log p(z)."""
    score: Array
    """-grad log p(z), shape (m,)."""
    information: Array
    """Its derivative, shape (m, m)."""
    outlier_probability: float
    """Probability that a component was an outlier."""


def correct_adaptively(
    means: Array,
    covariances: Array,
    probabilities: Array,
    learnt: Array,
    y: Array,
    H: Array,
    R: Array,
    noise: NoiseClasses,
    observed: np.ndarray,
    M: Array | None = None,
    inv: Inverse | None = None,
) -> AdaptiveStep:
    """Correct q filters by one measurement and learn the noise from it.

    Parameters
    ----------
    means : ndarray, shape (q, n)
        Predicted means.
    covariances : ndarray, shape (q, n, n)
        Their covariances.
    probabilities : ndarray, shape (q,)
        Probability of each filter.
    learnt : ndarray, shape (g, ...)
        What is known of the noise; not changed.
    y : ndarray, shape (q, m)
        Innovation of each filter, finite: the observed components.
    H : ndarray, shape (m, n)
        Measurement matrix.
    R : ndarray, shape (m, m)
        Covariance of the measurement noise as the filter was given it.
    noise : NoiseClasses
        Classes and memories.
    observed : ndarray of int, shape (m,)
        Which rows of learnt the components belong to, under grouping "component".
    M : ndarray, shape (n, m), optional
        Covariance of the state's error and the measurement noise.
    inv : callable, optional
        What inverts S; by default a singular S is an error.

    Returns
    -------
    AdaptiveStep

    Raises
    ------
    SingularInnovationError
        If S is not positive definite and inv is not given.
    """
    m, joint = len(R), noise.grouping == "joint"
    rows = np.zeros(1, dtype=int) if joint else observed
    K, known = len(noise.scales), learnt[rows].tolist()
    patterns, membership, begin = _patterns(K, len(rows))
    before = [[0.0] * K for _ in rows]
    for row, p in zip(known, before, strict=True):
        adaptive_noise.class_probabilities(row, p)
    log_prior = np.log(np.maximum(np.array(before)[np.arange(len(rows)), patterns], 1e-300)).sum(axis=1)
    # Factor of each component's standard deviation under each hypothesis, shape (h, m).
    factors = np.sqrt(learnt[rows, 0] * np.array(noise.scales)[patterns]) * np.ones(m)
    noises = factors[:, :, None] * R * factors[:, None, :]
    cross = None if M is None else M * factors[:, None, :]
    each = correct_each(y, covariances[:, None], H, noises, cross, inv)
    likely = log_prior + each.log_densities
    weights, log_density = normalized(np.log(np.maximum(probabilities, 1e-300))[:, None] + likely)
    of_filter = weights.sum(axis=1)
    # By itself, since the joint weights of a filter that is all but impossible underflow.
    given = np.exp(likely - likely.max(axis=1, keepdims=True))
    given /= given.sum(axis=1, keepdims=True)
    moves, after = collapse(given, each.moves, each.P)
    # E[v_i^2]/R_ii under each hypothesis: what the correction leaves of y belongs to v.
    ours = noises if cross is None else noises + np.swapaxes(H @ cross, -1, -2)
    left = (ours @ each.pulls[..., None])[..., 0]
    within = np.diagonal(noises - ours @ each.inverses @ np.swapaxes(ours, -1, -2), axis1=-2, axis2=-1)
    energies = (left**2 + np.maximum(within, 0.0)) / R.diagonal()
    energies = energies.mean(axis=-1, keepdims=True) if joint else energies
    posterior = np.tensordot(weights.sum(axis=0), membership, 1)
    ordinary = weights[:, :, None] * membership[:, :, 0]
    energy = (ordinary * energies).sum(axis=(0, 1)) / np.maximum(posterior[:, 0], 1e-300)
    for row, p, e in zip(known, posterior.tolist(), energy.tolist(), strict=True):
        adaptive_noise.learn(row, begin, noise.scales, p, e, noise.memory, noise.r_memory)
    learnt = learnt.copy()
    learnt[rows] = known
    flat = weights.ravel()
    outlying = float(weights.sum(axis=0)[(patterns > 0).any(axis=1)].sum())
    score = score_and_information(flat, each.pulls.reshape(-1, m), each.inverses.reshape(-1, m, m))
    return AdaptiveStep(means + moves, after, of_filter / of_filter.sum(), learnt, log_density, *score, outlying)


@lru_cache(maxsize=32)
def _patterns(K: int, groups: int) -> tuple[np.ndarray, Array, list[float]]:
    """Return the class of each group under each hypothesis, the same one-hot, and what is known at the start."""
    patterns = np.array(list(product(range(K), repeat=groups)))
    return patterns, np.eye(K)[patterns], adaptive_noise.start(K).tolist()
