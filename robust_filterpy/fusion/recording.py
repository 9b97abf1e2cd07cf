"""A whole recording at once: from what was read at each stamp to the state there, by the kernel; each sensor's delay.

How late a sensor's stamps are is the shift with which it agrees best with all the others. They give the track x(t),
smoothed where they are linear. A reading z of stamp t with a delay d is one of x(t - d); the d is looked for that makes
the mean of abs(z - h(x(t - d)) - c) least, c the median, since an offset is no delay. That is done for each sensor in
turn, with the others shifted as found so far, until nobody moves. Whoever is least late counts as on time.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage, stages
from robust_filterpy._warning import warn
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.fusion._stepping import Moment, Setup, covariance, through
from robust_filterpy.fusion._table import Clock, Readings, written
from robust_filterpy.fusion._timeline import Timeline
from robust_filterpy.fusion.sensors import Layout
from robust_filterpy.fusion.verdicts import LONGEST, Verdict, described, of_all
from robust_filterpy.smoothing.smoother import smooth

# How much less certain than the recording shows the smoother begins, in variance: more is rounding.
_WIDER = 1e6


@dataclass(frozen=True, repr=False)
class Recording:
    """Hold the states of a recording, one for each of its K stamps.

    Attributes
    ----------
    times : ndarray, shape (K,)
        Stamps in order, less the sensors' delays: numbers, or numpy.datetime64 in UTC.
    x : ndarray, shape (K, n)
        States.
    P : ndarray, shape (K, n, n)
        Their covariances.
    weights : ndarray, shape (K, M)
        How much each component of the sensors, in the order of declaration, was believed; NaN where it was missing,
        and where stamps were taken one by one: sensors by function, ``watch=True``, ``reacquire``.
    duplicates : int
        Rows that said again what had been said.
    names : tuple of str
        Of the states.
    verdicts : tuple of (stamp, str, Verdict)
        Of a fusion that watches, or of one with ``reacquire``: whenever something else was said of a sensor, or of the
        "motion", in order.
    """

    times: np.ndarray
    x: Array
    P: Array
    weights: Array
    duplicates: int
    names: tuple[str, ...]
    verdicts: tuple[tuple[Any, str, Verdict], ...] = ()

    def __repr__(self) -> str:
        """Say how long the recording is, where it ends, and what was said of sensors."""
        if not len(self.times):
            return "Recording(no stamps)"
        last = ", ".join(f"{name}={value:.5g}" for name, value in zip(self.names, self.x[-1], strict=True))
        begin, end = written(self.times[0]), written(self.times[-1])
        lines = [f"Recording({len(self.times)} stamps, {begin} to {end}; at the end {last})"]
        for who in dict.fromkeys(name for _, name, _ in self.verdicts):
            # The same again is the same fault, its onset more precise.
            mine = groupby((one for one in self.verdicts if one[1] == who), key=lambda one: one[2].fault)
            *before, (fault, said) = [(fault, list(same)) for fault, same in mine]
            since, when = written(said[-1][2].since), written(said[0][0])
            lines.append(f"  {who} {fault}, since {since}, first said at {when}")
            if before:
                lines[-1] += "; before that " + ", ".join(fault for fault, _ in before[-3:])
        return "\n".join(lines)

    def columns(self) -> dict[str, np.ndarray]:
        """Return the stamps, the states and their standard deviations by name, as a data frame takes them.

        Returns
        -------
        dict of str to ndarray, shape (K,)
        """
        columns = {"time": self.times}
        for i, name in enumerate(self.names):
            columns[name], columns[f"{name}_std"] = self.x[:, i], np.sqrt(self.P[:, i, i])
        return columns


def fused(setup: Setup, begin: Moment, start: Any, rows: Readings, smoothed: bool) -> Recording:
    """Return the states of a recording."""
    layout, motion, K = setup.layout, setup.motion, len(rows.keys)
    if not K:
        raise ValueError("table: expected a row for each reading, got none")
    if start is not None and rows.keys[0] < start:
        raise ValueError(f"table: expected stamps from t0, {Clock.stamp(start)}, on, got {Clock.stamp(rows.keys[0])}")
    dts = np.concatenate([[Clock.between(start, rows.keys[0].item())], Clock.seconds(rows.keys)]).astype(float)
    x, P = np.empty((K, motion.dim_x)), np.empty((K, motion.dim_x, motion.dim_x))
    weights = np.full((K, layout.size), np.nan)
    if smoothed and layout.grouping != "component":
        raise ValueError("smoothed: expected sensors without group, since the smoother takes each component; leave one")
    if smoothed and setup.reacquire is not None:
        raise ValueError("smoothed: expected a fusion without reacquire, since the smoother decides nothing; leave one")
    said: list[tuple[int, str, Verdict]] = []
    believed = rows.zs.copy()
    if setup.watches or setup.reacquire is not None:
        with stages("Fusion.run", None):
            moment, failed, said = _watched(setup, (begin, start), rows, (x, P, believed))
    else:
        moment, failed = through(setup, begin, dts, rows.zs, rows.inputs, (x, P, weights))
    if failed:
        who, at, why = failed[0]
        warn(
            f"{len(failed)} reading(s) left out, since a sensor's function failed at the state then; the first is of "
            f"{who!r} at {Clock.stamp(rows.keys[at].item())}: {why}",
            RuntimeWarning,
        )
    if smoothed:
        x, P, weights = _smoothed(setup, begin, moment, dts, rows._replace(zs=believed), (x, P))
    times = rows.keys.astype("M8[ns]") if rows.keys.dtype == np.int64 else rows.keys
    verdicts = tuple((Clock.stamp(rows.keys[k].item()), name, verdict) for k, name, verdict in said)
    return Recording(times, x, P, weights, rows.duplicates, motion.names, verdicts)


def _watched(
    setup: Setup, began: tuple[Moment, Any], rows: Readings, into: tuple[Array, Array, Array]
) -> tuple[Moment, list[tuple[str, int, str]], list[tuple[int, str, Verdict]]]:
    """Write the states of stamps that are taken one by one; return the last moment, who failed, and what was said.

    What sensors read that were left out, each from its onset on, becomes NaN in the last array of into.
    """
    layout, line = setup.layout, Timeline(setup, began[0], 0.0, LONGEST + 100)
    line.base_key, moment = began[1], began[0]
    failed: list[tuple[str, int, str]] = []
    said: list[tuple[int, str, Verdict]] = []
    before = of_all(layout, moment)
    for k, key in enumerate(rows.keys.tolist()):
        stage(f"stamp {k} of {len(rows.keys)}")
        entry, line.ends = line.at(key), k == len(rows.keys) - 1
        entry.z[:], entry.control = rows.zs[k], rows.inputs[k]
        moment = line.until()[0]
        into[0][k], into[1][k] = moment.state.x, moment.state.P
        for s in np.flatnonzero(moment.watch.out).tolist() if moment.watch is not None else ():
            into[2][np.searchsorted(rows.keys, moment.watch.since[s]) : k + 1, layout.party == s] = np.nan
        failed.extend((who, k, why) for who, why in moment.failed)
        now = of_all(layout, moment)
        said.extend((k, name, one) for name, one in now.items() if one[:2] != before[name][:2])
        before = now
        line.forget()
    return moment, failed, sorted(said + _silences(layout, rows), key=lambda one: one[0])


def _silences(layout: Layout, rows: Readings) -> list[tuple[int, str, Verdict]]:
    """Return which sensors have been silent, from the first stamp on that tells it, and who has spoken again."""
    verdicts, keys = [], rows.keys
    for name, place in layout.places.items():
        spoke = np.flatnonzero((~np.isnan(rows.zs[:, place])).any(axis=1))
        gaps = Clock.seconds(keys[spoke])
        every = layout.sensors[name].every
        for i in range(2 if every is None else 0, len(spoke)):
            limit = 5.0 * np.median(gaps[max(i - LONGEST, 0) : i]) if every is None else 3.0 * every
            detected = int(np.searchsorted(keys, Clock.moved(keys[spoke[i]].item(), float(limit)), side="right"))
            if detected < (spoke[i + 1] if i + 1 < len(spoke) else len(keys)):
                verdicts.append((detected, name, described("silent", Clock.stamp(keys[spoke[i]].item()))))
                if i + 1 < len(spoke):
                    verdicts.append((int(spoke[i + 1]), name, described("healthy")))
    return verdicts


def _smoothed(
    setup: Setup, begin: Moment, last: Moment, dts: Array, rows: Readings, filtered: tuple[Array, Array]
) -> tuple[Array, Array, Array]:
    """Return states, covariances and weights by the smoother, with each sensor's noise as large as it was learned."""
    layout, motion = setup.layout, setup.motion
    if not motion.is_linear or layout.curved:
        raise ValueError("smoothed: expected a linear motion and linear sensors, got a function of the state")
    F, Q, drift = motion.over_each(dts, filtered[0], np.concatenate([begin.state.u[None], rows.inputs[:-1]]))
    kf = RobustKalmanFilter(motion.dim_x, layout.size, motion.dim_x)
    (x, P), start = filtered, begin.state
    shown = ((x - start.x) ** 2).max(axis=0) + P[-1].diagonal()
    narrower = np.sqrt(np.minimum(_WIDER * shown / np.maximum(start.P.diagonal(), 1e-300), 1.0))
    kf.x, kf.P = start.x, start.P * np.multiply.outer(narrower, narrower)
    kf.H, kf.B = layout.H, np.eye(motion.dim_x)
    root = np.sqrt(np.where(np.isnan(last.state.sizes), 1.0, setup.policy.factors(last.state.memory)))
    kf.R = covariance(layout, last.state.sizes) * np.multiply.outer(root, root)
    us = np.broadcast_to(drift, (len(dts), motion.dim_x))
    influence = setup.policy.choices.influence if setup.policy.noise is None else None
    smoothed = smooth(kf, rows.zs, Fs=F, Qs=Q, us=us, influence=influence)
    return smoothed.x, smoothed.P, smoothed.weights


# Points of the grid; how near the best of it a delay is looked for, in parts of the longest; rounds; readings compared.
_GRID, _NEAR, _ROUNDS, _MOST = 41, 1e-4, 6, 4000
# A delay is found if all that are less worse than this, in log-density, are in a tenth of what was searched.
_WORSE, _NARROW = 8.0, 0.1
_FEWEST = 20


def delays_of(setup: Setup, begin: Moment, rows: Readings, longest: float) -> tuple[dict[str, float], dict[str, str]]:
    """Return how much later than the least late each sensor's stamps are, and why a delay cannot be found."""
    layout = setup.layout
    seconds = (rows.keys - rows.keys[0]) / (1e9 if rows.keys.dtype == np.int64 else 1.0)
    own = {name: np.flatnonzero((~np.isnan(rows.zs[:, place])).any(axis=1)) for name, place in layout.places.items()}
    reasons = {name: f"it has {len(at)} readings, too few" for name, at in own.items() if len(at) < _FEWEST}
    able = [name for name in layout.names if name not in reasons]
    if len(able) < 2:
        reasons.update(dict.fromkeys(able, "there is no other sensor to compare it with"))
        return dict.fromkeys(layout.names, np.nan), reasons
    shifts, certain = dict.fromkeys(able, 0.0), dict.fromkeys(able, False)
    for _ in range(_ROUNDS):
        before = dict(shifts)
        for name in able:
            others = {one: own[one] for one in able if one != name}
            track = _track(setup, begin, rows, seconds, others, shifts)
            shifts[name], certain[name] = _shift(setup, track, (seconds[own[name]], rows.zs[own[name]], name), longest)
        if max(abs(shifts[name] - before[name]) for name in able) < 2e-3 * longest:
            break
    reasons.update({
        name: "a delay and none explain its readings about as well: what it measures has to change, and unevenly"
        for name in able if not certain[name]
    })  # fmt: skip
    least = min((shifts[name] for name in able if certain[name]), default=0.0)
    return {name: shifts[name] - least if certain.get(name) else np.nan for name in layout.names}, reasons


def _track(
    setup: Setup, begin: Moment, rows: Readings, seconds: Array, own: dict[str, np.ndarray], shifts: dict[str, float]
) -> tuple[Array, Array]:
    """Return times and states as some sensors tell them, each shifted."""
    places = setup.layout.places
    times = np.concatenate([seconds[at] - shifts[name] for name, at in own.items()])
    keys, where = np.unique(times, return_inverse=True)
    zs, first = np.full((len(keys), setup.layout.size), np.nan), 0
    for name, at in own.items():
        zs[where[first : first + len(at)], places[name]] = rows.zs[at, places[name]]
        first += len(at)
    inputs = rows.inputs[np.clip(np.searchsorted(seconds, keys, side="right") - 1, 0, None)]
    straight = setup.motion.is_linear and not setup.layout.curved
    return keys, fused(setup._replace(watches=False), begin, None, Readings(keys, zs, inputs, 0), straight).x


def _shift(
    setup: Setup, track: tuple[Array, Array], said: tuple[Array, Array, str], longest: float
) -> tuple[float, bool]:
    """Return the shift of one sensor that agrees best with a track, and whether it is certain."""
    (times, states), (stamps, zs, name) = track, said
    place = setup.layout.places[name]
    # The same readings for every shift, or shifts could not be compared.
    inside = np.flatnonzero((stamps >= times[0] + longest) & (stamps <= times[-1] - longest))
    if len(inside) < _FEWEST:
        return 0.0, False
    inside = inside[np.linspace(0, len(inside) - 1, min(len(inside), _MOST)).astype(int)]
    stamps, zs = stamps[inside], zs[inside]

    def cost(d: float) -> float:
        at = np.column_stack([np.interp(stamps - d, times, column) for column in states.T])
        apart = _apart(setup, at, zs, name)[:, place]
        apart = np.abs(apart - np.nanmedian(apart, axis=0))
        return float((np.isfinite(apart).sum(axis=0) * np.log(np.nanmean(apart, axis=0) + 1e-300)).sum())

    grid = np.linspace(-longest, longest, _GRID)
    costs = np.array([cost(d) for d in grid])
    best, step, near = float(grid[np.argmin(costs)]), grid[1] - grid[0], grid[costs < costs.min() + _WORSE]
    certain = bool(near[-1] - near[0] <= 2.0 * longest * _NARROW and abs(best) < longest - 0.5 * step)
    found = minimize_scalar(cost, bounds=(best - step, best + step), options={"xatol": _NEAR * longest})
    return float(found.x), certain


def _apart(setup: Setup, states: Array, zs: Array, name: str) -> Array:
    """Return how far readings are from what states say."""
    layout = setup.layout
    if layout.sensors[name].h is None:
        return np.asarray(zs - states @ layout.H.T)
    alone = np.full(zs.shape, np.nan)
    for k, (x, z) in enumerate(zip(states, zs, strict=True)):
        mine = np.full(layout.size, np.nan)
        mine[layout.places[name]] = z[layout.places[name]]
        seen = layout.seen_from(x, mine)
        alone[k] = seen.z - seen.H @ x
    return alone
