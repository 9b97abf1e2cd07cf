"""How a filter of many sensors predicts and corrects: pure functions from state to state, the other rooms' recursions.

`LearntNoise` is what `AdaptiveKalmanFilter` does, `BoundedInfluence` what `RobustKalmanFilter` does, on one vector of
all sensors' measurements in which whoever has not spoken is missing: what is learnt has a row for each component, so
every sensor has a noise, or a custom, of its own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from robust_filterpy._arrays import require_finite_prediction
from robust_filterpy._checks import Array
from robust_filterpy.correction import copies as side_by_side
from robust_filterpy.correction import spread
from robust_filterpy.correction.copies import Copies, Scales
from robust_filterpy.correction.definition import Innovation, correct, correct_by_custom, innovation_moments
from robust_filterpy.correction.learning import NoiseClasses, describe, usual
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.policies import process_scales
from robust_filterpy.fusion._first_readings import none_yet
from robust_filterpy.kernel import learnt as learnt_kernel
from robust_filterpy.kernel import series as series_kernel
from robust_filterpy.kernel.records import Model, Output

__all__ = ["BoundedInfluence", "LearntNoise", "Policy", "State", "series"]


class State(NamedTuple):
    """A filter between two moments; nothing in here is ever written to."""

    means: Array
    """Of the copies that differ in what they take the process for, (q, n)."""
    covariances: Array
    """(q, n, n)"""
    belief: Array
    """Which of them are likely, in which part of the state, (q + 2, n)."""
    memory: Array
    """What is known of each component's noise, (M, ..)."""
    x: Array
    """Mean of all, (n,)."""
    P: Array
    """Its covariance, (n, n)."""
    sizes: Array
    """Variance that stands for R where nobody told it, NaN until it is known, 1 elsewhere, (M,)."""
    u: Array
    """Control input in force, (dim_u,)."""
    trial: Array
    """First readings where nobody told R, (M, ..)."""


class Steps(NamedTuple):
    """What many steps left; written to as they are taken."""

    x: Array
    """(N, n)"""
    P: Array
    """(N, n, n)"""
    weights: Array
    """(N, M)"""


#: From a state, and the step that it stands before, to where the kernel came.
Advance = Callable[[State, int], tuple[State, int]]


def _copies(state: State) -> Copies:
    """Return the copies of a state."""
    return Copies(*state[:3])


class LearntNoise:
    """Copies side by side under noise that is a mixture of classes, learnt or told (`correction.learnt`).

    Parameters
    ----------
    noise : NoiseClasses
        Classes of measurement noise.
    process : Scales
        What the process may be.
    """

    def __init__(self, noise: NoiseClasses, process: Scales) -> None:
        """Keep the choices."""
        self.noise, self.doubt = noise, process

    def start(self, x: Array, P: Array, sizes: Array, u: Array) -> State:
        """Return the state before anything has happened."""
        M, begun = len(sizes), side_by_side.start(x, P, self.doubt)
        return State(*begun, self.noise.start(M), x, P, sizes, u, none_yet(M))

    def predicted(self, state: State, F: Array, Q: Array, drift: Array) -> State:
        """Return the state after a stretch of time."""
        found = self._of(*learnt_kernel.predict(_copies(state), F, Q, self.doubt, drift), state)
        require_finite_prediction(found.x, found.P)
        return found

    def weighed(self, state: State, z: Array, H: Array, R: Array, learns: Any) -> tuple[State, Array]:
        """Return the state after the readings of one moment, and their weights; learns: of whom noise is learnt."""
        one, x, P = learnt_kernel.correct(_copies(state), state.memory, z, H, R, self.noise, self.doubt)
        memory = one.memory
        if not np.all(learns):
            memory = np.where(np.asarray(learns)[:, None], memory, state.memory)
        return self._of(one.copies, x, P, state)._replace(memory=memory), one.weights

    def _of(self, copies: Copies, x: Array, P: Array, state: State) -> State:
        """Return copies, and x and P that they merge to, as a state."""
        return State(*copies, state.memory, x, P, state.sizes, state.u, state.trial)

    def factors(self, state: State) -> Array:
        """Return what a component's ordinary noise is over R, in variance, as learnt."""
        return np.asarray(state.memory[:, 0])

    def contamination(self, state: State) -> Array:
        """Return the share of outliers of each component, as learnt."""
        return describe(state.memory, np.array(self.noise.scales)).contamination

    def classes(self, state: State) -> tuple[Array, Array]:
        """Return the factors of ordinary noise's variance that outliers may have, and their shares."""
        scales = np.array(self.noise.scales)
        return scales, np.array([usual(row, len(scales)) for row in state.memory])

    def process(self, state: State) -> float:
        """Return the factor of Q that is thought likely."""
        return float(np.exp(np.mean(np.log(self.doubt.scales) @ side_by_side.slow(_copies(state), self.doubt))))

    def kernel(self, zs: Array, model: tuple[Array, ...], into: Steps) -> Advance:
        """Return what takes the kernel's steps, as many as it can."""
        F, Q, drift, H, R = model
        kept = learnt_kernel.Kept(into.x, into.P.reshape(len(zs), -1), weights=into.weights)

        def advance(state: State, first: int) -> tuple[State, int]:
            stands = learnt_kernel.begin(_copies(state), state.memory)
            reached = learnt_kernel.run(stands, zs, (F, Q, H, R, drift), self.noise, self.doubt, kept, first=first)
            if reached > first:
                state = self._of(Copies(*stands[:3]), stands.x, stands.P, state)._replace(memory=stands.learnt)
            return state, reached

        return advance


class BoundedInfluence:
    """One state and a bounded influence function, by custom or as told (`correction.definition`).

    Parameters
    ----------
    choices : Choices
        Influence function, scaling, information, grouping.
    """

    def __init__(self, choices: Choices) -> None:
        """Keep the choices."""
        self.choices = choices
        self.by_custom = choices.scaling == "learnt" and not choices.is_linear

    def start(self, x: Array, P: Array, sizes: Array, u: Array) -> State:
        """Return the state before anything has happened."""
        one = side_by_side.start(x, P, process_scales(None))
        return State(*one, spread.begin(len(sizes)), x, P, sizes, u, none_yet(len(sizes)))

    def predicted(self, state: State, F: Array, Q: Array, drift: Array) -> State:
        """Return the state after a stretch of time."""
        x, P = F @ state.x + drift, F @ state.P @ F.T + Q
        P = 0.5 * (P + P.T)
        require_finite_prediction(x, P)
        return state._replace(x=x, P=P, means=x[None], covariances=P[None])

    def weighed(self, state: State, z: Array, H: Array, R: Array, learns: Any) -> tuple[State, Array]:
        """Return the state after the readings of one moment, and their weights."""
        part = np.flatnonzero(~np.isnan(z))
        weights, H, R, memory = np.full(len(z), np.nan), H[part], R[np.ix_(part, part)], state.memory
        y, choices = z[part] - H @ state.x, self._of_those(part)
        C, S = innovation_moments(state.P, H, R)
        if self.by_custom:
            found = correct_by_custom(memory[part], state.x, state.P, Innovation(z[part], y, C, S, R, H), choices)
            memory = memory.copy()
            memory[part] = np.where(np.broadcast_to(learns, len(z))[part, None], found.memory, memory[part])
        else:
            found = correct(state.x, state.P, y, C, S, choices)
        weights[part] = found.weights
        state = state._replace(x=found.x, P=found.P, means=found.x[None], covariances=found.P[None], memory=memory)
        return state, weights

    def _of_those(self, part: np.ndarray) -> Choices:
        """Return the choices with the groups of those that have spoken."""
        if self.choices.grouping == "component":
            return self.choices
        groups = [tuple(np.flatnonzero(np.isin(part, group)).tolist()) for group in self.choices.grouping]
        return self.choices.changed(grouping=tuple(group for group in groups if group))

    def factors(self, state: State) -> Array:
        """Return what a component's innovations are over what was told, in variance, as learnt."""
        known = state.memory[:, spread.WEIGHT] > 0
        return np.where(known & self.by_custom, state.memory[:, spread.SPREAD] ** 2, 1.0)

    def contamination(self, state: State) -> Array:
        """Return the share of far innovations of each component, NaN where none is learnt."""
        known = state.memory[:, spread.WEIGHT] > 0
        return np.where(known & self.by_custom, state.memory[:, spread.SHARE], np.nan)

    def classes(self, state: State) -> tuple[Array, Array]:
        """Return the factors of ordinary noise's variance that outliers may have, and their shares."""
        share = np.clip(np.nan_to_num(self.contamination(state)), 0.01, 0.4)[:, None]
        return np.array([1.0, 100.0]), np.concatenate([1.0 - share, share], axis=1)

    def process(self, state: State) -> float:
        """Return the factor of Q that is thought likely."""
        return 1.0

    def kernel(self, zs: Array, model: tuple[Array, ...], into: Steps) -> Advance:
        """Return what takes the kernel's steps, as many as it can."""
        F, Q, drift, H, R = model
        n = into.x.shape[1]
        kept = Output(into.x[None], into.P[None], np.empty((1, 0, n)), np.empty((1, 0, n, n)), into.weights[None],
                      np.zeros(1))  # fmt: skip
        stacks = Model(F[None], Q[None], H[None], R[None], drift[None])

        def advance(state: State, first: int) -> tuple[State, int]:
            if not series_kernel.serves(self.choices):
                return state, first
            x, P, memory = state.x[None].copy(), state.P[None].copy(), state.memory[None].copy()
            reached = series_kernel.filter_series(
                self.choices, zs[None], stacks, x, P, kept, memory=memory, start=first
            )  # fmt: skip
            return state._replace(x=x[0], P=P[0], means=x, covariances=P, memory=memory[0]), int(reached[0])

        return advance


#: What a fusion asks of a filter. Both have the methods that `LearntNoise` has.
Policy: TypeAlias = LearntNoise | BoundedInfluence


def series(
    policy: Policy, state: State, zs: Array, F: Array, Q: Array, drift: Array, H: Array, R: Array
) -> tuple[Array, Array, Array, State]:
    """Return x, P, weights of many steps, and the last state; by the kernel, each step that it declines by the policy.

    Parameters
    ----------
    policy : Policy
        What predicts and corrects.
    state : State
        Before the first step.
    zs : ndarray, shape (N, M)
        Readings, NaN where missing.
    F, Q, drift, H, R : ndarray, shape (N, ..) or (1, ..)
        Of each step, or of all.

    Returns
    -------
    x, P, weights : ndarray, shape (N, n), (N, n, n), (N, M)
    state : State
    """
    n, model, first = len(state.x), (F, Q, drift, H, R), 0
    steps = Steps(np.empty((len(zs), n)), np.empty((len(zs), n, n)), np.empty(zs.shape))
    advance = policy.kernel(zs, model, steps)
    while first < len(zs):
        state, reached = advance(state, first)
        if reached == first:
            F_k, Q_k, drift_k, H_k, R_k = (part[first % len(part)] for part in model)
            moved = policy.predicted(state, F_k, Q_k, drift_k)
            state, steps.weights[first] = policy.weighed(moved, zs[first], H_k, R_k, True)
            steps.x[first], steps.P[first], reached = state.x, state.P, first + 1
        first = reached
    return (*steps, state)
