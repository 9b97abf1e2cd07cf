"""A whole recording at once: from a table with a row for each reading to the state at each stamp, by the kernel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._warning import warn
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.fusion._stepping import Moment, Setup, advanced, aged, covariance
from robust_filterpy.fusion._timeline import Timeline
from robust_filterpy.fusion._times import Clock, written
from robust_filterpy.fusion.sensors import Layout
from robust_filterpy.fusion.verdicts import LONGEST, Verdict, described, of_all
from robust_filterpy.smoothing.smoother import smooth

__all__ = ["Recording", "Rows", "fused", "read", "table_columns"]

# Stamps that are taken together: so many F and Q fit a cache, and need no room to speak of.
_TOGETHER = 20_000
# Stamps from which the start is found, and by how much less certain than that the smoother begins, in variance.
_TO_BEGIN, _WIDER = 200, 1e6


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
        said: dict[str, list[tuple[Any, Verdict]]] = {}
        for when, who, verdict in self.verdicts:
            of_it = said.setdefault(who, [])
            # The same again is the same fault, its onset known better.
            if of_it and of_it[-1][1].fault == verdict.fault:
                of_it[-1] = (of_it[-1][0], verdict)
            else:
                of_it.append((when, verdict))
        for who, of_it in said.items():
            when, verdict = of_it[-1]
            lines.append(f"  {who} {verdict.fault}, since {written(verdict.since)}, first said at {written(when)}")
            if len(of_it) > 1:
                lines[-1] += "; before that " + ", ".join(before.fault for _, before in of_it[-4:-1])
        return "\n".join(lines)

    def columns(self) -> dict[str, np.ndarray]:
        """Return the stamps, the states and their standard deviations by name, as a data frame takes them.

        Returns
        -------
        dict of str to ndarray, shape (K,)
        """
        found = {"time": self.times}
        for i, name in enumerate(self.names):
            found[name] = self.x[:, i]
            found[f"{name}_std"] = np.sqrt(self.P[:, i, i])
        return found


class Rows(NamedTuple):
    """Readings in the order of their stamps."""

    keys: np.ndarray
    """Of the stamps, (K,)."""
    zs: Array
    """(K, M), NaN where nothing was read."""
    inputs: Array
    """Control input in force until each stamp, (K, dim_u)."""
    duplicates: int


def read(
    setup: Setup, clock: Clock, table: Any, time: str, sensor: str, value: Any, controls: tuple[Any, Any] | None
) -> Rows:
    """Return the readings of a table, or raise.

    Parameters
    ----------
    setup : Setup
        Motion and sensors.
    clock : Clock
        What the stamps are.
    table : data frame or dict
        A row for each reading.
    time, sensor : str
        Columns.
    value : str or sequence of str
        Column, or columns.
    controls : tuple, optional
        Stamps and inputs.

    Returns
    -------
    Rows
    """
    layout = setup.layout
    chosen = [value] if isinstance(value, str) else list(value)
    stamps, who, *columns = table_columns(table, [time, sensor, *chosen])
    keys = clock.keys(stamps)
    values = np.column_stack([_checks.numbers(name, column) for name, column in zip(chosen, columns, strict=True)])
    if np.isinf(values).any():
        row = int(np.flatnonzero(np.isinf(values).any(axis=1))[0])
        raise ValueError(f"value: expected finite numbers or NaN (missing), got {values[row]} in row {row}")
    index = _indices(layout.names, who)
    shift = np.array([s.delay for s in layout.sensors.values()])[index]
    keys = keys - (np.round(shift * 1e9).astype(np.int64) if keys.dtype == np.int64 else shift)
    at, us = _inputs(setup.motion.dim_u, clock, controls, keys.dtype)
    every, where = np.unique(np.concatenate([keys, at]), return_inverse=True)
    zs, duplicates = np.full((len(every), layout.size), np.nan), 0
    for i, (name, place) in enumerate(layout.places.items()):
        rows, m = np.flatnonzero(index == i), place.stop - place.start
        if len(rows) and m > len(chosen):
            raise ValueError(f"value: expected {m} columns, as sensor {name!r} has components, got {chosen}")
        to = where[rows]
        unique, first = np.unique(to, return_index=True)
        if len(unique) < len(rows):
            other = np.searchsorted(unique, to)
            said = values[rows, :m]
            apart = ~((said == said[first[other]]) | (np.isnan(said) & np.isnan(said[first[other]]))).all(axis=1)
            if apart.any():
                row = int(rows[np.argmax(apart)])
                raise ValueError(
                    f"sensor {name!r}: expected one reading for each stamp, got two that differ at "
                    f"{clock.stamp(every[where[row]].item())} (row {row}); leave one out"
                )
            duplicates += len(rows) - len(unique)
        zs[to, place] = values[rows, :m]
    return Rows(every, zs, _held(us, where[len(keys) :], len(every), setup.motion.dim_u), duplicates)


def fused(setup: Setup, begin: Moment, start: Any, rows: Rows, smoothed: bool) -> Recording:
    """Return the states of a recording.

    Parameters
    ----------
    setup : Setup
        What does not change.
    begin : Moment
        Before the first stamp.
    start : float, int or None
        Key of that moment; None if it is that of the first stamp.
    rows : Rows
        What was read.
    smoothed : bool
        Whether from the whole recording.

    Returns
    -------
    Recording
    """
    layout, motion, K = setup.layout, setup.motion, len(rows.keys)
    if not K:
        raise ValueError("table: expected a row for each reading, got none")
    if start is not None and rows.keys[0] < start:
        raise ValueError(f"table: expected stamps from t0, {Clock.stamp(start)}, on, got {Clock.stamp(rows.keys[0])}")
    first = 0.0 if start is None else Clock.between(start, rows.keys[0].item())
    apart = np.diff(rows.keys)
    dts = np.concatenate([[first], apart / 1e9 if apart.dtype == np.int64 else apart]).astype(float)
    x, P = np.empty((K, motion.dim_x)), np.empty((K, motion.dim_x, motion.dim_x))
    weights, moment, done = np.full((K, layout.size), np.nan), begin, 0
    straight = motion.is_linear and not layout.curved
    if smoothed and layout.grouping != "component":
        raise ValueError("smoothed: expected sensors without group, since the smoother takes each component; leave one")
    if smoothed and setup.reacquire is not None:
        raise ValueError("smoothed: expected a fusion without reacquire, since the smoother decides nothing; leave one")
    failed: list[tuple[str, int, str]] = []
    said: list[tuple[int, str, Verdict]] = []
    if setup.watches or setup.reacquire is not None:
        moment, failed, said = _watched(setup, (begin, start), rows, (x, P))
        done = K
    while done < K:
        # Step by step goes what the kernel cannot: what is not linear, first readings of sensors that nobody told.
        stop = _next_first(moment, rows.zs, done) if straight else done
        if stop == done:
            moment = advanced(setup, moment, dts[done].item(), rows.zs[done], rows.inputs[done])
            failed.extend((who, done, why) for who, why in moment.failed)
            x[done], P[done], done = moment.state.x, moment.state.P, done + 1
            continue
        to = min(done + _TOGETHER, stop)
        F, Q, drift = _model(setup, moment, dts[done:to], rows.inputs[done:to])
        R = covariance(layout, moment.state.sizes)[None]
        x[done:to], P[done:to], weights[done:to], state = setup.policy.series(
            moment.state, rows.zs[done:to], F, Q, drift, layout.H[None], R
        )
        state = aged(state, float(dts[done:to].sum()), np.full(layout.size, np.nan))
        moment, done = moment._replace(state=state._replace(u=rows.inputs[to - 1])), to
    if failed:
        who, at, why = failed[0]
        warn(
            f"{len(failed)} reading(s) left out, since a sensor's function failed at the state then; the first is of "
            f"{who!r} at {Clock.stamp(rows.keys[at].item())}: {why}",
            RuntimeWarning,
        )
    if smoothed:
        believed = rows._replace(zs=_without_lies(layout, rows, said))
        x, P, weights = _smoothed(setup, begin, moment, dts, believed, (x, P))
    times = rows.keys.astype("M8[ns]") if rows.keys.dtype == np.int64 else rows.keys
    verdicts = tuple((Clock.stamp(rows.keys[k].item()), name, verdict) for k, name, verdict in said)
    return Recording(times, x, P, weights, rows.duplicates, motion.names, verdicts)


def _watched(
    setup: Setup, began: tuple[Moment, Any], rows: Rows, into: tuple[Array, Array]
) -> tuple[Moment, list[tuple[str, int, str]], list[tuple[int, str, Verdict]]]:
    """Write the states of stamps that are taken one by one; return the last moment, who failed, and what was said."""
    layout, line = setup.layout, Timeline(setup, began[0], 0.0, LONGEST + 100)
    line.base_key, moment = began[1], began[0]
    failed: list[tuple[str, int, str]] = []
    said: list[tuple[int, str, Verdict]] = []
    before = of_all(layout, moment)
    for k, key in enumerate(rows.keys.tolist()):
        entry = line.at(key)
        entry.z[:], entry.control = rows.zs[k], rows.inputs[k]
        moment = line.until()[0]
        into[0][k], into[1][k] = moment.state.x, moment.state.P
        failed.extend((who, k, why) for who, why in moment.failed)
        now = of_all(layout, moment)
        said.extend((k, name, one) for name, one in now.items() if one[:2] != before[name][:2])
        before = now
        line.forget()
    return moment, failed, sorted(said + _silences(layout, rows), key=lambda one: one[0])


def _silences(layout: Layout, rows: Rows) -> list[tuple[int, str, Verdict]]:
    """Return which sensors have been silent, from the first stamp on that tells it, and who has spoken again."""
    found, keys = [], rows.keys
    for name, place in layout.places.items():
        spoke = np.flatnonzero((~np.isnan(rows.zs[:, place])).any(axis=1))
        gaps = np.diff(keys[spoke]) / (1e9 if keys.dtype == np.int64 else 1.0)
        every = layout.sensors[name].every
        for i in range(len(spoke)):
            usual = np.median(gaps[max(i - LONGEST, 0) : i]) if i > 1 else np.inf
            limit = 5.0 * usual if every is None else 3.0 * every
            if not np.isfinite(limit):
                continue
            told = int(np.searchsorted(keys, Clock.moved(keys[spoke[i]].item(), float(limit)), side="right"))
            if told < (spoke[i + 1] if i + 1 < len(spoke) else len(keys)):
                found.append((told, name, described("silent", Clock.stamp(keys[spoke[i]].item()))))
                if i + 1 < len(spoke):
                    found.append((int(spoke[i + 1]), name, described("healthy")))
    return found


def _without_lies(layout: Layout, rows: Rows, said: list[tuple[int, str, Verdict]]) -> Array:
    """Return the readings without those of sensors that were left out, each from the onset on."""
    if not said:
        return rows.zs
    zs = rows.zs.copy()
    for name, place in layout.places.items():
        mine = [(k, one) for k, who, one in said if who == name and one.fault != "silent"]
        for i, (_, one) in enumerate(mine):
            if one.fault in ("biased", "drifting", "stuck"):
                since = one.since.astype("M8[ns]").astype(np.int64) if rows.keys.dtype == np.int64 else one.since
                until = mine[i + 1][0] if i + 1 < len(mine) else len(zs)
                zs[int(np.searchsorted(rows.keys, since)) : until, place] = np.nan
    return zs


def _next_first(moment: Moment, zs: Array, done: int) -> int:
    """Return the next row with a reading of a component whose noise is not known yet, the number of rows if none."""
    unknown = np.isnan(moment.state.sizes)
    if not unknown.any():
        return len(zs)
    # A look at some rows after the other: the next one is near.
    for low in range(done, len(zs), 1000):
        there = (~np.isnan(zs[low : low + 1000, unknown])).any(axis=1)
        if there.any():
            return low + int(np.argmax(there))
    return len(zs)


def _model(setup: Setup, moment: Moment, dts: Array, inputs: Array) -> tuple[Array, Array, Array]:
    """Return F, Q and B u of stretches of time."""
    F, Q, B = setup.motion.stacks(dts)
    if not setup.motion.dim_u:
        return F, Q, np.zeros((1, setup.motion.dim_x))
    before = np.concatenate([moment.state.u[None], inputs[:-1]])
    return F, Q, np.asarray((B @ before[:, :, None])[:, :, 0])


def _smoothed(
    setup: Setup, begin: Moment, last: Moment, dts: Array, rows: Rows, filtered: tuple[Array, Array]
) -> tuple[Array, Array, Array]:
    """Return states, covariances and weights by the smoother, with each sensor's noise as large as it was learnt."""
    layout, motion = setup.layout, setup.motion
    if not motion.is_linear or layout.curved:
        raise ValueError("smoothed: expected a linear motion and linear sensors, got a function of the state")
    F, Q, drift = _model(setup, begin, dts, rows.inputs)
    kf = RobustKalmanFilter(motion.dim_x, layout.size, motion.dim_x)
    kf.x, kf.P = _narrowed(begin, filtered, F, Q, drift)
    kf.H, kf.B = layout.H, np.eye(motion.dim_x)
    root = np.sqrt(np.where(np.isnan(last.state.sizes), 1.0, setup.policy.factors(last.state)))
    kf.R = covariance(layout, last.state.sizes) * np.multiply.outer(root, root)
    us = np.broadcast_to(drift, (len(dts), motion.dim_x))
    choices = getattr(setup.policy, "choices", None)
    found = smooth(kf, rows.zs, Fs=F, Qs=Q, us=us, influence=None if choices is None else choices.influence)
    return found.x, found.P, found.weights


def _narrowed(begin: Moment, filtered: tuple[Array, Array], F: Array, Q: Array, drift: Array) -> tuple[Array, Array]:
    """Return the start, at most a million times less certain than the recording knows it: more is rounding."""
    (x, P), last = filtered, min(len(filtered[0]), _TO_BEGIN) - 1
    at, cov = x[last], P[last]
    for k in range(last - 1, -2, -1):
        # Rauch, Tung and Striebel, from the states after each stamp; the start is before the first.
        before, spread = (x[k], P[k]) if k >= 0 else (begin.state.x, begin.state.P)
        moved = F[k + 1] @ before + drift[k + 1 if len(drift) > 1 else 0]
        grown = F[k + 1] @ spread @ F[k + 1].T + Q[k + 1]
        gain = np.linalg.lstsq(grown, F[k + 1] @ spread, rcond=None)[0].T
        at, cov = before + gain @ (at - moved), spread + gain @ (cov - grown) @ gain.T
    start, told = begin.state.x, begin.state.P
    known = _WIDER * np.diag(np.abs(cov.diagonal()))
    share = np.linalg.lstsq(told + known, told, rcond=None)[0]
    narrow = known @ share
    return start + share.T @ (at - start), 0.5 * (narrow + narrow.T)


def table_columns(table: Any, names: list[str]) -> list[np.ndarray]:
    """Return columns of a data frame or a dict by name, or raise.

    Parameters
    ----------
    table : data frame or dict
        Where they are.
    names : list of str
        Which.

    Returns
    -------
    list of ndarray
    """
    if isinstance(table, Mapping):
        there, column = list(table), lambda name: np.asarray(table[name])
    else:
        try:
            import narwhals as nw
        except ImportError:
            raise ImportError(
                'tables are read by narwhals; pip install "robust_filterpy[fleet]", or pass a dict of columns'
            ) from None
        try:
            frame = nw.from_native(table, eager_only=True)
        except TypeError:
            raise TypeError(
                f"table: expected a data frame in memory, or a dict of columns, got {type(table).__name__}"
            ) from None
        there, column = frame.columns, lambda name: _plain(nw, frame[name])
    missing = [name for name in names if name not in there]
    if missing:
        raise ValueError(
            f"table: expected the columns {missing}, got {list(there)}; time=, sensor= and value= name them"
        )
    found = [column(name) for name in names]
    if len({len(one) for one in found}) > 1:
        raise ValueError(f"table: expected columns of one length, got {[len(one) for one in found]}")
    return found


def _plain(nw: Any, column: Any) -> np.ndarray:
    """Return a column as numpy has it; instants in UTC."""
    kind = column.dtype
    if kind == nw.Datetime and getattr(kind, "time_zone", None) is not None:
        column = column.dt.convert_time_zone("UTC").dt.replace_time_zone(None)
    return np.asarray(column.to_numpy())


def _indices(names: tuple[str, ...], who: np.ndarray) -> np.ndarray:
    """Return each row's sensor as its place among the declared, or raise."""
    unique, inverse = np.unique(np.asarray(who, dtype=object).astype(str), return_inverse=True)
    unknown = [name for name in unique.tolist() if name not in names]
    if unknown:
        raise ValueError(f"sensor: expected names among {list(names)}, got {unknown[:5]}; leave their rows out")
    return np.array([names.index(name) for name in unique.tolist()], dtype=int)[inverse]


def _inputs(p: int, clock: Clock, controls: Any, dtype: Any) -> tuple[np.ndarray, Array]:
    """Return keys and values of control inputs, or raise."""
    if controls is None:
        return np.zeros(0, dtype=dtype), np.zeros((0, p))
    if not isinstance(controls, tuple) or len(controls) != 2:
        raise TypeError(f"controls: expected (stamps, inputs), got {_checks.shown(controls)}")
    keys, us = clock.keys(controls[0]), _checks.numbers("controls", controls[1])
    us = us[:, None] if us.ndim == 1 else us
    if us.shape != (len(keys), p) or not np.isfinite(us).all():
        raise ValueError(f"controls: expected finite inputs of shape ({len(keys)}, {p}), got shape {us.shape}")
    if keys.dtype != dtype:
        raise TypeError("controls: expected stamps of the kind that the table has")
    order = np.argsort(keys, kind="stable")
    if (np.diff(keys[order]) == 0).any():
        raise ValueError("controls: expected one input for each stamp, got two")
    return keys[order], us[order]


def _held(us: Array, places: np.ndarray, steps: int, p: int) -> Array:
    """Return the input in force from each stamp on, 0 before the first."""
    found = np.zeros((steps, p))
    if len(us):
        which = np.searchsorted(places, np.arange(steps), side="right") - 1
        found[which >= 0] = us[which[which >= 0]]
    return found
