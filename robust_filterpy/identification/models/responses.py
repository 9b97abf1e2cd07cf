"""How sure a model is of its responses and of its poles and zeros, from the covariance of its parameters."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.signal import lfilter

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models.guard import is_stable
from robust_filterpy.identification.models.response_records import FrequencyResponse, NoiseSpectrum, StepResponse
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.models.uncertainty import Regions, bands, regions

__all__ = ["Responses"]


class Responses:
    """What anything with a structure, theta and P tells of its responses: a `Model`, a `ParameterTracker`."""

    structure: Structure
    theta: Any
    P: Any
    R: Any
    dt: float | None

    def _period(self, dt: Any) -> float:
        """Return the sampling period that was asked for, else that of the recording, else 1."""
        return (self.dt or 1.0) if dt is None else _checks.positive("dt", dt)

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
        w, period = _frequencies(omega, self._period(dt))
        delays = np.exp(-1j * period * w)
        center = _transfer(self.structure, np.asarray(self.theta)[None], delays)[0]
        divisor = np.where(center == 0.0, 1.0, center)

        def logarithm(thetas: Array) -> Array:
            # An input without coefficients does nothing for any theta.
            ratio = np.where(center == 0.0, 1.0, _transfer(self.structure, thetas, delays) / divisor)
            return np.stack((np.log(np.abs(ratio)), np.angle(ratio)), axis=1)

        with np.errstate(divide="ignore", invalid="ignore"):
            band = bands(self._stable, self.theta, self.P, logarithm, level, rng)
        (small, left), (large, right) = band[0], band[1]
        phase = np.unwrap(np.angle(center), axis=-1)
        size = np.abs(center)
        sampled = band[2].any(axis=0)
        values = (
            center, size, size * np.exp(small), size * np.exp(large), phase, phase + left, phase + right, sampled
        )  # fmt: skip
        response, middle, lowest, highest, angle, least, most, curved = (_squeezed(value) for value in values)
        return FrequencyResponse(
            w, response, middle, lowest, highest, angle, least, most, float(level), period, curved
        )  # fmt: skip

    def step_response(
        self, steps: int = 50, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> StepResponse:
        """Return what y does after a unit step of each input, with bands.

        Parameters
        ----------
        steps : int, default 50
            How many samples.
        level : float, default 0.95
            Probability of the band at each time.
        dt : float, optional
            Sampling period in s. Default: that of the recording, if its index told it, else 1.
        rng : numpy.random.Generator or int, optional
            For bands by sampling, where the delta method fails.

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

        def steps_of(thetas: Array) -> Array:
            return np.array([_steps(self.structure, theta, length) for theta in thetas])

        lower, upper, sampled = bands(self._stable, self.theta, self.P, steps_of, level, rng)
        center = _steps(self.structure, np.asarray(self.theta), length)
        values = (_squeezed(value) for value in (center, center + lower, center + upper))
        response, lowest, highest = values
        return StepResponse(
            period * np.arange(length, dtype=float), response, lowest, highest, float(level), _squeezed(sampled)
        )  # fmt: skip

    def noise_spectrum(
        self, omega: ArrayLike, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> NoiseSpectrum:
        """Return the power spectral density of what the ordinary noise does to y, with bands.

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
        NoiseSpectrum

        Raises
        ------
        ValueError
            If a frequency, level or dt does not fit.
        """
        w, period = _frequencies(omega, self._period(dt))
        delays, places = np.exp(-1j * period * w), self.structure.polynomials
        # R is known as well as a variance from so many samples.
        n, spread = len(self.theta), 2.0 / self._noise_samples
        joint = np.zeros((n + 1, n + 1))
        joint[:n, :n], joint[n, n] = self.P, spread

        def logarithm(thetas: Array) -> Array:
            c, a, d = (_at(thetas, part, delays) for part in (places.c, places.a, places.d))
            return 2.0 * (np.log(np.abs(c)) - np.log(np.abs(a)) - np.log(np.abs(d))) + thetas[:, n:]

        whole = np.append(self.theta, 0.0)
        center = self.R * period * np.exp(logarithm(whole[None])[0])
        lower, upper, sampled = bands(self._stable, whole, joint, logarithm, level, rng)
        return NoiseSpectrum(w, center, center * np.exp(lower), center * np.exp(upper), float(level), period, sampled)

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
        places = self.structure.polynomials

        def poles(theta: Array) -> Array:
            return np.concatenate([np.roots([1.0, *theta[part]]) for part in (places.a, places.f)])

        return regions(np.asarray(self.theta), np.asarray(self.P), poles, level, rng)

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


def _steps(structure: Structure, theta: Array, length: int) -> Array:
    """Return the step responses, shape (n_inputs, length)."""
    places = structure.polynomials
    a, f = (np.concatenate(([1.0], theta[part])) for part in (places.a, places.f))
    denominator = np.convolve(a, f)
    ways = [
        lfilter(np.concatenate((np.zeros(nk), theta[place], np.zeros(int(not nb)))), denominator, np.ones(length))
        for place, (nb, nk) in zip(places.b, structure.inputs, strict=True)
    ]
    return np.array(ways)


def _squeezed(rows: Any) -> Any:
    """Return the only row, where there is one input."""
    return rows[0] if len(rows) == 1 else rows


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


def _frequencies(omega: ArrayLike, period: float) -> tuple[Array, float]:
    """Return frequencies, shape (n,), and the sampling period, or raise."""
    w = np.atleast_1d(_checks.numbers("omega", omega))
    highest = np.pi / period
    if w.ndim != 1 or not w.size or not ((w >= 0.0) & (w <= highest * (1.0 + 1e-9))).all():
        raise ValueError(
            f"omega: expected frequencies of shape (n,) from 0 to pi/dt = {highest:.4g} rad/s, "
            f"got {_checks.described(w) if w.size != 1 else w.item()}"
        )
    return w, period
