"""One step of a fusion as a pure function: what happens between two stamps, and at the second of them.

A filter's policy predicts and corrects, here as functions from state to state.

All sensors' measurements are one vector in which whoever has not spoken is missing: what is learned has a row for each
component, so every sensor has a noise, or a typical innovation, of its own.

How noisy a sensor is whose R nobody gave its first readings say, and serve for nothing else: three in a row are
compared with a straight line in time, the middle one is off by e with variance R (1 + (a^2 + b^2)/(a + b)^2), a and b
the times between them. Five such e, from seven readings, give R to begin with; from then on it is learned. The state
plays no part, so it does not matter how uncertain it is.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._arrays import require_finite_prediction
from robust_filterpy._checks import Array
from robust_filterpy.correction.policies import Contaminated, Learnt, Scales, noise_policy, process_policy
from robust_filterpy.filters.driver import run
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.policies import Policy
from robust_filterpy.fusion._watch import DEPARTS, Looked, coasted, fresh, looked_at
from robust_filterpy.fusion.motion import Motion
from robust_filterpy.fusion.sensors import Layout, Seen
from robust_filterpy.influence.functions import Influence
from robust_filterpy.kernel.series import Rows

# Columns of what is remembered of a component: its age, the last reading, the time before it, the one before that, how
# many there were, then squares.
_AGE, _LAST, _GAP, _BEFORE, _COUNT, _SQUARES = 0, 1, 2, 3, 4, 5
# So many squares are needed; the median of a squared normal number is .455.
_NEEDED, _MEDIAN = 5, 0.4549
#: Length of what is remembered, for each component.
TRIAL = _SQUARES + _NEEDED


def compared(trial: Array, sizes: Array, seconds: float, values: Array) -> tuple[Array, Array]:
    """Return what is remembered after another moment, and the variances that are estimated by now."""
    unknown = np.isnan(sizes)
    if not unknown.any():
        return trial, sizes
    trial, sizes = trial.copy(), sizes.copy()
    trial[unknown, _AGE] += seconds
    for i in np.flatnonzero(unknown & ~np.isnan(values)):
        row, z = trial[i], values[i]
        count, a, b = int(row[_COUNT]), row[_GAP], row[_AGE]
        if count >= 2:
            with np.errstate(over="ignore"):
                e = row[_LAST] - (row[_BEFORE] * b + z * a) / (a + b)
                square = min(e * e / (1.0 + (a * a + b * b) / (a + b) ** 2), 1e300)
            row[_SQUARES:] = np.append(row[_SQUARES + 1 :], square)
        row[_BEFORE], row[_GAP], row[_LAST], row[_AGE], row[_COUNT] = row[_LAST], b, z, 0.0, count + 1
        # A sensor that repeats itself to the last digit has not shown it yet.
        if count + 1 >= _NEEDED + 2 and row[_SQUARES:].any():
            median = float(np.median(row[_SQUARES:])) / _MEDIAN
            sizes[i] = median if median > 0.0 else float(row[_SQUARES:].mean())
    return trial, sizes


class State(NamedTuple):
    """A filter between two moments; nothing in here is ever written to."""

    #: Mean of all models, (n,).
    x: Array
    #: Its covariance, (n, n).
    P: Array
    #: What was learned of each component's noise, (M, ..).
    memory: Array
    #: What the policy keeps besides.
    carried: Any
    #: Variance that stands for R where nobody gave it, NaN until it is estimated, 1 elsewhere, (M,).
    sizes: Array
    #: Control input in force, (dim_u,).
    u: Array
    #: First readings where nobody gave R, (M, ..).
    trial: Array


def policy_of(layout: Layout, noise: Any, process: Any, influence: Influence | None) -> Policy:
    """Return what predicts and corrects, as `Fusion` is asked for it, or raise if a sensor's R is to be given."""
    noise, process = noise_policy(noise), process_policy(process)
    if influence is None:
        if isinstance(noise, Contaminated):
            _require_R(layout, "noise that is given")
        # All sensors stand in one vector, in which each fails on its own, or a group together.
        noise, process = Learnt() if noise is None else noise, Scales() if process is None else process
        return RobustKalmanFilter(1, 1, noise=noise, process=process, grouping=layout.grouping).policy
    if noise is not None or process is not None:
        raise ValueError("influence: expected neither noise nor process with it")
    _require_R(layout, "influence")
    return RobustKalmanFilter(1, 1, influence=influence, scaling="innovation", grouping=layout.grouping).policy


def _require_R(layout: Layout, why: str) -> None:
    """Raise if the size of a noise is neither given nor learned."""
    for name, sensor in layout.sensors.items():
        if sensor.R is None:
            raise ValueError(f"sensor {name!r}: expected R, since with {why} nobody learns it")


def arrays(policy: Policy, state: State) -> tuple[Array, ...]:
    """Return a state as arrays: the models, their probabilities, memory, x, P, sizes, u, trial."""
    hypotheses = policy.current(state.carried, state.x, state.P)[:3]
    return (*hypotheses, state.memory, state.x, state.P, state.sizes, state.u, state.trial)


def of_arrays(policy: Policy, parts: Any) -> State:
    """Return the state that `arrays` has taken apart, or raise if the probabilities are none."""
    means, covariances, belief, memory, x, P, sizes, u, trial = parts
    hypotheses = policy.resumed({"means": means, "covariances": covariances, "belief": belief}, x, P)
    return State(x, P, memory, hypotheses, sizes, u, trial)


def series(
    policy: Policy, state: State, zs: Array, F: Array, Q: Array, drift: Array, H: Array, R: Array, into: Rows
) -> State:
    """Return the last state of many steps, what was asked for of each written into rows."""
    stands = policy.standing(state.carried, state.x, state.P, state.memory)
    run(policy, stands, zs, (F, Q, H, R, drift), into, of="Fusion")
    hypotheses = policy.carried_of(state.carried, stands)
    return state._replace(x=stands.x, P=stands.P, memory=stands.learnt, carried=hypotheses)


# What the first readings tell of a noise that nobody gave is worth so many samples.
_FIRST_READINGS = 2.0
#: A reading is far beyond so many standard deviations.
FAR = 6.0


class Setup(NamedTuple):
    """What does not change while a fusion runs."""

    motion: Motion
    layout: Layout
    policy: Policy
    #: Whether there are verdicts about the sensors.
    watches: bool = False
    #: What is to be expected after a blackout (`reacquisition.Reacquisition`); None if nothing is ever in doubt.
    reacquire: Any = None


class Moment(NamedTuple):
    """What there is after everything of one stamp has been judged; nothing in here is ever written to."""

    state: State
    #: What was learned of the sensors' health (`_watch.Watch`); None if nobody looks.
    watch: Any = None
    #: Sensors whose reading could not be used, since a function of theirs has no answer for this state, and why.
    failed: tuple[tuple[str, str], ...] = ()
    #: Hypotheses about a sensor or the state (`reacquisition.Doubt`); None if there is no doubt.
    doubt: Any = None
    #: Sensor with the farthest reading, if it is far beyond what is expected and that is looked for; else -1.
    far: int = -1
    #: Whether the state is not the one to which the step led: a doubt has been decided, or is served.
    anew: bool = False


def begun(setup: Setup, x: Array, P: Array) -> Moment:
    """Return the moment before the first stamp."""
    layout, policy = setup.layout, setup.policy
    sizes, M = np.where(layout.without_R, np.nan, 1.0), layout.size
    u, trial = np.zeros(setup.motion.dim_u), np.zeros((M, TRIAL))
    state = State(x, P, policy.begin(M), policy.start(x, P), sizes, u, trial)
    scales = policy.shares(state.memory)[0]
    return Moment(state, fresh(layout.n, M, len(layout.parties), scales) if setup.watches else None)


def moved(setup: Setup, state: State, seconds: float) -> State:
    """Return the state some seconds later, with nothing read."""
    if seconds == 0.0:
        return state
    F, Q, drift = setup.motion.over(seconds, state.x, state.u)
    x, P, hypotheses = setup.policy.predicted(state.carried, state.x, state.P, F, Q, drift, 1.0)
    require_finite_prediction(x, P)
    return state._replace(x=x, P=P, carried=hypotheses)


def advanced(setup: Setup, before: Moment, seconds: float, z: Array, control: Array | None) -> Moment:
    """Return the moment some seconds later, when something was read or a control input changed."""
    layout, policy, state, watch = setup.layout, setup.policy, before.state, before.watch
    n, step, seen = layout.n, setup.motion.over(seconds, state.x, state.u), Seen(z, layout.H)
    values = z
    if layout.curved:
        x = step.F @ state.x + step.drift
        seen = layout.seen_from(x, z)
        # What goes round in circles is compared as the difference to what was expected.
        values = np.where(layout.is_curved, seen.z - seen.H @ x, seen.z)
    if control is not None:
        state = state._replace(u=control)
    used, R = seen.z, layout.R
    if layout.any_without_R:
        state = aged(state, seconds, values)
        used, R = np.where(np.isnan(state.sizes), np.nan, used), covariance(layout, state.sizes)
    readings = used
    if watch is not None and watch.ill:
        # Nothing is taken from a sensor that lies.
        used = np.where(watch.out[layout.party], np.nan, used)
    xs, Ps, weights = np.empty((2, 1, n)), np.empty((2, 1, n * n)), np.empty((1, layout.size))
    F, Q, drift, H, R = [part[None] for part in (*step, seen.H, R)]
    after = series(policy, state, used[None], F, Q, drift, H, R, Rows(xs[0], Ps[0], xs[1], Ps[1], weights))
    if watch is None and setup.reacquire is None:
        return Moment(after, None, seen.failed)
    here = np.flatnonzero(readings == readings)
    if not len(here):
        return Moment(after, watch and coasted(watch, step.F, seconds), seen.failed)
    y, P = readings - seen.H @ xs[1, 0], Ps[1].reshape(n, n)
    if watch is not None:
        if watch.ill:
            # Nothing is learned of a sensor on alarm.
            learns = (watch.fault != DEPARTS)[layout.party]
            after = after._replace(memory=np.where(learns[:, None], after.memory, state.memory))
        now = Looked(here, z, y, seen.H, P, R[0].diagonal(), weights[0], policy, state)
        watch = looked_at(watch, step.F, seconds, now, layout.party)
    if setup.reacquire is None:
        return Moment(after, watch, seen.failed)
    spread = ((seen.H @ P) * seen.H).sum(axis=1)
    e = np.abs(np.where(np.isnan(used), 0.0, y)) / np.sqrt(spread + policy.factors(state.memory) * R[0].diagonal())
    return Moment(after, watch, seen.failed, None, int(layout.owner[np.argmax(e)]) if e.max() > FAR else -1)


# Stamps that are taken together: so many F and Q fit a cache, and need no room to speak of.
_TOGETHER = 20_000


def through(
    setup: Setup, moment: Moment, dts: Array, zs: Array, inputs: Array, into: tuple[Array, Array, Array]
) -> tuple[Moment, list[tuple[str, int, str]]]:
    """Return the moment after many stamps, with the control inputs from each on, and who failed at which, and why.

    x, P and weights of each are written into rows.
    """
    layout, (x, P, weights), done, K = setup.layout, into, 0, len(zs)
    failed: list[tuple[str, int, str]] = []
    while done < K:
        # Step by step goes what the kernel cannot: what is not linear, first readings of sensors whose R nobody gave.
        straight = setup.motion.is_linear and not layout.curved
        stop = _next_first(moment, zs, done) if straight else done
        if stop == done:
            moment = advanced(setup, moment, dts[done].item(), zs[done], inputs[done])
            failed.extend((who, done, why) for who, why in moment.failed)
            x[done], P[done], done = moment.state.x, moment.state.P, done + 1
            continue
        part = slice(done, min(done + _TOGETHER, stop))
        us = np.concatenate([moment.state.u[None], inputs[part][:-1]])
        F, Q, drift = setup.motion.over_each(dts[part], x[part], us)
        rows = Rows(x[part], P[part].reshape(len(us), -1), weights=weights[part])
        R = covariance(layout, moment.state.sizes)[None]
        state = series(setup.policy, moment.state, zs[part], F, Q, drift, layout.H[None], R, rows)
        state = aged(state, float(dts[part].sum()), np.full(layout.size, np.nan))
        moment, done = moment._replace(state=state._replace(u=inputs[part.stop - 1])), part.stop
    return moment, failed


def _next_first(moment: Moment, zs: Array, done: int) -> int:
    """Return the next row with a reading of a component whose noise is not estimated, the number of rows if none."""
    unknown = np.isnan(moment.state.sizes)
    # A look at some rows after the other: the next one is near.
    for low in range(done, len(zs) if unknown.any() else 0, 1000):
        there = (~np.isnan(zs[low : low + 1000, unknown])).any(axis=1)
        if there.any():
            return low + int(np.argmax(there))
    return len(zs)


def aged(state: State, seconds: float, values: Array) -> State:
    """Return the state that has the first readings of sensors whose R nobody gave."""
    trial, sizes = compared(state.trial, state.sizes, seconds, values)
    if trial is state.trial:
        return state
    estimated = np.isnan(state.sizes) & ~np.isnan(sizes)
    memory = state.memory
    if estimated.any():
        memory = memory.copy()
        memory[estimated, 1] = _FIRST_READINGS
    return state._replace(trial=trial, sizes=sizes, memory=memory)


def covariance(layout: Layout, sizes: Array) -> Array:
    """Return R of all sensors, where nobody gave it as the first readings suggested."""
    if not layout.any_without_R:
        return layout.R
    root = np.sqrt(np.where(np.isnan(sizes), 1.0, sizes))
    return np.asarray(layout.R * np.multiply.outer(root, root))
