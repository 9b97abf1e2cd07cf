"""The model beside a level that breaks, and without a motion that never dies: kept where the likelihood says so."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.signal import lfilter
from scipy.stats import norm

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.identification.estimation.cleaning import cleaned
from robust_filterpy.identification.estimation.estimate import Problem, estimated
from robust_filterpy.identification.estimation.trend import LAGS_OF_IMPULSES, PRICE, Break, Trend, impulse_output
from robust_filterpy.identification.models import dependence as gain
from robust_filterpy.identification.models.dependence import LAGS, autocovariances, dependence, whitening_of
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.results import Finding
from robust_filterpy.influence.regression import mad_scale

__all__ = [
    "LEAST_SAMPLES",
    "TRENDS",
    "Beside",
    "Settled",
    "another_gain",
    "beside_input_outliers",
    "break_finding",
    "of_impulses",
    "output_of",
    "undisturbed_outputs",
    "unlike",
    "unlike_in_parts",
    "without_endless_motion",
    "without_leverage",
]

TRENDS: Final = ("none", "constant", "line", "breaks")
#: In fewer samples a step and the dynamics cannot be told apart.
LEAST_SAMPLES: Final = 200
# A share of its response that the impulse response of `impulse_output` leaves out calls for a model of the differences.
_SLOW: Final = 0.7
# Motion counts if its size in the second half is this share of y's; it never dies if (1 - |pole|) N is below the other.
_SMALL: Final = 0.05
_ENDLESS: Final = 0.1
# An input is far outside beyond so many half widths of four fifths of its values, or off the levels that nine tenths of
# them have, of which there are at most so many, each with more samples than these.
_FAR_INPUT: Final = 3.2
_MOST_LEVELS: Final = 20
_FEWEST: Final = 4
# So many normal ones may be as far out, on each side.
_FARTHEST: Final = 0.05
# An input so many deviations from 0 stays there.
_STAYS: Final = 5.0
# What rows far outside make of y is off by so many deviations where they are wrong.
_LEVERAGE: Final = 5.0
# Parts of a recording that are held against its inputs, and how long one may be.
_PARTS: Final = 8
_LEAST_PART: Final = 120
_MOST_PART: Final = 400
# Samples of a short recording for each lag of the inputs.
_EACH_LAG: Final = 12
# A part in which outliers leave less than this share clear is judged as it was measured; less is enough where the model
# is of other recordings too, of which one may be of another plant in all of its samples.
_LEAST_CLEAR: Final = 0.5
_LEAST_CLEAR_BESIDE: Final = 0.75


class Beside(NamedTuple):
    """A model beside whatever else a recording has.

    Attributes
    ----------
    model : Model, StateSpaceModel or GreyBoxModel
        The model.
    findings : tuple of Finding
        Of what is beside it.
    levels : ndarray, shape (N, p)
        What was taken off several outputs.
    u : ndarray, shape (N, n_inputs)
        Inputs that it is of.
    held : bool
        Whether some of these are held back.
    evidence : float
        Log-likelihood with the colour of the residuals.
    """

    model: Any
    findings: tuple[Finding, ...]
    levels: Any = None
    u: Any = None
    held: bool = False
    evidence: float = float("nan")


class Settled(NamedTuple):
    """What a recording of one output has beside one model of it, for others of the same recording.

    Attributes
    ----------
    trend : Trend
        Steps and ramps of its level.
    input : Finding or None
        Says that outliers of its inputs are held back.
    """

    trend: Trend
    input: Finding | None

    @classmethod
    def of(cls, model: Model, samples: int) -> Settled:
        """Return what a model has beside it."""
        values = model.trend if model.trend.size else np.zeros(samples)
        input = next((one for one in model.findings if one.kind == "input outliers"), None)
        breaks = [
            Break(one.kind, one.place[0], 0.0, one.evidence) for one in model.findings if one.kind in ("step", "ramp")
        ]
        if breaks:
            sizes = np.linalg.lstsq(np.column_stack([one.column(samples) for one in breaks]), values, rcond=None)[0]
            breaks = [one._replace(size=float(size)) for one, size in zip(breaks, sizes, strict=True)]
        return cls(Trend(values, tuple(breaks)), input)

    def after(self, first: int) -> Settled:
        """Return the same for the recording from a sample on."""
        breaks = [one._replace(time=max(one.time - first, 0)) for one in self.trend.breaks]
        kept = tuple(one for one in breaks if one.kind == "ramp" or one.time)
        return self._replace(trend=Trend(self.trend.values[first:], kept))


def without_endless_motion(problem: Problem, y: Array, best: Beside) -> Beside:
    """Find the model again from rest if what was in motion when the recording began would outlast it."""
    model, own = best.model, y - best.levels[:, 0]
    slowest = endless_pole(model, max(part.stop - part.start for part in problem.spans))
    if slowest is None:
        return best
    if len(problem.begins) == 1:
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
    evidence = 2.0 * (still.log_likelihood - model.log_likelihood)
    found = Finding("slow start", text, evidence, (0, y.size))
    return best._replace(model=still, evidence=still.evidence, findings=(*best.findings, found))


def endless_pole(model: Model, samples: int) -> float | None:
    """Return the size of a pole that keeps what is in motion for longer than a recording, None if there is none."""
    slowest = float(np.abs(np.roots(model.parts.f)).max(initial=0.0))
    return slowest if model.structure.n_inputs and abs(1.0 - slowest) * samples < _ENDLESS else None


def undisturbed_outputs(problem: Problem, y: Array, plain: Model) -> Iterator[Array]:
    """Yield outputs of a recording that no level disturbs, shape (N,), NaN where nothing tells them."""
    yield of_impulses(y[:, None], problem.u, problem.spans)[:, 0]
    if _is_slow(plain, len(y)) and len(problem.begins) == 1:
        try:
            u, rest = np.diff(problem.u, axis=0), np.zeros(problem.rest.size)
            found = estimated(problem._replace(u=u, rest=rest, sampled=False), np.diff(y)).model
        except ValueError:
            return
        yield replace(found, operating_point=problem.rest).simulate(problem.u)


def _is_slow(model: Model, samples: int) -> bool:
    """Tell whether much of a model's response comes later than the lags of `impulse_output`."""
    parts, impulse = model.parts, np.eye(1, samples).ravel()
    with np.errstate(all="ignore"):
        sizes = [np.abs(lfilter(b, np.convolve(parts.a, parts.f), impulse)) for b in parts.b]
        return any(size[LAGS_OF_IMPULSES:].sum() > _SLOW * size.sum() for size in sizes)


def of_impulses(y: Array, u: Array, spans: Any) -> Array:
    """Return what long impulse responses make of the inputs, NaN where a recording is too short to tell."""
    found = np.full(y.shape, np.nan)
    for part in spans:
        for j, own in enumerate(y[part].T):
            if u.shape[1] and np.count_nonzero(~np.isnan(own)) >= LEAST_SAMPLES:
                found[part, j] = impulse_output(own, u[part])
    return found


def output_of(model: Model, y: Array, u: Array) -> Array:
    """Return a model's output, with the motion in which it began if that dies."""
    rest, run = model.simulate(u), model.free_run(y, u)
    motion, known = run - rest, ~np.isnan(run)
    late = motion[y.size // 2 :]
    dies = np.sqrt(np.mean(np.square(late))) < _SMALL * mad_scale(y[~np.isnan(y)] - np.nanmedian(y))
    return np.where(known & dies, np.nan_to_num(run), rest)


def unlike_in_parts(problem: Problem, y: Array, model: Model, others: bool = False) -> tuple[Finding, ...]:
    """Find the parts of a recording in which what the model leaves follows the inputs."""
    parts = _parts(y.size, others)
    if not model.structure.n_inputs or model.structure.takes_phi or not len(parts) or model.noise.is_rounding:
        return ()
    whole = cleaned(model, y, problem.u)
    if whole is None:
        prediction = model.predict(y, problem.u)
        residual = y - prediction
        if model.structure.nd:
            # A prediction follows a level that wanders, and after a jump of it both are off together for a while.
            prediction = model.simulate(problem.u) + _trend(model, y)
    else:
        # A part that is nearly all outliers is of another plant, whatever replaces them.
        told = ~np.isnan(y) & (np.arange(y.size) >= whole.prepared.first)
        clear = whole.clear & told
        least = _LEAST_CLEAR_BESIDE if others else _LEAST_CLEAR
        own = parts[clear[parts].sum(axis=1) < least * told[parts].sum(axis=1)].ravel()
        clear[own] = False
        residual = np.where(clear, whole.residual, np.nan)
        prediction = whole.prepared.y + _trend(model, y) - whole.residual
        if own.size:
            residual[own] = model.residuals(y, problem.u)[own]
            # Predictions from outputs as measured carry their outliers to the residuals: what u alone makes does not.
            prediction[own] = (model.simulate(problem.u) + _trend(model, y))[own]
    own = np.nan_to_num(prediction - _trend(model, y) - model.level)
    found = unlike(residual, np.column_stack((own, problem.u - problem.rest)), others)
    if found or others:
        return found
    return another_gain(residual, gain.driven(model.structure, model.theta, own, problem.u))


def unlike(residual: Array, signals: Array, others: bool = False) -> tuple[Finding, ...]:
    """Find the parts of a recording in which what any model leaves follows the inputs."""
    parts = _parts(residual.size, others)
    if not len(parts):
        return ()
    lags = min(LAGS, parts.shape[1] // _EACH_LAG) if others else LAGS
    whitening = whitening_of(autocovariances(residual))
    # Two neighbours together are surer of a plant that differs from the model less.
    for windows in (parts, np.hstack((parts[:-1], parts[1:]))):
        found = dependence(residual[windows], signals[windows], lags, whitening) if len(windows) else None
        if found is None or not found.found.any():
            continue
        where = windows[found.found]
        first, last = int(where[0, 0]), int(where[-1, -1]) + 1
        text = (
            f"between samples {first} and {last} up to {100 * float(found.share.max()):.0f} % of what the model leaves "
            "follow u: the plant is another one there, a sensor is stuck, or the structure is too small"
        )
        evidence = float(-2.0 * np.log(np.maximum(found.chance.min(), np.finfo(float).tiny)))
        return (Finding("another plant", text, evidence, (first, last)),)
    return ()


def another_gain(residual: Array, x: Array) -> tuple[Finding, ...]:
    """Find out whether the gain of the plant changes in a recording, from all of its samples together."""
    sample, before, after, z = gain.broken(residual, x)
    if not z:
        return ()
    text = (
        f"from about sample {sample} on the gain from u to y is {1.0 + after:.2f} times the model's, before "
        f"{1.0 + before:.2f} times: the plant is another one there, or the structure is too small"
    )
    return (Finding("another plant", text, z * z, (sample, residual.size)),)


def _parts(samples: int, others: bool) -> Any:
    """Return the samples of each part of a recording, equally many, up to its end; none if a model is of it alone."""
    span = max(_LEAST_PART, min(samples // _PARTS, _MOST_PART))
    if others:
        span = min(span, samples)
    found = np.arange(samples % span, samples - span + 1, span)[:, None] + np.arange(span)
    return found if others or len(found) > 1 else found[:0]


def beside_input_outliers(u: Array, find: Callable[[Array], Beside], settled: Settled | None = None) -> Beside:
    """Find the model of inputs, and that with values far outside the others held back, and take it if much likelier."""
    # Both ways from the beginning: what an outlier of u leaves looks like steps of the level, or like slow motion.
    if settled is not None and settled.input is not None:
        other, _ = _held_back(u)
        held = find(other)
        return held._replace(u=other, held=True, findings=(*held.findings, settled.input))
    told = find(u)._replace(u=u)
    other, places = _held_back(u)
    if settled is not None or not places.size:
        return told
    stage("the model without outliers of u")
    try:
        held = find(other)
    except ValueError:
        return told
    gain = 2.0 * (held.evidence - told.evidence)
    if gain < PRICE * np.log(len(u)) * (1 + _breaks(held.findings) - _breaks(told.findings)):
        return told
    return held._replace(u=other, held=True, findings=(*held.findings, _input_outliers(places, gain)))


def without_leverage(problem: Problem, y: Array) -> Beside:
    """Find the linear regression on the caller's rows, those left out that lie far outside and that y does not follow.
    """

    def beside(y: Array) -> Beside:
        return Beside(estimated(problem, y).model, (), np.zeros((y.size, 1)), problem.u)

    far = np.column_stack([_outside(column) for column in problem.u.T]).any(axis=1)
    if not far.any():
        return beside(y)
    try:
        model = beside(np.where(far, np.nan, y)).model
    except ValueError:
        return beside(y)
    sure = model.R + np.einsum("ij,jk,ik->i", problem.u, model.P, problem.u)
    left = y - problem.u @ model.theta - model.offset
    places = np.flatnonzero(far & (np.abs(left) > _LEVERAGE * np.sqrt(sure)))
    # Outliers of y hit these as often as any other.
    if places.size <= 2.0 * getattr(model.noise.influence, "contamination", 0.0) * far.sum():
        return beside(y)
    text = (
        f"u has {places.size} rows far outside the others that y does not follow: they do not count; what was "
        "measured wrongly there is u"
    )
    found = Finding(
        "input outliers", text, float(np.sum(left[places] ** 2 / sure[places])), (int(places[0]), int(places[-1]) + 1)
    )
    spoilt = np.isin(np.arange(y.size), places)
    return beside(np.where(spoilt, np.nan, y))._replace(findings=(found,))


def _breaks(findings: tuple[Finding, ...]) -> int:
    """Return how many steps and ramps were found."""
    return sum(one.kind in ("step", "ramp") for one in findings)


def _held_back(u: Array) -> tuple[Array, Any]:
    """Return inputs with the value before in the place of each that is unlike the others, and in which samples."""
    u, far = u.copy(), np.zeros(u.shape, dtype=bool)
    for j, column in enumerate(u.T):
        odd = far[:, j] = _odd(column)
        # The last ordinary value before each; at the beginning the first one.
        last = np.maximum.accumulate(np.where(odd, -1, np.arange(odd.size)))
        column[:] = column[np.where(last < 0, int(np.argmin(odd)), last)]
    return u, np.flatnonzero(far.any(axis=1))


def _input_outliers(places: Any, gain: float) -> Finding:
    """Return in words that inputs in some samples are held at the value before."""
    text = (
        f"u has {places.size} values unlike the others that y does not follow: the model is of the values before "
        "them, held; give u as it acted"
    )
    return Finding("input outliers", text, gain, (int(places[0]), int(places[-1]) + 1))


def _odd(u: Array) -> Any:
    """Return which values of an input are unlike the others: far outside, or off the levels that it has otherwise."""
    odd = _outside(u)
    _, which, counts = np.unique(u, return_inverse=True, return_counts=True)
    common = counts > max(_FEWEST, u.size // 200)
    if common.sum() <= _MOST_LEVELS and counts[common].sum() >= 0.9 * u.size:
        odd |= ~common[which]
    return odd & (np.ptp(np.quantile(u, [0.1, 0.9])) > 0.0)


def _outside(u: Array) -> Any:
    """Return which values of an input are far outside the others, of many of which some are further out."""
    low, middle, high = np.quantile(u, [0.1, 0.5, 0.9])
    far = max(_FAR_INPUT, float(norm.isf(_FARTHEST / u.size) / norm.isf(0.1)))
    return (np.abs(u - middle) > far * max(high - middle, middle - low)) & (high > low)


def _trend(model: Model, y: Array) -> Array:
    """Return the trend of a model's recording, 0 if it has none."""
    return model.trend if model.trend.size else np.zeros(y.size)


def break_finding(found: Any, index: Any, gain: float, samples: int, u: Array) -> Finding:
    """Return a break in words."""
    when = f"sample {found.time}" + ("" if index is None else f" ({index[found.time]})")
    if found.kind == "step":
        text = f"the level of y steps by {found.size:.4g} at {when}"
    else:
        text = f"the level of y changes by {found.size:.4g} a sample from {when} on"
    for column in u.reshape(len(u), -1).T:
        level = float(np.nanmedian(column))
        if abs(level) > _STAYS * mad_scale(column[~np.isnan(column)] - level):
            text += f", or a gain does, since u stays near {level:.3g}"
            break
    return Finding(found.kind, f"{text}; taken off", min(found.evidence, gain), (found.time, samples))
