"""AdaptiveKalmanFilter: a filter that is told neither how large its noises are nor how they fail, and learns it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.correction.definition import nothing_observed
from robust_filterpy.correction.learning import SCALES, NoiseClasses
from robust_filterpy.correction.options import Grouping
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.whitening import Inverse
from robust_filterpy.filters._hypotheses import ScoreFilter
from robust_filterpy.filters._interacting import Bank, InteractingFilter
from robust_filterpy.filters._learnt_noise import Learnt, LearntNoiseMixin, ordinary_noise

__all__ = ["AdaptiveKalmanFilter"]


class AdaptiveKalmanFilter(LearntNoiseMixin, ScoreFilter, InteractingFilter):
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
    process_scales : sequence of float, default (1, 0.01, 0.1, 10, 100)
        Factors of the covariance Q, > 0; the first is where the filter starts; ``(1,)`` trusts Q.
    dwell : float, default 1000
        Mean number of steps that the process keeps a scale, > 1.
    jump : float, default 1e-9
        Chance in each step that the state jumps somewhere else, in [0, 1). Samples have to agree before a jump is
        believed, about eight with 1e-9, six with 1e-6; outliers that agree for longer are believed too. 0 means never,
        and then the start is trusted as P says.
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
    learnt : ndarray, shape (1 or sensors, 6 + 2 K + K^2)
        What is known of the noise, as one small array, r (a factor of R) first: keep it, or assign it to another
        filter with the same R, grouping and measurement scales, which then starts with it.

    Raises
    ------
    ValueError, TypeError
        If a dimension or an option is out of range.

    See Also
    --------
    robust_filterpy.correction.learnt.correct : The step as a pure function.
    robust_filterpy.filters.NoiseMatchedKalmanFilter : The same merging with numbers that are given.
    robust_filterpy.batch.adaptive_series : Many recordings by one call.

    Notes
    -----
    An outlier is what exceeds most samples: if class 0 is no longer the majority, the noise itself has grown. R may be
    wrong by a factor of 1000 either way, Q by 100. From an R ten to thirty times too small it can take
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
        process_scales: Sequence[float] = (1.0, 0.01, 0.1, 10.0, 100.0),
        dwell: float = 1000.0,
        jump: float = 1e-9,
        measurement_scales: Sequence[float] = SCALES,
        grouping: Grouping = "component",
        memory: float = 300.0,
        r_memory: float = 30.0,
    ) -> None:
        """Set up filterpy's attributes, the copies and the noise."""
        classes = NoiseClasses(measurement_scales, grouping, memory, r_memory)
        super().__init__(dim_x, dim_z, dim_u, grouping=grouping)
        self._set_noise(classes, dim_z)
        self._set_copies(process_scales, dwell, jump)
        self._first = 0

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
        bank, values, m = self._current(), np.atleast_1d(values), len(H)
        known = self._known(self._first + m)
        found = self._learn(bank, values, H, R, M, known, self._first)
        before = known if self._classes.grouping == "joint" else known[self._first :]
        if found is None:
            self._found = (0.0, bank, self._learnt, 0.0)
            return nothing_observed(bank.x, P, H.dot(P).dot(H.T) + ordinary_noise(R, before), m)
        self._found = (found.log_density, found.bank, found.known, found.outlier_probability)
        return _Adapted(found.bank.x, found.bank.P, found, values, bank, H.copy(), R.copy(), M, before, self._inverse)

    def _settle(self) -> None:
        """Take over the corrected copies and what they have learnt."""
        _, _, self._learnt, self._outlier_probability = self._found
        super()._settle()

    def _skip(self) -> None:
        """Leave the copies and the noise as they are."""
        super()._skip()
        self._outlier_probability = 0.0


class _Adapted(NamedTuple):
    """A correction under learnt noise; what few programs look at is computed on request."""

    x: Array
    P: Array
    learnt: Learnt
    z: Array
    prior: Bank
    H: Array
    R: Array
    M: Array | None
    known: Array
    """Of the noise, before it; a row for each sensor or one for all."""
    inv: Inverse | None
    memory: None = None
    """Of customary innovations it has none."""

    def as_arrays(self) -> Correction:
        """Return everything that a correction shows."""
        ordinary, M = ordinary_noise(self.R, self.known), self.M
        # A noise that is larger by a factor keeps its correlation with the state.
        cross = None if M is None else M * np.sqrt(self.known[: len(self.R), 0])
        return self.learnt.correction(self.z, self.prior.x, self.prior.P, self.H, ordinary, cross, self.inv)
