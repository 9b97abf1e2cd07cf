"""Whether a tracker has lost its plant, judged by what its samples have in common."""

from __future__ import annotations

from typing import Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.dependence import SHARE, autocovariances, dependence, whitening_of
from robust_filterpy.influence.regression import mad_scale

__all__ = ["LostTrackerWarning", "Watch"]

# Samples that are judged together.
_WINDOW: Final = 200
# A filter that has clipped half of what it saw believes in another model than the data.
_LEAST_WEIGHT: Final = 0.5
# More steps than this share that leave the stable models come from a wrong structure or step.
_MOST_GUARDED: Final = 0.25
# A level beside which the scatter of the residuals is small is an offset.
_OFFSET: Final = 2.0
# Residuals are held against the past inputs in windows of so many samples, this many apart: a plant that changes is
# in the whole of one after their sum.
_SPAN: Final = 120
#: How often the tracker must let the watch judge.
PERIOD: Final = 40
# Of the autocovariances of ordinary residuals, how much each look renews.
_PACE: Final = 0.15
# R may follow noise that changes, not over this factor.
_WANDERING: Final = 1e4


class LostTrackerWarning(UserWarning):
    """A tracker that has stopped following its plant."""


class Watch:
    """Look at a tracker's samples, and find words for what is wrong with them, once."""

    def __init__(self) -> None:
        """Start with no samples."""
        self._weights, self._guard, self._residuals = np.zeros(0), np.zeros(0, dtype=int), np.zeros(0)
        self._followed: tuple[Array, Array] = np.zeros(0), np.zeros((0, 0))
        self._seen, self._covariances = 0, np.zeros(3)
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

    @property
    def waits(self) -> int:
        """After how many samples it looks whether residuals follow the inputs."""
        return PERIOD - self._seen % PERIOD

    def lost(self, residuals: Array, signals: Array) -> str:
        """Take in samples, at most `waits`, and return why the model is another plant's, in words; empty if it is not.

        Parameters
        ----------
        residuals : ndarray, shape (N,)
            Measured less predicted output, NaN where it is missing.
        signals : ndarray, shape (N, n_signals)
            Predictions and inputs: what a residual follows that does not come from noise.

        Returns
        -------
        str
        """
        before, columns = self._followed
        kept = np.concatenate((before, residuals))[-_SPAN:]
        rows = np.concatenate((columns.reshape(before.size, -1), signals)) if before.size else signals
        self._followed, self._seen = (kept, rows[-_SPAN:]), self._seen + residuals.size
        if self._seen % PERIOD or kept.size < _SPAN:
            return ""
        now = autocovariances(kept)
        usual = self._covariances if self._covariances[0] > 0.0 else now
        found = dependence(kept, rows[-_SPAN:], whitening=whitening_of(usual))
        if not found.found:
            # What is ordinary follows slowly, and not what is half suspicious already.
            if found.share < 0.5 * SHARE or not self._covariances[0]:
                self._covariances = usual + _PACE * (now - usual)
            return ""
        return (
            f"the plant is no longer the model's: over the last {_SPAN} samples {100 * float(found.share):.0f} % of "
            "the residuals' variance follow the inputs (a gain, sign or pole has changed, or the sensor is stuck)"
        )

    def window(self, n_signals: int) -> tuple[Array, Array]:
        """Return what `lost` stands on, for a state.

        Parameters
        ----------
        n_signals : int
            Number of signals.

        Returns
        -------
        numbers : ndarray, shape (4,)
            Samples seen, and the autocovariances of ordinary residuals.
        rows : ndarray, shape (L, 1 + n_signals)
            The last residuals, and the signals of the same samples.
        """
        residuals, signals = self._followed
        rows = np.column_stack((residuals, signals)) if residuals.size else np.zeros((0, 1 + n_signals))
        return np.array([self._seen, *self._covariances]), rows

    def go_on(self, numbers: Array, rows: Array) -> None:
        """Take over what `window` returned; samples of before are forgotten, not what was said of them.

        Parameters
        ----------
        numbers : ndarray, shape (1 or more,)
            As returned: how many samples were seen, and what was kept beside.
        rows : ndarray, shape (N, 1 or more)
            As returned: residuals and inputs of the window.
        """
        said = self._spoken, self._spoken_of_start
        self.__init__()  # type: ignore[misc]
        self._spoken, self._spoken_of_start = said
        self._seen, self._covariances = int(numbers[0]), numbers[1:].copy()
        self._followed = rows[:, 0].copy(), rows[:, 1:].copy()

    def forget(self) -> None:
        """Begin anew with no samples, for another model."""
        spoken = self._spoken_of_start
        self.__init__()  # type: ignore[misc]
        self._spoken_of_start = spoken

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
