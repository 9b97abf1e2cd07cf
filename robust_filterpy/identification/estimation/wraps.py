"""An output that leaves its range at one end and comes back at the other: an angle, a counter, an integer too small."""

from __future__ import annotations

from typing import Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.estimation.estimate import Problem
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.results import Finding

__all__ = ["with_wraps", "wraps"]

# A jump goes over so much of the range, its neighbours over no more than the other, and the model misses so much of it.
_JUMP: Final = 0.7
_QUIET: Final = 0.4
_MISSED: Final = 0.3
# So many are no accident, in which most are missed. Of outliers beside a plant that swings some look like it in many.
_FEWEST: Final = 4
_ACCIDENTS: Final = 1 / 5000
_MOST: Final = 0.5


def with_wraps(problem: Problem, y: Array, model: Model) -> tuple[Finding, ...]:
    """Find out whether an output wraps round."""
    return wraps(y, model.residuals(y, problem.u)) if model.structure.n_inputs else ()


def wraps(y: Array, residual: Array) -> tuple[Finding, ...]:
    """Find out whether an output wraps round, from what any model leaves of it."""
    low, high = np.nanquantile(y, [0.005, 0.995])
    size = float(high - low)
    if not size > 0.0 or y.size < 4:
        return ()
    change = np.abs(np.nan_to_num(np.diff(y), nan=np.inf)) / size
    within = (y >= low - 0.02 * size) & (y <= high + 0.02 * size)
    alone = (change[1:-1] > _JUMP) & (change[:-2] < _QUIET) & (change[2:] < _QUIET) & within[1:-2] & within[2:-1]
    at = np.flatnonzero(alone) + 2
    if at.size < max(_FEWEST, _ACCIDENTS * y.size):
        return ()
    # A plant that switches jumps too, and its model with it.
    missed = np.abs(np.nan_to_num(residual[at])) > _MISSED * size
    if missed.sum() < _FEWEST or missed.mean() < _MOST:
        return ()
    text = (
        f"y jumps {at.size} times from one end of its range, {low:.4g} to {high:.4g}, to the other and stays there, "
        "which the model does not: an angle or a counter that wraps? numpy.unwrap(y, period=..) first"
    )
    return (Finding("wraps", text, float("nan"), (int(at[0]), int(at[-1]) + 1)),)
