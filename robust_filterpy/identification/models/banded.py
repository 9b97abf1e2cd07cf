"""Responses with bands, of anything whose parameters have a covariance: the delta method, or sampled parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models.response_records import FrequencyResponse, NoiseSpectrum, StepResponse
from robust_filterpy.identification.models.uncertainty import bands

# What a row of parameters does, for each input: of shape (rows, n_inputs, points).
_Rows = Callable[[Array], Any]


class Banded:
    """Parameters theta with covariance P, of a model that was sampled every dt seconds."""

    theta: Any
    P: Any
    dt: float | None

    def _stable(self, theta: Array) -> bool:
        """Tell whether the way from the inputs to y is stable for other parameters."""
        raise NotImplementedError

    def _period(self, dt: Any) -> float:
        """Return the sampling period that was asked for, else that of the recording, else 1."""
        return (self.dt or 1.0) if dt is None else _checks.positive("dt", dt)

    def _frequencies(self, omega: ArrayLike, dt: Any) -> tuple[Array, float, Any]:
        """Return frequencies, shape (n,), the sampling period, and q^-1 at these frequencies; or raise."""
        w, period = np.atleast_1d(_checks.numbers("omega", omega)), self._period(dt)
        highest = np.pi / period
        if w.ndim != 1 or not w.size or not ((w >= 0.0) & (w <= highest * (1.0 + 1e-9))).all():
            raise ValueError(
                f"omega: expected frequencies of shape (n,) from 0 to pi/dt = {highest:.4g} rad/s, "
                f"got {_checks.described(w) if w.size != 1 else w.item()}"
            )
        return w, period, np.exp(-1j * period * w)

    def _banded_frequencies(self, of: _Rows, w: Array, period: float, level: float, rng: Any) -> FrequencyResponse:
        """Return a frequency response with its bands."""
        center = of(np.asarray(self.theta)[None])[0]
        divisor = np.where(center == 0.0, 1.0, center)

        def logarithm(thetas: Array) -> Array:
            # An input without coefficients does nothing for any theta.
            ratio = np.where(center == 0.0, 1.0, of(thetas) / divisor)
            return np.stack((np.log(np.abs(ratio)), np.angle(ratio)), axis=1)

        with np.errstate(divide="ignore", invalid="ignore"):
            low, high, sampled = bands(self._stable, self.theta, self.P, logarithm, level, rng)
        size, phase = np.abs(center), np.unwrap(np.angle(center), axis=-1)
        one = _squeezed
        return FrequencyResponse(
            w, one(center), one(size), one(size * np.exp(low[0])), one(size * np.exp(high[0])), one(phase),
            one(phase + low[1]), one(phase + high[1]), float(level), period, one(sampled.any(axis=0)),
        )  # fmt: skip

    def _banded_steps(self, of: _Rows, length: int, period: float, level: float, rng: Any) -> StepResponse:
        """Return a step response with its bands."""
        center = of(np.asarray(self.theta)[None])[0]
        low, high, sampled = bands(self._stable, self.theta, self.P, of, level, rng)
        one, time = _squeezed, period * np.arange(length, dtype=float)
        return StepResponse(time, one(center), one(center + low), one(center + high), float(level), one(sampled))

    def _banded_density(
        self, of: _Rows, size: Any, samples: Any, w: Array, period: float, level: float, rng: Any
    ) -> NoiseSpectrum:
        """Return a density, of which `of` gives the logarithm for rows [theta, logarithm of a factor of each R]."""
        # R is known as well as a variance from so many samples.
        spread = 2.0 / np.atleast_1d(samples)
        n, whole = len(self.theta), np.concatenate((self.theta, np.zeros(spread.size)))
        joint = np.diag(np.concatenate((np.zeros(n), spread)))
        joint[:n, :n] = self.P
        center = size * period * np.exp(of(whole[None])[0])
        low, high, sampled = bands(self._stable, whole, joint, of, level, rng)
        return NoiseSpectrum(w, center, center * np.exp(low), center * np.exp(high), float(level), period, sampled)


def _squeezed(rows: Any) -> Any:
    """Return the only row, where there is one input."""
    return rows[0] if len(rows) == 1 else rows
