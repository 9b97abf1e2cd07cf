"""How a filter of many sensors predicts and corrects: pure functions from state to state, the other rooms' recursions.

`LearntNoise` is what `AdaptiveKalmanFilter` does, `BoundedInfluence` what `RobustKalmanFilter` does, on one vector of
all sensors' measurements in which whoever has not spoken is missing: what is learnt has a row for each component, so
every sensor has a noise, or a custom, of its own.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np

from robust_filterpy._arrays import require_finite_prediction
from robust_filterpy._checks import Array
from robust_filterpy.correction import copies as side_by_side
from robust_filterpy.correction import spread
from robust_filterpy.correction.copies import Copies, Scales
from robust_filterpy.correction.learning import describe, usual
from robust_filterpy.correction.policies import process_scales
from robust_filterpy.correction.result import Correction
from robust_filterpy.fusion._first_readings import none_yet
from robust_filterpy.kernel import learnt as learnt_kernel
from robust_filterpy.kernel.record import weights_of
from robust_filterpy.kernel.records import Kept

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

    @property
    def kept(self) -> None:
        """What a filter's policy keeps besides: nothing that is not here."""


class Steps(NamedTuple):
    """What many steps left; written to as they are taken."""

    x: Array
    """(N, n)"""
    P: Array
    """(N, n, n)"""
    weights: Array
    """(N, M)"""


def _copies(state: State) -> Copies:
    """Return the copies of a state."""
    return Copies(*state[:3])


class _Judged:
    """What both policies are: a filter's policy and the copies that it begins with.

    Parameters
    ----------
    judge : robust_filterpy.filters policy
        What judges the measurements of a filter.
    """

    doubt: Scales = process_scales(None)

    def __init__(self, judge: Any) -> None:
        """Keep it."""
        self.judge = judge

    def start(self, x: Array, P: Array, sizes: Array, u: Array) -> State:
        """Return the state before anything has happened."""
        M, begun = len(sizes), side_by_side.start(x, P, self.doubt)
        return State(*begun, self.judge.begin(M), x, P, sizes, u, none_yet(M))

    def advance(self, state: State, zs: Array, model: tuple[Array, ...], into: Kept, first: int) -> tuple[State, int]:
        """Take steps as far as the kernel can, and return where it came."""
        stands = learnt_kernel.begin(_copies(state), state.memory)
        stands.x[:], stands.P[:] = state.x, state.P
        reached = self.judge.advance(stands, zs, model, into, first=first)
        return (self._reached(stands, state) if reached > first else state), reached

    def _reached(self, stands: learnt_kernel.State, state: State) -> State:
        """Return where the kernel came, as a state."""
        raise NotImplementedError


class LearntNoise(_Judged):
    """Copies side by side under noise that is a mixture of classes, learnt or told (`filters._mixture.Mixture`)."""

    def __init__(self, judge: Any) -> None:
        """Keep the choices."""
        super().__init__(judge)
        self.noise, self.doubt = judge.classes, judge.scales

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

    def _reached(self, stands: learnt_kernel.State, state: State) -> State:
        """Return where the kernel came, as a state."""
        return self._of(Copies(*stands[:3]), stands.x, stands.P, state)._replace(memory=stands.learnt)


class BoundedInfluence(_Judged):
    """One state and a bounded influence function, by custom or as told (`filters._bounded.Bounded`)."""

    def predicted(self, state: State, F: Array, Q: Array, drift: Array) -> State:
        """Return the state after a stretch of time."""
        x, P, _ = self.judge.predicted(None, state.x, state.P, F, Q, drift, 1.0)
        require_finite_prediction(x, P)
        return self._at(x, P, state)

    def weighed(self, state: State, z: Array, H: Array, R: Array, learns: Any) -> tuple[State, Array]:
        """Return the state after the readings of one moment, and their weights."""
        seen = ~np.isnan(z)
        if not seen.any():
            return state, np.full(len(z), np.nan)
        found, _ = self.judge.corrected(state, state.x, state.P, z, H, R, None, None)
        if self.judge.learns:
            keeps = (seen & np.broadcast_to(learns, len(z)))[:, None]
            state = state._replace(memory=np.where(keeps, found.memory, state.memory))
        weights = found.weights if isinstance(found, Correction) else weights_of(found.record)
        return self._at(found.x, found.P, state), weights

    def _at(self, x: Array, P: Array, state: State) -> State:
        """Return a state elsewhere."""
        return state._replace(x=x, P=P, means=x[None], covariances=P[None])

    def _reached(self, stands: learnt_kernel.State, state: State) -> State:
        """Return where the kernel came, as a state."""
        return self._at(stands.x, stands.P, state)._replace(memory=stands.learnt)

    def factors(self, state: State) -> Array:
        """Return what a component's innovations are over what was told, in variance, as learnt."""
        known = state.memory[:, spread.WEIGHT] > 0
        return np.where(known & self.judge.learns, state.memory[:, spread.SPREAD] ** 2, 1.0)

    def contamination(self, state: State) -> Array:
        """Return the share of far innovations of each component, NaN where none is learnt."""
        known = state.memory[:, spread.WEIGHT] > 0
        return np.where(known & self.judge.learns, state.memory[:, spread.SHARE], np.nan)

    def classes(self, state: State) -> tuple[Array, Array]:
        """Return the factors of ordinary noise's variance that outliers may have, and their shares."""
        share = np.clip(np.nan_to_num(self.contamination(state)), 0.01, 0.4)[:, None]
        return np.array([1.0, 100.0]), np.concatenate([1.0 - share, share], axis=1)

    def process(self, state: State) -> float:
        """Return the factor of Q that is thought likely."""
        return 1.0


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
    n, model, first = len(state.x), (F, Q, H, R, drift), 0
    steps = Steps(np.empty((len(zs), n)), np.empty((len(zs), n, n)), np.empty(zs.shape))
    into = Kept(steps.x, steps.P.reshape(len(zs), n * n), weights=steps.weights)
    while first < len(zs):
        state, reached = policy.advance(state, zs, model, into, first)
        if reached == first:
            F_k, Q_k, H_k, R_k, drift_k = (part[first % len(part)] for part in model)
            moved = policy.predicted(state, F_k, Q_k, drift_k)
            state, steps.weights[first] = policy.weighed(moved, zs[first], H_k, R_k, True)
            steps.x[first], steps.P[first], reached = state.x, state.P, first + 1
        first = reached
    return (*steps, state)
