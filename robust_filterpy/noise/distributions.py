"""The least favorable noise as a scipy.stats distribution, and the Fisher information of any density."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from scipy import special, stats

from robust_filterpy._checks import Array, fraction, positive
from robust_filterpy.influence.functions import Huber

__all__ = ["LeastFavorable", "fisher_information"]


class LeastFavorable(stats.rv_continuous):
    """Follow the density of least Fisher information among the contaminated normal ones.

    Normal in the middle, exponential beyond the threshold k:
    p(x) = (1 - eps)/(sqrt(2 pi) s) exp(-rho(x/s)), with Huber's rho. Its score is Huber's psi.

    Parameters
    ----------
    contamination : float
        Share of outliers, in [0, 1).
    scale : float, default 1
        Standard deviation of the normal that is contaminated, in the unit of the measurement.

    Raises
    ------
    ValueError
        If contamination is outside [0, 1) or scale is not > 0.

    Examples
    --------
    >>> density = LeastFavorable(0.1)
    >>> round(density.threshold, 3)
    1.14
    >>> round(float(density.cdf(density.threshold)), 4)
    0.8356
    """

    def __init__(self, contamination: float, scale: float = 1.0) -> None:
        """Check the parameters and hand an unparametrised distribution to scipy."""
        self.contamination = fraction("contamination", contamination)
        self.scale = positive("scale", scale)
        self._psi = Huber.from_contamination(self.contamination)
        self.threshold = self._psi.threshold
        super().__init__(name="least_favorable")

    def __repr__(self) -> str:
        """Show the parameters."""
        return f"LeastFavorable(contamination={self.contamination}, scale={self.scale})"

    def score(self, x: Any) -> Array:
        """Return -d log p/dx, the shape of x: Huber's psi of x/scale, over scale."""
        return self._psi.psi(np.asarray(x, dtype=float) / self.scale) / self.scale

    @property
    def _tail(self) -> float:
        """Probability beyond the threshold, on one side."""
        if math.isinf(self.threshold):
            return 0.0
        k = self.threshold
        return (1.0 - self.contamination) * math.exp(-0.5 * k * k) / (math.sqrt(2.0 * math.pi) * k)

    def _logpdf(self, x: Array) -> Array:
        level = math.log1p(-self.contamination) - 0.5 * math.log(2 * math.pi) - math.log(self.scale)
        return level - self._psi.rho(np.asarray(x) / self.scale)

    def _pdf(self, x: Array) -> Array:
        return np.exp(self._logpdf(x))

    def _cdf(self, x: Array) -> Array:
        e = np.asarray(x) / self.scale
        k = self.threshold
        if math.isinf(k):
            return special.ndtr(e)
        lower = self._tail * np.exp(k * (np.minimum(e, -k) + k))
        upper = 1.0 - self._tail * np.exp(-k * (np.maximum(e, k) - k))
        middle = self._tail + (1.0 - self.contamination) * (special.ndtr(e) - special.ndtr(-k))
        return np.where(e < -k, lower, np.where(e > k, upper, middle))

    def _sf(self, x: Array) -> Array:
        return self._cdf(-np.asarray(x))

    def _ppf(self, q: Array) -> Array:
        k, tail = self.threshold, self._tail
        if math.isinf(k):
            return self.scale * special.ndtri(q)
        low = np.minimum(q, 1.0 - q)
        with np.errstate(divide="ignore", invalid="ignore"):
            outside = -k + np.log(low / tail) / k
            inside = special.ndtri((low - tail) / (1.0 - self.contamination) + special.ndtr(-k))
        e = np.where(low < tail, outside, inside)
        return self.scale * np.where(q <= 0.5, e, -e)

    def _updated_ctor_param(self) -> dict[str, Any]:
        return dict(contamination=self.contamination, scale=self.scale)

    def __reduce__(self) -> tuple[Any, ...]:
        """Rebuild from the parameters: scipy's own way looks for shape parameters."""
        return type(self), tuple(self._updated_ctor_param().values())


def fisher_information(dist: Any) -> float:
    """Return the Fisher information of location, I(p) = integral of p'^2/p (paper 30).

    Parameters
    ----------
    dist : scipy.stats distribution
        Frozen, with ``logpdf`` and ``ppf``; a method ``score`` is used if there is one, otherwise log p is
        differentiated numerically.

    Returns
    -------
    float
        In 1/unit^2: 1/sigma^2 for a normal distribution, (1 - eps)(2 Phi(k) - 1)/sigma^2 for
        `LeastFavorable`.

    Raises
    ------
    TypeError
        If dist has no ``logpdf`` and ``ppf``.

    Examples
    --------
    >>> round(fisher_information(stats.logistic()), 6)
    0.333333
    """
    if not (callable(getattr(dist, "logpdf", None)) and callable(getattr(dist, "ppf", None))):
        raise TypeError(f"dist: expected a frozen scipy.stats distribution with logpdf and ppf, got {dist!r}")
    from scipy.integrate import quad

    quartiles = dist.ppf([0.25, 0.5, 0.75])
    unit, center = float(quartiles[2] - quartiles[0]), float(quartiles[1])
    lower, upper = (float(edge) for edge in dist.support())

    def integrand(x: float) -> float:
        log_density = float(dist.logpdf(x))
        if not log_density > -700.0:
            return 0.0
        # Near the median the step shrinks, so that a density with a peak there is differentiated on one side.
        h = min(1e-3 * unit, max(0.4 * abs(x - center), 1e-9 * unit))
        return _score(dist, x, h, lower, upper) ** 2 * math.exp(log_density)

    steps = unit * np.array([0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 64.0])
    inner = np.concatenate([center - steps[::-1], [center], center + steps])
    edges = [lower, *inner[(inner > lower) & (inner < upper)], upper]
    return float(sum(quad(integrand, low, high, limit=200)[0] for low, high in pairwise(edges)))


def _score(dist: Any, x: float, h: float, lower: float, upper: float) -> float:
    """Return -d log p/dx, by a five-point difference unless the distribution knows it."""
    if hasattr(dist, "score"):
        return float(dist.score(x))
    h = min(h, 0.4 * (x - lower), 0.4 * (upper - x))
    if h <= 0.0:
        return 0.0
    far, near, next_, last = dist.logpdf(x + h * np.array([-2.0, -1.0, 1.0, 2.0]))
    return float((last - far - 8.0 * (next_ - near)) / (12.0 * h))
