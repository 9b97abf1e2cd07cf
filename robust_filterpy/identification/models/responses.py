"""How sure a model is of its responses, poles and zeros: functions of a system, its parameters and their covariance.

A system says what a row of parameters does (`_ways`, `_steps`, `_density`), where its roots are and whether it is
stable: polynomials here, states in `state_space`.

A property h(theta) is looked at in theta and one standard deviation s_i to both sides along each principal axis of P.
Half the differences are the delta method's standard deviation, sigma^2 = sum ((h(theta + s_i) - h(theta - s_i)) / 2)^2.
Where the curvature (h(theta + s_i) + h(theta - s_i)) / 2 - h(theta) adds up to more than a share of sigma (next to the
unit circle, at a resonance, at a double pole), the distribution of theta is sampled instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cholesky, solve_discrete_lyapunov, svd
from scipy.optimize import linear_sum_assignment
from scipy.signal import lfilter
from scipy.stats import chi2, norm

from robust_filterpy import _checks
from robust_filterpy._brief import Pictured, brief
from robust_filterpy._checks import Array
from robust_filterpy.identification.models import regressor
from robust_filterpy.identification.models.regressor import are_stable
from robust_filterpy.identification.models.results import Estimated, probability
from robust_filterpy.identification.models.signals import Signals, table
from robust_filterpy.identification.models.structures import Structure

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
        sizes, axes = np.linalg.eigh(self.covariance)
        edges = self.radius[:, None, None] * (axes * np.sqrt(np.maximum(sizes, 0.0))[:, None]) @ circle
        return self.values[:, None] + edges[:, 0] + 1j * edges[:, 1]

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
        each = zip(np.asarray(others, dtype=complex) - self.values, self.covariance, np.abs(self.values), strict=True)
        return np.array([_distance(*one) for one in each]) <= self.radius


class Response(Pictured):
    """What a system does at frequencies or times, with bands: prints its parts, and is a table of some."""

    #: Fields that are columns of the table, and that which is its index.
    columns: ClassVar[tuple[str, ...]] = ("response", "lower", "upper")
    against: ClassVar[str] = "omega"

    __str__ = __repr__ = brief

    def to_frame(self) -> Any:
        """Return the response and its bands as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            A row for each frequency or time: what is shown, and its band; of several inputs each by its number.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        columns: dict[str, Array] = {}
        for name in self.columns:
            rows = np.atleast_2d(getattr(self, name))
            columns |= {name if len(rows) == 1 else f"{name}[{i}]": row for i, row in enumerate(rows)}
        return table(columns, getattr(self, self.against), self.against)


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse(Response):
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

    picture = "models.plot_bode"
    columns = ("magnitude", "magnitude_lower", "magnitude_upper", "phase", "phase_lower", "phase_upper")

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
class StepResponse(Response):
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

    picture, against = "models.plot_step", "time"

    time: Array
    response: Array
    lower: Array
    upper: Array
    level: float
    sampled: Any


@dataclass(frozen=True, eq=False, repr=False)
class NoiseSpectrum(Response):
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

    picture, columns = "models.plot_noise_spectrum", ("density", "lower", "upper")

    omega: Array
    density: Array
    lower: Array
    upper: Array
    level: float
    dt: float
    sampled: Any


def bands(
    is_inside: Callable[[Array], bool], theta: Any, P: Any, h: Callable[[Array], Array], level: float, rng: Any
) -> tuple[Array, Array, Any]:
    """Return the band of h(theta) about its value."""
    theta, z = np.asarray(theta), float(norm.ppf(0.5 + 0.5 * probability(level)))
    center, steps, half, curvature = _around(theta, P, h)
    std = np.sqrt(np.sum(half**2, axis=0))
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
    values = roots(theta)

    def matched(rows: Array) -> Any:
        return np.array([_matched(values, roots(row)) for row in rows])

    _, steps, half, curvature = _around(theta, P, matched)
    half = _plane(half)
    covariance = np.einsum("ika,ikb->kab", half, half)
    curved = ~(curvature <= _CURVED * np.sqrt(np.trace(covariance, axis1=1, axis2=2)) + 1e-12 * np.abs(values))
    flat = np.linalg.eigvalsh(covariance)[:, 0] <= (_THIN * np.abs(values)) ** 2
    radius = np.sqrt(np.where(flat, chi2.ppf(level, 1), chi2.ppf(level, 2)))
    if curved.any():
        drawn = matched(_drawn(theta, steps, rng)) - values
        for k in np.flatnonzero(curved):
            cloud = _plane(drawn[:, k])
            covariance[k] = cloud.T @ cloud / len(cloud)
            distances = [_distance(d, covariance[k], abs(values[k])) for d in drawn[:, k]]
            radius[k] = np.quantile(distances, level)
    return Regions(values, covariance, radius, level, curved)


def _around(theta: Array, P: Any, h: Callable[[Array], Any]) -> tuple[Any, Array, Any, Any]:
    """Return h(theta), the steps to both sides, half of what h does between them, and how much it is curved."""
    center, steps = h(theta[None])[0], principal_axes(np.asarray(P))
    ahead, behind = h(theta + steps), h(theta - steps)
    return center, steps, 0.5 * (ahead - behind), np.abs(0.5 * (ahead + behind) - center).sum(axis=0)


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


# A pole this near to the negative real axis, or to 0, is on it.
_ON: Final = 1e-9


class System(Estimated):
    """A linear system with parameters theta of covariance P, sampled every dt seconds: a model, a tracker."""

    R: Any

    # What a kind of system says; theta may stand in rows, and q^-1 is given at some frequencies.
    #: (thetas, q^-1, output): what goes from each input to an output, (rows, n_inputs, n).
    _ways: Callable[..., Any]
    #: (thetas, length, output): an output after a unit step of each input, (rows, n_inputs, length).
    _steps: Callable[..., Array]
    #: (thetas, q^-1, output): logarithm of the noise's density, of rows [theta, logarithm of a factor of each R].
    _density: Callable[..., Array]
    _poles: Callable[[Array], Any]
    #: (theta, input, output).
    _zeros: Callable[..., Any]
    #: Whether the way from the inputs to y is stable for other parameters.
    _stable: Callable[[Array], bool]

    def _require(self, what: str) -> None:
        """Raise unless there is an input to what is asked for."""

    @property
    def _signals(self) -> Signals:
        """How many inputs and outputs there are."""
        raise NotImplementedError

    @property
    def _of_poles(self) -> slice:
        """The parameters that the poles depend on."""
        return slice(None)

    def frequency_response(
        self, omega: ArrayLike, output: int = 0, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> FrequencyResponse:
        """Return the frequency response from the inputs to an output, with bands.

        Parameters
        ----------
        omega : array_like, shape (n,)
            Frequencies in rad/s, in [0, pi/dt].
        output : int, default 0
            Which output, of a model that has several.
        level : float, default 0.95
            Probability of the band at each frequency.
        dt : float, optional
            Sampling period in s. Default: that of the recording, if its index has it, else 1.
        rng : numpy.random.Generator or int, optional
            For bands by sampling, where the delta method fails.

        Returns
        -------
        FrequencyResponse

        Raises
        ------
        ValueError
            If there is no input, or a frequency, output, level or dt does not fit.

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
        self._require("frequency response; noise_spectrum(omega) has that of the noise")
        (w, period, delays), which = self._frequencies(omega, dt), self._numbered("output", output)
        center = self._ways(np.asarray(self.theta)[None], delays, which)[0]
        divisor = np.where(center == 0.0, 1.0, center)

        def logarithm(thetas: Array) -> Array:
            # An input without coefficients does nothing for any theta.
            ratio = np.where(center == 0.0, 1.0, self._ways(thetas, delays, which) / divisor)
            return np.stack((np.log(np.abs(ratio)), np.angle(ratio)), axis=1)

        with np.errstate(divide="ignore", invalid="ignore"):
            low, high, sampled = bands(self._stable, self.theta, self.P, logarithm, level, rng)
        size, phase = np.abs(center), np.unwrap(np.angle(center), axis=-1)
        rows = (size, size * np.exp(low[0]), size * np.exp(high[0]), phase, phase + low[1], phase + high[1])
        fields = (*map(_squeezed, (center, *rows)), float(level), period, _squeezed(sampled.any(axis=0)))
        return FrequencyResponse(w, *fields)

    def step_response(
        self, steps: int = 50, output: int = 0, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> StepResponse:
        """Return what an output does after a unit step of each input, with bands.

        Parameters
        ----------
        steps : int, default 50
            How many samples.
        output, level, dt, rng
            As in `frequency_response`.

        Returns
        -------
        StepResponse

        Raises
        ------
        ValueError
            If there is no input, or steps, output, level or dt does not fit.
        """
        self._require("step response")
        length, period = _checks.count("steps", steps, 1), self._period(dt)
        of = partial(self._steps, length=length, output=self._numbered("output", output))
        center = of(np.asarray(self.theta)[None])[0]
        low, high, sampled = bands(self._stable, self.theta, self.P, of, level, rng)
        fields = (*map(_squeezed, (center, center + low, center + high)), float(level), _squeezed(sampled))
        return StepResponse(period * np.arange(length, dtype=float), *fields)

    def noise_spectrum(
        self, omega: ArrayLike, output: int = 0, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> NoiseSpectrum:
        """Return the power spectral density of what the ordinary noise does to an output, with bands.

        Parameters
        ----------
        omega, output, level, dt, rng
            As in `frequency_response`.

        Returns
        -------
        NoiseSpectrum

        Raises
        ------
        ValueError
            If a frequency, output, level or dt does not fit.
        """
        w, period, delays = self._frequencies(omega, dt)
        of = partial(self._density, delays=delays, output=self._numbered("output", output))
        # R is as certain as a variance from so many samples.
        spread = 2.0 / np.atleast_1d(self._noise_samples)
        n, whole = len(self.theta), np.concatenate((self.theta, np.zeros(spread.size)))
        joint = np.diag(np.concatenate((np.zeros(n), spread)))
        joint[:n, :n] = self.P
        center = period * np.exp(of(whole[None])[0])
        low, high, sampled = bands(self._stable, whole, joint, of, level, rng)
        return NoiseSpectrum(w, center, center * np.exp(low), center * np.exp(high), float(level), period, sampled)

    def poles(self, level: float = 0.95, rng: Any = None, dt: float | None = None) -> Regions:
        """Return the poles, the roots of A or F or the eigenvalues of A, with regions.

        Parameters
        ----------
        level : float, default 0.95
            Probability of each region.
        rng : numpy.random.Generator or int, optional
            For regions by sampling, where the delta method fails.
        dt : float, optional
            Sampling period in s: poles in continuous time, log(z)/dt in 1/s; 1 over their size is a time constant.

        Returns
        -------
        Regions

        Raises
        ------
        ValueError
            If the regressor is the caller's, level is no probability, or of poles in continuous time one is at 0 or on
            the negative real axis, where nothing in continuous time has its samples.
        """
        part, theta, of = self._of_poles, np.asarray(self.theta), self._poles
        if dt is not None:
            period = self._period(dt)
            for pole in of(theta[part]):
                if abs(pole.imag) <= _ON and pole.real <= _ON:
                    raise ValueError(
                        f"poles: expected none at 0 or on the negative real axis in continuous time, got "
                        f"{pole.real:.4g}; take a smaller order, or sample faster"
                    )
            of = lambda row: np.log(self._poles(row).astype(complex)) / period  # noqa: E731
        return regions(theta[part], np.asarray(self.P)[part, part], of, level, rng)

    def zeros(
        self, level: float = 0.95, rng: Any = None, input: int | None = None, output: int | None = None
    ) -> Regions:
        """Return the zeros, the roots of B, or of states the transmission zeros, with regions.

        Parameters
        ----------
        level : float, default 0.95
            Probability of each region.
        rng : numpy.random.Generator or int, optional
            For regions by sampling, where the delta method fails.
        input, output : int, optional
            The way from one input to one output. Default: from the first input, of states of all together, as
            python-control computes them.

        Returns
        -------
        Regions

        Raises
        ------
        ValueError
            If there is no such input or output, the regressor is the caller's, level is no probability, or states have
            not as many outputs as inputs and slycot, by which python-control finds their zeros, is not installed.
        """
        self._require("zeros")
        one, other = (value if value is None else self._numbered(name, value)
                      for name, value in (("input", input), ("output", output)))  # fmt: skip
        of = partial(self._zeros, input=one, output=other)
        return regions(np.asarray(self.theta), np.asarray(self.P), of, level, rng)

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

    def _numbered(self, name: str, value: Any) -> int:
        """Return the number of an input or output or raise."""
        if isinstance(value, float):
            raise TypeError(f"{name}: expected an integer, got {value}; level= goes by its name")
        most = getattr(self._signals, f"n_{name}s")
        if _checks.count(name, value) >= most:
            raise ValueError(f"{name}: expected 0 to {most - 1}, got {value}")
        return int(value)


class PolynomialSystem(System):
    """A system whose parameters are coefficients of polynomials."""

    structure: Structure

    @property
    def coefficients(self) -> Any:
        """Those of the polynomials, as `Coefficients`."""
        return regressor.coefficients(self.structure, self.theta)

    def transfer_function(self, dt: float | bool | Literal["recorded"] = "recorded") -> control.TransferFunction:
        """Return the way from u to y, B(q)/A(q) or B(q)/F(q), as it stands.

        Parameters
        ----------
        dt : float, True or "recorded", default "recorded"
            Sampling period in s; True leaves it open. "recorded": as an index has it, True if none does.

        Returns
        -------
        control.TransferFunction
            One output and as many inputs as the structure has.

        Raises
        ------
        ValueError
            If the structure has no input, or a regressor of the caller's.

        Examples
        --------
        >>> from robust_filterpy import ARX, ParameterTracker
        >>> tf = ParameterTracker(ARX(1, 1), theta=[-0.5, 2.0]).transfer_function(dt=0.1)
        >>> tf.poles().real, float(tf.dcgain())
        (array([0.5]), 4.0)
        """
        import control

        period, whole = regressor.period(dt, self.dt), regressor.denominator(self.structure, self.theta)
        if self.structure.takes_phi:
            regressor.coefficients(self.structure, self.theta)
        self._require("transfer function")
        is_number = isinstance(period, (int, float, np.number)) and period is not False
        if period is not True and not (is_number and 0.0 < period < np.inf):
            raise ValueError(f"dt: expected a sampling period > 0 in s, or True, got {period!r}")
        ways = [(b, max(whole.size, b.size)) for b in _numerators(self.structure, self.theta)]
        numerators = [np.pad(b, (0, size - b.size)) if b.any() else np.zeros(1) for b, size in ways]
        return control.tf([numerators], [[np.pad(whole, (0, size - whole.size)) for _, size in ways]], period)

    @property
    def _signals(self) -> Signals:
        """One output, and the inputs of the structure."""
        return Signals(self.structure.n_inputs, 1)

    def _require(self, what: str) -> None:
        """Raise unless there is an input, and polynomials."""
        if self.structure.takes_phi:
            raise ValueError(
                f"{self.structure}: expected a model with polynomials, this one has a regressor of the caller's"
            )
        if what and not self.structure.inputs:
            raise ValueError(f"{self.structure}: expected a model with an input, this one has no {what}")

    def _stable(self, theta: Array) -> bool:
        """Tell whether A and F are stable."""
        return are_stable(theta, (self.structure.polynomials.a, self.structure.polynomials.f))

    def _ways(self, thetas: Array, delays: Any, output: int) -> Any:
        """Return B/(A F)."""
        places = self.structure.polynomials
        denominator = _at(thetas, places.a, delays) * _at(thetas, places.f, delays)
        ways = [
            thetas[:, place] @ delays[None] ** (nk + np.arange(nb))[:, None] / denominator
            for place, (nb, nk) in zip(places.b, self.structure.inputs, strict=True)
        ]
        return np.stack(ways, axis=1)

    def _steps(self, thetas: Array, length: int, output: int) -> Array:
        """Return the response of B/(A F)."""
        responses = np.empty((len(thetas), self.structure.n_inputs, length))
        for row, theta in zip(responses, thetas, strict=True):
            denominator = regressor.denominator(self.structure, theta)
            for one, numerator in zip(row, _numerators(self.structure, theta), strict=True):
                one[:] = lfilter(numerator, denominator, np.ones(length))
        return responses

    def _density(self, thetas: Array, delays: Any, output: int) -> Array:
        """Return that of R |C/(A D)|^2."""
        places = self.structure.polynomials
        c, a, d = (np.log(np.abs(_at(thetas, part, delays))) for part in (places.c, places.a, places.d))
        return 2.0 * (c - a - d) + thetas[:, len(self.theta) :] + np.log(self.R)

    def _poles(self, theta: Array) -> Any:
        """Return the roots of A and F."""
        self._require("")
        return regressor.poles(self.structure, theta)

    def _zeros(self, theta: Array, input: int | None, output: int | None) -> Any:
        """Return the roots of the B of an input."""
        return np.roots(theta[self.structure.polynomials.b[input or 0]])


def balancing(A: Array, B: Array, C: Array) -> Array:
    """Return the basis in which each state is as easy to reach as to see, those that do most first."""
    try:
        reached = solve_discrete_lyapunov(A, B @ B.T)
        seen = solve_discrete_lyapunov(A.T, C.T @ C)
        jitter = 1e-13 * np.eye(len(A))
        L = cholesky(reached + jitter * np.trace(reached), lower=True)
        M = cholesky(seen + jitter * np.trace(seen), lower=True)
        _, values, right = svd(M.T @ L)
        return np.asarray(L @ right.T / np.sqrt(values))
    except (np.linalg.LinAlgError, ValueError):
        return np.eye(len(A))


def _numerators(structure: Structure, theta: Array) -> list[Array]:
    """Return b_0 + b_1 q^-1 + .. of each input, the delay as leading zeros."""
    orders = zip(structure.polynomials.b, structure.inputs, strict=True)
    return [np.concatenate((np.zeros(nk), theta[place])) if nb else np.zeros(1) for place, (nb, nk) in orders]


def _at(thetas: Array, part: slice, delays: Any) -> Any:
    """Return 1 + c_1 q^-1 + .. of each row of theta at each q^-1."""
    n = part.stop - part.start
    return 1.0 + thetas[:, part] @ delays[None] ** np.arange(1, n + 1)[:, None]


def _squeezed(rows: Any) -> Any:
    """Return the only row, where there is one input."""
    return rows[0] if len(rows) == 1 else rows
