"""Responses, poles and zeros with bands and regions, and how these follow from the covariance of parameters.

A property h(theta) is looked at in theta and one standard deviation s_i to both sides along each principal axis of P.
Half the differences are the delta method's standard deviation, sigma^2 = sum ((h(theta + s_i) - h(theta - s_i)) / 2)^2.
Where the curvature (h(theta + s_i) + h(theta - s_i)) / 2 - h(theta) adds up to more than a share of sigma (next to the
unit circle, at a resonance, at a double pole), the distribution of theta is sampled instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2, norm

from robust_filterpy import _checks
from robust_filterpy._brief import Pictured, brief, wrapped
from robust_filterpy._checks import Array
from robust_filterpy.identification.models.signals import table

if TYPE_CHECKING:
    import control

# Curvature of more than this share of a standard deviation is sampled.
_CURVED: Final = 0.2
_SAMPLES: Final = 2000
# An axis of an ellipse as thin as this, relative to its center, has no width.
_THIN: Final = 1e-7


@dataclass(frozen=True, eq=False, repr=False)
class Regions:
    """Poles or zeros with elliptic regions; those of a real one are intervals.

    Attributes
    ----------
    values : ndarray of complex, shape (k,)
        Poles or zeros.
    covariance : ndarray, shape (k, 2, 2)
        Shape of each region: of the real and the imaginary part.
    radius : ndarray, shape (k,)
        Distance of the boundary from the center in units of the covariance, by Mahalanobis.
    level : float
        Probability of each region.
    sampled : ndarray of bool, shape (k,)
        Which regions are those of sampled parameters.
    """

    values: Any
    covariance: Array
    radius: Array
    level: float
    sampled: Any

    @property
    def std(self) -> Array:
        """Standard deviations of the real and the imaginary part, shape (k, 2)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))

    def __repr__(self) -> str:
        """Show each value with the standard deviation of its real part, and of its imaginary part if it has one."""
        parts = [
            f"{value.real:.4g}+-{s[0]:.2g}" + (f" {value.imag:+.4g}i+-{s[1]:.2g}" if value.imag else "")
            for value, s in zip(self.values, self.std, strict=True)
        ]
        return f"Regions({', '.join(parts)})"

    def to_frame(self) -> Any:
        """Return the values and how sure they are as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            A row for each value: real, imag, std_real, std_imag.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        real, imag = self.std.T
        return table({"real": self.values.real, "imag": self.values.imag, "std_real": real, "std_imag": imag})

    def ellipses(self, points: int = 73) -> Any:
        """Return the boundaries of the regions.

        Parameters
        ----------
        points : int, default 73
            How many points each has.

        Returns
        -------
        ndarray of complex, shape (k, points)
        """
        angles = np.linspace(0.0, 2.0 * np.pi, _checks.count("points", points, 3))
        circle = np.stack((np.cos(angles), np.sin(angles)))
        boundaries = np.empty((self.values.size, angles.size), dtype=complex)
        for k, covariance in enumerate(self.covariance):
            sizes, axes = np.linalg.eigh(covariance)
            x, y = self.radius[k] * (axes * np.sqrt(np.maximum(sizes, 0.0))) @ circle
            boundaries[k] = self.values[k] + x + 1j * y
        return boundaries

    def contains(self, others: ArrayLike) -> Any:
        """Tell which of other poles or zeros, in the order of these, lie in the regions.

        Parameters
        ----------
        others : array_like of complex, shape (k,)
            Such as those of the true plant.

        Returns
        -------
        ndarray of bool, shape (k,)
        """
        difference = np.asarray(others, dtype=complex) - self.values
        inside = np.empty(self.values.size, dtype=bool)
        for k, covariance in enumerate(self.covariance):
            inside[k] = _distance(difference[k], covariance, abs(self.values[k])) <= self.radius[k]
        return inside


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

    __str__ = brief

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


def bands(
    is_inside: Callable[[Array], bool], theta: Any, P: Any, h: Callable[[Array], Array], level: float, rng: Any
) -> tuple[Array, Array, Any]:
    """Return the band of h(theta) about its value."""
    theta, z = np.asarray(theta), float(norm.ppf(0.5 + 0.5 * probability(level)))
    center = h(theta[None])[0]
    steps = principal_axes(np.asarray(P))
    ahead, behind = h(theta + steps), h(theta - steps)
    std = np.sqrt(np.sum((0.5 * (ahead - behind)) ** 2, axis=0))
    curvature = np.abs(0.5 * (ahead + behind) - center).sum(axis=0)
    lower, upper = -z * std, z * std
    # Where a step has left the stable models, or is infinite, curvature is no number.
    stable = all(is_inside(row) for row in (*(theta + steps), *(theta - steps)))
    # What has no variance has no more than rounding.
    rounding = 1e-12 * np.abs(center) + 1e-9 * std.max(initial=0.0)
    curved = ~(curvature <= _CURVED * std + rounding) if stable else np.ones(center.shape, dtype=bool)
    if curved.any():
        drawn = _drawn(theta, steps, rng)
        inside = np.array([is_inside(row) for row in drawn])
        # Of a model that is itself unstable all are.
        values = h(drawn[inside] if inside.any() else drawn) - center
        ends = np.nanquantile(values, [0.5 - 0.5 * level, 0.5 + 0.5 * level], axis=0)
        lower, upper = np.where(curved, ends[0], lower), np.where(curved, ends[1], upper)
    return lower, upper, curved


def regions(theta: Array, P: Array, roots: Callable[[Array], Any], level: float, rng: Any) -> Regions:
    """Return roots that theta determines, with their regions."""
    level = probability(level)
    values, steps = roots(theta), principal_axes(P)
    ahead, behind = (np.array([_matched(values, roots(row)) for row in theta + sign * steps]) for sign in (1.0, -1.0))
    if not values.size:
        return Regions(values, np.zeros((0, 2, 2)), np.zeros(0), level, np.zeros(0, dtype=bool))
    half = _plane(0.5 * (ahead - behind))
    covariance = np.einsum("ika,ikb->kab", half, half)
    curvature = np.abs(0.5 * (ahead + behind) - values).sum(axis=0)
    curved = ~(curvature <= _CURVED * np.sqrt(np.trace(covariance, axis1=1, axis2=2)) + 1e-12 * np.abs(values))
    flat = np.array(
        [np.linalg.eigvalsh(c)[0] <= (_THIN * abs(v)) ** 2 for c, v in zip(covariance, values, strict=True)]
    )
    radius = np.sqrt(np.where(flat, chi2.ppf(level, 1), chi2.ppf(level, 2)))
    if curved.any():
        drawn = np.array([_matched(values, roots(row)) for row in _drawn(theta, steps, rng)]) - values
        for k in np.flatnonzero(curved):
            cloud = _plane(drawn[:, k])
            covariance[k] = cloud.T @ cloud / len(cloud)
            distances = [_distance(d, covariance[k], abs(values[k])) for d in drawn[:, k]]
            radius[k] = np.quantile(distances, level)
    return Regions(values, covariance, radius, level, curved)


def principal_axes(P: Array) -> Array:
    """Return a standard deviation along each principal axis of P in units of its diagonal."""
    size = np.sqrt(np.maximum(P.diagonal(), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(P / np.outer(size, size))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))).T * size)


def _drawn(theta: Array, steps: Array, rng: Any) -> Array:
    """Return parameters drawn from N(theta, P), as rows."""
    # Without a generator always the same, so that a model gives the same bands twice.
    generator = np.random.default_rng(0 if rng is None else rng)
    return np.asarray(theta + generator.normal(size=(_SAMPLES, len(steps))) @ steps)


def _matched(values: Any, others: Any) -> Any:
    """Return other roots in the order of those that they are closest to."""
    if others.size != values.size:
        return np.full(values.size, np.nan + 0j)
    _, order = linear_sum_assignment(np.abs(values[:, None] - others))
    return others[order]


def _plane(values: Any) -> Array:
    """Return complex numbers as pairs, with one axis more."""
    return np.stack((values.real, values.imag), axis=-1)


def _distance(difference: complex, covariance: Array, size: float) -> float:
    """Return the distance by Mahalanobis, infinite off an axis without width."""
    sizes, axes = np.linalg.eigh(covariance)
    along = axes.T @ np.array([difference.real, difference.imag])
    thin = sizes <= (_THIN * size) ** 2
    if (np.abs(along[thin]) > 10.0 * _THIN * max(size, 1.0)).any():
        return float("inf")
    return float(np.sqrt(np.sum(along[~thin] ** 2 / sizes[~thin])))


def probability(level: Any) -> float:
    """Return a probability of a band or a test, checked."""
    value = _checks.real("level", level)
    if not 0.0 < value < 1.0:
        raise ValueError(f"level: expected a probability in (0, 1), got {_checks.shown(level)}")
    return value
