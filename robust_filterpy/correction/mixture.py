"""The exact score of contaminated normal noise.

A measurement noise (1 - eps) N(0, R) + eps N(0, ratio^2 R) makes the innovation a mixture too. Its score
g(y) = -grad log p(y) moves the state by C g(y), and its derivative is the exact second moment (Masreliez 1975)::

    p(y) = (1 - eps) N(0, S) + eps N(0, S + (ratio^2 - 1) R)
    x+ = x + C g(y),    P+ = P - C g'(y) C'

The same moments come from correcting once for each hypothesis and merging (`robust_filterpy.correction.merging`), which
also works where the hypotheses differ in P.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import logsumexp

from robust_filterpy import _checks
from robust_filterpy._checks import Array

__all__ = ["ContaminatedScore", "InnovationScore"]

_LOG_2PI = math.log(2.0 * math.pi)


class InnovationScore(NamedTuple):
    """The density of one innovation, a mixture of normal distributions, and its derivatives.

    With one sensor it is an influence function of e = y/sqrt(S) as well: rho, psi, psi_deriv, weights.
    """

    probabilities: Array
    """Prior probabilities of the hypotheses, shape (h,)."""
    covariances: Array
    """Covariances of the innovation under each, the ordinary one first, shape (h, m, m)."""

    def posterior(self, y: ArrayLike) -> Array:
        """Return the probability of each hypothesis given y, shape (h,)."""
        logs, _ = self._parts(np.atleast_1d(np.asarray(y, dtype=float)))
        return np.asarray(np.exp(logs - logsumexp(logs)))

    def log_density(self, y: ArrayLike) -> float:
        """Return log p(y), y of shape (m,)."""
        return float(logsumexp(self._parts(np.atleast_1d(np.asarray(y, dtype=float)))[0]))

    def score(self, y: ArrayLike) -> Array:
        """Return g(y) = -grad log p(y), shape (m,)."""
        y = np.atleast_1d(np.asarray(y, dtype=float))
        logs, pulls = self._parts(y)
        return np.asarray(np.exp(logs - logsumexp(logs)) @ pulls)

    def information(self, y: ArrayLike) -> Array:
        """Return the derivative of g at y, shape (m, m); not positive where hypotheses compete."""
        y = np.atleast_1d(np.asarray(y, dtype=float))
        logs, pulls = self._parts(y)
        probabilities = np.exp(logs - logsumexp(logs))
        inverses = np.linalg.inv(self.covariances)
        g = probabilities @ pulls
        return np.asarray(np.tensordot(probabilities, inverses, 1) - (pulls.T * probabilities) @ pulls + np.outer(g, g))

    def _parts(self, y: Array) -> tuple[Array, Array]:
        """Return log(probability N(y; 0, S_i)) and S_i^-1 y of each hypothesis, shapes (h,) and (h, m)."""
        column = np.broadcast_to(y[:, None], (len(self.probabilities), y.size, 1))
        pulls = np.linalg.solve(self.covariances, column)[..., 0].astype(float)
        dets = np.linalg.slogdet(self.covariances)[1]
        return np.asarray(np.log(self.probabilities) - 0.5 * (pulls @ y + dets + y.size * _LOG_2PI)), pulls

    def rho(self, e: ArrayLike) -> Array:
        """Return -log p(e)/p(0) for one sensor, the shape of e."""
        at_zero = self.log_density(0.0)
        return self._each(e, lambda y, _: at_zero - self.log_density(y))

    def psi(self, e: ArrayLike) -> Array:
        """Return the score in standardized form for one sensor, the shape of e."""
        return self._each(e, lambda y, s: s * self.score(y)[0])

    def psi_deriv(self, e: ArrayLike) -> Array:
        """Return the derivative of psi for one sensor, the shape of e."""
        return self._each(e, lambda y, s: s * s * self.information(y)[0, 0])

    def weights(self, e: ArrayLike) -> Array:
        """Return psi(e)/e for one sensor, the shape of e."""
        first = float(self.covariances[0, 0, 0])
        ratios = first / self.covariances[:, 0, 0]
        return self._each(e, lambda y, _: float(self.posterior(y) @ ratios))

    def _each(self, e: ArrayLike, function: Any) -> Array:
        """Apply a function of (y, sqrt(S)) to each y = sqrt(S) e."""
        if self.covariances.shape[1] != 1:
            raise ValueError(f"e: expected one sensor for an influence function, got {self.covariances.shape[1]}")
        s = math.sqrt(float(self.covariances[0, 0, 0]))
        e = np.asarray(e, dtype=float)
        return np.array([float(function(np.array([s * v]), s)) for v in e.ravel()]).reshape(e.shape)


@dataclass(frozen=True)
class ContaminatedScore:
    """Describe contaminated normal noise, (1 - contamination) N(0, V) + contamination N(0, scale_ratio^2 V).

    V is the covariance that the filter has for it: R for a measurement, Q for a process. The score of an innovation
    follows from it only together with S and R, so this is no influence function of e alone, and
    `robust_filterpy.RobustKalmanFilter` refuses it; `robust_filterpy.NoiseMatchedKalmanFilter` takes it.

    Parameters
    ----------
    contamination : float, default 0.1
        Share of outliers, in [0, 1).
    scale_ratio : float, default 10
        Standard deviation of the outliers over that of the ordinary samples, >= 1.

    Raises
    ------
    ValueError
        If contamination is outside [0, 1) or scale_ratio below 1 or infinite.

    Examples
    --------
    >>> score = ContaminatedScore(0.1, 10.0).for_innovation(S=[[1.5]], R=[[1.0]])
    >>> score.psi([0.5, 3.0, 30.0]).round(3)
    array([0.493, 1.424, 0.448])
    """

    contamination: float = 0.1
    scale_ratio: float = 10.0

    def __post_init__(self) -> None:
        """Check the parameters."""
        object.__setattr__(self, "contamination", _checks.fraction("contamination", self.contamination))
        ratio = _checks.positive("scale_ratio", self.scale_ratio)
        if ratio < 1.0:
            raise ValueError(f"scale_ratio: expected a number >= 1, got {self.scale_ratio!r}")
        object.__setattr__(self, "scale_ratio", ratio)

    @property
    def is_ordinary(self) -> bool:
        """Whether there are no outliers."""
        return self.contamination == 0.0 or self.scale_ratio == 1.0

    @property
    def variance_ratio(self) -> float:
        """Variance of the mixture over that of the ordinary samples."""
        return 1.0 + self.contamination * (self.scale_ratio**2 - 1.0)

    def patterns(self, dim: int, grouping: Any = "joint") -> list[tuple[float, Array]]:
        """Return every hypothesis of which components are outliers.

        Parameters
        ----------
        dim : int
            Number of components.
        grouping : {"joint", "component"}
            All fail together, or each on its own: 2 or 2^dim hypotheses.

        Returns
        -------
        list of (float, ndarray of shape (dim,))
            Probability, and the factor of each component's standard deviation; the ordinary one first.
        """
        if self.is_ordinary:
            return [(1.0, np.ones(dim))]
        if grouping == "joint":
            return [(1.0 - self.contamination, np.ones(dim)), (self.contamination, np.full(dim, self.scale_ratio))]
        return [
            (
                self.contamination ** sum(bad) * (1.0 - self.contamination) ** (dim - sum(bad)),
                np.where(bad, self.scale_ratio, 1.0),
            )
            for bad in product((False, True), repeat=dim)
        ]

    def for_innovation(self, S: ArrayLike, R: ArrayLike, grouping: str = "joint") -> InnovationScore:
        """Return the density of an innovation whose measurement noise is this.

        Parameters
        ----------
        S : array_like, shape (m, m)
            Innovation covariance with ordinary noise.
        R : array_like, shape (m, m)
            The part of it that is ordinary measurement noise.
        grouping : {"joint", "component"}
            Whether the sensors fail together or each on its own.

        Returns
        -------
        InnovationScore

        Raises
        ------
        ValueError
            If S and R are no square matrices of the same shape.
        """
        S, R = np.atleast_2d(_checks.numbers("S", S)), np.atleast_2d(_checks.numbers("R", R))
        if S.shape != R.shape or S.shape[0] != S.shape[1]:
            raise ValueError(f"S, R: expected square matrices of one shape, got {S.shape} and {R.shape}")
        patterns = self.patterns(len(S), grouping)
        return InnovationScore(
            np.array([probability for probability, _ in patterns]),
            np.array([S + (np.outer(scale, scale) - 1.0) * R for _, scale in patterns]),
        )
