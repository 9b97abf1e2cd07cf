"""Samples of n actuators through the recursion: the one driver of `ParameterTracker` and `TrackerBank`.

From one look to the next (at a start's samples, at residuals that may follow the inputs) by the kernel (``tracker.h``),
by the definition where the kernel declines.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import kernel
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices
from robust_filterpy.identification.estimation.identify import identify
from robust_filterpy.identification.models.guard import GUARDS
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.regressor import LARGEST
from robust_filterpy.identification.models.results import Columns
from robust_filterpy.identification.recursive import setup
from robust_filterpy.identification.recursive.handover import gone_on
from robust_filterpy.identification.recursive.noise_scale import NoiseScale
from robust_filterpy.identification.recursive.recursion import Recursion
from robust_filterpy.identification.recursive.start import ColdStart
from robust_filterpy.identification.recursive.state import Form, Past, State
from robust_filterpy.identification.recursive.watch import News
from robust_filterpy.kernel.series import SCALINGS, plain, rule

# So many samples at most go to the definition before the kernel has another try.
_MOST_ODD = 1024
# Findings in the samples of which the first model is made that are said: what these break, the samples to come may too.
_SAID = ("step", "ramp", "input outliers")


class Settings(NamedTuple):
    """What may be changed between two calls, and is then as it is for a whole call."""

    choices: tuple[Choices, ...] | None
    """Options of the correction, one for all or one each; None where the kernel does not serve."""
    F: Array
    """(1 or n, d, d); the definition takes those of the filters."""
    Q: Array
    alpha_sq: Array
    """(n,)"""
    enabled: np.ndarray
    """(n,)"""
    filter_of: Callable[[int], Any]
    """The filter of an actuator, for the definition."""
    place: Callable[[int, int], str]
    """How an error names a sample of an actuator."""
    most_odd: int = _MOST_ODD
    shows_last: bool = False
    """Whether the filter is to show the last samples: the definition takes them."""


def serves(choices: tuple[Choices, ...]) -> bool:
    """Return whether the kernel takes samples under these options: a tracker's spread is not learnt, R is."""
    learnt = float(SCALINGS.index("learnt"))
    rules = (rule(choice) for choice in choices)
    return kernel.extension() is not None and all(one is not None and one[4] != learnt for one in rules)


def advance(
    form: Form, using: Settings, now: State, y: Array, u: Array, R: Array | None
) -> tuple[State, Columns, News]:
    """Return what checked samples make of now, their columns with the axes (n, N), and what is to be said.

    y and R (n, N), u (n, N, n_inputs), y NaN where it is missing, R None for that of the state.
    """
    n, length = y.shape
    out, said, k = Columns.empty(n, length, form.layout.n), [], 0
    while k < length:
        part = slice(k, min(k + _waits(form, using, now), length))
        begun = np.flatnonzero(now.begun)
        if begun.size < n:
            _only_look_on(now, y, part, out)
        if begun.size:
            now = _taken(form, using, now, begun, (y, u, R), part, out)
        shown = Columns(*(column[:, part] for column in out))
        windows, news = now.windows.seen(shown.weights, shown.guard, shown.residual, now.scale[:, 0], form.has_offset)
        said += news
        now, news = _looked(form, using, now._replace(windows=windows), y[:, part], u[:, part], shown)
        said += news
        k = part.stop
    return now, out, said


def predicted(form: Form, using: Settings, now: State, u: Array) -> Array:
    """Return the next outputs (n,), the inputs (n, n_inputs) being u."""
    layout, u, past = form.layout, form.with_constant(u), now.past
    inputs, phi = np.empty_like(past.inputs), np.empty((len(u), layout.n))
    inputs[:, 1:] = past.inputs[:, :-1]
    inputs[:, layout.starts] = u[:, layout.used]
    phi[:, layout.outputs], phi[:, layout.inputs_in_phi] = past.outputs, inputs[:, layout.picks]
    phi[:, layout.f], phi[:, layout.c] = past.undisturbed, past.residuals
    wound_up = (using.alpha_sq != 1.0) & (np.einsum("ijj->i", now.P) > now.windup)
    with np.errstate(over="ignore", invalid="ignore"):
        moved = (using.F @ now.theta[:, :, None])[:, :, 0]
        theta = np.where((using.enabled & ~wound_up)[:, None], moved, now.theta)
        y = np.nan_to_num(np.einsum("ij,ij->i", phi, theta), posinf=LARGEST, neginf=-LARGEST)
    y = np.clip(y, -LARGEST, LARGEST) + now.centre
    for i in np.flatnonzero(~now.begun).tolist():
        y[i] = now.starts[i].levels(np.zeros(0))[-1]
    return y


# From one look to the next.


def _waits(form: Form, using: Settings, now: State) -> int:
    """Return after how many samples something is to be looked at, at least 1."""
    waits = [max(start.waits, 1) for start in now.starts.values()]
    return min([*waits, now.followed.waits(_watched(form, using, now))])


def _watched(form: Form, using: Settings, now: State) -> np.ndarray:
    """Return the actuators that start anew if their residuals follow the inputs."""
    mask = now.restarts & using.enabled
    if not mask.any() or not form.structure.n_inputs:
        return np.zeros(0, dtype=int)
    mask[list(now.starts)] = False
    return np.flatnonzero(mask)


def _only_look_on(now: State, y: Array, part: slice, out: Columns) -> None:
    """Take samples of the actuators that have no model yet."""
    for i in np.flatnonzero(~now.begun).tolist():
        out.theta[i, part], out.variance[i, part] = now.theta[i], np.inf
        out.prediction[i, part] = now.starts[i].levels(y[i, part])[:-1]
        out.residual[i, part] = y[i, part] - out.prediction[i, part]


def _looked(form: Form, using: Settings, now: State, y: Array, u: Array, shown: Columns) -> tuple[State, News]:
    """Return what these samples make of the starts, and of those that turn out to be lost."""
    watched, news = _watched(form, using, now), []
    for i, start in list(now.starts.items()):
        start = start.added(y[i], u[i])
        now = now._replace(starts={**now.starts, i: start})
        if using.enabled[i] and start.waits <= 0:
            now, said = _with_model(form, now, i, start)
            news += said
    if watched.size:
        signals = np.concatenate((shown.prediction[watched, :, None], u[watched]), axis=2)
        followed, lost = now.followed.looked(watched, shown.residual[watched], signals)
        now = now._replace(followed=followed)
        for i, trouble in lost:
            start = ColdStart.of(form.structure.n_theta, form.structure.n_inputs, int(now.samples[i]))
            now = now._replace(
                starts={**now.starts, i: start}, followed=now.followed.forgotten(i), windows=now.windows.forgotten(i)
            )
            news.append((i, f"{trouble}; it starts anew, and theta may jump when a model of the next samples is found"))
    return now, news


def _with_model(form: Form, now: State, i: int, start: ColdStart) -> tuple[State, News]:
    """Make a model of the samples so far and go on from there."""
    structure = form.structure
    try:
        with warnings.catch_warnings():
            # A short recording leaves several models open, and those to come decide.
            warnings.simplefilter("ignore", UserWarning)
            model = identify(
                start.y,
                start.u if structure.n_inputs else None,
                structure,
                offset=form.has_offset,
                R=None if now.scale[i, 3] else float(now.scale[i, 0]),
            )
    except ValueError as error:
        failure = str(error)
    else:
        failure, now = "", gone_on(form, now, i, model)
    others = {j: other for j, other in now.starts.items() if j != i}
    if start.is_last_look and not failure:
        now = now._replace(starts=others)
        return _usual(form, now, i, start, model) if structure.n_inputs else (now, [])
    now = now._replace(starts={**others, i: start.waiting(structure.n_theta)})
    if not start.is_last_look:
        return now, []
    sentence = f"no model can be made of {start.y.size} samples, it goes on looking: {failure}"
    windows, news = now.windows.without_model(i, sentence)
    return now._replace(windows=windows), news


def _usual(form: Form, now: State, i: int, start: ColdStart, model: Model) -> tuple[State, News]:
    """Learn from a model's own recording what is usual; say what is odd in that recording already."""
    prediction = model.predict(start.y, start.u)
    signals = np.column_stack((np.nan_to_num(prediction), start.u))
    followed, share = now.followed.begun(i, start.y - prediction, signals)
    now = now._replace(followed=followed)
    odd = {one.kind: one.text for one in model.findings}
    taken = [text for kind, text in odd.items() if kind in _SAID or (kind == "another plant" and not share)]
    if not (share or taken):
        return now, []
    sentence = (
        f"of its first {start.y.size} samples: {'; '.join(taken)}"
        if taken
        else (
            f"{100 * share:.0f} % of what the model of the first {start.y.size} samples leaves follow the inputs: the "
            f"structure is too small, or the noise is another than that of {form.structure}; compare by validate and "
            "select_structure"
        )
    )
    windows, news = now.windows.without_model(i, sentence)
    return now._replace(windows=windows), news


# Through the samples.


class _Arrays(NamedTuple):
    """Copies of what a sample moves, for some of the actuators: the kernel writes into them."""

    theta: Array
    P: Array
    past: Past
    scale: Array


def _taken(
    form: Form, using: Settings, now: State, which: np.ndarray, signals: tuple[Array, Array, Array | None],
    part: slice, out: Columns,
) -> State:  # fmt: skip
    """Return what samples of the actuators that have begun make of now."""
    stacks = now.theta, now.P, now.scale, *now.past
    if which.size == len(now.theta):
        theta, P, scale, *past = (stack.copy() for stack in stacks)
    else:
        theta, P, scale, *past = (plain(stack[which]) for stack in stacks)
    arrays = _Arrays(theta, P, Past(*past), scale)
    after = np.full(len(which), part.start)
    stops = _last_shown(using, signals[0], part)
    if using.choices is not None:
        after = _by_kernel(form, using, now, which, signals, arrays, slice(part.start, stops[0]), out)
    for row in np.flatnonzero(after < part.stop).tolist():
        _finished(form, using, now, which, row, int(after[row]), signals, arrays, stops, out)
    if which.size == len(now.theta):
        return now._replace(theta=arrays.theta, P=arrays.P, past=arrays.past, scale=arrays.scale)

    def whole(stack: Array, rows: Array) -> Array:
        found = stack.copy()
        found[which] = rows
        return found

    past = [whole(a, b) for a, b in zip(now.past, arrays.past, strict=True)]
    theta, P, scale = whole(now.theta, arrays.theta), whole(now.P, arrays.P), whole(now.scale, arrays.scale)
    return now._replace(theta=theta, P=P, past=Past(*past), scale=scale)


def _last_shown(using: Settings, y: Array, part: slice) -> list[int]:
    """Return before which samples the kernel stops, since the filter is to show them, and the end."""
    if not using.shows_last or part.stop < y.shape[1]:
        return [part.stop]
    if part.stop - part.start == 1:
        return [part.start, part.stop]
    known = part.start + np.flatnonzero(y[0, part] == y[0, part])
    return [*sorted({*known[-1:].tolist(), part.stop - 1}), part.stop]


def _by_kernel(
    form: Form, using: Settings, now: State, which: np.ndarray, signals: tuple[Array, Array, Array | None],
    arrays: _Arrays, part: slice, out: Columns, rows: slice = slice(None),
) -> np.ndarray:  # fmt: skip
    """Advance actuators by the kernel and return the first sample of each that is left to the definition."""
    y, u, R = signals
    here = which[rows]
    if part.start >= part.stop:
        return np.full(len(here), part.start)
    own = here if len(here) < len(y) else slice(None)
    flags = np.empty((len(here), 4), dtype=np.intp)
    flags[:, 0], flags[:, 1] = form.gradient[own] == "filtered", [GUARDS.index(name) for name in form.guard[own]]
    flags[:, 2], flags[:, 3] = form.cleans, using.enabled[own]
    rules = np.stack([rule(choice) for choice in using.choices])  # type: ignore[misc, union-attr]
    shared = [(a if len(a) == 1 else a[own])[:, None] for a in (rules, using.F, using.Q)]
    written = Columns(*(column[own, part] for column in out))
    blocks = [np.ascontiguousarray(column) for column in written]
    done = np.zeros(len(here), dtype=np.intp)
    kernel.extension().track(
        form.layout.numbers,
        (*map(plain, (*shared, using.alpha_sq[own], now.windup[own], now.centre[own])), flags),
        (y[own, part], u[own, part], None if R is None else R[own, part]),
        tuple(a[rows] for a in (arrays.theta, arrays.P, *arrays.past, arrays.scale)), tuple(blocks), done,
    )  # fmt: skip
    for column, block in zip(out, blocks, strict=True):
        column[own, part] = block
    return part.start + done


def _finished(
    form: Form, using: Settings, now: State, which: np.ndarray, row: int, k: int,
    signals: tuple[Array, Array, Array | None], arrays: _Arrays, stops: list[int], out: Columns,
) -> None:  # fmt: skip
    """Take the rest of one actuator's samples: the definition those that the kernel declines or the filter shows."""
    end, odd, one = stops[-1], 1, slice(row, row + 1)
    while k < end:
        shown = k in stops[:-1]
        until = end if using.choices is None else min(k + (1 if shown else odd), next(s for s in stops if s > k))
        _by_definition(form, using, now, which, row, signals, arrays, slice(k, until), out)
        k = until
        if using.choices is not None and k not in stops:
            part = slice(k, next(s for s in stops if s > k))
            k = int(_by_kernel(form, using, now, which, signals, arrays, part, out, one)[0])
            odd = 1 if k - part.start >= odd else min(2 * odd, using.most_odd)


def _by_definition(
    form: Form, using: Settings, now: State, which: np.ndarray, row: int,
    signals: tuple[Array, Array, Array | None], arrays: _Arrays, part: slice, out: Columns,
) -> None:  # fmt: skip
    """Take samples of one actuator by the definition."""
    i, (y, u, R) = int(which[row]), signals
    kf, centre, memory = using.filter_of(i), float(now.centre[i]), arrays.past.memory(form.layout, row)
    setup.load(kf, arrays.theta[row], arrays.P[row], float(arrays.scale[row, 0]))
    one = Recursion(form, i, kf, bool(using.enabled[i]), float(now.windup[i]))
    scale, inputs, k = NoiseScale(*arrays.scale[row, 1:].tolist()), form.with_constant(u[i, part]), part.start
    outputs, variances = (y[i, part] - centre).tolist(), repeat(None) if R is None else R[i, part].tolist()
    try:
        for k, output, v, r in zip(range(part.start, part.stop), outputs, inputs, variances, strict=False):
            sample, scale = one.stepped(memory, scale, output, v, r)
            out.prediction[i, k], out.residual[i, k] = sample.prediction + centre, sample.residual
            out.weights[i, k], out.guard[i, k] = sample.weight, sample.guard
            out.theta[i, k], out.variance[i, k] = np.ravel(kf.x), np.diagonal(kf.P)
    except (ValueError, TypeError, np.linalg.LinAlgError) as error:
        error.args = (f"{using.place(k, i)}{error}", *error.args[1:])
        raise
    arrays.theta[row], arrays.P[row] = np.ravel(kf.x), kf.P
    arrays.scale[row] = setup.told_variance(kf), *scale
    for stack, value in zip(arrays.past, Past.of(memory), strict=True):
        stack[row] = value[0]
