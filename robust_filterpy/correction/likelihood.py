"""The log-likelihood of an innovation under the density that psi is made for."""

from __future__ import annotations

import math
import sys

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices, length_and_direction
from robust_filterpy.correction.whitening import Inverse, standardize, standardized

_DEFAULT = Choices()
_LARGEST = sys.float_info.max
_EPS = sys.float_info.epsilon


@np.errstate(all="ignore")
def log_density(y: Array, S: Array, choices: Choices = _DEFAULT, inv: Inverse | None = None) -> float:
    """Return the log-likelihood of an innovation: log f(S^(-1/2) y) + log det S^(-1/2).

    f(e) is proportional to exp(-rho(e)), so it is normal for an infinite threshold and linear in \\|e\\| beyond a
    finite one. It is standardized by S^(-1/2) whatever the scaling of the filter.

    Parameters
    ----------
    y : ndarray, shape (m,)
        Innovation; NaN marks a missing component.
    S : ndarray, shape (m, m)
        Innovation covariance.
    choices : Choices
        Influence function and grouping.
    inv : callable, optional
        What inverts S; where that leaves out directions, so does the likelihood.

    Returns
    -------
    float
        0 if every component is missing: such a sample tells no model from another.

    Raises
    ------
    SingularInnovationError
        If S is not positive definite and inv is not given.

    Notes
    -----
    An influence function without a density of its own (redescending, or somebody else's) has f(e) =
    exp(-rho(e))/sqrt(2 pi), which does not integrate to 1.
    """
    observed = np.flatnonzero(y == y)
    if observed.size == 0:
        return 0.0
    if observed.size < y.size:
        y, S = y[observed], S[np.ix_(observed, observed)]
    T, SI, _ = standardize(S, "innovation", inv)
    rank, log_det = observed.size, -np.linalg.slogdet(T)[1]
    if SI is not None:
        values = np.linalg.eigvalsh(0.5 * (SI + SI.T))
        values = values[values > values.size * _EPS * values[-1]]
        rank, log_det = values.size, -0.5 * float(np.log(values).sum())
    e = standardized(T, y)
    return _log_standard_density(e, rank, choices) - float(log_det)


def _log_standard_density(e: Array, rank: int, choices: Choices) -> float:
    """Return log f(e), component by component or of the length."""
    normalizer = getattr(choices.influence, "log_normalizer", lambda dim: 0.5 * dim * math.log(2.0 * math.pi))
    if choices.grouping == "component":
        losses = choices.evaluated("rho", e)
        total = float(np.minimum(losses, 0.5 * _LARGEST / e.size).sum())
        return -total - rank * normalizer(1)
    length, _ = length_and_direction(e)
    return -min(choices.evaluated("rho", np.array([length])).item(), _LARGEST) - normalizer(rank)
