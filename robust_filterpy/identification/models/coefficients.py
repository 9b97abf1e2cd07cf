"""A parameter vector as a model: its coefficients, its transfer function, its response."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy.signal

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.regressor import Layout, Memory
from robust_filterpy.identification.models.results import BoxJenkinsCoefficients, Coefficients, PolynomialCoefficients
from robust_filterpy.identification.models.structures import Structure


def coefficients(structure: Structure, theta: Array) -> Any:
    """Split theta."""
    if structure.takes_phi:
        raise ValueError(f"{structure}: expected a model with a, b, c; the coefficients of your regressor are theta")
    places = structure.polynomials
    b = tuple(theta[place] for place in places.b)
    first = b[0] if len(b) == 1 else b or theta[:0]
    a, f, c, d = (theta[place] for place in (places.a, places.f, places.c, places.d))
    if structure.form == "Structure" and structure.nf + structure.nd:
        return PolynomialCoefficients(a, first, f, c, d)
    if structure.form == "BoxJenkins":
        return BoxJenkinsCoefficients(first, f, c, d)
    return Coefficients(f if structure.form == "OutputError" else a, first, c)


def denominator(structure: Structure, theta: Array) -> Array:
    """Return A F, its leading 1 too."""
    a, f = (np.concatenate(([1.0], theta[part])) for part in (structure.polynomials.a, structure.polynomials.f))
    return np.convolve(a, f)


def poles(structure: Structure, theta: Array) -> Any:
    """Return the roots of A and F."""
    return np.concatenate(
        [np.roots([1.0, *theta[part]]) for part in (structure.polynomials.a, structure.polynomials.f)]
    )


def transfer_function(structure: Structure, theta: Array, dt: Any) -> Any:
    """Return B/(A F) as a control.TransferFunction."""
    import control

    if structure.takes_phi:
        coefficients(structure, theta)
    if not structure.inputs:
        raise ValueError(f"{structure}: expected a model with an input, this one has no transfer function")
    if dt is not True and not (_is_number(dt) and 0.0 < dt < math.inf):
        raise ValueError(f"dt: expected a sampling period > 0 in s, or True, got {dt!r}")
    whole, numerators, denominators = denominator(structure, theta), [], []
    for place, (nb, nk) in zip(structure.polynomials.b, structure.inputs, strict=True):
        numerator = np.zeros(max(whole.size, nk + nb) if nb else whole.size)
        numerator[nk : nk + nb] = theta[place]
        numerators.append(numerator if numerator.any() else np.zeros(1))
        denominators.append(np.pad(whole, (0, numerator.size - whole.size)))
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
    c, noise = theta[layout.c], np.zeros(len(u))
    # What noise is already in the memory goes on acting for nc samples.
    for k in range(min(c.size, len(u))):
        noise[k] = c[k:].dot(memory.residuals[: c.size - k])
    with np.errstate(over="ignore", invalid="ignore"):
        w = _fed_back(forcing, theta[layout.f], memory.undisturbed)
        disturbance = _fed_back(noise, theta[layout.d], memory.outputs[layout.na :])
        y = _fed_back(w + disturbance, theta[layout.a], memory.outputs[: layout.na])
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
