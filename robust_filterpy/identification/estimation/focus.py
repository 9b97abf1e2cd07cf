"""A fit that counts one band of frequencies: for a model smaller than its plant, where the model has to be right.

What an output error leaves, L (y - B/F u), is that of the filtered signals L y and L u, so that a fit to these weighs
what is wrong at each frequency by |L|^2 (Ljung, System Identification, 2nd ed., 1999, section 14.4). A noise model
would take L off again: the dynamics of every structure are fitted as an output error. A filter smears an outlier over
its whole memory, which no loss can undo. Here it comes last: the model of all frequencies says what the outliers and
gaps should have been, and its values pass L in their place. L is a Butterworth filter of order 2 at each edge of the
band; its first samples, which hang on what was before the recording, are left out.

What the noise, the level and the weights are, the recording says as it is, with the dynamics held at those of the band.
Filtered residuals carry over from one to the next; the covariance counts that, with L and the noise model of all
frequencies (`prediction_error.sandwich`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.signal import butter, lfilter, sosfilt

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.estimation.estimate import Problem, estimated
from robust_filterpy.identification.estimation.limits import Limits
from robust_filterpy.identification.models.findings import Finding
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.structures import Structure

__all__ = ["band", "band_filter", "dynamics_of", "focused"]

_ORDER: Final = 2
# The filter's memory ends where so much of its impulse response's energy has been, and is this part of the recording at
# most.
_SETTLED: Final = 0.999
_MOST: Final = 0.25


def band(focus: Any, dt: float | None) -> tuple[float, float]:
    """Return the edges of a band in rad/s (rad a sample without dt), checked.

    Parameters
    ----------
    focus : (float, float)
        Lower and upper edge; None or 0 for no lower one, None or pi/dt for no upper one.
    dt : float or None
        Sampling period in s.

    Returns
    -------
    low, high : float

    Raises
    ------
    ValueError
        If there is no such band between 0 and pi/dt, or it is all frequencies.
    TypeError
        If focus is no pair of numbers.
    """
    highest = np.pi / (dt or 1.0)
    if not isinstance(focus, (tuple, list, np.ndarray)) or len(focus) != 2:
        raise TypeError(f"focus: expected (low, high) in rad/s, got {_checks.shown(focus)}")
    low = 0.0 if focus[0] is None else _checks.real("focus[0]", focus[0])
    high = highest if focus[1] is None else _checks.real("focus[1]", focus[1])
    if not 0.0 <= low < high <= highest * (1.0 + 1e-9) or (low == 0.0 and high >= highest):
        raise ValueError(
            f"focus: expected 0 <= low < high <= pi/dt = {highest:.4g} rad/s, and not all of that, got "
            f"{_checks.shown(focus)}; without a time index of y and u the unit is rad a sample"
        )
    return low, min(high, highest)


def focused(
    problem: Problem,
    y: Array,
    found: Model,
    edges: tuple[float, float],
    held: Callable[[Problem], tuple[Model, tuple[Finding, ...]]],
) -> tuple[Model, tuple[Finding, ...]]:
    """Return the model of a band, and what was found in the recording.

    Parameters
    ----------
    problem : Problem
        What is to be found.
    y : ndarray, shape (N,)
        Output, NaN where it is missing.
    found : Model
        The model of all frequencies.
    edges : (float, float)
        From `band`.
    held : callable
        Finds the model of the recording as it is for a problem whose dynamics are held.

    Returns
    -------
    model : Model
    findings : tuple of Finding

    Raises
    ------
    ValueError
        If the recording is too short for the filter, or the input does not excite the parameters within the band.
    """
    inner = dynamics_of(problem.structure)
    recorded, known = found.prepared(y, problem.u)
    measured = np.where(known, recorded.y, np.nan)
    expected = found.predict(measured, problem.u)
    trust = np.where(known, np.where(np.isnan(found.weights), 1.0, found.weights), 0.0)
    parts = found.parts
    gains = np.array([b.sum() for b in parts.b]) / (parts.a.sum() * parts.f.sum())
    at = np.array([found.operating_point[i] for i, (nb, _) in enumerate(problem.structure.inputs) if nb])
    resting = found.level + gains @ at
    clean = np.where(trust > 0.0, expected + trust * (measured - expected), expected)
    output, signal = np.nan_to_num(clean - resting, nan=0.0), problem.u - found.operating_point
    sos, settled = band_filter(edges, problem.dt or 1.0, y.size)
    noise = parts.d
    if problem.structure.integrated:
        # Noise that is summed up is most of what there is at low frequencies.
        output, signal = np.diff(output, prepend=output[0]), np.diff(signal, axis=0, prepend=signal[:1])
        noise = noise[:1]
    disturbance = lfilter(parts.c, np.convolve(parts.a, noise), np.eye(1, y.size).ravel())
    output, signal = sosfilt(sos, output), sosfilt(sos, signal, axis=0)[settled:]
    output[~known] = np.nan
    own, of_inner = _places(problem.structure), _places(inner)
    told = problem.limits or Limits(*np.multiply.outer([-np.inf, np.inf], np.ones(problem.structure.n_theta)))
    order = np.argsort(of_inner)
    limits = Limits(told.lower[own][order], told.upper[own][order])
    inside = problem._replace(
        structure=inner, u=signal, rest=np.zeros(signal.shape[1]), R=None, offset=problem.offset and edges[0] == 0.0,
        limits=limits if limits.any else None, carried=sosfilt(sos, disturbance)[: 2 * settled],
    )  # fmt: skip
    try:
        best = estimated(inside, output[settled:])
    except ValueError as error:
        error.args = (f"focus: within {edges[0]:.4g} to {edges[1]:.4g} rad/s: {error}",)
        raise
    lower, upper = told.lower.copy(), told.upper.copy()
    lower[own] = upper[own] = best.theta[of_inner]
    limits = Limits(lower, upper)
    model, findings = held(problem._replace(limits=limits))
    P = model.P.copy()
    P[np.ix_(own, own)] = best.P[np.ix_(of_inner, of_inner)]
    doubt = "; ".join(dict.fromkeys(words for words in (best.warning, model.warning) if words))
    return replace(model, P=P, warning=doubt, focus=edges), findings


def dynamics_of(structure: Structure) -> Structure:
    """Return the output error with the dynamics of a structure, or raise if it has none or two denominators.

    Parameters
    ----------
    structure : Structure
        Any.

    Returns
    -------
    Structure
    """
    if not structure.n_inputs or structure.takes_phi:
        raise ValueError(f"focus: expected None for {structure}, which has no dynamics from an input")
    if structure.na and structure.nf:
        raise ValueError(f"focus: expected a structure with A or F alone, got {structure}; take an OutputError")
    # Called as in the structure: a's or f's.
    form = "OutputError" if structure.na or structure.form == "OutputError" else "Structure"
    return Structure(nb=structure.nb, nf=structure.na or structure.nf, nk=structure.nk, form=form)


def _places(structure: Structure) -> Any:
    """Return where the dynamics stand in theta: the denominator, then B of each input."""
    places = structure.polynomials
    parts = (places.a if structure.na else places.f, *places.b)
    return np.concatenate([np.arange(part.start, part.stop) for part in parts])


def band_filter(edges: tuple[float, float], dt: float, size: int) -> tuple[Array, int]:
    """Return L, and how many samples its memory has.

    Parameters
    ----------
    edges : (float, float)
        From `band`.
    dt : float
        Sampling period in s.
    size : int
        Samples of the recording.

    Returns
    -------
    sos : ndarray
        L as sections of second order.
    settled : int

    Raises
    ------
    ValueError
        If the recording is too short for it.
    """
    low, high = edges
    kind = "lowpass" if low == 0.0 else "highpass" if high >= np.pi / dt else "bandpass"
    corners = {"lowpass": high, "highpass": low, "bandpass": edges}[kind]
    sos = butter(_ORDER, corners, kind, fs=2.0 * np.pi / dt, output="sos")
    energy = np.cumsum(sosfilt(sos, np.eye(1, 4 * size).ravel()) ** 2)
    settled = int(np.searchsorted(energy, _SETTLED * energy[-1])) + 1
    if settled > _MOST * size:
        raise ValueError(
            f"focus: expected a band whose filter settles within a quarter of the {size} samples, got one that takes "
            f"{settled}; a wider band, or one that is farther from 0, takes less"
        )
    return sos, settled
