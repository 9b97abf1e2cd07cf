"""What a tracker does to one actuator, done to a stack of them: the same rules with a leading axis.

The definitions are `_memory`, `_sharpness` and `guard`; nothing here differs from them but the axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification._conditioning import _SHARPEST
from robust_filterpy.identification._regressor import LARGEST, Layout
from robust_filterpy.identification.guard import MOST_HALVINGS

# So many halvings are tried at once: numpy's calls cost more than a few more polynomials.
_TOGETHER = 6


class Past(NamedTuple):
    """Past signals of n actuators, newest first; each array of a `Memory` with a leading axis, never written into."""

    outputs: Array
    inputs: Array
    residuals: Array
    gradients: Array

    @classmethod
    def at_rest(cls, layout: Layout, n: int) -> Past:
        """Return the past of actuators at rest."""
        return cls(**{name: np.zeros((n, *shape)) for name, shape in layout.shapes().items()})

    def with_inputs(self, layout: Layout, u: Array) -> Array:
        """Return what ``inputs`` becomes with the next ones, u of shape (n, n_inputs)."""
        inputs = np.empty_like(self.inputs)
        inputs[:, 1:] = self.inputs[:, :-1]
        inputs[:, layout.starts] = u[:, layout.used]
        return inputs

    def regressors(self, layout: Layout, inputs: Array) -> Array:
        """Return phi of every actuator, shape (n, n_theta)."""
        phi = np.empty((len(inputs), layout.n))
        phi[:, : layout.na] = self.outputs
        phi[:, layout.inputs_in_phi] = inputs[:, layout.picks]
        phi[:, layout.n - layout.nc :] = self.residuals
        return phi


def rowwise(a: Array, b: Array) -> Array:
    """Return the scalar product of each row of a with the row of b, shape (n,)."""
    return np.asarray(np.einsum("ij,ij->i", a, b))


def all_pushed(past: Array, newest: Array) -> Array:
    """Return past values with new ones in front and the oldest gone."""
    if past.shape[1] == 0:
        return past
    moved = np.empty_like(past)
    moved[:, 1:] = past[:, :-1]
    moved[:, 0] = newest
    return moved


def all_bounded(values: Array) -> Array:
    """Return values, at most LARGEST in size; NaN becomes 0."""
    # False for NaN as well.
    if np.abs(values).max() <= LARGEST:
        return values
    return np.clip(np.nan_to_num(values, posinf=LARGEST, neginf=-LARGEST), -LARGEST, LARGEST)


def all_gradients(phi: Array, coefficients: Array, past: Array) -> Array:
    """Return psi(k) = phi(k) - f_1 psi(k-1) - .. - f_m psi(k-m) of each actuator."""
    psi = phi - np.einsum("ij,ijk->ik", coefficients, past)
    large = ~(rowwise(psi, psi) < LARGEST * LARGEST)
    if large.any():
        psi[large] = np.clip(np.nan_to_num(psi[large]), -LARGEST, LARGEST)
    return psi


def are_stable(coefficients: Array) -> np.ndarray:
    """Tell of each row c_1 .. c_m whether z^m + c_1 z^(m-1) + .. + c_m is stable, as `is_stable` does."""
    c = np.ascontiguousarray(coefficients.T)
    stable = np.ones(c.shape[1], dtype=bool)
    # The rows that have failed go on, to no avail: their divisors may be 0.
    with np.errstate(all="ignore"):
        while len(c):
            c, k = c[:-1], c[-1]
            stable &= np.abs(k) < 1.0
            if len(c):
                c = (c - k * c[::-1]) / (1.0 - k * k)
    return stable


def all_restrained(
    theta: Array, old: Array, part: slice, free: np.ndarray, halves: np.ndarray
) -> tuple[Array, np.ndarray]:
    """Return every theta as far as its guard lets it, and what the guard did, as `restrained` does.

    free and halves tell which actuators have no guard and which the guard "halve"; the others reject.
    """
    events = np.zeros(len(theta), dtype=np.int64)
    failed = ~(are_stable(theta[:, part]) | free)
    if not failed.any():
        return theta, events
    left = np.flatnonzero(failed & halves)
    step = theta[left] - old[left]
    theta = np.where(failed[:, None], old, theta)
    events[failed] = -1
    for first in range(1, MOST_HALVINGS + 1, _TOGETHER):
        if left.size == 0:
            break
        halvings = np.arange(first, min(first + _TOGETHER, MOST_HALVINGS + 1))
        shorter = old[left] + 0.5 ** halvings[:, None, None] * step
        stable = are_stable(shorter[:, :, part].reshape(-1, part.stop - part.start)).reshape(halvings.size, -1)
        found, at = stable.any(axis=0), stable.argmax(axis=0)
        theta[left[found]] = shorter[at[found], np.flatnonzero(found)]
        events[left[found]] = halvings[at[found]]
        left, step = left[~found], step[~found]
    return theta, events


def all_tempering(square: Array, trace: Array, r: Array) -> Array:
    """Return the factor, at most 1, by which to shrink each sample, as `tempering` does."""
    factor = np.ones_like(square)
    sharp = ~(square * trace <= _SHARPEST * r)
    if sharp.any():
        factor[sharp] = np.sqrt(_SHARPEST / square[sharp]) * np.sqrt(r[sharp] / trace[sharp])
    return factor


def all_repaired(P: Array) -> Array:
    """Return every P of a stack, or the nearest covariance to it, as `repaired` does."""
    symmetric = 0.5 * (P + P.transpose(0, 2, 1))
    values, vectors = np.linalg.eigh(symmetric)
    floor = np.finfo(float).eps * values[:, -1:]
    lost = values[:, 0] < -floor[:, 0]
    mended = (vectors * np.maximum(values, floor)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.where(lost[:, None, None], mended, symmetric)
