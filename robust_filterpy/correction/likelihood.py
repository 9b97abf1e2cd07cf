"""The log-likelihood of an innovation under the density that psi is made for, by the chain rule."""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.standardization import group_scaling

__all__ = ["log_density_of_group"]

_LARGEST = sys.float_info.max
# What one group costs at most, so that the sum over all is a number.
_COSTLIEST = 1e300


def log_density_of_group(y: Array, S: Array, choices: Any) -> float:
    """Return log f(S^(-1/2) y) + log det S^(-1/2) of one group of sensors, given those before it."""
    # f(e) is proportional to exp(-rho(e)): normal for an infinite threshold, linear in |e| beyond a finite one. It is
    # standardized by the nominal S^(-1/2), whatever the scaling of the filter and whatever it learned, so that filters
    # with different models can be compared by it.
    # An influence function without a density of its own (redescending, or somebody else's) has f(e) =
    # exp(-rho(e))/sqrt(2 pi), which does not integrate to 1.
    k = len(y)
    T = group_scaling(S, "innovation")
    e = np.clip(T @ y, -_LARGEST, _LARGEST)
    peak = float(np.abs(e).max())
    length = min(peak * float(np.linalg.norm(e / peak)), _LARGEST) if peak > 0.0 else 0.0
    loss = choices.rho_of(length)
    normalizer = getattr(choices.influence, "log_normalizer", None)
    constant = 0.5 * k * math.log(2.0 * math.pi) if normalizer is None else normalizer(k)
    return float(np.log(T.diagonal()).sum()) - min(loss, _COSTLIEST) - constant
