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
        self.n, self.length = structure.n_theta, length
        self.starts, self.picks, self.used = (np.array(v, dtype=np.intp) for v in (starts, picks, used))
        self.inputs_in_phi = slice(structure.na, structure.constant_place)
        self.direct = [i for i, (nb, nk) in enumerate(structure.inputs) if nb and nk == 0]
        self.stable = structure.stable_parts
        # The denominators of the prediction's derivative, one after the other; D is a numerator.
        places, none = structure.polynomials, slice(0, 0)
        self.has_disturbance = structure.nf + structure.nd > 0
        self.residuals = places.c
        if self.has_disturbance:
            self.outputs, self.undisturbed, self.part = places.d, places.f, places.c
        else:
            self.outputs, self.undisturbed = slice(0, structure.na), none
            self.part = none if structure.feeds_back is None else structure.feeds_back
        self.is_filtered = bool(self.stable) or self.has_disturbance
        #: Where what goes through B/F stands in phi.
        self.through = slice(structure.na, places.c.start)
        self.goes_through = np.isin(np.arange(self.n), np.arange(self.n)[self.through]).astype(float)
        self.na, self.nc, self.nf, self.order = (
            part.stop - part.start for part in (self.outputs, self.residuals, self.undisturbed, self.part)
        )

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shape of each array in the memory."""
        return {
            "outputs": (self.na,),
            "inputs": (self.length,),
            "residuals": (self.nc,),
            "gradients": (self.order, self.n),
            "measured": (self.na,),
            "undisturbed": (self.nf,),
            "prefiltered": (max(self.nf, self.na) if self.has_disturbance else 0, self.n),
        }


class Memory:
    """Past signals, newest first.

    ``outputs`` is the part of phi that belongs to them, with its minus sign, ``inputs`` has the newest input too, and
    ``gradients`` has a row phi(k-j) filtered by 1/A_hat for each past sample that the filter needs. ``measured`` is
    like ``outputs``, with the outputs as they were measured.

    Where the noise has a model of its own (Box and Jenkins), ``outputs`` and ``measured`` hold the disturbance,
    ``undisturbed`` what the inputs do, both with their minus sign, and ``prefiltered`` phi through 1/F_hat.
    """

    __slots__ = ("gradients", "inputs", "measured", "outputs", "prefiltered", "residuals", "undisturbed")

    def __init__(self, layout: Layout) -> None:
        """Start at rest."""
        self.outputs: Array
        self.inputs: Array
        self.residuals: Array
        self.gradients: Array
        self.measured: Array
        self.undisturbed: Array
        self.prefiltered: Array
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
        phi[layout.outputs] = self.outputs
        phi[layout.inputs_in_phi] = inputs[layout.picks]
        phi[layout.undisturbed] = self.undisturbed
        phi[layout.residuals] = self.residuals
        return H

    def regressors(self, layout: Layout, u: Array) -> tuple[Array, Array]:
        """Return phi of a recording, shape (N, n), with its inputs alone filled in, and ``inputs`` at its end."""
        length = len(u)
        phi = np.zeros((length, layout.n))
        inputs = self.inputs.copy()
        ends = [*layout.starts[1:], layout.length][: len(layout.starts)]
        column = layout.inputs_in_phi.start
        for i, start, end in zip(layout.used, layout.starts, ends, strict=True):
            signal = np.concatenate((self.inputs[start:end][::-1], u[:, i]))
            inputs[start:end] = signal[: -(end - start) - 1 : -1]
            for lag in layout.picks[(layout.picks >= start) & (layout.picks < end)] - start:
                phi[:, column] = signal[end - start - lag : end - start - lag + length]
                column += 1
        return phi, inputs


def gradient(layout: Layout, phi: Array, theta: Array, memory: Memory) -> tuple[Array, Array]:
    """Return psi(k), the derivative of the prediction, and what of it goes through F alone.

    psi(k) = phi(k) - f_1 psi(k-1) - .. with the coefficients of what feeds back. With a model of the noise
    chi = phi/F for inputs and what they do, and C psi = D chi for these, C psi = phi for the others.
    """
    newest = np.zeros(0)
    if layout.has_disturbance:
        chi = _bounded(phi - theta[layout.undisturbed].dot(memory.prefiltered[: layout.nf]))
        newest = chi * layout.goes_through
        phi = chi + theta[layout.outputs].dot(memory.prefiltered[: layout.na])
    return _bounded(phi - theta[layout.part].dot(memory.gradients)), newest


def _bounded(row: Array) -> Array:
    """Return a row of numbers that can be squared."""
    return row if row.dot(row) < LARGEST * LARGEST else np.clip(np.nan_to_num(row), -LARGEST, LARGEST)


def pushed(past: Array, newest: Array | float) -> Array:
    """Return past values with a new one in front and the oldest gone."""
    if len(past) == 0:
        return past
    moved = np.empty_like(past)
    moved[1:] = past[:-1]
    moved[0] = newest
    return moved
