"""One step of a fusion as a pure function: what happens between two stamps, and at the second of them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.fusion._policies import Policy, State, compared, predicted, start, weighed
from robust_filterpy.fusion._watch import fresh, looked_at
from robust_filterpy.fusion.motion import Motion
from robust_filterpy.fusion.sensors import Layout

__all__ = ["Moment", "Setup", "advanced", "aged", "begun", "covariance", "moved"]

# What the first readings tell of a noise that nobody told is worth so many samples.
_UNTOLD = 2.0


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
    innovation: Array
    """z - h(x) before the correction, NaN where missing, (M,)."""
    deviation: Array
    """Its standard deviation if the noise is ordinary, as learnt before, (M,)."""
    watch: Any = None
    """What is known of the sensors' health (`_watch.Watch`); None if nobody looks."""
    failed: tuple[tuple[str, str], ...] = ()
    """Sensors whose reading could not be used, since a function of theirs has no answer for this state, and why."""
    doubt: Any = None
    """Hypotheses about a sensor or the state (`reacquisition.Doubt`); None if there is no doubt."""


def begun(setup: Setup, x: Array, P: Array) -> Moment:
    """Return the moment before the first stamp."""
    layout = setup.layout
    sizes, none = np.where(layout.untold, np.nan, 1.0), np.full(layout.size, np.nan)
    watch = fresh(layout.size, len(layout.parties)) if setup.watches else None
    return Moment(start(setup.policy, x, P, sizes, np.zeros(setup.motion.dim_u)), none, none, watch)


def moved(setup: Setup, state: State, seconds: float) -> State:
    """Return the state some seconds later, with nothing read."""
    if seconds == 0.0:
        return state
    return predicted(setup.policy, state, *setup.motion.over(seconds, state.x, state.u))


def advanced(setup: Setup, before: Moment, seconds: float, z: Array, control: Array | None) -> Moment:
    """Return the moment some seconds later, when something was read or a control input changed."""
    layout, policy = setup.layout, setup.policy
    state = predicted(policy, before.state, *setup.motion.over(seconds, before.state.x, before.state.u))
    none = np.full(layout.size, np.nan)
    if control is not None:
        state = state._replace(u=control)
    if np.isnan(z).all():
        return Moment(aged(state, seconds, none), none, none, before.watch)
    seen = layout.seen_from(state.x, z)
    y = seen.z - seen.H @ state.x
    # What goes round in circles is compared as the difference to what was expected.
    if layout.any_untold:
        state = aged(state, seconds, np.where(layout.is_curved, y, seen.z))
    if layout.any_untold:
        y = np.where(np.isnan(state.sizes), np.nan, y)
    if np.isnan(y).all():
        return Moment(state, none, none, before.watch, seen.failed)
    spread = ((seen.H @ state.P) * seen.H).sum(axis=1)
    R = covariance(layout, state.sizes)
    deviation = np.sqrt(spread + policy.factors(state.memory) * R.diagonal())
    here, watch, learns = ~np.isnan(y), before.watch, True
    used = np.where(here, seen.z, np.nan)
    if watch is not None:
        known = policy.factors(state.memory), policy.contamination(state.memory)
        watch = looked_at(watch, z, y, spread, R.diagonal(), known, layout.party)
        # Nothing is learnt of a sensor on alarm, and nothing taken from one that lies.
        learns = (watch.fault != 1.0)[layout.party]
        used = np.where(watch.out[layout.party], np.nan, used)
    if watch is None or not np.isnan(used).all():
        state = weighed(policy, state, used, seen.H, R, learns)[0]
    return Moment(state, y, np.where(here, deviation, np.nan), watch, seen.failed)


def aged(state: State, seconds: float, values: Array) -> State:
    """Return the state that knows the first readings of sensors that nobody told."""
    trial, sizes = compared(state.trial, state.sizes, seconds, values)
    if trial is state.trial:
        return state
    known = np.isnan(state.sizes) & ~np.isnan(sizes)
    memory = state.memory
    if known.any():
        memory = memory.copy()
        memory[known, 1] = _UNTOLD
    return state._replace(trial=trial, sizes=sizes, memory=memory)


def covariance(layout: Layout, sizes: Array) -> Array:
    """Return R of all sensors, where nobody told it as the first readings suggested."""
    if not layout.any_untold:
        return layout.R
    root = np.sqrt(np.where(np.isnan(sizes), 1.0, sizes))
    return np.asarray(layout.R * np.multiply.outer(root, root))
