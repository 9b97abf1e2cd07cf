"""What the filters share that correct a state once for each of several hypotheses."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._arrays import process_noise, state_of
from robust_filterpy._checks import Array
from robust_filterpy.correction.definition import innovation_moments
from robust_filterpy.correction.options import Information, Scaling
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.standardization import ordered_scaling
from robust_filterpy.correction.whitening import Inverse
from robust_filterpy.filters.kalman import RobustKalmanFilter


class MultipleHypothesisFilter(RobustKalmanFilter):
    """Keep what `_corrected` finds out beside the posterior in ``_found`` and only if the correction is accepted.

    A subclass's `_corrected` sets ``_found``, a tuple whose first entry is the log-likelihood; `_settle` is called
    when a correction has been accepted, `_skip` when there was nothing to correct by.
    """

    # Outside __dict__, which filterpy's Saver copies at every epoch: one number for each step of the last recording.
    __slots__ = ("_process_scales",)

    _found: tuple[Any, ...]
    # Their psi follows from probabilities, and no share of clipped innovations is expected of it.
    _counts_clipped = False

    @property
    def process_scale(self) -> float:
        """Mean factor of Q in the step before the last measurement, given that measurement."""
        raise NotImplementedError

    def batch_filter(
        self,
        zs: Any,
        Fs: Any = None,
        Qs: Any = None,
        Hs: Any = None,
        Rs: Any = None,
        Bs: Any = None,
        us: Any = None,
        update_first: bool = False,
        saver: Any = None,
    ) -> tuple[Array, Array, Array, Array]:
        """Filter a whole recording, and remember for `rts_smoother` what was found out about the process.

        Parameters
        ----------
        zs, Fs, Qs, Hs, Rs, Bs, us, update_first, saver
            As in `RobustKalmanFilter.batch_filter`.

        Returns
        -------
        means, covariances, means_p, covariances_p : ndarray
            As in `RobustKalmanFilter.batch_filter`.

        Raises
        ------
        ValueError, TypeError, LinAlgError
            As in `RobustKalmanFilter.batch_filter`.
        """
        if saver is not None and not callable(getattr(saver, "save", None)):
            return super().batch_filter(zs, Fs, Qs, Hs, Rs, Bs, us, update_first, saver)
        notes = ProcessScales(self, saver)
        found = super().batch_filter(zs, Fs, Qs, Hs, Rs, Bs, us, update_first, notes)
        self._process_scales = np.array(notes.scales)
        return found

    def rts_smoother(
        self, Xs: Array, Ps: Array, Fs: Any = None, Qs: Any = None, inv: Any = np.linalg.inv
    ) -> tuple[Array, Array, Array, Array]:
        """Smooth what `batch_filter` returned, with the process noise that it found in each step.

        Parameters
        ----------
        Xs, Ps, Fs, Qs, inv
            As in `RobustKalmanFilter.rts_smoother`.

        Returns
        -------
        x, P, K, Pp : ndarray
            As in `RobustKalmanFilter.rts_smoother`.

        Raises
        ------
        ValueError, TypeError
            If the lengths or shapes do not fit.

        Notes
        -----
        Q of step k is `process_scale` times the ordinary Q where Xs ends with the filter's state after the last
        `batch_filter` of that length. A loop over `predict` and `update` hands over ``Qs`` itself: the ordinary Q
        times `process_scale` after each update. A jump would otherwise be smoothed away, before and after it.
        """
        scales = getattr(self, "_process_scales", None)
        if scales is not None and len(scales) == len(Xs) > 0 and np.array_equal(np.ravel(Xs[-1]), np.ravel(self.x)):
            n = self.dim_x
            nominal = [self.Q] * len(scales) if Qs is None else Qs
            Qs = [
                scale * (process_noise(Q, None, n) + np.zeros((n, n)))
                for scale, Q in zip(scales, nominal, strict=False)
            ]
        return super().rts_smoother(Xs, Ps, Fs, Qs, inv)

    def _settle(self) -> None:
        """Take over what the accepted correction found."""

    def _update(self, z: Any, R: Any, H: Any, M: Any) -> None:
        """Correct by a whole measurement; a refused call leaves the findings too."""
        found = self._found
        try:
            super()._update(z, R, H, M)
        except BaseException:
            self._found = found
            raise
        if self._found[0] is not None:
            self._log_likelihood = self._found[0]
            self._settle()

    def get_update(self, z: ArrayLike | None = None) -> tuple[Array, Array]:
        """Return what `update` would make of x and P, and change nothing.

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar, or None
            Measurement, as in `update`.

        Returns
        -------
        x : ndarray, shape of ``self.x``
            Corrected state.
        P : ndarray, shape (dim_x, dim_x)
            Its covariance.
        """
        found = self._found
        try:
            return super().get_update(z)
        finally:
            self._found = found

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

        Notes
        -----
        ``log_likelihood`` is that of the last part.
        """
        found = self._found
        try:
            super().update_sequential(start, z_i, R_i, H_i)
        except BaseException:
            self._found = found
            raise
        if np.isnan(_checks.numbers("z_i", z_i)).all():
            self._found = found
        else:
            self._log_likelihood = self._found[0]
            self._settle()

    def log_likelihood_of(self, z: ArrayLike | None) -> float:
        """Return the log-likelihood of a measurement given the present state and its hypotheses.

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar, or None
            Measurement; NaN marks a missing component.

        Returns
        -------
        float
            0 if z is missing altogether.
        """
        x, P = state_of(self)
        H, R, values, _ = self._measurement(z, None, None, None, len(x))
        if values is None:
            return 0.0
        found = self._found
        try:
            self._corrected(x, P, values, H, R, None)
            return float(self._found[0])
        finally:
            self._found = found


class ProcessScales:
    """A saver that notes the process scale of each step, before another saver's turn."""

    def __init__(self, kf: MultipleHypothesisFilter, saver: Any) -> None:
        """Keep the filter and the other saver."""
        self.kf, self.saver = kf, saver
        self.scales: list[float] = []

    def save(self) -> None:
        """Note the scale."""
        self.scales.append(self.kf.process_scale)
        if self.saver is not None:
            self.saver.save()


class ScoreMixin:
    """Correct by the score of the innovation, which follows from the noise model and leaves nothing to choose."""

    # Its psi follows from probabilities, and no share of clipped innovations is expected of it.
    _counts_clipped = False

    @property
    def scaling(self) -> Scaling:
        """Always "innovation": another scaling would not be the score."""
        return "innovation"

    @scaling.setter
    def scaling(self, value: Scaling) -> None:
        raise AttributeError(f"scaling: always 'innovation' for a {type(self).__name__}")

    @property
    def information(self) -> Information:
        """Always "realized": the exact second moment."""
        return "realized"

    @information.setter
    def information(self, value: Information) -> None:
        raise AttributeError(f"information: always 'realized' for a {type(self).__name__}")


class ScoreFilter(ScoreMixin, MultipleHypothesisFilter):
    """Correct a state under several hypotheses by the score."""


def finite_product(H: Array, x: Array) -> Array:
    """Return H x, shape (m,), or raise: NaN would pass for a missing measurement."""
    predicted = H.dot(x)
    if not np.isfinite(predicted).all():
        raise ValueError(f"x: expected finite numbers, got H x = {predicted}")
    return np.asarray(predicted)


class ScoreInfluence(NamedTuple):
    """psi is the score of the innovation."""

    score: Array
    """g(y) of the k observed components, shape (k,)."""
    information: Array
    """Its derivative, shape (k, k)."""

    def __call__(self, T: Array, S: Array, e: Array) -> tuple[Array, Array]:
        """Return psi(e)/e and psi'(e): with T S T' = I, psi = T S g so that C T' psi = C g."""
        root = T.dot(S)
        psi, weights = root.dot(self.score), np.ones_like(e)
        np.divide(psi, e, out=weights, where=e != 0.0)
        return weights, np.diag(root.dot(self.information).dot(root.T))


class WeightInfluence(NamedTuple):
    """psi is e with a weight on each component."""

    weights: Array
    """In [0, 1], shape (k,)."""
    outlying: np.ndarray
    """Whether a component counts as clipped, shape (k,)."""

    def __call__(self, T: Array, S: Array, e: Array) -> tuple[Array, Array]:
        """Return psi(e)/e and psi'(e)."""
        return self.weights, np.where(self.outlying, 0.0, self.weights)


class MergedCorrection(NamedTuple):
    """A correction merged from hypotheses; what few programs look at is computed on request."""

    x: Array
    """Posterior mean, shape (n,)."""
    P: Array
    """Posterior covariance, shape (n, n)."""
    y: Array
    """Innovation, shape (m,); NaN where missing."""
    prior: Array
    """Prior covariance, shape (n, n)."""
    H: Array
    """Shape (m, n)."""
    R: Array
    """Covariance of ordinary noise, shape (m, m)."""
    M: Array | None
    """Its covariance with the state's error, shape (n, m)."""
    inv: Inverse | None
    """What inverts S."""
    influence: ScoreInfluence | WeightInfluence
    """psi of the observed components."""
    memory: None = None
    """Of customary innovations it has none."""

    def as_arrays(self) -> Correction:
        """Return everything that a correction shows."""
        m = len(self.H)
        C, S = innovation_moments(self.prior, self.H, self.R, self.M)
        part = np.flatnonzero(self.y == self.y)
        y = np.where(np.isnan(self.y), 0.0, self.y)
        order = tuple((int(i),) for i in part[np.argsort(np.abs(y[part]) / np.sqrt(S.diagonal()[part]))])
        T = ordered_scaling(S, order, "innovation")
        e, pick = T.dot(y), np.ix_(part, part)
        weights, psi_deriv, score = np.full(m, np.nan), np.full(m, np.nan), np.zeros(m)
        weights[part], psi_deriv[part] = self.influence(T[pick], S[pick], e[part])
        score[part] = T[pick].T.dot(weights[part] * e[part])
        return Correction(
            self.x, self.P, C, y, S, score, T.T.dot(T), e, weights, psi_deriv, order, "innovation", 0.0
        )  # fmt: skip
