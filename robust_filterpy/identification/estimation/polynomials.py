"""identify for structures of polynomials: the model of one output beside levels, without a motion that never dies."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.signal import lfilter

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.identification.estimation.beside import Beside, Search, Settled, far_outside, of_impulses
from robust_filterpy.identification.estimation.cleaning import cleaned
from robust_filterpy.identification.estimation.estimate import Problem, estimated
from robust_filterpy.identification.estimation.left import parts_of, wraps
from robust_filterpy.identification.estimation.prediction_error import colour_of
from robust_filterpy.identification.estimation.trend import LAGS_OF_IMPULSES, PRICE
from robust_filterpy.identification.models.dependence import driven
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.results import Finding
from robust_filterpy.identification.models.signals import fingerprint
from robust_filterpy.influence.regression import mad_scale

# A share of its response that the impulse response of `impulse_output` leaves out calls for a model of the differences.
_SLOW: Final = 0.7
# Motion counts if its size in the second half is this share of y's; it never dies if (1 - |pole|) N is below the other.
_SMALL: Final = 0.05
_ENDLESS: Final = 0.1
# What rows far outside make of y is off by so many deviations where they are wrong.
_LEVERAGE: Final = 5.0
# A part in which outliers leave less than this share clear is judged as it was measured; less is enough where the model
# is of other recordings too, of which one may be of another plant in all of its samples.
_LEAST_CLEAR: Final = 0.5
_LEAST_CLEAR_BESIDE: Final = 0.75


def identified_polynomials(problem: Problem, y: Array, index: Any, trend: str | Settled) -> Model:
    """Find the model of recordings of one output, shape (N, 1), beside whatever else these have."""
    spans, own = problem.spans, y[:, 0]

    def find(u: Array, levels: Array, columns: list[Array], end: Any) -> Beside:
        at = np.hstack(columns) if columns else None
        estimate = estimated(problem.of_inputs(u), (y - levels)[:, 0], at, end)
        moved = levels if at is None else levels + (at @ estimate.sizes)[:, None]
        return Beside(estimate.model, moved, u, estimate.model.evidence, end=estimate.p)

    def alone(model: Model, y: Array, u: Array) -> Array:
        return np.concatenate([_output_of(model, y[part, 0], u[part]) for part in spans])[:, None]

    def starts(u: Array, plain: Model) -> Iterator[Array]:
        yield of_impulses(y, u, spans)
        acted = problem.of_inputs(u)
        if _is_slow(plain, len(y)) and len(spans) == 1:
            try:
                differences = acted._replace(u=np.diff(u, axis=0), rest=np.zeros(u.shape[1]), sampled=False)
                model = estimated(differences, np.diff(own)).model
            except ValueError:
                return
            yield replace(model, operating_point=acted.rest).simulate(u)[:, None]

    def settled(best: Beside) -> Beside:
        return _without_endless_motion(problem.of_inputs(best.u), own, best)

    search = Search(y, problem.u, spans, find, alone, starts, True, settled, index)
    # A row of the caller's regressor is no input that is held.
    best = _without_leverage(problem, own) if problem.structure.takes_phi else search.best(trend)
    model, levels = best.model, best.levels[:, 0]
    if len(spans) > 1:
        again = zip(spans, model.recordings, strict=True)
        model = replace(model, recordings=tuple((fingerprint(own[part]), t + levels[part]) for part, (_, t) in again))
    elif levels.any():
        model = replace(model, trend=levels, fingerprint=fingerprint(own))
    return replace(model, findings=(*best.findings, *_left(search, problem.of_inputs(best.u), best, model)))


def _left(search: Search, problem: Problem, best: Beside, model: Model) -> tuple[Finding, ...]:
    """Find what the model leaves of its recordings."""
    structure, y, several = model.structure, search.y[:, 0], len(search.spans) > 1
    if not structure.n_inputs:
        return ()
    predicted = [model.predict(y[part], problem.u[part]) for part in search.spans]
    residual = y - np.concatenate(predicted)
    if structure.takes_phi:
        return wraps(y, residual)
    output, clear = np.zeros(y.size), residual
    if not model.noise.is_rounding:
        signals = zip(search.spans, predicted, strict=True)
        judged = [_judged(model, y[part], problem.u[part], one, several) for part, one in signals]
        output, clear = (np.concatenate(each) for each in zip(*judged, strict=True))
    # Only a structure that models the noise can be right about what goes back to the input.
    meaning = (
        f"{structure} is unbiased only as far as its noise model is right: validate it, and try more c's and d's"
        if structure.na + structure.nc + structure.nd
        else f"{structure} is biased by that unless the noise is white: BoxJenkins or ARMAX model the noise"
    )
    acting = driven(structure, model.theta, output, problem.u)[:, None]
    direct = min(nk for _, nk in structure.inputs) == 0
    more = _slow_noise(model, clear)
    left = search.left(best, output[:, None], residual[:, None], problem.rest, direct, meaning, acting, clear[:, None])
    return (*left, *more)


def _slow_noise(model: Model, residual: Array) -> tuple[Finding, ...]:
    """Find out whether what a model with measured outputs in its regressor leaves follows itself."""
    e = np.nan_to_num(residual)
    gain = 2.0 * colour_of(model.noise.psi(e)).gain
    if not model.structure.na or model.noise.is_rounding or gain < PRICE * np.log(e.size):
        return ()
    text = (
        f"what {model.structure} leaves follows itself, and so does its regressor, which holds y: its parameters are "
        "biased by that, further than their standard deviations say; OutputError and BoxJenkins are not, or more a's"
    )
    return (Finding("noise that follows itself", text, gain, (0, e.size)),)


def _judged(model: Model, y: Array, u: Array, predicted: Array, several: bool) -> tuple[Array, Array]:
    """Return what a model makes of the inputs of a recording, and what it leaves, NaN where outliers spoil it."""
    whole, trend = cleaned(model, y, u), model.trend if model.trend.size else np.zeros(y.size)
    parts, residual = parts_of(y.size, several), y - predicted
    if whole is None:
        # A prediction follows a level that wanders, and after a jump of it both are off together for a while.
        output = model.simulate(u) if model.structure.nd else predicted - trend
        return np.nan_to_num(output - model.level), residual
    # A part that is nearly all outliers is of another plant, whatever replaces them.
    measured = ~np.isnan(y) & (np.arange(y.size) >= whole.prepared.first)
    clear = whole.clear & measured
    least = _LEAST_CLEAR_BESIDE if several else _LEAST_CLEAR
    own = parts[clear[parts].sum(axis=1) < least * measured[parts].sum(axis=1)].ravel()
    clear[own] = False
    left, output = np.where(clear, whole.residual, np.nan), whole.prepared.y - whole.residual
    if own.size:
        left[own] = residual[own]
        # Predictions from outputs as measured carry their outliers to the residuals: what u alone makes does not.
        output[own] = model.simulate(u)[own]
    return np.nan_to_num(output - model.level), left


def _without_endless_motion(problem: Problem, y: Array, best: Beside) -> Beside:
    """Find the model again from rest if what was in motion when the recording began would outlast it."""
    model, own = best.model, y - best.levels[:, 0]
    slowest = float(np.abs(np.roots(model.parts.f)).max(initial=0.0))
    longest = max(part.stop - part.start for part in problem.spans)
    if not model.structure.n_inputs or abs(1.0 - slowest) * longest >= _ENDLESS:
        return best
    if len(problem.spans) == 1:
        late = slice(y.size // 2, None)
        motion = model.free_run(own, problem.u)[late] - model.simulate(problem.u)[late]
        if np.sqrt(np.mean(np.square(motion))) < _SMALL * np.nanstd(y):
            return best
    stage("the model from rest")
    still = estimated(problem._replace(moving=False), own).model
    text = (
        f"a pole at {slowest:.6g} would keep what was in motion when y began beyond its {y.size} samples, which cannot "
        "tell it from none: the model begins at rest"
    )
    finding = Finding("slow start", text, 2.0 * (still.log_likelihood - model.log_likelihood), (0, y.size))
    return best._replace(model=still, evidence=still.evidence, findings=(*best.findings, finding))


def _is_slow(model: Model, samples: int) -> bool:
    """Tell whether much of a model's response comes later than the lags of `impulse_output`."""
    parts, impulse = model.parts, np.eye(1, samples).ravel()
    with np.errstate(all="ignore"):
        sizes = [np.abs(lfilter(b, np.convolve(parts.a, parts.f), impulse)) for b in parts.b]
        return any(size[LAGS_OF_IMPULSES:].sum() > _SLOW * size.sum() for size in sizes)


def _output_of(model: Model, y: Array, u: Array) -> Array:
    """Return a model's output, with the motion in which it began if that dies."""
    rest, run = model.simulate(u), model.free_run(y, u)
    motion, defined = run - rest, ~np.isnan(run)
    late = motion[y.size // 2 :]
    dies = np.sqrt(np.mean(np.square(late))) < _SMALL * mad_scale(y[~np.isnan(y)] - np.nanmedian(y))
    return np.where(defined & dies, np.nan_to_num(run), rest)


def _without_leverage(problem: Problem, y: Array) -> Beside:
    """Find the linear regression on the caller's rows, without those far outside that y does not follow."""

    def without(wrong: Any) -> Beside:
        model = estimated(problem, np.where(wrong, np.nan, y)).model
        return Beside(model, np.zeros((y.size, 1)), problem.u)

    far = np.column_stack([far_outside(column) for column in problem.u.T]).any(axis=1)
    if not far.any():
        return without(far)
    try:
        model = without(far).model
    except ValueError:
        return without(False)
    sure = model.R + np.einsum("ij,jk,ik->i", problem.u, model.P, problem.u)
    left = y - problem.u @ model.theta - model.offset
    places = np.flatnonzero(far & (np.abs(left) > _LEVERAGE * np.sqrt(sure)))
    # Outliers of y hit these as often as any other.
    if places.size <= 2.0 * getattr(model.noise.influence, "contamination", 0.0) * far.sum():
        return without(False)
    text = (
        f"u has {places.size} rows far outside the others that y does not follow: they do not count; what was "
        "measured wrongly there is u"
    )
    place = (int(places[0]), int(places[-1]) + 1)
    finding = Finding("input outliers", text, float(np.sum(left[places] ** 2 / sure[places])), place)
    return without(np.isin(np.arange(y.size), places))._replace(findings=(finding,))
