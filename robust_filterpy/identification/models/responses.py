"""How sure a model is of its responses and of its poles and zeros, from the covariance of its parameters.

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
from scipy.signal import lfilter
from scipy.stats import chi2, norm

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._pictures import drawn
from robust_filterpy.identification.models.guard import is_stable
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.models.time_axis import table

if TYPE_CHECKING:
    import control

__all__ = ["FrequencyResponse", "NoiseSpectrum", "Regions", "Responses", "StepResponse", "bands", "regions"]

# Curvature of more than this share of a standard deviation is sampled.
_CURVED: Final = 0.2
_SAMPLES: Final = 2000
# An axis of an ellipse as thin as this, beside the size of its centre, has no width.
_THIN: Final = 1e-7


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse:
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

    def plot(self, **options: Any) -> Any:
        """Draw magnitude and phase with their bands.

        Parameters
        ----------
        **options : dict, optional
            Of `robust_filterpy.plotting.plot_bode`.

        Returns
        -------
        ndarray of matplotlib.axes.Axes
        """
        return drawn("plot_bode", self, options)

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
class StepResponse:
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

    def plot(self, **options: Any) -> Any:
        """Draw the response with its band.

        Parameters
        ----------
        **options : dict, optional
            Of `robust_filterpy.plotting.plot_step`.

        Returns
        -------
        matplotlib.axes.Axes
        """
        return drawn("plot_step", self, options)

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
class NoiseSpectrum:
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

    omega: Array
    density: Array
    lower: Array
    upper: Array
    level: float
    dt: float
    sampled: Any

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
        Distance of the boundary from the centre in units of the covariance, by Mahalanobis.
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

    def __repr__(self) -> str:
        """Show each value with the standard deviation of its real part, and of its imaginary part if it has one."""
        std = np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))
        parts = [
            f"{value.real:.4g}+-{s[0]:.2g}" + (f" {value.imag:+.4g}i+-{s[1]:.2g}" if value.imag else "")
            for value, s in zip(self.values, std, strict=True)
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
        std = np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))
        columns = {"real": self.values.real, "imag": self.values.imag, "std_real": std[:, 0], "std_imag": std[:, 1]}
        return table(columns)

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
        found = np.empty((self.values.size, angles.size), dtype=complex)
        for k, covariance in enumerate(self.covariance):
            sizes, axes = np.linalg.eigh(covariance)
            x, y = self.radius[k] * (axes * np.sqrt(np.maximum(sizes, 0.0))) @ circle
            found[k] = self.values[k] + x + 1j * y
        return found

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


# Bands and regions.


def bands(
    is_inside: Callable[[Array], bool], theta: Any, P: Any, h: Callable[[Array], Array], level: float, rng: Any
) -> tuple[Array, Array, Any]:
    """Return the band of h(theta) about its value.

    Parameters
    ----------
    is_inside : function
        Whether a theta is one that can be, such as a stable one.
    theta : ndarray, shape (n,)
        Parameters.
    P : ndarray, shape (n, n)
        Their covariance.
    h : function
        Of rows of theta.
    level : float
        Probability of the band.
    rng : numpy.random.Generator, int or None
        Where it is sampled.

    Returns
    -------
    lower, upper : ndarray, shape of h(theta)
        From its value on.
    sampled : ndarray of bool, shape of h(theta)
    """
    theta, z = np.asarray(theta), float(norm.ppf(0.5 + 0.5 * _probability(level)))
    center = h(theta[None])[0]
    steps = _axes(np.asarray(P))
    ahead, behind = h(theta + steps), h(theta - steps)
    std = np.sqrt(np.sum((0.5 * (ahead - behind)) ** 2, axis=0))
    curvature = np.abs(0.5 * (ahead + behind) - center).sum(axis=0)
    lower, upper = -z * std, z * std
    # Where a step has left the stable models, or is infinite, curvature is no number.
    stable = all(is_inside(row) for row in (*(theta + steps), *(theta - steps)))
    # What is known for sure has no more than rounding.
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
    """Return roots that theta determines, with their regions.

    Parameters
    ----------
    theta : ndarray, shape (n,)
        Parameters.
    P : ndarray, shape (n, n)
        Their covariance.
    roots : function
        The roots, of a theta.
    level : float
        Probability of each region.
    rng : numpy.random.Generator, int or None
        Where a region is sampled.

    Returns
    -------
    Regions
    """
    level = _probability(level)
    values, steps = roots(theta), _axes(P)
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


def _axes(P: Array) -> Array:
    """Return a standard deviation along each principal axis of P in units of its diagonal, as rows."""
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


def _probability(level: Any) -> float:
    """Return a number in (0, 1) or raise."""
    value = _checks.real("level", level)
    if not 0.0 < value < 1.0:
        raise ValueError(f"level: expected a probability in (0, 1), got {level!r}")
    return value
