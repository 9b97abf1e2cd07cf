"""How sure a model is of its responses and of its poles and zeros, from the covariance of its parameters."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models import regressor as coefficients
from robust_filterpy.identification.models.banded import Banded
from robust_filterpy.identification.models.regressor import is_stable
from robust_filterpy.identification.models.response_records import FrequencyResponse, NoiseSpectrum, StepResponse
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.models.uncertainty import Regions, regions


class Responses(Banded):
    """What anything with a structure, theta and P tells of its responses: a `Model`, a `ParameterTracker`."""

    structure: Structure
    R: Any

    @property
    def _noise_samples(self) -> float:
        """How many samples R stands on."""
        return np.inf

    def _stable(self, theta: Array) -> bool:
        """Tell whether the way from the inputs to y is stable for other parameters."""
        places = self.structure.polynomials
        return all(is_stable(theta[part].tolist()) for part in (places.a, places.f))

    def frequency_response(
        self, omega: ArrayLike, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> FrequencyResponse:
        """Return the frequency response from the inputs to y, with bands.

        Parameters
        ----------
        omega : array_like, shape (n,)
            Frequencies in rad/s, in [0, pi/dt].
        level : float, default 0.95
            Probability of the band at each frequency.
        dt : float, optional
            Sampling period in s. Default: that of the recording, if its index told it, else 1.
        rng : numpy.random.Generator or int, optional
            For bands by sampling, where the delta method fails.

        Returns
        -------
        FrequencyResponse

        Raises
        ------
        ValueError
            If there is no input, or a frequency, level or dt does not fit.

        Examples
        --------
        >>> import numpy as np
        >>> from robust_filterpy.identification import FIR, identify
        >>> u = np.random.default_rng(1).choice([-1.0, 1.0], 200)
        >>> y = np.concatenate(([0.0], 2.0 * u[:-1])) + 0.1 * np.random.default_rng(2).normal(size=200)
        >>> found = identify(y, u, FIR(1)).frequency_response([0.1])
        >>> bool(found.magnitude_lower[0] < 2.0 < found.magnitude_upper[0])
        True
        """
        _require_input(self.structure, "frequency response; noise_spectrum(omega) has that of the noise")
        w, period, delays = self._frequencies(omega, dt)
        return self._banded_frequencies(lambda rows: _transfer(self.structure, rows, delays), w, period, level, rng)

    def step_response(
        self, steps: int = 50, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> StepResponse:
        """Return what y does after a unit step of each input, with bands.

        Parameters
        ----------
        steps : int, default 50
            How many samples.
        level, dt, rng
            As in `frequency_response`.

        Returns
        -------
        StepResponse

        Raises
        ------
        ValueError
            If there is no input, or steps, level or dt does not fit.
        """
        _require_input(self.structure, "step response")
        length, period = _checks.count("steps", steps, 1), self._period(dt)
        return self._banded_steps(lambda rows: _steps(self.structure, rows, length), length, period, level, rng)

    def noise_spectrum(
        self, omega: ArrayLike, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> NoiseSpectrum:
        """Return the power spectral density of what the ordinary noise does to y, with bands.

        Parameters
        ----------
        omega, level, dt, rng
            As in `frequency_response`.

        Returns
        -------
        NoiseSpectrum

        Raises
        ------
        ValueError
            If a frequency, level or dt does not fit.
        """
        (w, period, delays), places = self._frequencies(omega, dt), self.structure.polynomials
        n = len(self.theta)

        def logarithm(thetas: Array) -> Array:
            c, a, d = (_at(thetas, part, delays) for part in (places.c, places.a, places.d))
            return 2.0 * (np.log(np.abs(c)) - np.log(np.abs(a)) - np.log(np.abs(d))) + thetas[:, n:]

        return self._banded_density(logarithm, self.R, self._noise_samples, w, period, level, rng)

    def poles(self, level: float = 0.95, rng: Any = None) -> Regions:
        """Return the poles, the roots of A or F, with regions.

        Parameters
        ----------
        level : float, default 0.95
            Probability of each region.
        rng : numpy.random.Generator or int, optional
            For regions by sampling, where the delta method fails.

        Returns
        -------
        Regions

        Raises
        ------
        ValueError
            If the regressor is the caller's, or level is no probability.
        """
        _require_polynomials(self.structure)
        roots = partial(coefficients.poles, self.structure)
        return regions(np.asarray(self.theta), np.asarray(self.P), roots, level, rng)

    def zeros(self, level: float = 0.95, rng: Any = None, input: int = 0) -> Regions:
        """Return the zeros of the way from one input to y, the roots of its B, with regions.

        Parameters
        ----------
        level : float, default 0.95
            Probability of each region.
        rng : numpy.random.Generator or int, optional
            For regions by sampling, where the delta method fails.
        input : int, default 0
            Which input.

        Returns
        -------
        Regions

        Raises
        ------
        ValueError
            If there is no such input, the regressor is the caller's, or level is no probability.
        """
        _require_input(self.structure, "zeros")
        if _checks.count("input", input, 0) >= self.structure.n_inputs:
            raise ValueError(f"input: expected 0 to {self.structure.n_inputs - 1} for {self.structure}, got {input}")
        part = self.structure.polynomials.b[input]
        return regions(np.asarray(self.theta), np.asarray(self.P), lambda t: np.roots(t[part]), level, rng)


# Properties of theta.


def _at(thetas: Array, part: slice, delays: Any) -> Any:
    """Return 1 + c_1 q^-1 + .. of each row of theta at each q^-1."""
    n = part.stop - part.start
    return 1.0 + thetas[:, part] @ delays[None] ** np.arange(1, n + 1)[:, None]


def _transfer(structure: Structure, thetas: Array, delays: Any) -> Any:
    """Return B/A or B/F of each row of theta, shape (m, n_inputs, n)."""
    places = structure.polynomials
    denominator = _at(thetas, places.a, delays) * _at(thetas, places.f, delays)
    ways = [
        thetas[:, place] @ delays[None] ** (nk + np.arange(nb))[:, None] / denominator
        for place, (nb, nk) in zip(places.b, structure.inputs, strict=True)
    ]
    return np.stack(ways, axis=1)


def _steps(structure: Structure, thetas: Array, length: int) -> Array:
    """Return the step responses of each row of theta, shape (m, n_inputs, length)."""
    found, orders = np.empty((len(thetas), structure.n_inputs, length)), structure.inputs
    for row, theta in zip(found, thetas, strict=True):
        denominator = coefficients.denominator(structure, theta)
        for i, (place, (nb, nk)) in enumerate(zip(structure.polynomials.b, orders, strict=True)):
            numerator = np.concatenate((np.zeros(nk), theta[place], np.zeros(int(not nb))))
            row[i] = lfilter(numerator, denominator, np.ones(length))
    return found


# Checks.


def _require_input(structure: Structure, what: str) -> None:
    """Raise unless there is an input."""
    _require_polynomials(structure)
    if not structure.inputs:
        raise ValueError(f"{structure}: expected a model with an input, this one has no {what}")


def _require_polynomials(structure: Structure) -> None:
    """Raise unless the parameters are those of polynomials."""
    if structure.takes_phi:
        raise ValueError(f"{structure}: expected a model with polynomials, this one has a regressor of the caller's")
