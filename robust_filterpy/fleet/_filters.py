"""Many keys with one filter: by the compiled loops, keys with equally many steps together, or one by one.

However a recording is cut into batches, and whichever keys come together, the numbers are the same to the last bit:
every step that the kernel can take is the kernel's, and the definition takes single steps.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks, _state
from robust_filterpy._arrays import noise_covariance, process_noise, state_of
from robust_filterpy._checks import Array
from robust_filterpy.compiled import dispatch
from robust_filterpy.compiled.records import Model, Output
from robust_filterpy.filters.kalman import RobustKalmanFilter

#: What an impossible step raises.
REFUSED = (ValueError, TypeError, np.linalg.LinAlgError)
# Numbers of a group of keys that are worked on at once: what stays in a processor's cache.
_GROUP = 100_000


class Plain(NamedTuple):
    """A `RobustKalmanFilter` as the compiled loops take it."""

    size: tuple[int, int]
    F: Array
    Q: Array
    H: Array
    R: Array
    B: Array | None
    x: Array
    """Shape (n,)."""
    P: Array
    column: bool
    """Whether the filter holds x as a column."""
    label: Array


def plain(kf: Any) -> Plain | None:
    """Return what the loops need, None if they do not serve this filter on this machine, however long the batch."""
    if type(kf) is not RobustKalmanFilter or kf._compiled_loop(None) is None:
        return None
    x, P = state_of(kf)
    n, m = kf.dim_x, kf.dim_z
    size = dispatch.fixed_series_size(n, m)
    if size is None:
        return None
    F, H = _checks.matrix("F", kf.F, (n, n), "dim_x"), _checks.matrix("H", kf.H, (m, n), "dim_z")
    Q, R = process_noise(kf.Q, None, n) * np.ones((n, n)), noise_covariance(kf.R, None, m)
    if not all((a == a.T).all() for a in (Q, R, P)):
        return None
    B = None if kf.B is None or np.ndim(kf.B) != 2 else _checks.numbers("B", kf.B)
    label = _state.labelled(type(kf).__name__, {})[_state.LABEL]
    label.flags.writeable = False
    return Plain(size, F, Q, H, R, B, x.ravel().copy(), P.copy(), np.ndim(kf.x) == 2, label)


def require_consistent(kf: Any, update: Mapping[str, Any]) -> None:
    """Raise unless the filter can take a step."""
    trial = copy.deepcopy(kf)
    trial.restore(trial.state())
    trial.predict()
    try:
        trial.update(np.zeros(kf.dim_z), **update)
    except TypeError as error:
        raise TypeError(f"update: expected the further arguments of {type(kf).__name__}.update, {error}") from None


def advance(
    kf: Any, update: Mapping[str, Any], series: Plain | None, jobs: Sequence[Any]
) -> list[tuple[dict[str, Array], Array] | Exception]:
    """Return state and columns of each job, or what was wrong with it; kf stays as it is."""
    found: list[Any] = [None] * len(jobs)
    if series is None:
        worker = copy.deepcopy(kf)
        for i, job in enumerate(jobs):
            try:
                found[i] = _alone(worker, update, kf, job)
            except REFUSED as error:
                found[i] = error
        return found
    for rows, x, P in _groups(series, kf, jobs, found):
        z = np.stack([jobs[i].z for i in rows])
        u = None if jobs[rows[0]].u is None else np.stack([jobs[i].u for i in rows])
        _together(series, kf, update, z, u, x, P, rows, found)
    return found


def _alone(worker: Any, update: Mapping[str, Any], kf: Any, job: Any) -> tuple[dict[str, Array], Array]:
    """Take the steps of one key by the filter's own methods."""
    state = kf.state()
    if job.state is not None:
        # Matrices are the model's.
        moving = {name: value for name, value in job.state.items() if name not in kf._settings}
        state = {**{name: value for name, value in state.items() if name in kf._settings}, **moving}
    worker.restore(state)
    n, m = kf.dim_x, kf.dim_z
    columns = np.empty((len(job.z), 2 * n + m))
    for k in range(len(job.z)):
        _step(worker, update, job, k)
        columns[k] = np.concatenate((np.ravel(worker.x), np.sqrt(np.diagonal(worker.P)), np.ravel(worker.weights)))
    return _state.labelled(type(kf).__name__, worker._moving()), columns


def _step(worker: Any, update: Mapping[str, Any], job: Any, k: int) -> None:
    """Predict and correct once, or raise with the step named."""
    try:
        if job.u is None:
            worker.predict()
        else:
            worker.predict(u=job.u[k])
        worker.update(job.z[k], **update)
    except REFUSED as error:
        error.args = (f"step {k}: {error}", *error.args[1:])
        raise


def _groups(series: Plain, kf: Any, jobs: Sequence[Any], found: list[Any]) -> Iterator[tuple[list[int], Array, Array]]:
    """Yield keys with equally many steps, their x and P; those without a fitting state are put among the found."""
    n = len(series.x)
    kinds: dict[tuple[int, bool], list[int]] = {}
    for i, job in enumerate(jobs):
        kinds.setdefault((len(job.z), job.u is None), []).append(i)
    for (steps, _), members in kinds.items():
        share = max(1, _GROUP // max(steps * (2 * n + len(series.H)), n * n))
        for first in range(0, len(members), share):
            rows = members[first : first + share]
            x, P = np.empty((len(rows), n)), np.empty((len(rows), n, n))
            good = [_started(series, kf, jobs[i].state, x, P, at, found, i) for at, i in enumerate(rows)]
            good = [at for at in good if at >= 0]
            if len(good) < len(rows):
                rows, x, P = [rows[at] for at in good], x[good], P[good]
            if rows and not (np.isfinite(x).all() and _checks.all_covariances(P)):
                good = [at for at, i in enumerate(rows) if _is_fit(kf, jobs[i].state, found, i)]
                rows, x, P = [rows[at] for at in good], x[good], P[good]
            if rows:
                yield rows, x, P


def _started(series: Plain, kf: Any, state: Any, x: Array, P: Array, at: int, found: list[Any], i: int) -> int:
    """Write x and P of a key and return their place, -1 if its state does not fit."""
    if state is None:
        x[at], P[at] = series.x, series.P
        return at
    try:
        label = state.get(_state.LABEL)
        if label is not series.label and not np.array_equal(label, series.label):
            _state.require_kind(state, type(kf).__name__)
        x[at], P[at] = np.reshape(state["x"], len(series.x)), state["P"]
        return at
    except (*REFUSED, KeyError, AttributeError):
        return at if _is_fit(kf, state, found, i) else -1


def _is_fit(kf: Any, state: Any, found: list[Any], i: int) -> bool:
    """Return whether a state fits the filter; what is wrong with it is put among the found."""
    if state is None:
        return True
    try:
        copy.deepcopy(kf).restore(state)
    except REFUSED as error:
        found[i] = error
        return False
    return True


def _together(
    series: Plain, kf: Any, update: Mapping[str, Any], z: Array, u: Array | None, x: Array, P: Array,
    rows: list[int], found: list[Any],
) -> None:  # fmt: skip
    """Advance keys with equally many steps, and put what comes of them among the found."""
    count, steps, m = z.shape
    n = x.shape[1]
    Bu = np.zeros((1, 1, n)) if u is None or series.B is None else np.ascontiguousarray(u @ series.B.T)
    columns = np.empty((count, steps, 2 * n + m))
    kept = Output(
        np.empty((count, steps, n)), np.empty((count, steps, 1, n)), np.empty((count, 0, n)),
        np.empty((count, 0, n, n)), np.empty((count, steps, m)), np.zeros(count),
    )  # fmt: skip
    model = Model(series.F[None, None], series.Q[None, None], series.H[None, None], series.R[None, None], Bu)
    done = _kernel(series, kf, z, model, x, P, kept, 0)
    for s in np.flatnonzero(done < steps).tolist():
        try:
            _mixed(series, kf, update, z, u, model, x, P, kept, s, int(done[s]))
        except REFUSED as error:
            found[rows[s]] = error
    columns[:, :, :n], columns[:, :, 2 * n :] = kept.means, kept.weights
    np.sqrt(np.maximum(kept.covariances[:, :, 0], 0.0), out=columns[:, :, n : 2 * n])
    shape = (n, 1) if series.column else (n,)
    for s, i in enumerate(rows):
        if found[i] is None:
            state = {_state.LABEL: series.label, "x": x[s].reshape(shape).copy(), "P": P[s].copy()}
            found[i] = state, columns[s]


def _kernel(series: Plain, kf: Any, z: Array, model: Model, x: Array, P: Array, kept: Output, start: int) -> np.ndarray:
    """Advance in place and return how many steps were taken."""
    if not z.shape[1]:
        return np.zeros(len(z), dtype=int)
    return dispatch.filter_series(
        series.size, kf._choices, z, model, x, P, kept, alpha_sq=kf._alpha_sq, likely=False, start=start
    )


def _mixed(
    series: Plain, kf: Any, update: Mapping[str, Any], z: Array, u: Array | None, model: Model, x: Array, P: Array,
    kept: Output, s: int, k: int,
) -> None:  # fmt: skip
    """Go on with one key from step k, which the kernel has declined: that step by the definition, then the kernel."""
    steps, only = z.shape[1], slice(s, s + 1)
    own = model if len(model.Bu) == 1 else Model(*model[:4], model.Bu[only])
    worker = copy.deepcopy(kf)
    part = Output(*(a[only] for a in kept))
    while k < steps:
        worker.x, worker.P = x[s].reshape(np.shape(worker.x)).copy(), P[s].copy()
        _step(worker, update, _Row(z[s], None if u is None else u[s]), k)
        kept.means[s, k], kept.covariances[s, k, 0] = np.ravel(worker.x), np.diagonal(worker.P)
        kept.weights[s, k] = np.ravel(worker.weights)
        x[s], P[s] = np.ravel(worker.x), worker.P
        k += 1
        if k < steps:
            k = int(_kernel(series, kf, z[only], own, x[only], P[only], part, k)[0])


class _Row(NamedTuple):
    """Measurements and inputs of one key."""

    z: Array
    u: Array | None
