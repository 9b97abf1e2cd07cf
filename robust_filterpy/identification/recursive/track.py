"""Samples of n actuators through the recursion: the driver of `Following`.

From one look to the next (at a start's samples, at residuals that may follow the inputs) by the kernel (``tracker.h``),
by the definition where the kernel declines.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from itertools import repeat
from typing import Any

import numpy as np

from robust_filterpy import kernel
from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.filters.kalman import RobustKalmanFilter, replaced
from robust_filterpy.filters.notices import StuckSensorWarning
from robust_filterpy.identification.estimation.disturbances import Settled
from robust_filterpy.identification.estimation.estimate import near
from robust_filterpy.identification.estimation.identify import identify
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.recording import measurements
from robust_filterpy.identification.models.regressor import LARGEST, are_stable
from robust_filterpy.identification.recursive import recursion
from robust_filterpy.identification.recursive.recursion import ColdStart, Form, Recursion, State, Unjudged
from robust_filterpy.identification.recursive.watch import OF_START, OF_STUCK, SPAN, STUCK, News, is_right, long_held
from robust_filterpy.kernel.series import SCALINGS, rule

_LEARNT = float(SCALINGS.index("learnt"))
# Findings in the samples of which the first model is made that are said: what these break, the samples to come may too.
_SAID = ("step", "ramp", "input outliers")
# With F(1) below this a constant before 1/F has no level.
_INTEGRATES = 1e-9
_Signals = tuple[Array, Array, Array | None]


def rules_of(kf: RobustKalmanFilter) -> Array | None:
    """Return a filter's options for the kernel, None where that does not serve; a tracker's spread is not learned."""
    # Of our own filter as it comes the kernel gives the numbers of `update`.
    own = type(kf) is RobustKalmanFilter and not (replaced(kf) or kf.policy.noise or kf.choices.patience)
    one = rule(kf.choices) if own else None
    return None if one is None or one[4] == _LEARNT else np.array([[one]])


def goes_by_kernel(form: Form) -> bool:
    """Tell whether the kernel takes the samples, as long as nothing is out of the ordinary."""
    return form.rules is not None and kernel.extension() is not None


def settled(form: Form, now: State) -> tuple[State, News]:
    """Return a state that has looked at the samples that wait for it, and what is to be said of them."""
    waiting = now.unjudged
    if not waiting.samples:
        return now, []
    y, u, out = (np.concatenate(part, axis=1) for part in zip(*waiting.samples, strict=True))
    return _judged(form, now._replace(unjudged=Unjudged()), waiting, y, u, out[:, :, -4:])


def advance(
    form: Form, now: State, flags: np.ndarray, place: Callable[[int, int], str], signals: _Signals
) -> tuple[State, Array, News]:
    """Return what checked samples make of now, a row for each with the axes (n, N, ..), and what is to be said."""
    # The signals are y (n, N), NaN where it is missing, u (n, N, n_inputs), and R (n, N), None for that of the state.
    # In a row stand theta, its variances, prediction, residual, weight and guard. Flags are those of the form with who
    # learns, (n, 5); place names a sample of an actuator in an error.
    y, u, _ = signals
    said: News = []
    length, d, k, waiting = y.shape[1], form.layout.n, 0, now.unjudged
    # What is looked at from time to time waits until that is due, of samples that come one by one.
    waits = length == 1 and goes_by_kernel(form) and not (now.starts and not now.begun.all())
    if waiting.samples and not (waits and waiting.flags is flags):
        now, said = settled(form, now)
    out = np.empty((*y.shape, form.width))
    while k < length:
        waiting = now.unjudged if now.unjudged.samples else _begun(form, now, flags, waits)
        part = slice(k, min(k + waiting.due, length))
        if not waits:
            stage(f"sample {k} of {length}")
            for i in np.flatnonzero(~now.begun).tolist():
                # Without a model yet.
                level = now.starts[i].levels(y[i, part])[:-1]
                out[i, part, :d], out[i, part, d : 2 * d] = now.theta[i], np.inf
                out[i, part, -4:] = np.column_stack(
                    (level, y[i, part] - level, np.full(level.size, np.nan), 0.0 * level)
                )
        moved, kept = _through(form, now, flags, place, signals, out, part)
        # What views cost, of one sample is much.
        here = (y, u, out) if length == 1 else (y[:, part], u[:, part], out[:, part])
        samples = (*waiting.samples, here)
        now = State(moved, now.record, now.settings, kept, *now[4:-1], Unjudged(samples, *waiting[1:]))
        # Of a sensor that is stuck the user hears at once.
        stuck = form.judges and now.part("readings")[:, -1].any()
        if not waits or len(samples) >= waiting.due or stuck:
            now, news = settled(form, now)
            said += news
        k = part.stop
    return now, out, said


def predicted(form: Form, now: State, enabled: np.ndarray, u: Array) -> Array:
    """Return the next outputs (n,), the inputs (n, n_inputs) being u."""
    u, past = form.with_constant(u), now.past
    phi = past.regressor(form.layout, past.with_input(form.layout, u))
    wound_up = (now.settings["alpha_sq"] != 1.0) & (np.einsum("ijj->i", now.P) > now.part("windup"))
    with np.errstate(over="ignore", invalid="ignore"):
        moved = (now.settings["F"] @ now.theta[:, :, None])[:, :, 0]
        theta = np.where((enabled & ~wound_up)[:, None], moved, now.theta)
        y = np.nan_to_num(np.einsum("ij,ij->i", phi, theta), posinf=LARGEST, neginf=-LARGEST)
    y = np.clip(y, -LARGEST, LARGEST) + now.part("centre")
    for i in np.flatnonzero(~now.begun).tolist():
        y[i] = now.starts[i].levels(np.zeros(0))[-1]
    return y


# From one look to the next.


def _begun(form: Form, now: State, flags: np.ndarray, waits: bool) -> Unjudged:
    """Return what is needed before the first of some samples to look at them together."""
    mask = flags[:, 3] > 0
    mask[list(now.starts)] = False
    watched = np.flatnonzero(mask)
    # Where a look changes nothing of the recursion, those at a recording wait for its end.
    changing = watched if waits else watched[now.restarts[watched]]
    due = min([now.watch.waits(changing), *(max(start.waits, 1) for start in now.starts.values())])
    return Unjudged((), due, watched, flags, now.part("readings")[:, -1])


def _judged(form: Form, now: State, waiting: Unjudged, y: Array, u: Array, shown: Array) -> tuple[State, News]:
    """Return what samples that have been taken say of sensors, starts, and of models that turn out to be lost."""
    left_out = np.isnan(shown[:, :, 1]) & ~np.isnan(y)
    watch, news = now.watch.once(OF_STUCK, long_held(left_out, waiting.stuck), STUCK, StuckSensorWarning)
    now = now._replace(watch=watch)
    for i, start in list(now.starts.items()):
        start = start.added(y[i], u[i])
        now = now._replace(starts={**now.starts, i: start})
        if waiting.flags[i, 3] and start.waits <= 0:
            now, said = _with_model(form, now, i, start)
            news += said
    if not waiting.watched.size:
        return now, news
    prediction, residual, *believed = np.moveaxis(shown, -1, 0)
    new = np.stack((residual, prediction, *np.moveaxis(u, -1, 0), *believed), axis=-1)[waiting.watched]
    theta = now.theta[:, form.own]
    watch, lost = now.watch.looked(
        waiting.watched, now.restarts, new, form.structure, theta, now.scale, form.has_offset
    )
    now = now._replace(watch=watch)
    for i, one in ((one.actuator, one) for one in lost):
        if one.gain:
            now = with_gain(form, now, i, one.gain, watch.rows[i, -SPAN:, 2:-2].mean(axis=0))
        elif one.restarts:
            start = ColdStart.of(form.structure.n_theta, form.structure.n_inputs, int(now.part("samples")[i]))
            now = now._replace(starts={**now.starts, i: start}, watch=now.watch.forgotten(i))
    return now, news + lost


def _with_model(form: Form, now: State, i: int, start: ColdStart) -> tuple[State, News]:
    """Make a model of the samples so far and go on from there."""
    structure = form.structure
    stage(f"a model of {start.y.size} samples")
    try:
        model = _near(form, now, i, start) or _identified(form, now, i, start)
    except ValueError as error:
        failure = str(error)
    else:
        failure, now = "", gone_on(form, now, i, model)
        now = _with_readings(now, i, start, model)
    others = {j: other for j, other in now.starts.items() if j != i}
    if start.is_last_look and not failure:
        now = now._replace(starts=others)
        return _usual(form, now, i, start, model) if structure.n_inputs else (now, [])
    now = now._replace(starts={**others, i: start.waiting(structure.n_theta)})
    if not start.is_last_look:
        return now, []
    sentence = f"no model can be made of {start.y.size} samples, it goes on looking: {failure}"
    watch, news = now.watch.once(OF_START, np.arange(len(now.begun)) == i, sentence)
    return now._replace(watch=watch), news


def _identified(form: Form, now: State, i: int, start: ColdStart, begin: Array | None = None) -> Model:
    """Return a model of the samples of a start, searched for from every start or from one alone, or raise."""
    u, R = start.u if form.structure.n_inputs else None, None if now.scale[i, 3] else float(now.scale[i, 0])
    # What the level does besides is looked for at first and at last, and intervals are for the last model.
    looks = begin is None or start.is_last_look
    trend: Any = Settled(np.zeros(0 if looks else start.y.size), begin=begin, draws=start.is_last_look)
    with warnings.catch_warnings():
        # A short recording leaves several models open, and those to come decide.
        warnings.simplefilter("ignore", UserWarning)
        # The samples to come wait, and `run` says itself what it is at.
        return identify(start.y, u, form.structure, offset=form.has_offset, R=R, trend=trend, progress=False)


def _near(form: Form, now: State, i: int, start: ColdStart) -> Model | None:
    """Return the model near the recursion's, None if what it leaves follows the inputs: another one may be better."""
    structure, theta, places = form.structure, now.theta[i][form.own], form.structure.polynomials
    a, f = (1.0 + float(theta[part].sum()) for part in (places.a, places.f))
    stable = are_stable(theta, structure.stable_parts) and abs(f) > _INTEGRATES
    # The first model, and that of another plant, are searched for from every start; so is the last one where noise has
    # dynamics: of the several ends of such a search the nearest need not be the best.
    stays = start.is_last_look and structure.nc + structure.nd > 0
    if stays or start.is_first_look(structure.n_theta) or not (now.begun[i] and stable):
        return None
    offset = float(now.part("centre")[i] * a + now.theta[i, structure.constant_place] / f) if form.has_offset else 0.0
    begin = near(structure, theta, offset, structure, start.u)
    begin = begin if form.has_offset else np.delete(begin, structure.n_theta)
    try:
        model = _identified(form, now, i, start, begin)
    except ValueError:
        return None
    return model if is_right(*_left(model, start)) else None


def _left(model: Model, start: ColdStart) -> tuple[Array, Array]:
    """Return what a model leaves of its own recording, and the signals that this is held against."""
    prediction = model.predict(start.y, start.u if model.structure.n_inputs else None)
    return start.y - prediction, np.column_stack((np.nan_to_num(prediction), start.u))


def _with_readings(now: State, i: int, start: ColdStart, model: Model) -> State:
    """Learn from a model's own recording how often the sensor repeats itself, and how white its noise is."""
    y, (nu, _) = measurements(start.y, start.u)[0] - now.part("centre")[i], _left(model, start)
    row = np.zeros(recursion.READINGS)
    for k in np.flatnonzero(~np.isnan(y + nu)).tolist():
        recursion.note(row, float(y[k]), float(nu[k]))
    return now.with_parts(i, readings=row)


def _usual(form: Form, now: State, i: int, start: ColdStart, model: Model) -> tuple[State, News]:
    """Learn from a model's own recording what is usual; say what is odd in that recording already."""
    watch, share = now.watch.begun(i, *_left(model, start), float(now.scale[i, 4]))
    odd = {one.kind: one.text for one in model.findings}
    news: News = []
    which = np.arange(len(now.begun)) == i
    if "stuck" in odd:
        text = f"of its first samples: {odd['stuck']}"
        watch, news = watch.once(OF_STUCK, which, text, StuckSensorWarning)
    taken = [text for kind, text in odd.items() if kind in _SAID or (kind == "another plant" and not share)]
    sentence = (
        f"{100 * share:.0f} % of what the model of the first {start.y.size} samples leaves follow the inputs: the "
        f"structure is too small, or the noise is another than that of {form.structure}; compare by validate and "
        "select_structure"
    )
    if taken:
        sentence = f"of its first {start.y.size} samples: {'; '.join(taken)}"
    watch, more = watch.once(OF_START, which & bool(share or taken), sentence)
    return now._replace(watch=watch), news + more


# From a model to a recursion that goes on at its end, or with another gain.


def gone_on(form: Form, now: State, i: int, model: Model) -> State:
    """Return what becomes of actuator i by a model: it goes on at the end of the model's recording."""
    structure, layout = form.structure, form.layout
    n, places, place = structure.n_theta, structure.polynomials, structure.constant_place
    x, P, memory, centre = model.theta, model.P, model.memory, float(now.part("centre")[i])
    if form.has_offset:
        # The constant is one more input of B/F, and drives the output from its center.
        centre = model.level
        a, f = (1.0 + float(model.theta[part].sum()) for part in (places.a, places.f))
        constant, J = (model.offset - centre * a) * f, np.eye(n + 1)
        J[n, places.a], J[n, n] = -centre * f, f
        order, joint = np.insert(np.arange(n), place, n), np.nan_to_num(model.joint, posinf=0.0)
        x, P = np.append(x, constant)[order], (J @ joint @ J.T)[np.ix_(order, order)]
    P, scale = 0.5 * (P + P.T), now.scale[i].copy()
    # Of past outputs in the regressor, too.
    scale[4] = math.sqrt(12.0 * model.noise.least * (1.0 + float(np.square(x[layout.a]).sum())))
    if scale[3]:
        # A recording without noise says nothing of how large it is.
        stands_on = 0.0 if model.noise.is_rounding else float(model.weights.size)
        scale[:3] = model.R, stands_on, recursion.ordinary_mean(model.noise.influence)
    if form.has_offset:
        f, c, d = (1.0 + float(x[part].sum()) for part in (layout.f, layout.c, layout.d))
        prefiltered = 1.0 / max(abs(f), 1e-6)
        response = prefiltered * d / max(abs(c), 1e-6)
        memory = memory._replace(
            inputs=np.append(memory.inputs, 1.0),
            gradients=np.insert(memory.gradients, place, response, axis=1),
            prefiltered=np.insert(memory.prefiltered, place, prefiltered, axis=1),
        )
    return now.with_parts(
        i, theta=x, P=P, **memory._asdict(), scale=scale, centre=centre,
        windup=recursion.WINDUP * max(float(np.trace(P)), 1e-300), begun=True, restarts=True,
    )  # fmt: skip


def with_gain(form: Form, now: State, i: int, g: float, u: Array) -> State:
    """Return what becomes of actuator i by a gain that has changed: theta moves by it, and P says how surely."""
    theta = now.theta[i]
    along, places = np.zeros(theta.size), form.structure.polynomials
    for j, b in enumerate(places.b):
        along[form.own[b]] = theta[form.own[b]]
        if form.has_offset:
            along[form.structure.constant_place] -= theta[form.own[b]].sum() * u[j]
    return now.with_parts(i, theta=theta + g * along, P=now.P[i] + g**2 * np.outer(along, along))


# Through the samples.


def _through(
    form: Form, now: State, flags: np.ndarray, place: Callable[[int, int], str], signals: _Signals, out: Array,
    part: slice,
) -> tuple[Array, tuple[dict[str, Array], ...]]:  # fmt: skip
    """Return what moves and is kept after samples of the actuators that have begun; the kernel may decline some."""
    everyone = not now.starts or bool(now.begun.all())
    which: Any = slice(None) if everyone else np.flatnonzero(now.begun)
    moved = now.moved.copy() if everyone else now.moved[which]
    kept, done, length, by_kernel = list(now.kept), [0] * len(moved), part.stop - part.start, goes_by_kernel(form)
    if by_kernel and done:
        done = _by_kernel(form, now, flags, moved, which, signals, out, part)
    for row in [row for row, count in enumerate(done) if count < length]:
        i, one, k = int(np.arange(len(now.moved))[which][row]), moved[row : row + 1], part.start + done[row]
        while k < part.stop:
            until = k + 1 if by_kernel else part.stop
            parts, of = one.view(now.record)[0, 0], slice(k, until)
            kept[i : i + 1] = _by_definition(form, now, bool(flags[i, 3]), place, parts, i, signals, out, of)
            k = until
            if k < part.stop:
                k += _by_kernel(form, now, flags, one, np.array([i]), signals, out, slice(k, part.stop))[0]
    if not everyone:
        rest, moved = moved, now.moved.copy()
        moved[which] = rest
    return moved, tuple(kept)


def _by_kernel(
    form: Form, now: State, flags: np.ndarray, moved: Array, own: np.ndarray | slice, signals: _Signals, out: Array,
    part: slice,
) -> list[int]:  # fmt: skip
    """Advance what moves of some actuators in place, and return how many samples of each the kernel has taken."""
    (y, u, R), done, settings = signals, np.zeros(len(moved), dtype=np.intp), now.settings
    (F, Q, alpha_sq), taken, written = (settings[name] for name in ("F", "Q", "alpha_sq")), signals, out
    if len(done) < len(y):
        F, Q, alpha_sq, flags = F[own], Q[own], alpha_sq[own], flags[own]
    # What a view costs, of one sample is much.
    if len(done) < len(y) or part.stop - part.start < y.shape[1]:
        taken = y[own, part], u[own, part], None if R is None else R[own, part]
        written = np.ascontiguousarray(out[own, part])
    track, numbers = kernel.extension().track, form.layout.numbers
    track(*taken, numbers, form.rules, F[:, None], Q[:, None], alpha_sq, flags, moved, written, done)
    if written is not out:
        out[own, part] = written
    return done.tolist()


def _by_definition(
    form: Form, now: State, enabled: bool, place: Callable[[int, int], str], parts: Any, i: int, signals: _Signals,
    out: Array, part: slice,
) -> tuple[dict[str, Array], ...]:  # fmt: skip
    """Take samples of actuator i by the definition, write into the record of what moves of it, return what it keeps."""
    (y, u, R), kf, centre, k = signals, form.filter, float(parts["centre"]), part.start
    recursion.load(form, now, i, parts["theta"], parts["P"], float(parts["scale"][0]))
    one = Recursion(form, enabled, parts)
    inputs, outputs = form.with_constant(u[i, part]), (y[i, part] - centre).tolist()
    variances = repeat(None) if R is None else R[i, part].tolist()
    try:
        for k, output, v, r in zip(range(part.start, part.stop), outputs, inputs, variances, strict=False):
            sample = one.step(output, v, r)
            out[i, k] = *np.ravel(kf.x), *np.diagonal(kf.P), sample.prediction + centre, *sample[1:]
    except (ValueError, TypeError, np.linalg.LinAlgError) as error:
        error.args = (f"{place(k, i)}{error}", *error.args[1:])
        raise
    scale = recursion.noise_variance(kf), *one.scale
    after = {"theta": np.ravel(kf.x), "P": kf.P, "scale": scale, "readings": one.readings, **one.memory._asdict()}
    for name, value in after.items():
        parts[name] = value
    return recursion.kept_of(kf) if now.kept else ()
