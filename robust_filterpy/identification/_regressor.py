"""What a recursion remembers between samples, as plain arrays: the past signals that phi is made of."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.structures import Structure

# Beyond this the square of a signal, times P, leaves the range of floats.
LARGEST: Final = 1e100

# Standard deviations from which on an innovation makes its output one that a cleaned regressor replaces.
CLEANED_FROM: Final = 3.0


def bounded(value: float) -> float:
    """Return value, at most LARGEST in size; NaN, which is inf - inf here, becomes 0."""
    if -LARGEST <= value <= LARGEST:
        return value
    return math.copysign(LARGEST, value) if value == value else 0.0


class Layout:
    """Where each signal stands in phi and in the memory of a structure.

    The inputs of all lags stand in one array, u(k), u(k-1), .. of the first input and then of the next, so that one
    shift by one place makes them all a sample older.
    """

    def __init__(self, structure: Structure) -> None:
        """Work out the places."""
        starts: list[int] = []
        picks: list[int] = []
        used: list[int] = []
        length = 0
        for i, (nb, nk) in enumerate(structure.inputs):
            if nb:
                starts.append(length)
                picks.extend(range(length + nk, length + nk + nb))
                used.append(i)
                length += nk + nb
        self.n, self.na, self.nc, self.length = structure.n_theta, structure.na, structure.nc, length
        self.starts, self.picks, self.used = (np.array(v, dtype=np.intp) for v in (starts, picks, used))
        self.inputs_in_phi = slice(self.na, self.n - self.nc)
        self.direct = [i for i, (nb, nk) in enumerate(structure.inputs) if nb and nk == 0]
        self.part = structure.feeds_back
        self.order = 0 if self.part is None else self.part.stop - self.part.start

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shape of each array in the memory."""
        return {
            "outputs": (self.na,),
            "inputs": (self.length,),
            "residuals": (self.nc,),
            "gradients": (self.order, self.n),
            "measured": (self.na,),
        }


class Memory:
    """Past signals, newest first.

    ``outputs`` is the part of phi that belongs to them, with its minus sign, ``inputs`` has the newest input too, and
    ``gradients`` has a row phi(k-j) filtered by 1/A_hat for each past sample that the filter needs. ``measured`` is
    like ``outputs``, with the outputs as they were measured.
    """

    __slots__ = ("gradients", "inputs", "measured", "outputs", "residuals")

    def __init__(self, layout: Layout) -> None:
        """Start at rest."""
        self.outputs: Array
        self.inputs: Array
        self.residuals: Array
        self.gradients: Array
        self.measured: Array
        for name, shape in layout.shapes().items():
            setattr(self, name, np.zeros(shape))

    def with_input(self, layout: Layout, u: Array) -> Array:
        """Return what ``inputs`` becomes with the next input."""
        inputs = np.empty_like(self.inputs)
        inputs[1:] = self.inputs[:-1]
        inputs[layout.starts] = u[layout.used]
        return inputs

    def regressor(self, layout: Layout, inputs: Array) -> Array:
        """Return phi as a row, shape (1, n)."""
        H = np.empty((1, layout.n))
        phi = H[0]
        phi[: layout.na] = self.outputs
        phi[layout.inputs_in_phi] = inputs[layout.picks]
        phi[layout.n - layout.nc :] = self.residuals
        return H

    def regressors(self, layout: Layout, u: Array) -> tuple[Array, Array]:
        """Return phi of a recording, shape (N, n), with its inputs alone filled in, and ``inputs`` at its end."""
        length = len(u)
        phi = np.zeros((length, layout.n))
        inputs = self.inputs.copy()
        ends = [*layout.starts[1:], layout.length][: len(layout.starts)]
        column = layout.na
        for i, start, end in zip(layout.used, layout.starts, ends, strict=True):
            signal = np.concatenate((self.inputs[start:end][::-1], u[:, i]))
            inputs[start:end] = signal[: -(end - start) - 1 : -1]
            for lag in layout.picks[(layout.picks >= start) & (layout.picks < end)] - start:
                phi[:, column] = signal[end - start - lag : end - start - lag + length]
                column += 1
        return phi, inputs


def gradient(phi: Array, coefficients: Array, past: Array) -> Array:
    """Return psi(k) = phi(k) - f_1 psi(k-1) - .. - f_m psi(k-m), the derivative of the prediction."""
    psi = phi - coefficients.dot(past)
    if not psi.dot(psi) < LARGEST * LARGEST:
        psi = np.clip(np.nan_to_num(psi), -LARGEST, LARGEST)
    return psi


def pushed(past: Array, newest: Array | float) -> Array:
    """Return past values with a new one in front and the oldest gone."""
    if len(past) == 0:
        return past
    moved = np.empty_like(past)
    moved[1:] = past[:-1]
    moved[0] = newest
    return moved
