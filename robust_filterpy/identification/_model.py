"""A parameter vector as a model: its coefficients, its transfer function, its response."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.signal

from robust_filterpy._checks import Array
from robust_filterpy.identification._regressor import Layout, Memory
from robust_filterpy.identification.noise_structures import BoxJenkins
from robust_filterpy.identification.results import BoxJenkinsCoefficients, Coefficients
from robust_filterpy.identification.structures import LinearRegression, Structure


def coefficients(structure: Structure, theta: Array) -> Any:
    """Split theta."""
    if isinstance(structure, LinearRegression):
        raise ValueError(f"{structure}: expected a model with a, b, c; the coefficients of your regressor are theta")
    places = structure.polynomials
    b = tuple(theta[place] for place in places.b)
    first = b[0] if len(b) == 1 else b or theta[:0]
    if isinstance(structure, BoxJenkins):
        return BoxJenkinsCoefficients(first, theta[places.f], theta[places.c], theta[places.d])
    return Coefficients(theta[: structure.na], first, theta[places.c])


def transfer_function(structure: Structure, theta: Array, dt: Any) -> Any:
    """Return B/A, or B/F, as a control.TransferFunction."""
    import control

    if isinstance(structure, LinearRegression):
        coefficients(structure, theta)
    if not structure.inputs:
        raise ValueError(f"{structure}: expected a model with an input, this one has no transfer function")
    if dt is not True and not (_is_number(dt) and 0.0 < dt < math.inf):
        raise ValueError(f"dt: expected a sampling period > 0 in s, or True, got {dt!r}")
    places, numerators, denominators = structure.polynomials, [], []
    a = theta[places.f if places.f.stop > places.f.start else places.a]
    for place, (nb, nk) in zip(places.b, structure.inputs, strict=True):
        degree = max(a.size, nk + nb - 1) if nb else a.size
        numerator, denominator = np.zeros(degree + 1), np.zeros(degree + 1)
        numerator[nk : nk + nb] = theta[place]
        denominator[0] = 1.0
        denominator[1 : a.size + 1] = a
        numerators.append(numerator if numerator.any() else np.zeros(1))
        denominators.append(denominator)
    return control.tf([numerators], [denominators], dt)


def period(dt: Any, recorded: float | None) -> Any:
    """Return the sampling period that was asked for; for "recorded" that of the recording, True if it is unknown."""
    if not isinstance(dt, str) or dt != "recorded":
        return dt
    return True if recorded is None else recorded


def _is_number(value: Any) -> bool:
    """Tell whether value can be compared as a real number."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def simulate(structure: Structure, layout: Layout, memory: Memory, theta: Array, u: Array) -> Array:
    """Run a model on its input alone, from what the memory holds; noise to come is 0."""
    phi, _ = memory.regressors(layout, u)
    forcing = phi.dot(theta)
    c, noise = theta[layout.residuals], np.zeros(len(u))
    # What noise is already in the memory goes on acting for nc samples.
    for k in range(min(c.size, len(u))):
        noise[k] = c[k:].dot(memory.residuals[: c.size - k])
    with np.errstate(over="ignore", invalid="ignore"):
        if layout.has_disturbance:
            y = _fed_back(forcing, theta[layout.undisturbed], memory.undisturbed)
            y = y + _fed_back(noise, theta[layout.outputs], memory.outputs)
        else:
            y = _fed_back(forcing + noise, theta[layout.outputs], memory.outputs)
    if not np.isfinite(y).all():
        k = int(np.argmin(np.isfinite(y)))
        raise ValueError(f"theta: the output overflows at sample {k}: the model as it stands is unstable")
    return y


def _fed_back(forcing: Array, coefficients: Array, past: Array) -> Array:
    """Return the output of 1/(1 + c_1 q^-1 + ..) that goes on from past outputs, with their minus sign."""
    if not coefficients.size:
        return forcing
    a = np.concatenate(([1.0], coefficients))
    return np.asarray(scipy.signal.lfilter([1.0], a, forcing, zi=scipy.signal.lfiltic([1.0], a, -past))[0])
