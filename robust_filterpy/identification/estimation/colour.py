"""The colour of what a model leaves: an autoregression, its order by evidence (Schwarz, Annals of Statistics 6, 1978).

Slow noise explains what a step, a ramp or another parameter would explain, and leaves parameters less sure. So whatever
is held against residuals is held against these with a colour of their own, and standard deviations count it.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import lfilter

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.regressor import stabilised

__all__ = ["Colour", "colour_of", "evidence", "evidence_of_outputs"]

_MOST: Final = 20
_SAMPLES_EACH: Final = 20
# A residual beyond so many standard deviations of the ordinary ones tells the autoregression no more.
_CLIP: Final = 3.0


class Colour(NamedTuple):
    """What makes a signal white.

    Attributes
    ----------
    polynomial : ndarray, shape (order + 1,)
        Its coefficients from 1 on.
    gain : float
        How much likelier a normal signal is with it than white, less what Schwarz's criterion asks for the order.
    """

    polynomial: Array
    gain: float

    @property
    def response(self) -> Array:
        """The filter that makes this colour of white noise, by its impulse response of unit energy."""
        if self.polynomial.size == 1:
            return np.ones(1)
        h = lfilter([1.0], stabilised(self.polynomial), np.eye(1, 1000).ravel())
        return np.asarray(h[: np.flatnonzero(np.abs(h) > 1e-3 * np.abs(h).max())[-1] + 1] / np.linalg.norm(h))


def colour_of(signal: Array) -> Colour:
    """Return the colour of a signal without outliers."""
    most = min(_MOST, signal.size // _SAMPLES_EACH)
    if most < 1 or not signal.any():
        return Colour(np.ones(1), 0.0)
    lagged = sliding_window_view(signal, most + 1)[:, ::-1]
    triangle = np.asarray(np.linalg.qr(np.column_stack((lagged[:, 1:], lagged[:, 0])), mode="r"))
    shared = triangle[:, -1]
    left = np.maximum(np.cumsum(shared[::-1] ** 2)[::-1], 1e-12 * (shared @ shared))
    gains = 0.5 * len(lagged) * np.log(left[0] / left) - 0.5 * np.arange(most + 1) * np.log(len(lagged))
    order = int(gains.argmax())
    a = np.linalg.lstsq(triangle[:order, :order], shared[:order], rcond=None)[0]
    return Colour(np.concatenate(([1.0], -a)), float(gains[order]))


def evidence(noise: Noise, residual: Array, rows: Any) -> float:
    """Return the log-likelihood of residuals of an output with the colour that they have."""
    shown = residual[rows]
    alone = noise.log_likelihood(shown) + colour_of(np.where(rows, noise.psi(residual), 0.0)).gain
    reach = _CLIP * float(np.sqrt(np.mean(np.square(shown))))
    carried = colour_of(np.where(rows, np.clip(residual, -reach, reach), 0.0)).polynomial
    if carried.size == 1:
        return alone
    left = lfilter(carried, [1.0], np.where(rows, residual, 0.0))[rows]
    told = noise.settled(left)
    return max(alone, told.log_likelihood(left) - 0.5 * (carried.size - 1) * float(np.log(shown.size)))


def evidence_of_outputs(noise: tuple[Noise, ...], residual: Array, spans: Any) -> float:
    """Return the log-likelihood of what is left of several outputs in several recordings, with its colour."""
    parts = [(one, own[part]) for one, own in zip(noise, residual.T, strict=True) for part in spans]
    return sum(evidence(one, np.nan_to_num(e), ~np.isnan(e)) for one, e in parts if not np.isnan(e).all())
