"""How well a model's output agrees with a measured one."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array
from robust_filterpy.influence.regression import mad_scale, moving_size, resolution, size_of

__all__ = ["ROUNDING", "fit_percent", "least_variance", "ordinary_fit", "ordinary_samples"]

#: What a model leaves of an output, in units of its size, that is rounding and tells nothing.
ROUNDING: Final = 1e-12

# Within so many standard deviations of the ordinary noise a sample is an ordinary one.
_ORDINARY: Final = 3.0
# What arithmetic loses of the largest values of a recording that else rests.
_NUMBERS: Final = 3e-14


def fit_percent(y: ArrayLike, y_model: ArrayLike, axis: int = 0) -> Any:
    """Compute the normalised root-mean-square fit of a model's output.

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
    known = y[~np.isnan(y)]
    numbers = _NUMBERS * moving_size(known - np.median(known)) if known.size else 0.0
    steps = resolution(known) if in_steps else 0.0
    return max(ROUNDING**2, (steps / size) ** 2 / 12.0, (numbers / size) ** 2)


def ordinary_samples(residual: Array, y: Array) -> Any:
    """Tell which samples are ordinary: within three standard deviations of the noise, known by its median.

    Parameters
    ----------
    residual : ndarray, shape (N,)
        Measured less predicted output; NaN where there is none.
    y : ndarray, shape (N,)
        Measured output: what is rounding of its variation is ordinary.

    Returns
    -------
    ndarray of bool, shape (N,)
        False where the residual is NaN.

    Examples
    --------
    >>> ordinary_samples(np.array([0.1, -0.1, 0.2, 9.0, np.nan]), np.array([4.0, 2.0, 4.0, 2.0, 4.0]))
    array([ True,  True,  True, False, False])
    """
    known, measured = residual[~np.isnan(residual)], y[~np.isnan(y)]
    scale = max(mad_scale(known), ROUNDING * size_of(measured - np.median(measured))) if known.size else 0.0
    return np.abs(np.where(np.isnan(residual), np.inf, residual)) <= _ORDINARY * scale


def ordinary_fit(y: Array, y_model: Array, ordinary: Any) -> float:
    """Compute the fit of a model's output on ordinary samples.

    Parameters
    ----------
    y, y_model : ndarray, shape (N,)
        Measured and computed output; NaN where there is none.
    ordinary : ndarray of bool, shape (N,)
        Which samples count.

    Returns
    -------
    float
        Percent; NaN if the output does not vary in these samples.

    Examples
    --------
    >>> y = np.array([0.0, 2.0, 0.0, 2.0, 99.0])
    >>> round(ordinary_fit(y, np.array([0.0, 1.0, 0.0, 1.0, 0.0]), y < 9.0), 1)
    29.3
    """
    counts = ordinary & ~np.isnan(y) & ~np.isnan(y_model)
    if counts.sum() < 2 or np.std(y[counts]) <= _constant(np.abs(y[counts]).max()):
        return float("nan")
    return float(fit_percent(y[counts], y_model[counts]))
