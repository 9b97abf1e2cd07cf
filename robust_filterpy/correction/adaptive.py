"""The correction under measurement noise that is learnt: one step as a pure function of arrays.

Several filters that differ in how large they take the process noise to be run side by side. Each is corrected under
every class of measurement noise, and what the classes give is merged by moments. How probable the classes are is
learnt, and all filters share it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.correction import adaptive_noise
from robust_filterpy.correction.merging import collapse, correct_each, normalized
from robust_filterpy.correction.options import Grouping
from robust_filterpy.correction.whitening import Inverse

__all__ = ["AdaptiveStep", "NoiseClasses", "correct_adaptively"]


@dataclass(frozen=True)
class NoiseClasses:
    """Say which classes of measurement noise there are, and how long what is learnt about them is remembered.

    Parameters
    ----------
    scales : sequence of float, default (1, 10, 100, 1000)
        Factors of the covariance R, ascending from 1.
    grouping : {"component", "joint"}
        Whether each sensor fails on its own, or all together.
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
    grouping: Grouping = "component"
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
        """Return what is known before the first sample, shape (1 or dim_z, ...)."""
        return np.tile(adaptive_noise.start(len(self.scales)), (1 if self.grouping == "joint" else dim_z, 1))

    def checked(self, learnt: ArrayLike, dim_z: int) -> Array:
        """Return a copy of what another filter has learnt, if it is for the same classes.

        Parameters
        ----------
        learnt : array_like, shape (1 or more, 2 + 2 K + K^2)
            As `robust_filterpy.correction.adaptive_noise.start` orders it, a row for each sensor.
        dim_z : int
            Number of sensors.

        Returns
        -------
        ndarray
            The copy.

        Raises
        ------
        ValueError, TypeError
            If the shape is another one, or the numbers are not what can be learnt.
        """
        values, begin = _checks.numbers("learnt", learnt), self.start(dim_z)
        fits = values.ndim == 2 and values.shape[1] == begin.shape[1]
        if not fits or len(values) < len(begin) or (self.grouping == "joint" and len(values) > 1):
            raise ValueError(
                f"learnt: expected shape {begin.shape}, got {values.shape}; it is for filters with the same grouping, "
                f"sensors and measurement_scales"
            )
        K = len(self.scales)
        totals = values[:, 2 + 2 * K :].reshape(-1, K, K).sum(axis=2)
        if not (np.isfinite(values).all() and (values >= 0.0).all() and (values[:, 0] > 0.0).all() and totals.all()):
            raise ValueError("learnt: expected finite numbers >= 0 with r > 0, as another filter's `learnt` has them")
        if not np.allclose(values[:, 2 + K : 2 + 2 * K].sum(axis=1), 1.0):
            raise ValueError("learnt: expected probabilities of the last sample's class that sum to 1")
        return values.copy()


class AdaptiveStep(NamedTuple):
    """The filters and the noise after a correction, and what has become of each component."""

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
    weights: Array
    """Expected precision of each component over that of ordinary noise, in (0, 1], shape (m,)."""
    outlier_probabilities: Array
    """Probability that each component was an outlier, shape (m,)."""


def correct_adaptively(
    means: Array,
    covariances: Array,
    probabilities: Array,
    learnt: Array,
    z: Array,
    H: Array,
    R: Array,
    noise: NoiseClasses,
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
        What is known of the noise, g = 1 under grouping "joint", else m; not changed.
    z : ndarray, shape (m,)
        Measurement, finite.
    H : ndarray, shape (m, n)
        Measurement matrix.
    R : ndarray, shape (m, m)
        Covariance of the measurement noise as the filter was given it.
    noise : NoiseClasses
        Classes and memories.
    M : ndarray, shape (n, m), optional
        Covariance of the state's error and the measurement noise. It grows with the deviation of the noise.
    inv : callable, optional
        What inverts S; by default a singular S is an error.

    Returns
    -------
    AdaptiveStep

    Raises
    ------
    SingularInnovationError
        If S is not positive definite and inv is not given.

    Notes
    -----
    Sensors that fail each on its own are taken one after the other, the most plausible first, and the classes of each
    are merged by moments before the next is looked at. The order follows from the data, so that the order of the
    sensors in z does not matter.
    """
    n, m, learnt = means.shape[1], len(z), learnt.copy()
    groups = (
        [np.arange(m)] if len(learnt) == 1 else _by_plausibility(means, covariances, probabilities, learnt, z, H, R)
    )
    correlated = len(groups) > 1 and (M is not None or np.count_nonzero(R) > m)
    if correlated:
        means, covariances = _with_noise(means, covariances, R, M)
    scales, begin = np.array(noise.scales), adaptive_noise.start(len(noise.scales)).tolist()
    log_density, weights, outlying = 0.0, np.empty(m), np.empty(m)
    for group in groups:
        row = 0 if len(learnt) == 1 else group[0]
        known, before = learnt[row].tolist(), [0.0] * len(scales)
        adaptive_noise.class_probabilities(known, before)
        deviations = np.sqrt(known[0] * scales)[:, None, None]
        seen, spread, cross = H[group], deviations**2 * R[np.ix_(group, group)], None
        if correlated:
            # H x + v_i, v_i = sqrt(r_i s_k) u_i, with u in the state.
            seen = np.concatenate([np.tile(seen, (len(scales), 1, 1)), deviations * np.eye(m)[group]], axis=2)
            spread = np.zeros((1, 1, 1))
        elif M is not None:
            cross = deviations * M
        predicted = (seen @ means[:, None, :, None])[..., 0]
        y = z[group] - predicted
        each = correct_each(y, covariances[:, None], seen, spread, cross, inv)
        likely = np.log(before) + each.log_densities
        joint, log_total = normalized(np.log(np.maximum(probabilities, 1e-300))[:, None] + likely)
        posterior = joint.sum(axis=0)
        # What is left of y under the ordinary class is noise. (z - y would have lost its digits beside a wild z.)
        left = each.y[:, 0] + (predicted[:, 0] - means[:, :n] @ H[group].T) - each.moves[:, 0, :n] @ H[group].T
        left_var = ((H[group] @ each.P[:, 0, :n, :n]) * H[group]).sum(axis=2)
        variances = R.diagonal()[group]
        noisy = variances > 0.0
        # Of a sensor without noise there is no factor to learn.
        energy = known[0]
        if noisy.any():
            energies = ((left**2 + left_var)[:, noisy] / variances[noisy]).mean(axis=1)
            energy = float(joint[:, 0] @ energies / max(posterior[0], 1e-300))
        adaptive_noise.learn(known, begin, noise.scales, posterior.tolist(), energy, noise.memory, noise.r_memory)
        learnt[row] = known
        # By itself, since the joint probabilities of a filter that is all but impossible underflow.
        given = np.exp(likely - likely.max(axis=1, keepdims=True))
        moves, covariances = collapse(given / given.sum(axis=1, keepdims=True), each.moves, each.P)
        means, probabilities, log_density = means + moves, joint.sum(axis=1), log_density + log_total
        weights[group], outlying[group] = posterior @ (1.0 / scales), 1.0 - posterior[0]
    return AdaptiveStep(means[:, :n], covariances[:, :n, :n], probabilities, learnt, log_density, weights, outlying)


def _by_plausibility(
    means: Array, covariances: Array, probabilities: Array, learnt: Array, z: Array, H: Array, R: Array
) -> list[np.ndarray]:
    """Return the sensors one by one, the one with the smallest innovation in standard deviations first."""
    x, P = collapse(probabilities, means, covariances)
    variances = ((H @ P) * H).sum(axis=1) + learnt[:, 0] * R.diagonal()
    return [np.array([i]) for i in np.argsort(np.abs(z - H @ x) / np.sqrt(variances))]


def _with_noise(means: Array, covariances: Array, R: Array, M: Array | None) -> tuple[Array, Array]:
    """Return means and covariances of state and noise together, so that a sensor tells of the others' noise too."""
    (q, n), m = means.shape, len(R)
    cross = np.zeros((n, m)) if M is None else M
    return (
        np.concatenate([means, np.zeros((q, m))], axis=1),
        np.array([np.block([[P, cross], [cross.T, R]]) for P in covariances]),
    )
