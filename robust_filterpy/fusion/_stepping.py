"""One step of a fusion as a pure function: what happens between two stamps, and at the second of them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.fusion._policies import Policy, State, compared, predicted, series, start, weighed
from robust_filterpy.fusion._watch import Looked, coasted, fresh, looked_at
from robust_filterpy.fusion.motion import Motion
from robust_filterpy.fusion.sensors import Layout

__all__ = ["FAR", "Moment", "Setup", "advanced", "aged", "begun", "covariance", "moved"]

# What the first readings tell of a noise that nobody gave is worth so many samples.
_UNTOLD = 2.0
#: A reading is far beyond so many standard deviations.
FAR = 6.0


class Setup(NamedTuple):
    """What does not change while a fusion runs."""

    motion: Motion
    layout: Layout
    policy: Policy
    watches: bool = False
    """Whether there are verdicts about the sensors."""
    reacquire: Any = None
    """What is to be expected after a blackout (`reacquisition.Reacquisition`); None if nothing is ever in doubt."""


class Moment(NamedTuple):
    """What there is after everything of one stamp has been judged; nothing in here is ever written to."""

    state: State
    watch: Any = None
    """What was learned of the sensors' health (`_watch.Watch`); None if nobody looks."""
    failed: tuple[tuple[str, str], ...] = ()
    """Sensors whose reading could not be used, since a function of theirs has no answer for this state, and why."""
    doubt: Any = None
    """Hypotheses about a sensor or the state (`reacquisition.Doubt`); None if there is no doubt."""
    far: int = -1
    """Sensor with the farthest reading, if it is far beyond what is expected and that is looked for; else -1."""
    anew: bool = False
    """Whether the state is not the one to which the step led: a doubt has been decided, or is served."""


def begun(setup: Setup, x: Array, P: Array) -> Moment:
    """Return the moment before the first stamp."""
    layout, policy = setup.layout, setup.policy
    sizes = np.where(layout.untold, np.nan, 1.0)
    state = start(policy, x, P, sizes, np.zeros(setup.motion.dim_u))
    scales = policy.shares(state.memory)[0]
    return Moment(state, fresh(layout.n, layout.size, len(layout.parties), scales) if setup.watches else None)


def moved(setup: Setup, state: State, seconds: float) -> State:
    """Return the state some seconds later, with nothing read."""
    if seconds == 0.0:
        return state
    return predicted(setup.policy, state, *setup.motion.over(seconds, state.x, state.u))


def advanced(setup: Setup, before: Moment, seconds: float, z: Array, control: Array | None) -> Moment:
    """Return the moment some seconds later, when something was read or a control input changed."""
    layout, policy, state, watch = setup.layout, setup.policy, before.state, before.watch
    step = setup.motion.over(seconds, state.x, state.u)
    if control is not None:
        state = state._replace(u=control)
    looks = watch is not None or setup.reacquire is not None
    if not (looks or layout.curved or layout.any_untold):
        # Nobody looks in between.
        return Moment(series(policy, state, z[None], *(part[None] for part in (*step, layout.H, layout.R)))[3])
    state = predicted(policy, state, *step)
    watch = None if watch is None else coasted(watch, step.F, seconds)
    if np.isnan(z).all():
        return Moment(aged(state, seconds, z), watch)
    seen = layout.seen_from(state.x, z)
    y = seen.z - seen.H @ state.x
    if layout.any_untold:
        # What goes round in circles is compared as the difference to what was expected.
        state = aged(state, seconds, np.where(layout.is_curved, y, seen.z))
        y = np.where(np.isnan(state.sizes), np.nan, y)
    if np.isnan(y).all():
        return Moment(state, watch, seen.failed)
    R, used, learns = covariance(layout, state.sizes), seen.z, True
    if layout.any_untold:
        used = np.where(np.isnan(y), np.nan, used)
    if watch is not None and watch.fault.any():
        # Nothing is learned of a sensor on alarm, and nothing taken from one that lies.
        learns = (watch.fault != 1.0)[layout.party]
        used = np.where(watch.out[layout.party], np.nan, used)
    after, weights = weighed(policy, state, used, seen.H, R, learns)
    if not looks:
        return Moment(after, watch, seen.failed)
    if watch is not None:
        watch = looked_at(watch, Looked(z, y, seen.H, R.diagonal(), weights, policy, state), layout.party)
    if setup.reacquire is None:
        return Moment(after, watch, seen.failed)
    spread = ((seen.H @ state.P) * seen.H).sum(axis=1)
    e = np.abs(np.where(np.isnan(used), 0.0, y)) / np.sqrt(spread + policy.factors(state.memory) * R.diagonal())
    return Moment(after, watch, seen.failed, None, int(layout.owner[np.argmax(e)]) if e.max() > FAR else -1)


def aged(state: State, seconds: float, values: Array) -> State:
    """Return the state that has the first readings of sensors whose R nobody gave."""
    trial, sizes = compared(state.trial, state.sizes, seconds, values)
    if trial is state.trial:
        return state
    estimated = np.isnan(state.sizes) & ~np.isnan(sizes)
    memory = state.memory
    if estimated.any():
        memory = memory.copy()
        memory[estimated, 1] = _UNTOLD
    return state._replace(trial=trial, sizes=sizes, memory=memory)


def covariance(layout: Layout, sizes: Array) -> Array:
    """Return R of all sensors, where nobody gave it as the first readings suggested."""
    if not layout.any_untold:
        return layout.R
    root = np.sqrt(np.where(np.isnan(sizes), 1.0, sizes))
    return np.asarray(layout.R * np.multiply.outer(root, root))
