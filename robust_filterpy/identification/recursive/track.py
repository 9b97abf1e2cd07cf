"""Recordings through the recursion by the kernel (``tracker.h``), for one actuator or many."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import kernel
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices
from robust_filterpy.identification.models.guard import GUARDS
from robust_filterpy.identification.models.regressor import Layout
from robust_filterpy.identification.models.results import Columns
from robust_filterpy.kernel.series import SCALINGS, rule


class Recursion(NamedTuple):
    """What the recursion of n actuators with d parameters depends on besides their signals."""

    choices: tuple[Choices, ...]
    """Options of the correction, one for all or one each."""
    cleans: bool
    """Whether the regressor holds cleaned outputs."""
    filtered: Any
    """Whether the gradient is filtered, (n,)."""
    guard: Any
    """One of `GUARDS`, (n,)."""
    learns: Any
    """Whether theta moves, (n,)."""
    F: Array
    """(1 or n, d, d)"""
    Q: Array
    """(1 or n, d, d)"""
    alpha_sq: Array
    """(n,)"""
    windup: Array
    """Trace of P beyond which theta and P stay under forgetting, (n,)."""
    centre: Array
    """What is taken off the outputs, (n,)."""


class Memories(NamedTuple):
    """Past signals of n actuators, newest first: the arrays of a `Memory` with a leading axis."""

    outputs: Array
    measured: Array
    inputs: Array
    residuals: Array
    undisturbed: Array
    prefiltered: Array
    gradients: Array


def serves(choices: tuple[Choices, ...]) -> bool:
    """Return whether the kernel takes samples under these options: a tracker's spread is not learnt, R is."""
    learnt = float(SCALINGS.index("learnt"))
    rules = (rule(choice) for choice in choices)
    return kernel.extension() is not None and all(one is not None and one[4] != learnt for one in rules)


def advance(
    layout: Layout,
    recursion: Recursion,
    y: Array,
    u: Array,
    r: Array | None,
    theta: Array,
    P: Array,
    memory: Memories,
    scale: Array,
    out: Columns,
) -> np.ndarray:
    """Advance actuators in place and return the first sample of each that is left to the definition, or N.

    y and r (n, N), NaN where y is missing, r None for the R in scale; u (n, N, inputs); theta (n, d); P (n, d, d);
    scale (n, 4), R and the fields of `NoiseScale`; the columns of out have the axes (n, N) in front. What is written
    into is C-contiguous.
    """
    choices, cleans, filtered, guard, learns, F, Q, *rest = recursion
    rules = np.stack([rule(choice) for choice in choices])  # type: ignore[misc]
    flags = np.empty((len(y), 4), dtype=np.intp)
    flags[:, 0], flags[:, 1] = filtered, [GUARDS.index(name) for name in guard]
    flags[:, 2], flags[:, 3] = cleans, learns
    done = np.zeros(len(y), dtype=np.intp)
    kernel.extension().track(
        layout.numbers, (rules, _plain(F), _plain(Q), *map(_plain, rest), flags), (y, u, r),
        (theta, P, *memory, scale), tuple(out), done,
    )  # fmt: skip
    return done


def _plain(array: Array) -> Array:
    """Return an array as the kernel takes it."""
    return np.ascontiguousarray(array, dtype=np.float64)
