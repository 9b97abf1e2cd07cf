"""Recordings through the compiled recursion, for one actuator or many."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.compiled import dispatch
from robust_filterpy.correction.options import Choices
from robust_filterpy.identification._regressor import Layout
from robust_filterpy.identification.guard import GUARDS
from robust_filterpy.identification.results import Columns
from robust_filterpy.identification.structures import ARX

#: Seconds that a sample takes by the definition, at least.
DEFINITION = 3e-5


class Recursion(NamedTuple):
    """What the recursion of n actuators with d parameters depends on besides their signals."""

    choices: tuple[Choices, ...]
    """Options of the correction, one for all or one each."""
    uses_model_output: bool
    cleans: bool
    """Whether the regressor holds cleaned outputs."""
    filtered: np.ndarray
    """Whether the gradient is filtered, (n,)."""
    guard: np.ndarray
    """One of `GUARDS`, (n,)."""
    F: Array
    """(1 or n, d, d)"""
    Q: Array
    """(1 or n, d, d)"""
    alpha_sq: Array
    """(n,)"""
    windup: Array
    """Trace of P beyond which theta and P stay under forgetting, (n,)."""


class Memories(NamedTuple):
    """Past signals of n actuators, newest first: the arrays of a `Memory` with a leading axis."""

    outputs: Array
    inputs: Array
    residuals: Array
    gradients: Array
    measured: Array
    undisturbed: Array
    prefiltered: Array


def serves(choices: tuple[Choices, ...], samples: float) -> bool:
    """Return whether the kernel takes so many samples, those of all actuators."""
    return all(map(dispatch.can_compile, choices)) and dispatch.ready(dispatch.TRACKING, samples * DEFINITION)


def advance(
    layout: Layout, recursion: Recursion, y: Array, phi: Array, r: Array, x: Array, P: Array, memory: Memories,
    scale: Array, out: Columns,
) -> np.ndarray:  # fmt: skip
    """Advance actuators in place and return the first sample of each that is left to the definition, or N.

    y (n, N) and phi (n, N, d), of which the inputs are filled in; r (n, 1 or N); x (n, d); P (n, d, d); scale (n, 4),
    R and the fields of `NoiseScale`, a memory of 0 where R is r; the columns of out have the axes (n, N) in front.
    """
    identity = np.eye(layout.n)
    moves = np.broadcast_to((recursion.F != identity).any(axis=(1, 2)), len(y))
    filtered = recursion.filtered & layout.is_filtered
    guard = [GUARDS.index(name) for name in recursion.guard]
    shared = (np.full(len(y), rule) for rule in (recursion.uses_model_output, recursion.cleans))
    rules = np.stack([filtered, guard, moves, *shared], axis=1).astype(np.int64)
    options = np.stack([dispatch.encoded(choice, 1) for choice in recursion.choices])
    parts = (layout.outputs, layout.residuals, layout.undisturbed, layout.through, layout.part, *layout.stable[:2])
    places = np.zeros((7, 2), dtype=np.int64)
    places[: len(parts)] = [(part.start, part.stop) for part in parts]
    done = np.zeros(len(y), dtype=np.int64)
    F, Q, alpha_sq, windup = map(dispatch.usable, recursion[5:])
    with dispatch.announced(dispatch.TRACKING):
        from robust_filterpy.identification._compiled_loop import track

        track(
            dispatch.usable(y), phi, dispatch.usable(r), F, Q, alpha_sq, windup, rules, options, places, x, P, memory,
            scale, out, done,
        )  # fmt: skip
    return done


def compile_kernel() -> None:
    """Take one sample of one actuator, so that numba compiles the recursion."""
    layout = Layout(ARX(1, 1))
    eye, one = np.eye(2)[None], np.ones(1)
    recursion = Recursion((Choices(),), False, False, np.array([False]), np.array(["none"]), eye, eye, one, one)
    memory = Memories(**{name: np.zeros((1, *shape)) for name, shape in layout.shapes().items()})
    advance(
        layout, recursion, one[None], np.zeros((1, 1, 2)), one[None], np.zeros((1, 2)), eye.copy(), memory,
        np.zeros((1, 4)), Columns.empty(1, 1, 2),
    )  # fmt: skip
