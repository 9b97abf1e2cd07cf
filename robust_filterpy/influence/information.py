"""What an influence function is worth: threshold <-> contamination of Huber's, E[psi'] of any.

In closed form for Huber's function and its density; by quadrature for the others.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from scipy import special

LOG_SQRT_2PI = 0.5 * math.log(2.0 * math.pi)
# The standard normal density is 0 here in double precision, and that of the length of 400 of them too.
_END = 60.0


def outlier_odds(k: float) -> float:
    """Return eps/(1 - eps) for which k is minimax."""
    density = math.exp(-0.5 * k * k) / math.sqrt(2.0 * math.pi)
    return max(2.0 * density / k - 2.0 * float(special.ndtr(-k)), 0.0)


@lru_cache(maxsize=256)
def minimax_threshold(contamination: float) -> float:
    """Invert `outlier_odds`; k runs over many decades, so the search is over log k."""
    from scipy.optimize import brentq

    odds = contamination / (1.0 - contamination)
    if odds < 1e-290:
        return math.inf
    return math.exp(brentq(lambda s: math.log(outlier_odds(math.exp(s)) / odds), -700.0, math.log(36.0), xtol=1e-15))


@lru_cache(maxsize=256)
def huber_log_normalizer(k: float, dim: int) -> float:
    """Return log of the radial integral in closed form by incomplete gamma functions."""
    half = 0.5 * dim
    if math.isinf(k):
        return dim * LOG_SQRT_2PI
    sphere = math.log(2.0) + half * math.log(math.pi) - special.gammaln(half)
    core = math.log(special.gammainc(half, 0.5 * k * k)) + special.gammaln(half) + (half - 1.0) * math.log(2.0)
    # log(exp(k^2/2) Gamma(dim, k^2)/k^dim); for integer dim the upper incomplete gamma is a finite sum.
    terms = -special.gammaln(np.arange(dim) + 1.0) + 2.0 * np.arange(dim) * math.log(k)
    tail = special.gammaln(dim) - 0.5 * k * k + special.logsumexp(terms) - dim * math.log(k)
    return float(sphere + np.logaddexp(core, tail))


def clipping_point(influence: Any) -> float:
    """Return where psi' ceases to be positive, infinite if nowhere below 100, or if there is no psi."""
    if influence is None or hasattr(influence, "from_contamination"):
        return math.inf if influence is None else float(influence.threshold)
    grid = np.linspace(0.0, 100.0, 100_001)
    flat = np.asarray(influence.psi_deriv(grid)) <= 0.0
    return float(grid[flat.argmax()]) if flat.any() else math.inf


def expected_information(influence: Any) -> float:
    """Return E[psi'(e)], the expected information of one standardized innovation (paper 40, 45).

    Parameters
    ----------
    influence : Influence
        Any object with ``psi_deriv``; the package's own or a norm of statsmodels.

    Returns
    -------
    float
        Under the density that psi is made for: the least favorable one for `Huber`, (1 - eps)(2 Phi(k) - 1), Student's
        t for `StudentT`; by quadrature under the standard normal for any other.

    Notes
    -----
    The paper prints (41) with the integral from 0; Phi is the normal distribution function, from -infinity.

    Examples
    --------
    >>> from robust_filterpy import Huber
    >>> round(expected_information(Huber(1.14)), 4)
    0.6711
    """
    nominal = getattr(influence, "nominal_information", lambda: None)()
    return _under_normal(influence) if nominal is None else nominal


@lru_cache(maxsize=64)
@np.errstate(under="ignore")
def expected_joint_information(influence: Any, dim: int) -> float:
    """Return the mean of tr(D)/dim for psi applied to the length of a standard normal vector in R^dim."""
    # psi' along the vector and psi(r)/r across it, each clipped to [0, 1] as the filter does. One component alone
    # counts as under grouping "component".
    if dim == 1:
        return expected_information(influence)
    from scipy import stats

    def share(r: np.ndarray) -> np.ndarray:
        along = np.clip(influence.psi_deriv(r), 0.0, 1.0)
        across = np.clip(influence.weights(r), 0.0, 1.0)
        return (along + (dim - 1) * across) / dim * stats.chi.pdf(r, dim)

    return _integral(share, influence, 0.0)


@lru_cache(maxsize=64)
@np.errstate(under="ignore")
def _under_normal(influence: Any) -> float:
    """Return E[psi'(e)] for e standard normal."""
    from scipy import stats

    return _integral(lambda e: influence.psi_deriv(e) * stats.norm.pdf(e), influence)


def _integral(function: Any, influence: Any, low: float = -_END) -> float:
    """Integrate piece by piece between the corners of an influence function, to where a normal density is 0."""
    from scipy.integrate import quad

    corners = np.array([0.5, 1.0, 2.0, 4.0, 8.0, 16.0, *getattr(influence, "corners", ())])
    points = [point for point in np.unique([*-corners, 0.0, *corners]) if low < point < _END]
    return float(quad(lambda e: function(np.array([e]))[0], low, _END, points=points, limit=500, epsabs=1e-13)[0])
