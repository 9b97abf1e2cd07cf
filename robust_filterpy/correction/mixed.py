"""A correction under a mixture as a filter keeps it; what few programs look at is made on request."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.definition import innovation_moments
from robust_filterpy.correction.learning import R_FACTOR
from robust_filterpy.correction.result import Correction, ordered_scaling

__all__ = ["Mixed", "any_outlier", "lags", "ordinary_noise"]

# In standard deviations.
_NO_LAG = 0.1


class Mixed(NamedTuple):
    """A correction under a mixture; what few programs look at is computed on request."""

    #: Posterior mean, shape (n,).
    x: Array
    #: Posterior covariance, shape (n, n).
    P: Array
    #: Of the noise after it; None where the filter has it already.
    memory: Array | None
    #: log p(z).
    log_density: float
    #: Shape (m,), NaN where missing.
    weights: Array
    #: Shape (m,).
    outlier_probabilities: Array
    #: Prior mean, shape (n,), or 0 where z is an innovation.
    prior_x: Array
    prior_P: Array
    H: Array
    #: As it was given.
    R: Array
    M: Array | None
    #: Shape (m,); NaN where missing.
    z: Array
    #: What was learned of the noise, a row of each sensor or of all; in a record of the kernel's factors of R alone.
    before: Array
    #: Innovations whose signs tell whether the estimate lags behind: 0 where too short, NaN where missing, (m,).
    lags: Array
    #: For each sensor the first one of those that fail together with it.
    leads: Array
    #: Covariance of what a line does not explain of z.
    curvature: Array | None = None

    @property
    def outlier_probability(self) -> float:
        """Probability that a component was an outlier; sensors that fail together have one."""
        return float(any_outlier(self.outlier_probabilities, self.leads))

    def as_arrays(self) -> Correction:
        """Return all that a correction shows, of the merged prior and ordinary noise as it was learned before."""
        m, M = len(self.H), self.M
        R = ordinary_noise(self.R, self.before)
        if self.curvature is not None:
            R = R + self.curvature
        # A noise that is larger by a factor keeps its correlation with the state.
        M = None if M is None else M * np.sqrt(self.before[:, R_FACTOR])
        C, S = innovation_moments(self.prior_P, self.H, R, M)
        y = np.where(np.isnan(self.weights), np.nan, self.z - self.H.dot(self.prior_x))
        part = np.flatnonzero(y == y)
        y = np.where(np.isnan(y), 0.0, y)
        order = tuple((int(i),) for i in part[np.argsort(np.abs(y[part]) / np.sqrt(S.diagonal()[part]))])
        T = ordered_scaling(S, order, "innovation")
        e, weights, psi_deriv, score = T.dot(y), np.full(m, np.nan), np.full(m, np.nan), np.zeros(m)
        weights[part] = self.weights[part]
        # The more likely an outlier than not, the more it counts as clipped.
        psi_deriv[part] = np.where(self.outlier_probabilities[part] > 0.5, 0.0, weights[part])
        score[part] = T[np.ix_(part, part)].T.dot(weights[part] * e[part])
        return Correction(
            self.x, self.P, C, y, S, score, T.T.dot(T), e, weights, psi_deriv, order, "innovation",
            self.log_density, outlier_probability=self.outlier_probability,
        )  # fmt: skip


def any_outlier(outlying: Array, leads: Array) -> Array:
    """Return the probability that any sensor, the last axis, was an outlier; those that fail together have one."""
    each = [outlying[..., leads == lead].max(axis=-1) for lead in np.unique(leads)]
    return np.asarray(each[0] if len(each) == 1 else 1.0 - np.prod([1.0 - p for p in each], axis=0))


def lags(y: Array, variances: Array) -> Array:
    """Return innovations, 0 where one is as short as what a start leaves where there is no noise."""
    return np.where(np.abs(y) < _NO_LAG * np.sqrt(variances), 0.0, y)


def ordinary_noise(R: Array, memory: Array) -> Array:
    """Return the covariance of ordinary noise for an R that was given, memory a row for each sensor or one for all."""
    if len(memory) == 1:
        return np.asarray(R * memory[0, R_FACTOR])
    r = np.sqrt(memory[: len(R), R_FACTOR])
    return np.asarray(R * np.multiply.outer(r, r))
