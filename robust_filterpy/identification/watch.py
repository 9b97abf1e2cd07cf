"""Whether a tracker has lost its plant, judged by what its samples have in common."""

from __future__ import annotations

from typing import Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.learnt_noise import mad_scale

__all__ = ["LostTrackerWarning", "Watch"]

# Samples that are judged together.
_WINDOW: Final = 200
# A filter that has clipped half of what it saw believes in another model than the data.
_LEAST_WEIGHT: Final = 0.5
# More steps than this share that leave the stable models come from a wrong structure or step.
_MOST_GUARDED: Final = 0.25
# A level beside which the scatter of the residuals is small is an offset.
_OFFSET: Final = 2.0
# R may follow noise that changes, not over this factor.
_WANDERING: Final = 1e4


class LostTrackerWarning(UserWarning):
    """A tracker that has stopped following its plant."""


class Watch:
    """Look at a tracker's samples, and find words for what is wrong with them, once."""

    def __init__(self) -> None:
        """Start with no samples."""
        self._weights, self._guard, self._residuals = np.zeros(0), np.zeros(0, dtype=int), np.zeros(0)
        self._R: float | None = None
        self._spoken = self._spoken_of_start = False

    def see(self, weights: Array, guard: np.ndarray, residuals: Array, R: float, has_offset: bool) -> str:
        """Take in samples and return what is wrong, in words; empty if nothing is, or it has been said.

        Parameters
        ----------
        weights, guard, residuals : ndarray, shape (N,)
            Columns of a `TrackingResult`.
        R : float
            Variance of the ordinary noise after them.
        has_offset : bool
            Whether the model has a constant.

        Returns
        -------
        str
        """
        if self._spoken:
            return ""
        self._weights = np.append(self._weights, weights)
        self._guard = np.append(self._guard, guard)
        self._residuals = np.append(self._residuals, residuals)
        while self._weights.size >= _WINDOW:
            weights, guard, residuals = (a[:_WINDOW] for a in (self._weights, self._guard, self._residuals))
            said = self._judged(weights, guard, residuals, R, has_offset)
            self._weights, self._guard = self._weights[_WINDOW:], self._guard[_WINDOW:]
            self._residuals = self._residuals[_WINDOW:]
            if said:
                self._spoken = True
                return said
        return ""

    def without_model(self, trouble: str) -> str:
        """Return why the start has found no model; empty if that has been said.

        Parameters
        ----------
        trouble : str
            The reason.

        Returns
        -------
        str
        """
        said, self._spoken_of_start = "" if self._spoken_of_start else trouble, True
        return said

    def _judged(self, weights: Array, guard: np.ndarray, residuals: Array, R: float, has_offset: bool) -> str:
        """Say what is wrong with a window."""
        known = ~np.isnan(weights)
        if known.sum() < _WINDOW // 2:
            return ""
        self._R = R if self._R is None else self._R
        level = float(np.median(residuals[known]))
        scatter = mad_scale(residuals[known] - level)
        if not has_offset and abs(level) > _OFFSET * scatter:
            return f"the residuals lie {level:.3g} off zero with a scatter of {scatter:.2g}: use offset=True"
        weight = float(weights[known].mean())
        if weight < _LEAST_WEIGHT:
            return (
                f"of {_WINDOW} samples in a row the mean weight was {weight:.2f}: the filter takes ordinary samples "
                f"for outliers, since R={R:.3g} is too small or theta has not followed the plant; leave R out, let "
                "theta move (Q, forgetting), or start anew"
            )
        if (guard != 0).mean() > _MOST_GUARDED:
            return (
                f"{100 * (guard != 0).mean():.0f} % of {_WINDOW} steps would have made the model unstable: the "
                "structure does not fit, or P and Q allow steps that are too large"
            )
        if not 1.0 / _WANDERING < R / self._R < _WANDERING:
            return f"R went from {self._R:.3g} to {R:.3g}: theta does not follow the plant, or the sensor has changed"
        return ""
