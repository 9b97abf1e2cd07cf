"""Responses with their bands, as arrays, tables and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from robust_filterpy._brief import brief, wrapped
from robust_filterpy._checks import Array
from robust_filterpy._pictures import Pictured
from robust_filterpy.identification.models.time_axis import table

if TYPE_CHECKING:
    import control


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse(Pictured):
    """Frequency response from each input to y, with pointwise bands.

    Attributes
    ----------
    omega : ndarray, shape (n,)
        Frequencies in rad/s.
    response : ndarray of complex, shape (n,) or (n_inputs, n)
        B/A or B/F at exp(i omega dt).
    magnitude, magnitude_lower, magnitude_upper : ndarray, shape of response
        Its size and band.
    phase, phase_lower, phase_upper : ndarray, shape of response
        Its angle in rad, unwrapped, and band.
    level : float
        Probability of each band.
    dt : float
        Sampling period in s.
    sampled : ndarray of bool, shape of response
        Where the bands are those of sampled parameters, since the delta method fails.
    """

    picture = "responses.plot_bode"

    omega: Array
    response: Any
    magnitude: Array
    magnitude_lower: Array
    magnitude_upper: Array
    phase: Array
    phase_lower: Array
    phase_upper: Array
    level: float
    dt: float
    sampled: Any

    def __repr__(self) -> str:
        """Show the ends of the response, each magnitude with its band."""
        size, low, high = (np.atleast_2d(a) for a in (self.magnitude, self.magnitude_lower, self.magnitude_upper))
        ends = [
            f"|G| = {size[i, k]:.3g} ({low[i, k]:.3g} .. {high[i, k]:.3g}) at {self.omega[k]:.3g} rad/s"
            for i in range(len(size))
            for k in sorted({0, self.omega.size - 1})
        ]
        return f"FrequencyResponse({self.omega.size} frequencies, {_percent(self.level)} bands: {', '.join(ends)})"

    def __str__(self) -> str:
        """Return the same on lines that a screen holds."""
        return wrapped(repr(self))

    def to_frame(self) -> Any:
        """Return the response and its bands as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            A row for each frequency: magnitude and phase with their bands; of several inputs each by its number.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        names = ("magnitude", "magnitude_lower", "magnitude_upper", "phase", "phase_lower", "phase_upper")
        return _frame(self, names, self.omega, "omega")

    def to_control(self) -> control.FrequencyResponseData:
        """Return the response for python-control.

        Returns
        -------
        control.FrequencyResponseData
            One output and as many inputs as the model has.
        """
        import control

        return control.FrequencyResponseData(np.atleast_2d(self.response)[None], self.omega, self.dt)


@dataclass(frozen=True, eq=False, repr=False)
class StepResponse(Pictured):
    """What y does after a unit step of each input, with pointwise bands.

    Attributes
    ----------
    time : ndarray, shape (n,)
        Time in s from the step on.
    response, lower, upper : ndarray, shape (n,) or (n_inputs, n)
        Output without its level, and band.
    level : float
        Probability of each band.
    sampled : ndarray of bool, shape of response
        Where the bands are those of sampled parameters.
    """

    picture = "responses.plot_step"

    time: Array
    response: Array
    lower: Array
    upper: Array
    level: float
    sampled: Any

    def __repr__(self) -> str:
        """Show where the response ends, with its band."""
        ends = [np.atleast_2d(a)[:, -1] for a in (self.response, self.lower, self.upper)]
        text = ", ".join(f"{value:.3g} ({low:.3g} .. {high:.3g})" for value, low, high in zip(*ends, strict=True))
        return f"StepResponse({self.time.size} samples, {_percent(self.level)} bands: {text} at {self.time[-1]:.3g} s)"

    def to_frame(self) -> Any:
        """Return the response and its band as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            A row for each time: response, lower, upper; of several inputs each by its number.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        return _frame(self, ("response", "lower", "upper"), self.time, "time")


@dataclass(frozen=True, eq=False)
class NoiseSpectrum(Pictured):
    """Power spectral density of what the noise does to y, with pointwise bands.

    Attributes
    ----------
    omega : ndarray, shape (n,)
        Frequencies in rad/s.
    density, lower, upper : ndarray, shape (n,)
        R \\|C/(A D)\\|^2 dt, in units of y squared per Hz, two-sided, outliers left out; and band.
    level : float
        Probability of each band.
    dt : float
        Sampling period in s.
    sampled : ndarray of bool, shape (n,)
        Where the bands are those of sampled parameters.
    """

    picture = "responses.plot_noise_spectrum"

    omega: Array
    density: Array
    lower: Array
    upper: Array
    level: float
    dt: float
    sampled: Any

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)

    def to_frame(self) -> Any:
        """Return the density and its band as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            A row for each frequency: density, lower, upper.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        return _frame(self, ("density", "lower", "upper"), self.omega, "omega")


def _frame(response: Any, names: tuple[str, ...], index: Array, label: str) -> Any:
    """Return fields of a response as a table; those of several inputs with the number of each."""
    columns: dict[str, Array] = {}
    for name in names:
        rows = np.atleast_2d(getattr(response, name))
        columns |= {name if len(rows) == 1 else f"{name}[{i}]": row for i, row in enumerate(rows)}
    return table(columns, index, label)


def _percent(level: float) -> str:
    """Return a probability as a message shows it."""
    return f"{100.0 * level:.4g} %"
