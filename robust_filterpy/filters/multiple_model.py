"""TwoSidedKalmanFilter: doubt the process as well as the measurement, without a model of either's outliers.

One sample cannot tell a lying sensor from a target that manoeuvres; the next ones can. So the filter runs a few
copies that differ in how large they take the process noise to be, and lets the likelihood of the recent innovations
say which to believe (interacting multiple models). In that likelihood a sample is an outlier as soon as not, and how
likely an outlier is does not depend on the copy: a lone one tells the copies nothing apart, while a few samples off to
the same side tell a lot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._arrays import process_noise, require_finite_prediction, state_of
from robust_filterpy._checks import Array
from robust_filterpy.correction.definition import correct
from robust_filterpy.correction.likelihood import log_density
from robust_filterpy.correction.options import Choices, Grouping, Information, Scaling, length_and_direction
from robust_filterpy.correction.result import Correction
from robust_filterpy.filters._hypotheses import MultipleHypothesisFilter, finite_product
from robust_filterpy.influence.functions import Influence, Linear, StudentT

__all__ = ["TwoSidedKalmanFilter"]

# What weighs the copies takes every second sample for an outlier, and an outlier for five times as large as an
# ordinary innovation. Shares from .4 and scales from 5 to 10 were measured to give the same errors within 1 %; a
# small probability lets a filter with many outliers take them for manoeuvres.
_OUTLIER_SHARE = 0.5
_OUTLIER_SCALE = 5.0
_GAUSSIAN = Choices(Linear())
_LOG_2PI = math.log(2.0 * math.pi)
# The square of this is finite, and so is the sum of a few.
_LARGE = 1e150


class _Bank(NamedTuple):
    """Means (q, n), covariances (q, n, n) and probabilities (q,) of the copies, and the x, P merged from them."""

    means: Array
    covariances: Array
    probabilities: Array
    x: Array
    P: Array


class TwoSidedKalmanFilter(MultipleHypothesisFilter):
    """Filter like `RobustKalmanFilter`, but let the size of the process noise be doubted too.

    Copies of the filter with process noise ``scale * Q`` run side by side. A copy's probability follows from the
    likelihood p_j of its innovations; from one step to the next the process keeps its scale with probability
    1 - 1/dwell. x and P are mean and covariance over the copies::

        p_j(z) = 1/2 N(z; H x_j, S_j) + 1/2 N(z; H x, 25 S)

    Parameters
    ----------
    dim_x : int
        Length of the state, >= 1.
    dim_z : int
        Length of the measurement, >= 1.
    dim_u : int, default 0
        Length of the control input.
    process_scales : sequence of float, default (1, 10, 100)
        Factors of the covariance Q, > 0; the first is where the filter starts.
    dwell : float, default 1000
        Mean number of steps that the process keeps a scale, > 1.
    influence : Influence, default StudentT(4)
        psi, as in `RobustKalmanFilter`.
    scaling : {"innovation", "unit", "bounded"}
        T, as in `RobustKalmanFilter`.
    information : {"realized", "expected", "weight"}
        D, as in `RobustKalmanFilter`.
    grouping : {"component", "joint"}
        psi of each component of e, or of the length of e.

    Raises
    ------
    ValueError
        If a dimension or an option is out of range.

    Notes
    -----
    The second term of p_j is the same for every copy, and any outlier's. With the density of psi instead, a larger
    S is the cheaper explanation of many outliers, and the filter takes them for manoeuvres: on equations 31-34 of the
    paper with 30 % outliers its error was 5 times that of the one-sided filter.

    With `Linear` as psi there are no outliers, p_j is normal, and this is the interacting multiple model filter.

    ``Q`` is the ordinary covariance. ``y``, ``S``, ``K``, ``e``, ``weights`` are those of the merged prior, and
    x_post is not x_prior + K y_bounded, because the copies have different gains. A program that assigns x or P
    assigns it to every copy.

    Examples
    --------
    >>> import numpy as np
    >>> kf = TwoSidedKalmanFilter(1, 1)
    >>> kf.H, kf.Q = np.eye(1), 0.01 * np.eye(1)
    >>> for z in [0.0] * 20 + [1e6] + [0.0] * 5:
    ...     kf.predict()
    ...     kf.update(z)
    >>> bool(abs(kf.x[0, 0]) < 0.1)
    True
    >>> for z in [8.0] * 12:
    ...     kf.predict()
    ...     kf.update(z)
    >>> bool(abs(kf.x[0, 0] - 8.0) < 0.5)
    True
    """

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        process_scales: Sequence[float] = (1.0, 10.0, 100.0),
        dwell: float = 1000.0,
        influence: Influence = StudentT(),
        scaling: Scaling = "innovation",
        information: Information = "realized",
        grouping: Grouping = "component",
    ) -> None:
        """Set up filterpy's attributes and the copies."""
        super().__init__(
            dim_x, dim_z, dim_u, influence=influence, scaling=scaling, information=information, grouping=grouping
        )
        scales = _checks.numbers("process_scales", process_scales)
        if scales.ndim != 1 or not scales.size or not (np.isfinite(scales) & (scales > 0.0)).all():
            raise ValueError(f"process_scales: expected one or more finite numbers > 0, got {process_scales!r}")
        if not _checks.positive("dwell", dwell) > 1.0:
            raise ValueError(f"dwell: expected a number of steps > 1, got {dwell!r}")
        self._scales, self._dwell = scales.copy(), float(dwell)
        # The ordinary scale is where a process starts, the others have the chance of one change.
        probabilities = np.full(scales.size, 1.0 / dwell)
        probabilities[0] = 1.0
        self._keep_copies(self._copies(probabilities / probabilities.sum()))
        self._found = (None,)

    @property
    def process_scales(self) -> Array:
        """Factors of Q, shape (q,)."""
        return self._scales.copy()

    @property
    def dwell(self) -> float:
        """Mean number of steps that the process keeps a scale."""
        return self._dwell

    @property
    def process_probabilities(self) -> Array:
        """Probability of each process scale, shape (q,)."""
        return self._shares.copy()

    @property
    def process_scale(self) -> float:
        """Mean factor of Q, over the copies."""
        return float(self._shares @ self._scales)

    def predict(
        self, u: ArrayLike | None = None, B: ArrayLike | None = None, F: ArrayLike | None = None, Q: Any = None
    ) -> None:
        """Predict the next state with every process scale.

        Parameters
        ----------
        u : array_like, shape (dim_u,) or (dim_u, 1), or scalar, optional
            Control input.
        B : array_like, shape (dim_x, dim_u), optional
            Control matrix for this call.
        F : array_like, shape (dim_x, dim_x), optional
            Transition matrix for this call.
        Q : array_like, shape (dim_x, dim_x), or scalar, optional
            Process noise covariance for this call; a scalar here means Q I.

        Raises
        ------
        ValueError
            If a shape does not fit; nothing has changed then.
        """
        bank = self._advanced(u, B, F, Q)
        self._take_over(bank)
        self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def _predicted(self, u: Any, B: Any, F: Any, Q: Any) -> tuple[Array, Array]:
        """Return the predicted mean, in the shape of x, and covariance."""
        bank = self._advanced(u, B, F, Q)
        return bank.x.reshape(np.shape(self.x)), bank.P

    def _advanced(self, u: Any, B: Any, F: Any, Q: Any) -> _Bank:
        """Return the copies after a prediction: mixed as the scale may have changed, then moved."""
        x, _ = super()._predicted(u, B, F, Q)
        x = x.ravel()
        bank = self._current()
        q, n = bank.means.shape
        stay = 1.0 - 1.0 / self._dwell if q > 1 else 1.0
        moves = np.full((q, q), (1.0 - stay) / max(q - 1, 1))
        np.fill_diagonal(moves, stay)
        probabilities = bank.probabilities @ moves
        origin = bank.probabilities[:, None] * moves / probabilities
        F = np.asarray(self.F if F is None else F, dtype=float)
        noise = process_noise(self.Q, Q, n)
        mixed = origin.T @ bank.means
        # Row j: the copies as seen from the mixture that copy j starts from.
        apart = bank.means - mixed[:, None]
        P = np.tensordot(origin.T, bank.covariances, 1) + np.swapaxes(apart * origin.T[:, :, None], 1, 2) @ apart
        covariances = self._alpha_sq * (F @ P @ F.T) + self._scales[:, None, None] * noise
        # B u moves every copy as it moves the mean.
        means = x + (mixed - bank.x) @ F.T
        merged = _merged(means, covariances, probabilities)
        require_finite_prediction(merged.x, merged.P)
        return merged

    def _corrected(self, x: Array, P: Array, values: Any, H: Array, R: Array, M: Any) -> Correction:
        """Return the correction of the merged state; every copy is corrected by itself."""
        values, inv = np.atleast_1d(values), self._inverse
        bank = self._current()
        shown = correct(x.ravel(), P, values - finite_product(H, x.ravel()), H, R, self._choices, M, inv)
        if np.isnan(values).all():
            return shown
        copies = [
            correct(mean, covariance, values - H.dot(mean), H, R, self._choices, M, inv)
            for mean, covariance in zip(bank.means, bank.covariances, strict=True)
        ]
        part = np.flatnonzero(~np.isnan(values))
        wide = shown._replace(S=_OUTLIER_SCALE**2 * shown.S)
        *logs, outlier = _log_normal([*copies, wide], part, inv)
        # Relative to the outlier's, so that what is nearly impossible under all of them still compares.
        relative = np.array(logs) - outlier
        if not self._choices.is_linear:
            relative = np.logaddexp(np.log1p(-_OUTLIER_SHARE) + relative, np.log(_OUTLIER_SHARE))
        joint = np.log(bank.probabilities) + relative
        peak = joint.max()
        weights = np.exp(joint - peak)
        total = float(outlier + peak + np.log(weights.sum()))
        probabilities = weights / weights.sum()
        merged = _merged(np.array([c.x for c in copies]), np.array([c.P for c in copies]), probabilities)
        self._found = (total, merged)
        return shown._replace(x=merged.x, P=merged.P)

    def _settle(self) -> None:
        """Take over the corrected copies."""
        self._take_over(self._found[1])
        self._found = (self._found[0],)

    def _skip(self) -> None:
        """Leave the copies as they are."""
        self._found = (None,)
        super()._skip()

    def _take_over(self, bank: _Bank) -> None:
        """Make these the copies, and x and P what they merge to."""
        self.x, self.P = bank.x.reshape(np.shape(self.x)).copy(), bank.P.copy()
        self._keep_copies(bank)

    def _keep_copies(self, bank: _Bank) -> None:
        """Store the copies as plain arrays, which filterpy's Saver can stack."""
        self._means, self._covariances, self._shares, self._merged_x, self._merged_P = bank

    def _current(self) -> _Bank:
        """Return the copies; all of them at x, P if these have been assigned from outside."""
        x, P = state_of(self)
        if np.array_equal(x.ravel(), self._merged_x) and np.array_equal(P, self._merged_P):
            return _Bank(self._means, self._covariances, self._shares, self._merged_x, self._merged_P)
        return self._copies(self._shares)

    def _copies(self, probabilities: Array) -> _Bank:
        """Return copies that are all at x, P."""
        x, P = state_of(self)
        q = len(probabilities)
        return _Bank(np.tile(x.ravel(), (q, 1)), np.tile(P, (q, 1, 1)), probabilities, x.ravel().copy(), P.copy())


def _log_normal(found: list[Correction], part: np.ndarray, inv: Any) -> list[float]:
    """Return log N(y; 0, S) of the observed part of each innovation."""
    pick = np.ix_(part, part)
    if inv is not None:
        return [log_density(one.y[part], one.S[pick], _GAUSSIAN, inv) for one in found]
    # What has passed `correct` has a factor, unless rounding alone was at fault; then the slower way finds it.
    try:
        factors = np.linalg.cholesky(np.array([one.S[pick] for one in found]))
    except np.linalg.LinAlgError:
        return [log_density(one.y[part], one.S[pick], _GAUSSIAN) for one in found]
    e = np.linalg.solve(factors, np.array([one.y[part] for one in found])[:, :, None])[:, :, 0]
    log_dets = 2.0 * np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)
    lengths = [length_and_direction(one)[0] for one in np.clip(e, -_LARGE, _LARGE)]
    return [-0.5 * (r * r + d + part.size * _LOG_2PI) for r, d in zip(lengths, log_dets.tolist(), strict=True)]


def _merged(means: Array, covariances: Array, probabilities: Array) -> _Bank:
    """Return copies together with their overall mean and covariance."""
    x = probabilities @ means
    apart = means - x
    return _Bank(
        means,
        covariances,
        probabilities,
        x,
        np.tensordot(probabilities, covariances, 1) + (apart.T * probabilities) @ apart,
    )
