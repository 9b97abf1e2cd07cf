"""E[psi']: the information that an average sample carries, in closed form or by quadrature."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np


@np.errstate(under="ignore")
def expected_information(influence: Any, noise: Any = None) -> float:
    """Return E[psi'(e)], the expected information of one standardized innovation (paper 40, 45).

    Parameters
    ----------
    influence : Influence
        Any object with ``psi_deriv``; the package's own or a norm of statsmodels.
    noise : scipy.stats distribution, optional
        Distribution of e (dimensionless). Default: the density that the influence function is made for: the
        least favorable one for `Huber`, Student's t for `StudentT`, the standard normal for any other.

    Returns
    -------
    float
        (1 - eps)(2 Phi(k) - 1) for `Huber` by default; P(\\|e\\| <= k) for `Huber` and a given noise; by
        quadrature otherwise.

    Raises
    ------
    TypeError
        If noise has no ``pdf`` and ``cdf``.

    Notes
    -----
    The paper prints (41) with the integral from 0; Phi is the normal distribution function, from -infinity.

    Examples
    --------
    >>> from robust_filterpy import Huber
    >>> from scipy import stats
    >>> round(expected_information(Huber(1.14)), 4)
    0.6711
    >>> round(expected_information(Huber(1.14), stats.norm()), 4)
    0.7457
    """
    if noise is None:
        nominal = getattr(influence, "nominal_information", lambda: None)()
        return _under_normal(influence) if nominal is None else nominal
    if not (callable(getattr(noise, "pdf", None)) and callable(getattr(noise, "cdf", None))):
        raise TypeError(f"noise: expected a scipy.stats distribution with pdf and cdf, got {noise!r}")
    if hasattr(influence, "from_contamination"):
        return float(noise.cdf(influence.threshold) - noise.cdf(-influence.threshold))
    return _integral(lambda e: influence.psi_deriv(e) * noise.pdf(e), _corners(influence))


@np.errstate(under="ignore")
def expected_joint_information(influence: Any, dim: int) -> float:
    """Return the mean of tr(D)/dim for psi applied to the length of a standard normal vector in R^dim."""
    # One component alone is not joined to anything: it counts as under grouping "component".
    if dim == 1:
        return expected_information(influence)
    return _under_chi(influence, dim)


def _under_normal(influence: Any) -> float:
    """Return E[psi'(e)] for e standard normal."""
    from scipy import stats

    return _integral(lambda e: influence.psi_deriv(e) * stats.norm.pdf(e), _corners(influence))


def _under_chi(influence: Any, dim: int) -> float:
    """Average psi' along the vector and psi(r)/r across it, each clipped to [0, 1] as the filter does."""
    from scipy import stats

    def share(r: np.ndarray) -> np.ndarray:
        along = np.clip(influence.psi_deriv(r), 0.0, 1.0)
        across = np.clip(influence.weights(r), 0.0, 1.0)
        return (along + (dim - 1) * across) / dim * stats.chi.pdf(r, dim)

    return _integral(share, _corners(influence), positive_only=True)


def _corners(influence: Any) -> tuple[float, ...]:
    """Return where psi' jumps, as far as the influence function tells."""
    return tuple(getattr(influence, "corners", ()))


def _integral(function: Any, corners: tuple[float, ...], positive_only: bool = False) -> float:
    """Integrate over the line, or its positive half, piece by piece between corners."""
    from scipy.integrate import quad

    inner = sorted({0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, *corners})
    edges = [*inner, np.inf]
    if not positive_only:
        edges = [-e for e in reversed(edges)][:-1] + edges
    return sum(
        quad(lambda e: float(function(np.array([e]))[0]), low, high, limit=200)[0] for low, high in pairwise(edges)
    )


_under_normal = lru_cache(maxsize=64)(_under_normal)
_under_chi = lru_cache(maxsize=64)(_under_chi)
