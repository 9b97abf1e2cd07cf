"""A parameter vector as a model: its coefficients, its transfer function, its response."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
import scipy.signal

from robust_filterpy._checks import Array
from robust_filterpy.identification._regressor import Layout, Memory
from robust_filterpy.identification.results import Coefficients
from robust_filterpy.identification.structures import LinearRegression, Structure


def coefficients(structure: Structure, theta: Array) -> Coefficients:
    """Split theta."""
    if isinstance(structure, LinearRegression):
        raise ValueError(f"{structure}: expected a model with a, b, c; the coefficients of your regressor are theta")
    ends = np.cumsum([structure.na, *(nb for nb, _ in structure.inputs)])
    b = tuple(theta[i:j] for i, j in pairwise(ends))
    return Coefficients(theta[: structure.na], b[0] if len(b) == 1 else b or theta[:0], theta[ends[-1] :])


def transfer_function(structure: Structure, theta: Array, dt: Any) -> Any:
    """Return B/A as a control.TransferFunction."""
    import control

    a, b, _ = coefficients(structure, theta)
    if not structure.inputs:
        raise ValueError(f"{structure}: expected a model with an input, this one has no transfer function")
    if dt is not True and not (_is_number(dt) and 0.0 < dt < math.inf):
        raise ValueError(f"dt: expected a sampling period > 0 in s, or True, got {dt!r}")
    numerators, denominators = [], []
    for part, (nb, nk) in zip(b if isinstance(b, tuple) else (b,), structure.inputs, strict=True):
        degree = max(a.size, nk + nb - 1) if nb else a.size
        numerator, denominator = np.zeros(degree + 1), np.zeros(degree + 1)
        numerator[nk : nk + nb] = part
        denominator[0] = 1.0
        denominator[1 : a.size + 1] = a
        numerators.append(numerator if numerator.any() else np.zeros(1))
        denominators.append(denominator)
    return control.tf([numerators], [denominators], dt)


def _is_number(value: Any) -> bool:
    """Tell whether value can be compared as a real number."""
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


def simulate(structure: Structure, layout: Layout, memory: Memory, theta: Array, u: Array) -> Array:
    """Run a model on its input alone, from what the memory holds; noise to come is 0."""
    phi, _ = memory.regressors(layout, u)
    forcing = phi.dot(theta)
    na, nc = structure.na, structure.nc
    # What noise is already in the memory goes on acting for nc samples.
    for k in range(min(nc, len(u))):
        forcing[k] += theta[theta.size - nc + k :].dot(memory.residuals[: nc - k])
    y = forcing
    with np.errstate(over="ignore", invalid="ignore"):
        if na:
            a = np.concatenate(([1.0], theta[:na]))
            y, _ = scipy.signal.lfilter([1.0], a, forcing, zi=scipy.signal.lfiltic([1.0], a, -memory.outputs))
    if not np.isfinite(y).all():
        k = int(np.argmin(np.isfinite(y)))
        raise ValueError(f"theta: the output overflows at sample {k}: the model as it stands is unstable")
    return y
