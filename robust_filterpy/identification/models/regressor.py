"""What a recursion remembers between samples, as plain arrays: the past signals that phi is made of."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.structures import Structure

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
    """Where each signal stands in phi and in the memory of a structure."""
    # The inputs of all lags stand in one array, u(k), u(k-1), .. of the first input and then of the next, so that one
    # shift by one place makes them all a sample older.

    def __init__(self, structure: Structure, constant: int = -1) -> None:
        """Work out the places; constant: which input is 1 in every sample and not among those that are given."""
        self.constant = constant
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
        self.stable, places = structure.stable_parts, structure.polynomials
        self.a, self.f, self.c, self.d = places.a, places.f, places.c, places.d
        self.na, self.nc, self.nd, self.nf = structure.na, structure.nc, structure.nd, structure.nf
        self.is_filtered = self.nc + self.nd + self.nf > 0
        where = np.arange(self.n)
        #: Where phi holds inputs, and what was measured: past outputs and disturbances.
        self.inputs_in_phi = np.concatenate([where[b] for b in places.b] or [where[:0]])
        self.outputs = np.concatenate((where[self.a], where[self.d]))
        #: What goes through B/F, and with A all that stands before the noise.
        self.through, self.before_noise = slice(self.na, self.c.start), slice(0, self.c.start)
        self.goes_through = np.isin(where, where[self.through]).astype(float)
        self.precedes_noise = np.isin(where, where[self.before_noise]).astype(float)

    @cached_property
    def numbers(self) -> np.ndarray:
        """The places as ``tracker.h`` wants them; an input that is the newest of its kind is -1 - its place."""
        newest = {int(place): -1 - i for i, place in enumerate(self.starts)}
        sources = [newest.get(int(pick), int(pick) - 1) for pick in self.picks]
        used = [-1 if i == self.constant else int(i) for i in self.used]
        first = int(self.inputs_in_phi[0]) if len(sources) else 0
        orders = (self.na, self.nc, self.nd, self.nf, self.a.start, self.c.start, self.d.start, self.f.start)
        sizes = (first, len(sources), self.length, len(used))
        return np.array([*orders, *sizes, *self.starts, *used, *sources], dtype=np.intp)

    def remembered(self, past: Array, y: float, before: float) -> Array:
        """Return -y and -d with those of one more sample; before: what stands before the noise in it."""
        return np.concatenate((pushed(past[: self.na], -y), pushed(past[self.na :], before - y)))

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Return the shape of each array in the memory."""
        return {
            "outputs": (self.na + self.nd,),
            "inputs": (self.length,),
            "residuals": (self.nc,),
            "gradients": (self.nc, self.n),
            "measured": (self.na + self.nd,),
            "undisturbed": (self.nf,),
            "prefiltered": (max(self.nf, self.nd), self.n),
        }


class Memory(NamedTuple):
    """Past signals, newest first; those of many actuators have an axis in front.

    ``outputs`` holds -y and then -d, the disturbances, as they stand in phi, and ``measured`` the same with the outputs
    as they were measured. ``undisturbed`` is -w, what the inputs do, and ``inputs`` has the newest input too.
    ``prefiltered`` has a row phi(k-j) filtered by 1/F_hat for each past sample that the gradient needs, and
    ``gradients`` one that went through D_hat/C_hat too.
    """

    outputs: Array
    measured: Array
    inputs: Array
    residuals: Array
    undisturbed: Array
    prefiltered: Array
    gradients: Array

    @classmethod
    def at_rest(cls, layout: Layout, *axes: int) -> Memory:
        """Return the memory of what has seen nothing."""
        return cls(**{name: np.zeros((*axes, *shape)) for name, shape in layout.shapes().items()})

    def with_input(self, layout: Layout, u: Array) -> Array:
        """Return what ``inputs`` becomes with the next input."""
        inputs = np.empty_like(self.inputs)
        inputs[..., 1:] = self.inputs[..., :-1]
        inputs[..., layout.starts] = u[..., layout.used]
        return inputs

    def regressor(self, layout: Layout, inputs: Array) -> Array:
        """Return phi, shape (.., n)."""
        phi = np.empty((*inputs.shape[:-1], layout.n))
        phi[..., layout.outputs] = self.outputs
        phi[..., layout.inputs_in_phi] = inputs[..., layout.picks]
        phi[..., layout.f] = self.undisturbed
        phi[..., layout.c] = self.residuals
        return phi

    def regressors(self, layout: Layout, u: Array) -> tuple[Array, Array]:
        """Return phi of a recording, shape (N, n), with its inputs alone filled in, and ``inputs`` at its end."""
        length = len(u)
        phi = np.zeros((length, layout.n))
        inputs = self.inputs.copy()
        ends = [*layout.starts[1:], layout.length][: len(layout.starts)]
        columns = iter(layout.inputs_in_phi)
        for i, start, end in zip(layout.used, layout.starts, ends, strict=True):
            signal = np.concatenate((self.inputs[start:end][::-1], u[:, i]))
            inputs[start:end] = signal[: -(end - start) - 1 : -1]
            for lag in layout.picks[(layout.picks >= start) & (layout.picks < end)] - start:
                phi[:, next(columns)] = signal[end - start - lag : end - start - lag + length]
        return phi, inputs


def gradient(layout: Layout, phi: Array, theta: Array, memory: Memory) -> tuple[Array, Array]:
    """Return psi(k), the derivative of the prediction, and what of it goes through F alone."""
    # chi = phi/F for inputs and what they do, and phi for past outputs; C psi = D chi for these, = phi for the others.
    chi = phi
    if layout.nf:
        chi = _bounded(phi - theta[layout.f].dot(memory.prefiltered[: layout.nf]) * layout.goes_through)
    psi = chi + theta[layout.d].dot(memory.prefiltered[: layout.nd]) if layout.nd else chi
    if layout.nc:
        psi = psi - theta[layout.c].dot(memory.gradients)
    return _bounded(psi), chi * layout.precedes_noise


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
