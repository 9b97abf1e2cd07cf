"""Learnt noise by the kernel: its rule, and half a step, by the definition where it declines."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction import learning, learnt, side_by_side
from robust_filterpy.correction.learning import NoiseClasses
from robust_filterpy.correction.learnt import Corrected
from robust_filterpy.correction.side_by_side import Models, Scales
from robust_filterpy.kernel.series import CORRECTION, PREDICTION, Rows, State, run

__all__ = ["Head", "begin", "correct", "predict", "rule"]


class Head(NamedTuple):
    """How the numbers of a rule begin, in the order of `rule_head` in online.c."""

    models: float
    """Scales of Q; they follow, and the scales of R."""
    classes: float
    stay: float
    jump: float
    memory: float
    r_memory: float
    learns: float
    draws: float
    """Whether the scale of Q is drawn anew in each step."""
    grouped: float
    """So many sensors fail with the first one of their group; -1: all with each other."""


@lru_cache(maxsize=64)
def rule(noise: NoiseClasses, process: Scales) -> Array:
    """Return what the kernel takes: sizes and options, scales of Q, scales of R, the memory at first, and who fails
    with whom.
    """
    drawn = () if process.probabilities is None else process.probabilities
    groups: Any = () if isinstance(noise.grouping, str) else noise.grouping
    leads = {i: min(group) for group in groups for i in group}
    named = -1 if noise.grouping == "joint" else max(leads, default=-1) + 1
    head = Head(
        len(process.scales), len(noise.scales), process.stay, process.jump, noise.memory, noise.r_memory, noise.learns,
        len(drawn) > 0, named,
    )  # fmt: skip
    start = learning.start(len(noise.scales), noise.probabilities)
    return np.array([*head, *process.scales, *noise.scales, *start, *drawn, *(leads.get(i, i) for i in range(named))])


def begin(models: Models, memory: Array) -> State:
    """Return copies of the arrays as a state, with room for the mean and the covariance of all."""
    n = models.x.shape[1]
    x, P, belief = models.packed
    return State(x.copy(), P.copy(), belief.copy(), memory.copy(), np.zeros(n), np.zeros((n, n)))


def predict(
    models: Models, F: Array, Q: Array, process: Scales, Bu: Array | None = None, alpha_sq: float = 1.0
) -> tuple[Models, Array, Array]:
    """Predict models of a filter: `robust_filterpy.correction.side_by_side.predict`."""
    n = len(F)
    state = begin(models, _SENSOR)
    model = (F[None], Q[None], np.zeros((1, 1, n)), np.ones((1, 1, 1)), None if Bu is None else Bu[None])
    if run(rule(_NOISE, process), state, np.full((1, 1), np.nan), model, Rows(), alpha_sq=alpha_sq, which=PREDICTION):
        return Models.unpacked(*state[:3]), state.x, state.P
    moved = side_by_side.predict(models, F, Q, process, Bu, alpha_sq)
    return moved, *side_by_side.merged(moved, process)


def correct(
    models: Models,
    memory: Array,
    z: Array,
    H: Array,
    R: Array,
    noise: NoiseClasses,
    process: Scales,
    M: Array | None = None,
    readings: Array | None = None,
) -> tuple[Corrected, Array, Array]:
    """Correct models of a filter by one measurement: `robust_filterpy.correction.learnt.correct`."""
    (m, n), state = H.shape, begin(models, memory)
    weights, outlying, likelihood = np.full((1, m), np.nan), np.zeros((1, m)), np.zeros(1)
    model = (_nothing(n), _nothing(n), H[None], R[None], None)
    into = Rows(weights=weights, outlying=outlying, log_likelihood=likelihood)
    said = None if readings is None else readings[None]
    if run(rule(noise, process), state, z[None], model, into, which=CORRECTION, readings=said, M=M):
        after = Models.unpacked(*state[:3])
        corrected = Corrected(after, state.learnt, float(likelihood[0]), weights[0], outlying[0])
        return corrected, state.x, state.P
    corrected = learnt.correct(models, memory, z, H, R, noise, process, M, readings)
    return corrected, *side_by_side.merged(corrected.models, process)


#: A prediction tells nothing of noise.
_NOISE = NoiseClasses((1.0,))
_SENSOR = _NOISE.start(1)


@lru_cache(maxsize=64)
def _nothing(n: int) -> Array:
    """Return F and Q of a half step that has none."""
    return np.zeros((1, n, n))
