"""How a filter of many sensors predicts and corrects: pure functions from state to state, the other rooms' recursions.

`LearntNoise` is what `AdaptiveKalmanFilter` does, `BoundedInfluence` what `RobustKalmanFilter` does, on one vector of
all sensors' measurements in which whoever has not spoken is missing: what is learnt has a row for each component, so
every sensor has a noise, or a custom, of its own.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np

from robust_filterpy._arrays import require_finite_prediction
from robust_filterpy._checks import Array
from robust_filterpy.correction import copies as side_by_side
from robust_filterpy.correction import spread
from robust_filterpy.correction.copies import Copies, Scales
from robust_filterpy.correction.definition import Innovation, correct, correct_by_custom, innovation_moments
from robust_filterpy.correction.learning import NoiseClasses, describe, usual
from robust_filterpy.correction.options import Choices
from robust_filterpy.fusion._first_readings import none_yet
from robust_filterpy.kernel import learnt as learnt_kernel
from robust_filterpy.kernel import series as series_kernel
from robust_filterpy.kernel.records import Model, Output

__all__ = ["BoundedInfluence", "LearntNoise", "Policy", "State"]


class State(NamedTuple):
    """A filter between two moments; nothing in here is ever written to."""

    means: Array
    """Of the copies that differ in what they take the process for, (q, n)."""
    covariances: Array
    """(q, n, n)"""
    probabilities: Array
    """(q,)"""
    memory: Array
    """What is known of each component's noise, (M, ..)."""
    x: Array
    """Mean of all, (n,)."""
    P: Array
    """Its covariance, (n, n)."""
    unseen: float
    """Chance that the state has jumped since the last measurement."""
    sizes: Array
    """Variance that stands for R where nobody told it, NaN until it is known, 1 elsewhere, (M,)."""
    u: Array
    """Control input in force, (dim_u,)."""
    trial: Array
    """First readings where nobody told R, (M, ..)."""


class Policy(Protocol):
    """What a fusion asks of a filter."""

    def start(self, x: Array, P: Array, sizes: Array, u: Array) -> State:
        """Return the state before anything has happened."""

    def predicted(self, state: State, F: Array, Q: Array, drift: Array) -> State:
        """Return the state after a stretch of time."""

    def corrected(self, state: State, z: Array, H: Array, R: Array, learns: Any) -> State:
        """Return the state after the readings of one moment; learns: which components' noise is learnt from them."""

    def factors(self, state: State) -> Array:
        """Return what a component's ordinary noise is over R, in variance, as learnt, (M,)."""

    def contamination(self, state: State) -> Array:
        """Return the share of outliers of each component, (M,); NaN where none is learnt."""

    def classes(self, state: State) -> tuple[Array, Array]:
        """Return the factors of ordinary noise's variance that outliers may have, (C,), and their shares, (M, C)."""

    def process(self, state: State) -> float:
        """Return the factor of Q that is thought likely."""

    def series(self, state: State, zs: Array, F: Array, Q: Array, drift: Array, H: Array, R: Array) -> tuple[Any, ...]:
        """Return x (N, n), P (N, n, n) and weights (N, M) of many steps, and the last state."""


def _copies(state: State) -> Copies:
    """Return the copies of a state."""
    return Copies(*state[:3], state.unseen)


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
        begun = side_by_side.start(x, P, self.doubt)
        return State(
            begun.x,
            begun.P,
            begun.probabilities,
            self.noise.start(len(sizes)),
            x,
            P,
            begun.unseen,
            sizes,
            u,
            none_yet(len(sizes)),
        )

    def predicted(self, state: State, F: Array, Q: Array, drift: Array) -> State:
        """Return the state after a stretch of time."""
        found = self._of(*learnt_kernel.predict(_copies(state), F, Q, self.doubt, drift), state)
        require_finite_prediction(found.x, found.P)
        return found

    def corrected(self, state: State, z: Array, H: Array, R: Array, learns: Any) -> State:
        """Return the state after the readings of one moment."""
        one, x, P = learnt_kernel.correct(_copies(state), state.memory, z, H, R, self.noise, self.doubt)
        memory = one.memory
        if not np.all(learns):
            memory = np.where(np.asarray(learns)[:, None], memory, state.memory)
        return self._of(one.copies, x, P, state)._replace(memory=memory)

    def _taken(self, stands: learnt_kernel.State, state: State) -> State:
        """Return where the kernel stands as a state."""
        copies = Copies(*stands[:3], float(stands.unseen[0]))
        return self._of(copies, stands.x, stands.P, state)._replace(memory=stands.learnt)

    def _of(self, copies: Copies, x: Array, P: Array, state: State) -> State:
        """Return copies, and x and P that they merge to, as a state."""
        return State(*copies[:3], state.memory, x, P, copies.unseen, state.sizes, state.u, state.trial)

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
        shares = state.probabilities[: len(self.doubt.scales)]
        return float(np.exp(shares @ np.log(self.doubt.scales) / shares.sum()))

    def series(self, state: State, zs: Array, F: Array, Q: Array, drift: Array, H: Array, R: Array) -> tuple[Any, ...]:
        """Return x, P, weights of many steps, and the last state; by the kernel, else step by step."""
        steps, (n, m) = len(zs), (len(state.x), zs.shape[1])
        x, P, weights = np.empty((steps, n)), np.empty((steps, n * n)), np.empty((steps, m))
        kept, first = learnt_kernel.Kept(x, P, weights=weights), 0
        while first < steps:
            stands = learnt_kernel.begin(_copies(state), state.memory)
            reached = learnt_kernel.run(stands, zs, (F, Q, H, R, drift), self.noise, self.doubt, kept, first=first)
            if reached > first:
                state, first = self._taken(stands, state), reached
                continue
            i, h = (first if len(F) > 1 else 0), (first if len(H) > 1 else 0)
            moved = self.predicted(state, F[i], Q[i], drift[first if len(drift) > 1 else 0])
            told = (zs[first], H[h], R[0], self.noise, self.doubt)
            one, mean, covariance = learnt_kernel.correct(_copies(moved), moved.memory, *told)
            state = self._of(one.copies, mean, covariance, moved)._replace(memory=one.memory)
            x[first], P[first], weights[first], first = state.x, state.P.ravel(), one.weights, first + 1
        return x, P.reshape(steps, n, n), weights, state


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
        return State(x[None], P[None], np.ones(1), spread.begin(len(sizes)), x, P, 0.0, sizes, u, none_yet(len(sizes)))

    def predicted(self, state: State, F: Array, Q: Array, drift: Array) -> State:
        """Return the state after a stretch of time."""
        x, P = F @ state.x + drift, F @ state.P @ F.T + Q
        P = 0.5 * (P + P.T)
        require_finite_prediction(x, P)
        return state._replace(x=x, P=P, means=x[None], covariances=P[None])

    def corrected(self, state: State, z: Array, H: Array, R: Array, learns: Any) -> State:
        """Return the state after the readings of one moment."""
        return self._corrected(state, z, H, R, learns)[0]

    def _corrected(self, state: State, z: Array, H: Array, R: Array, learns: Any) -> tuple[State, Array]:
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

    def series(self, state: State, zs: Array, F: Array, Q: Array, drift: Array, H: Array, R: Array) -> tuple[Any, ...]:
        """Return x, P, weights of many steps, and the last state; by the kernel, else step by step."""
        steps, (n, m) = len(zs), (len(state.x), zs.shape[1])
        x, P, weights = np.empty((1, steps, n)), np.empty((1, steps, n, n)), np.empty((1, steps, m))
        kept = Output(x, P, np.empty((1, 0, n)), np.empty((1, 0, n, n)), weights, np.zeros(1))
        first = 0
        while first < steps:
            reached = first
            if series_kernel.serves(self.choices):
                at, cov, memory = state.x[None].copy(), state.P[None].copy(), state.memory[None].copy()
                model = Model(F[None], Q[None], H[None], R[None], drift[None])
                reached = int(
                    series_kernel.filter_series(
                        self.choices, zs[None], model, at, cov, kept, memory=memory, start=first
                    )[0]
                )
                state = state._replace(x=at[0], P=cov[0], means=at, covariances=cov, memory=memory[0])
            if reached == first:
                i, h = (first if len(F) > 1 else 0), (first if len(H) > 1 else 0)
                state = self.predicted(state, F[i], Q[i], drift[first if len(drift) > 1 else 0])
                state, weights[0, first] = self._corrected(state, zs[first], H[h], R[0], True)
                x[0, first], P[0, first] = state.x, state.P
                reached = first + 1
            first = reached
        return x[0], P[0], weights[0], state
