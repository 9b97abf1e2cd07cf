"""AdaptiveKalmanFilter: a filter that is told neither how large its noises are nor how they fail, and learns it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._arrays import noise_covariance
from robust_filterpy._checks import Array
from robust_filterpy.correction.adaptive import NoiseClasses, correct_adaptively
from robust_filterpy.correction.adaptive_noise import DECADES, LearntNoise, describe
from robust_filterpy.correction.missing import nothing_observed
from robust_filterpy.correction.options import Grouping
from robust_filterpy.filters._hypotheses import (
    MergedCorrection,
    ScoreFilter,
    WeightInfluence,
    finite_product,
)
from robust_filterpy.filters._interacting import InteractingFilter, merged_bank

__all__ = ["AdaptiveKalmanFilter"]


class AdaptiveKalmanFilter(ScoreFilter, InteractingFilter):
    """Filter like `filterpy.kalman.KalmanFilter`, and learn the noises while filtering.

    The measurement noise is a mixture of normal distributions whose covariances are r s R. The scales s are given; the
    factor r, how often each scale occurs and how long it lasts are learnt (expected statistics with a forgetting
    memory). Copies of the filter with process noise ``scale * Q`` run side by side, as in `TwoSidedKalmanFilter`. Each
    copy is corrected under each scale; all of them are weighed by their likelihood and merged by moments.

    Parameters
    ----------
    dim_x : int
        Length of the state, >= 1.
    dim_z : int
        Length of the measurement, >= 1.
    dim_u : int, default 0
        Length of the control input.
    process_scales : sequence of float, default (1, 10, 100)
        Factors of the covariance Q, > 0; the first is where the filter starts. ``(1, 0.01, 0.1, 10, 100)`` finds a Q
        that is too large as well; ``(1,)`` trusts Q.
    dwell : float, default 1000
        Mean number of steps that the process keeps a scale, > 1.
    measurement_scales : sequence of float, default (1, 10, 100, 1000)
        Factors of the covariance R, ascending from 1.
    grouping : {"component", "joint"}
        Whether each sensor has a noise of its own and fails on its own, or all together, as one sensor that reports a
        vector.
    memory : float, default 300
        Samples for which it is remembered how often each scale occurs, > 1.
    r_memory : float, default 30
        Ordinary samples for which the size of the noise is remembered, > 1: a longer memory is quieter, a shorter one
        follows a noise that changes.

    Attributes
    ----------
    noise : LearntNoise
        What has been learnt: r, contamination, scale ratio and length of outlier runs, with standard errors.
    R_learnt : ndarray, shape (dim_z, dim_z)
        Covariance of ordinary noise as learnt, r R.
    outlier_probability : float
        Probability that a component of the last measurement was an outlier.
    process_probabilities : ndarray, shape (q,)
        Probability of each process scale.
    learnt : ndarray, shape (1 or sensors, 2 + 2 K + K^2)
        What is known of the noise, as one small array, r (a factor of R) first: keep it, or assign it to another
        filter with the same R, grouping and measurement scales, which then starts with it.

    Raises
    ------
    ValueError, TypeError
        If a dimension or an option is out of range.

    See Also
    --------
    robust_filterpy.correction.adaptive.correct_adaptively : The step as a pure function.
    robust_filterpy.filters.NoiseMatchedKalmanFilter : The same merging with numbers that are given.

    Notes
    -----
    An outlier is what exceeds most samples: if class 0 is no longer the majority, the noise itself has grown. R may be
    wrong by a factor of 1000 either way, Q may be too small by 100. From an R ten to thirty times too small it can take
    some hundred samples until R is found; the state suffers little meanwhile, since ordinary samples then count as the
    next class.

    With ``process_scales=(1,)`` a Q that is far too small makes the state's own motion look like noise, R grows and the
    filter stops following. Leave some doubt about the process.

    ``S``, ``SI``, ``K``, ``e`` and ``mahalanobis`` are those of the merged prior with ordinary noise as learnt; psi is
    the score of the innovation. x_post is not x_prior + K y_bounded, because the copies have different gains.
    ``log_likelihood`` is that of the mixture. `update_steadystate` clips, with the default Huber function.
    A program that assigns x or P assigns it to every copy. A measurement that is missing altogether teaches nothing; in
    `update_sequential` each part counts as a measurement.

    Examples
    --------
    >>> import numpy as np
    >>> rng = np.random.default_rng(0)
    >>> kf = AdaptiveKalmanFilter(1, 1)
    >>> kf.H, kf.R, kf.Q = np.eye(1), 100.0 * np.eye(1), 0.01 * np.eye(1)
    >>> for bad in rng.random(500) < 0.1:
    ...     kf.predict()
    ...     kf.update(rng.normal() * (10.0 if bad else 1.0))
    >>> bool(0.6 < kf.R_learnt[0, 0] < 1.6), bool(abs(kf.noise.contamination[0] - 0.1) < 0.06)
    (True, True)
    """

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        process_scales: Sequence[float] = (1.0, 10.0, 100.0),
        dwell: float = 1000.0,
        measurement_scales: Sequence[float] = DECADES,
        grouping: Grouping = "component",
        memory: float = 300.0,
        r_memory: float = 30.0,
    ) -> None:
        """Set up filterpy's attributes, the copies and the noise."""
        classes = NoiseClasses(measurement_scales, grouping, memory, r_memory)
        super().__init__(dim_x, dim_z, dim_u, grouping=grouping)
        self._classes, self._learnt = classes, classes.start(dim_z)
        self._set_copies(process_scales, dwell)
        self._outlier_probability, self._first = 0.0, 0

    @property
    def measurement_scales(self) -> Array:
        """Factors of R, shape (K,)."""
        return np.array(self._classes.scales)

    @property
    def memory(self) -> float:
        """Samples for which it is remembered how often each scale occurs."""
        return self._classes.memory

    @property
    def r_memory(self) -> float:
        """Ordinary samples for which the size of the noise is remembered."""
        return self._classes.r_memory

    @property
    def learnt(self) -> Array:
        """What is known of the noise, shape (1 or sensors, 2 + 2 K + K^2); a copy."""
        return self._learnt.copy()

    @learnt.setter
    def learnt(self, value: ArrayLike) -> None:
        self._learnt = self._classes.checked(value, self.dim_z)

    @property
    def noise(self) -> LearntNoise:
        """What has been learnt about the measurement noise."""
        return describe(self._learnt, self.measurement_scales, self.dim_z if self.grouping == "joint" else 1)

    @property
    def R_learnt(self) -> Array:
        """Covariance of ordinary noise as learnt, shape (dim_z, dim_z)."""
        return self._ordinary(noise_covariance(self.R, None, self.dim_z), self._known(self.dim_z))

    @property
    def outlier_probability(self) -> float:
        """Probability that a component of the last measurement was an outlier."""
        return self._outlier_probability

    @property
    def influence(self) -> Any:
        """The noise as learnt, whose score is psi."""
        return self.noise

    @influence.setter
    def influence(self, value: Any) -> None:
        raise AttributeError("influence: follows from the noise, which an AdaptiveKalmanFilter learns")

    @property
    def grouping(self) -> Grouping:
        """Whether the sensors fail "joint", or each "component" on its own; another one starts to learn anew."""
        return self._classes.grouping

    @grouping.setter
    def grouping(self, value: Grouping) -> None:
        classes = replace(self._classes, grouping=value)
        if value != self._classes.grouping:
            self._learnt, self._classes = classes.start(self.dim_z), classes
            self._choices = self._choices.changed(grouping=value)

    def update_sequential(self, start: int, z_i: ArrayLike, R_i: Any = None, H_i: ArrayLike | None = None) -> None:
        """Correct the state by a part of the measurement, as `RobustKalmanFilter.update_sequential` does.

        Parameters
        ----------
        start : int
            Place of the first component in z.
        z_i : array_like, shape (k,) or (k, 1), or scalar
            The components; NaN marks a missing one.
        R_i : array_like, shape (k, k), or scalar, optional
            Their noise covariance, otherwise that block of ``self.R``.
        H_i : array_like, shape (k, dim_x), optional
            Their measurement matrix, otherwise those rows of ``self.H``.

        Raises
        ------
        ValueError, SingularInnovationError
            As in `update`; also if the part leaves z.
        """
        self._first = _checks.count("start", start)
        try:
            super().update_sequential(start, z_i, R_i, H_i)
        finally:
            self._first = 0

    def _corrected(self, x: Array, P: Array, values: Any, H: Array, R: Array, M: Any) -> Any:
        """Return the correction of the merged state; every copy is corrected by itself."""
        column, values, m = x.ravel(), np.atleast_1d(values), len(H)
        y = values - finite_product(H, column)
        joint = self.grouping == "joint"
        learnt = self._known(self._first + m)
        ordinary = self._ordinary(R, learnt if joint else learnt[self._first :])
        # What H does not see says nothing about the state, and nothing is learnt from it.
        y[~H.any(axis=1)] = np.nan
        part = np.flatnonzero(y == y)
        if part.size == 0:
            self._found = (None,)
            return nothing_observed(column, P, H.dot(P).dot(H.T) + ordinary, m)
        rows = np.zeros(1, dtype=int) if joint else self._first + part
        bank, pick = self._current(), np.ix_(part, part)
        step = correct_adaptively(
            bank.means, bank.covariances, bank.probabilities, learnt[rows], values[part], H[part], R[pick],
            self._classes, None if M is None else M[:, part], self._inverse,
        )  # fmt: skip
        learnt[rows] = step.learnt
        bank = merged_bank(step.means, step.covariances, step.probabilities)
        # Sensors that fail together have one probability.
        ordinary_all = np.prod(1.0 - step.outlier_probabilities[: rows.size])
        self._found = (step.log_density, bank, learnt, float(1.0 - ordinary_all))
        # A noise that is larger by a factor keeps its correlation with the state.
        cross = None if M is None else M * np.sqrt(ordinary.diagonal() / R.diagonal())
        influence = WeightInfluence(step.weights, step.outlier_probabilities > 0.5)
        return MergedCorrection(bank.x, bank.P, y, P.copy(), H.copy(), ordinary, cross, self._inverse, influence)

    def _known(self, sensors: int) -> Array:
        """Return a copy of what is known, with rows for sensors that have joined."""
        more = 0 if self.grouping == "joint" else max(sensors - len(self._learnt), 0)
        return np.concatenate([self._learnt, self._classes.start(more)[:more]])

    def _ordinary(self, R: Array, learnt: Array) -> Array:
        """Return the covariance of ordinary noise for an R that was given."""
        r = np.sqrt(learnt[:, 0] * np.ones(len(R)) if len(learnt) == 1 else learnt[: len(R), 0])
        return np.asarray(R * np.multiply.outer(r, r))

    def _settle(self) -> None:
        """Take over the corrected copies and what they have learnt."""
        _, _, self._learnt, self._outlier_probability = self._found
        super()._settle()

    def _skip(self) -> None:
        """Leave the copies and the noise as they are."""
        super()._skip()
        self._outlier_probability = 0.0
