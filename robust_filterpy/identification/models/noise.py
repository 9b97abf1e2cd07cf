"""The noise that residuals show, and how well a model agrees with a recording.

Huber's psi is the safest answer for a class of distributions. The noise of one recording is one member of it, which the
residuals show: its own score loses nothing where there are no outliers and less than Huber's psi where there are.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array
from robust_filterpy.correction.contaminated import SETTLING_STEPS, START, Contaminated, maximised
from robust_filterpy.correction.spread import FAR
from robust_filterpy.influence.functions import Influence
from robust_filterpy.influence.regression import mad_scale, moving_size, resolution, robust_regression, size_of

#: What a model leaves of an output, in units of its size, that is rounding and tells nothing.
ROUNDING: Final = 1e-12
#: Within so many standard deviations of the ordinary noise a sample is an ordinary one.
ORDINARY: Final = 3.0
# What arithmetic loses of the largest values of a recording that else rests.
_NUMBERS: Final = 3e-14


def fit_percent(y: ArrayLike, y_model: ArrayLike, axis: int = 0) -> Any:
    """Compute the normalized root-mean-square fit of a model's output.

    ``100 (1 - ||y - y_model|| / ||y - mean(y)||)``: 100 is perfect, 0 no better than the mean, below 0 worse.

    Parameters
    ----------
    y : array_like, shape (steps,), or with more axes for several outputs or runs
        Measured output. NaN is a missing sample and does not count.
    y_model : array_like, of the shape of `y`
        Simulated or predicted output.
    axis : int
        The axis of time.

    Returns
    -------
    float, or ndarray without the axis of time
        Percent.

    Raises
    ------
    ValueError
        If the shapes differ, or an output is constant (or wholly missing), for which the fit is undefined.

    Examples
    --------
    >>> round(fit_percent([0.0, 2.0, 0.0, 2.0], [0.0, 1.0, 0.0, 1.0]), 1)
    29.3
    """
    measured, model = np.asarray(y, dtype=float), np.asarray(y_model, dtype=float)
    if measured.ndim == 0 or measured.shape != model.shape:
        raise ValueError(f"y_model: expected shape {measured.shape} as y has it, got {model.shape}")
    present = ~np.isnan(measured)
    count = present.sum(axis=axis, keepdims=True)
    mean = np.where(present, measured, 0.0).sum(axis=axis, keepdims=True) / np.maximum(count, 1)
    spread = np.linalg.norm(np.where(present, measured - mean, 0.0), axis=axis)
    missed = np.linalg.norm(np.where(present, measured - model, 0.0), axis=axis)
    scale = np.max(np.where(present, np.abs(measured), 0.0), axis=axis, initial=0.0)
    if np.any(spread <= _constant(scale) * np.sqrt(count.squeeze(axis))):
        raise ValueError("y: expected samples that differ, found a constant output; its fit is undefined")
    fit = 100 * (1 - missed / spread)
    return fit if fit.ndim else float(fit)


def _constant(scale: Any) -> Any:
    """Return the standard deviation of equal numbers of a size: their mean need not be that number to the last bit."""
    return 4 * np.finfo(float).eps * scale


def least_variance(y: Array, size: float, in_steps: bool = True) -> float:
    """Return what the noise of an output has at least, in units of a size: rounding, of numbers or of its sensor."""
    measured = y[~np.isnan(y)]
    numbers = _NUMBERS * moving_size(measured - np.median(measured)) if measured.size else 0.0
    steps = resolution(measured) if in_steps else 0.0
    return max(ROUNDING**2, (steps / size) ** 2 / 12.0, (numbers / size) ** 2)


def ordinary_samples(residual: Array, y: Array) -> Any:
    """Tell which samples are ordinary: within three standard deviations of the noise, known by its median."""
    e, measured = residual[~np.isnan(residual)], y[~np.isnan(y)]
    scale = max(mad_scale(e), ROUNDING * size_of(measured - np.median(measured))) if e.size else 0.0
    return np.abs(np.where(np.isnan(residual), np.inf, residual)) <= ORDINARY * scale


def ordinary_fit(y: Array, y_model: Array, ordinary: Any) -> float:
    """Compute the fit of a model's output on ordinary samples."""
    counts = ordinary & ~np.isnan(y) & ~np.isnan(y_model)
    if counts.sum() < 2 or np.std(y[counts]) <= _constant(np.abs(y[counts]).max()):
        return float("nan")
    return float(fit_percent(y[counts], y_model[counts]))


@dataclass(frozen=True)
class Noise:
    """Noise of a model's residuals: a variance, and the influence function of the standardized residual.

    Parameters
    ----------
    influence : Influence
        A `Contaminated` is learned with R; any other stays as it is.
    R : float
        Variance of the ordinary noise, in the unit of the residual squared.
    given : bool, default False
        Whether R is given and stays as it is.
    least : float, optional
        R never becomes smaller than this, which keeps a recording without noise from dividing by 0.
    """

    influence: Influence
    R: float
    given: bool = False
    least: float = np.finfo(float).tiny

    def refitted(self, residual: Array, steps: int = 5) -> Noise:
        """Return the noise that these residuals show, of a `Contaminated` after steps with its weak priors."""
        if isinstance(self.influence, Contaminated):
            fitted = maximised(residual, self.influence, self.R, self.given, self.least, steps)
            return replace(self, influence=Contaminated(*fitted[:2]), R=fitted[2])
        return self if self.given else replace(self, R=max(mad_scale(residual) ** 2, self.least))

    def settled(self, residual: Array) -> Noise:
        """Return `refitted` after so many steps that more would hardly move it."""
        return self.refitted(residual, SETTLING_STEPS)

    def times(self, size: float) -> Noise:
        """Return the noise of residuals that are so many times as large."""
        return replace(self, R=self.R * size**2, least=self.least * size**2)

    @property
    def is_rounding(self) -> bool:
        """Whether there is no noise: R is the least that it may be, but for the degrees of freedom."""
        return not self.given and self.R <= 2.0 * self.least

    @property
    def has_outliers(self) -> bool:
        """Whether a large residual has less weight than a small one: not for `Linear`."""
        return float(np.asarray(self.influence.weights(np.array([1e6])))[0]) < 1.0

    def cost(self, residual: Array) -> float:
        """Return -log of the likelihood of the residuals, up to a constant that R alone determines."""
        return float(np.sum(self.influence.rho(residual / math.sqrt(self.R))))

    def weights(self, residual: Array) -> Array:
        """Return psi(e)/e of each residual."""
        return np.asarray(self.influence.weights(residual / math.sqrt(self.R)), dtype=float)

    @property
    def variance(self) -> float:
        """R, as what each residual has of it."""
        return self.R

    def psi(self, residual: Array) -> Array:
        """Return psi of each residual in units of its standard deviation."""
        return np.asarray(self.influence.psi(residual / math.sqrt(self.R)), dtype=float)

    def slope(self, residual: Array) -> float:
        """Return the mean of psi', at least 1e-3."""
        return max(float(np.mean(self.influence.psi_deriv(residual / math.sqrt(self.R)))), 1e-3)

    def log_likelihood(self, residual: Array) -> float:
        """Return the log-likelihood of the residuals under the density that psi is made for."""
        # Beyond the reach of a `Contaminated` the density falls as Cauchy's does: with outliers of two sizes the
        # smaller ones set its ratio, and the larger ones would say nothing but that.
        normalizer = getattr(self.influence, "log_normalizer", lambda dim: 0.5 * dim * math.log(2.0 * math.pi))
        beyond = 0.0
        if isinstance(self.influence, Contaminated):
            reach = FAR * self.influence.scale_ratio * math.sqrt(self.R)
            beyond = 2.0 * float(np.sum(np.log(np.maximum(np.abs(residual) / reach, 1.0))))
            residual = np.clip(residual, -reach, reach)
        return -self.cost(residual) - beyond - residual.size * (normalizer(1) + 0.5 * math.log(self.R))


def likelihood_of_mixture(residual: Array, wild: float) -> float:
    """Return the log-likelihood of residuals under the mixture that they show; a larger one counts as ``wild``."""
    bounded = np.clip(residual, -wild, wild)
    start = Noise(START, max(mad_scale(bounded) ** 2, np.finfo(float).tiny))
    return start.settled(bounded).log_likelihood(bounded)


class Noises(NamedTuple):
    """Noise of residuals of several outputs, in one row.

    Attributes
    ----------
    parts : tuple of Noise
        That of each output.
    which : ndarray of int, shape (N,)
        The output of each residual.
    """

    parts: tuple[Noise, ...]
    which: Any

    @property
    def variance(self) -> Array:
        """R of each residual, shape (N,)."""
        return np.array([noise.R for noise in self.parts])[self.which]

    def refitted(self, residual: Array, steps: int = 5) -> Noises:
        """Return the noise that these residuals show."""
        parts = enumerate(self.parts)
        return self._replace(parts=tuple(noise.refitted(residual[self.which == j], steps) for j, noise in parts))

    def learnt(self) -> Noises:
        """Return the same with the mixture in the place of each influence function."""
        return self._replace(parts=tuple(Noise(START, one.R, one.given, one.least) for one in self.parts))

    def weights(self, residual: Array) -> Array:
        """Return psi(e)/e of each residual."""
        return self._each(residual, lambda noise, own: noise.weights(own))

    def psi(self, residual: Array) -> Array:
        """Return psi of each residual in units of its standard deviation."""
        return self._each(residual, lambda noise, own: noise.psi(own))

    def slope(self, residual: Array) -> Array:
        """Return the mean of psi' of its output for each residual."""
        return self._each(residual, lambda noise, own: np.full(own.size, noise.slope(own)))

    def cost(self, residual: Array) -> float:
        """Return -log of the likelihood of the residuals, up to a constant that the variances determine."""
        return sum(noise.cost(residual[self.which == j]) for j, noise in enumerate(self.parts))

    def log_likelihood(self, residual: Array) -> float:
        """Return the log-likelihood of the residuals."""
        return sum(noise.log_likelihood(residual[self.which == j]) for j, noise in enumerate(self.parts))

    def _each(self, residual: Array, of: Callable[[Noise, Array], Array]) -> Array:
        """Return what the noise of its output makes of each residual."""
        values = np.zeros(residual.size)
        for j, noise in enumerate(self.parts):
            values[self.which == j] = of(noise, residual[self.which == j])
        return values


def with_linear(model: Any, p: Array, free: Any, rows: Any, size: Any = 1.0) -> Array:
    """Return free parameters with those in which residuals, in units of a size, are linear at their robust best."""
    q, J = p.copy(), model.jacobian(p)[rows][:, free]
    if J.size:
        q[free] += robust_regression((-J.T / size).T, model.residuals(p)[rows] / size)
    return q


class OutputResiduals:
    """Residuals of recordings of several outputs, one row of y after the other, of which some are measured.

    Parameters
    ----------
    outputs : list of ndarray, shape (N, p)
        y of each recording, NaN where it is missing.

    Attributes
    ----------
    rows : ndarray of bool, shape (sum of N p,)
        Which residuals are measured.
    which : ndarray of int
        The output of each of these.
    """

    residuals: Callable[[Array], Array]

    def __init__(self, outputs: list[Array]) -> None:
        """Find out what is measured."""
        self.outputs, self._ends = outputs[0].shape[1], np.cumsum([len(y) for y in outputs])
        self.rows = ~np.isnan(np.concatenate(outputs)).ravel()
        self.which = np.tile(np.arange(self.outputs), self._ends[-1])[self.rows]

    def split(self, signal: Array) -> list[Array]:
        """Return what belongs to each recording of a signal like the residuals, shape (N, p)."""
        return np.split(signal.reshape(-1, self.outputs), self._ends[:-1])

    def believed(self, p: Array, noise: Noises, missing: float = 0.0) -> list[Array]:
        """Return the weights of the residuals of each recording, and a number where an output is missing."""
        weights = np.full(self.rows.size, missing)
        weights[self.rows] = noise.weights(self.residuals(p)[self.rows])
        return self.split(weights)
