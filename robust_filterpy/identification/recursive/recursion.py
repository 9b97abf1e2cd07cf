"""The recursion of n actuators: what moves, and one sample of one of them, the definition that the kernel is held to.

Everything that moves while parameters are followed is one immutable `State`, a tracker's with n = 1: no array in it is
ever written into, so that a call that is refused leaves it as it was because it made another one.

One sample: predict theta, predict y from phi, leave out a sensor that is stuck, look again at outputs that were
replaced, correct theta along the gradient, restrain an unstable step, follow R, remember.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np
from scipy.special import erfc, gammainc

from robust_filterpy import _checks, _state
from robust_filterpy._arrays import square, state_of
from robust_filterpy._checks import Array
from robust_filterpy.correction import repeats, spread
from robust_filterpy.correction.contaminated import Contaminated
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.states import go_on_with, kept_with, moved_shapes
from robust_filterpy.identification.models import regressor
from robust_filterpy.identification.models.dependence import BLOCKS
from robust_filterpy.identification.models.regressor import CLEANED_FROM, GUARDS, Layout, Memory, bounded, pushed
from robust_filterpy.identification.models.results import Sample
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive.watch import SPAN, USUAL, WINDOW, Watch

#: What the gain is computed from.
Gradient: TypeAlias = Literal["pseudolinear", "filtered"]
GRADIENTS: Final[tuple[Gradient, ...]] = ("pseudolinear", "filtered")
#: Which outputs an ARX or ARMAX has in its regressor.
Regressor: TypeAlias = Literal["measured", "cleaned"]
REGRESSORS: Final[tuple[Regressor, ...]] = ("measured", "cleaned")

#: With forgetting and no excitation P grows without end; at so many times its first trace it stops.
WINDUP = 1e8
#: What was learned of the readings, and for how many samples the sensor has been stuck.
READINGS = repeats.WIDTH + 1
# What a record has one number of.
_ALONE: Final = ("centre", "windup", "begun", "restarts", "samples")
# A recording that tells nothing yet may become so many times as long before its oldest samples go.
_LONGEST: Final = 4


class Form(NamedTuple):
    """What the recursion of n actuators is, fixed when it is made."""

    structure: Structure
    layout: Layout
    #: Where theta stands in what is estimated: besides it there may be a constant.
    own: np.ndarray
    has_offset: bool
    #: Whether the regressor holds cleaned outputs.
    cleans: bool
    #: Whether outputs are judged at all, so that a sensor may be found to be stuck.
    judges: bool
    #: What the kernel is to do, (5,): gradient filtered, place in `GUARDS`, cleans, learns (each actuator or not, which
    #: the driver says), judges.
    flags: np.ndarray
    #: The filter that the definition goes by: it is given all that it holds before it is used. How its correction is
    #: for the kernel, (1, 1, 8), None where that does not serve.
    filter: Any
    rules: Array | None

    @property
    def record(self) -> np.dtype[Any]:
        """What a sample moves of an actuator, and what stays with it, in the order of ``tracker.c``."""
        d, past = self.layout.n, self.layout.shapes()
        shapes = {"theta": (d,), "P": (d, d), **{name: past[name] for name in Memory._fields}, "scale": (5,)}
        each = [(name, float, shape) for name, shape in (shapes | {"readings": (READINGS,)}).items()]
        return np.dtype([*each, *((name, float, ()) for name in _ALONE)])

    @property
    def width(self) -> int:
        """How many numbers a sample gives: theta, its variances, prediction, residual, weight and guard."""
        return 2 * self.layout.n + 4

    @property
    def n_signals(self) -> int:
        """What residuals are held against: the prediction and the inputs."""
        return 1 + self.structure.n_inputs

    def with_constant(self, u: Array) -> Array:
        """Return inputs (.., n_inputs) with the constant, where phi has one."""
        return np.concatenate((u, np.ones((*u.shape[:-1], 1))), axis=-1) if self.has_offset else u


class ColdStart(NamedTuple):
    """A recording that grows; a model is made of an eighth, a quarter, half and all of the samples asked for."""

    #: How many samples it may look at.
    samples: int
    y: Array
    u: Array
    #: Samples until the next look.
    waits: int

    @classmethod
    def of(cls, n_theta: int, n_inputs: int, samples: int) -> ColdStart:
        """Keep nothing yet."""
        return cls(samples, np.zeros(0), np.zeros((0, n_inputs)), _until_next(samples, 0, n_theta))

    def added(self, y: Array, u: Array) -> ColdStart:
        """Return it with more samples, at most as many as it waits for."""
        # A frozen tracker does not look: it stays due, and a count below 0 would say in a state that there is no start.
        waits, keep = max(self.waits - len(y), 0), max(0, _LONGEST * self.samples - len(y))
        return ColdStart(self.samples, np.append(self.y[-keep:], y), np.concatenate((self.u[-keep:], u)), waits)

    def is_first_look(self, n_theta: int) -> bool:
        """Whether no model can have been made of fewer samples."""
        return self.y.size <= _until_next(self.samples, 0, n_theta)

    @property
    def is_last_look(self) -> bool:
        """Whether there are as many samples as were asked for."""
        return self.y.size >= self.samples

    def waiting(self, n_theta: int) -> ColdStart:
        """Return it waiting for the next look."""
        return self._replace(waits=_until_next(self.samples, self.y.size, n_theta))

    def levels(self, more: Array) -> Array:
        """Return the median of the outputs before each of some more, and after the last, 0 while there are none."""
        # Of as many as are kept, however the samples are divided into calls.
        y, longest = np.append(self.y, more), _LONGEST * self.samples
        medians = np.zeros(more.size + 1)
        for k in range(more.size + 1):
            measured = y[max(0, self.y.size + k - longest) : self.y.size + k]
            measured = measured[measured == measured]
            medians[k] = np.median(measured) if measured.size else 0.0
        return medians


def _until_next(samples: int, size: int, n_theta: int) -> int:
    """Return after how many samples the next look is."""
    least = max(20, 5 * (n_theta + 1))
    lengths = [max(samples >> k, 1) for k in (3, 2, 1, 0)]
    later = [length for length in lengths if length > size and (length >= least or length == samples)]
    return later[0] - size if later else max(samples // 4, 1)


class Unjudged(NamedTuple):
    """Samples that came one by one and wait to be looked at together."""

    #: y, u, and the row that each gave, with the axes (n, 1).
    samples: tuple[tuple[Any, ...], ...] = ()
    #: After how many the next look is.
    due: int = 0
    #: The actuators that have a model and learn.
    watched: Any = None
    #: What the kernel was to do, with who learns.
    flags: Any = None
    #: For how many samples each sensor had been stuck before.
    stuck: Any = None


class State(NamedTuple):
    """Parameters, covariances, past signals and what decides about another start, of n actuators."""

    #: What a sample moves of each actuator, and what stays with it, (n, W), which `record` divides into parts: theta, P
    #: (with the constant, where there is one) and the fields of `Memory`; scale, R and the fields of `NoiseScale`;
    #: readings, what was learned of them, as in `correction.repeats`, and for how many samples the sensor has been
    #: stuck; centre, what is taken off the outputs, so that the constant is small; windup, the trace of P beyond which
    #: it stops growing; begun, whether there is a model; restarts, whether another may be made when this one is no
    #: longer the plant's; samples, how many a start may look at.
    moved: Array
    record: np.dtype[Any]
    #: What may be set between samples: Q and F, (n, d, d), and alpha_sq, (n,).
    settings: Mapping[str, Array]
    #: What the filter of each actuator keeps besides, as ``filter_..``; of a plain one nothing.
    kept: tuple[dict[str, Array], ...]
    #: The actuators that look for a model.
    starts: Mapping[int, ColdStart]
    watch: Watch
    unjudged: Unjudged = Unjudged()

    def part(self, name: str) -> Array:
        """Return a part of what moves, with an axis of actuators in front; nobody writes into it."""
        return part_of(self.moved, self.record, name)

    @property
    def theta(self) -> Array:
        """With the constant, where there is one, (n, d)."""
        return self.part("theta")

    @property
    def P(self) -> Array:
        """Its covariance, (n, d, d)."""
        return self.part("P")

    @property
    def scale(self) -> Array:
        """R and the fields of `NoiseScale`, (n, 5)."""
        return self.part("scale")

    @property
    def begun(self) -> np.ndarray:
        """Whether there is a model, (n,)."""
        return self.part("begun") > 0.0

    @property
    def past(self) -> Memory:
        """Past signals."""
        return Memory(*map(self.part, Memory._fields))

    @property
    def restarts(self) -> np.ndarray:
        """Whether another model may be made when this one is no longer the plant's, which inputs tell, (n,)."""
        return (self.part("restarts") > 0.0) & (self.watch.rows.shape[2] > 4)

    def with_parts(self, which: Any = slice(None), **parts: Any) -> State:
        """Return it with parts of what moves, of some actuators, as given."""
        moved = self.moved.copy()
        for name, values in parts.items():
            part_of(moved, self.record, name)[which] = values
        return self._replace(moved=moved)

    def rows(self, which: np.ndarray) -> State:
        """Return the state of some actuators."""
        settings = {name: values[which] for name, values in self.settings.items()}
        kept = tuple(self.kept[i] for i in which) if self.kept else ()
        starts = {j: self.starts[i] for j, i in enumerate(which.tolist()) if i in self.starts}
        watch = Watch(*(values[which] for values in self.watch))
        return State(self.moved[which], self.record, settings, kept, starts, watch)

    def arrays(self) -> dict[str, Array]:
        """Return it as plain arrays with a leading axis, what was warned of not among them."""
        seen, waits = np.where(self.restarts, self.watch.seen, 0), np.full(len(self.watch.seen), -1.0)
        followed = self.watch.rows[:, WINDOW - min(int(seen.max(initial=0)), SPAN) :, :-2]
        none = np.zeros((0, followed.shape[2] - 1))
        waits[list(self.starts)] = [start.waits for start in self.starts.values()]
        recorded = {i: np.column_stack((start.y, start.u)) for i, start in self.starts.items()}
        each = [recorded.get(i, none) for i in range(len(seen))]
        return {
            **{name: self.part(name) for name in self.record.names or ()}, "waits": waits, "start": padded(each),
            "kept": np.array([len(one) for one in each]), "seen": seen, "followed": followed,
            "usual": self.watch.usual, "scores": self.watch.scores, **self.settings,
            **{name: np.stack([one[name] for one in self.kept]) for one in self.kept[:1] for name in one},
        }  # fmt: skip

    def restored(self, stored: Mapping[str, Array]) -> State:
        """Return what `arrays` was made of, checked; what has been said stays said."""
        recorded, starts = stored["start"], {}
        for i in np.flatnonzero(stored["waits"] >= 0).tolist():
            part = recorded[i, recorded.shape[1] - int(stored["kept"][i]) :]
            starts[i] = ColdStart(int(stored["samples"][i]), part[:, 0], part[:, 1:], int(stored["waits"][i]))
        parts = {name: stored[name] for name in self.record.names or ()}
        settings = {name: stored.get(name, values) for name, values in self.settings.items()}
        kept = tuple({name: stored[name][i] for name in one if name in stored} for i, one in enumerate(self.kept))
        now = State(self.moved, self.record, settings, kept, starts, self.watch.restored(stored))
        return now.with_parts(**parts)


def part_of(moved: Array, record: np.dtype[Any], name: str) -> Array:
    """Return a part of what moves, to be written into."""
    return np.asarray(moved.view(record)[name][:, 0])


def padded(parts: Any) -> Array:
    """Return arrays of different lengths as one, NaN before the shorter ones."""
    rows = np.full((len(parts), max(map(len, parts)), parts[0].shape[1]), np.nan)
    for whole, part in zip(rows, parts, strict=True):
        whole[len(whole) - len(part) :] = part
    return rows


def apart(whole: Array, lengths: np.ndarray) -> np.ndarray:
    """Return the last rows of each of several arrays, so many, as an array of objects."""
    parts = np.empty(len(whole), dtype=object)
    for i, length in enumerate(lengths.tolist()):
        parts[i] = whole[i, whole.shape[1] - int(length) :].copy()
    return parts


def at_rest(form: Form, samples: int, begun: bool, memory: float) -> State:
    """Return the state of an actuator that has seen nothing; begun: whether it is to begin without a start."""
    kf, structure, record = form.filter, form.structure, form.record
    starts = {} if begun else {0: ColdStart.of(structure.n_theta, structure.n_inputs, samples)}
    (x, P), scale = state_of(kf), (noise_variance(kf), 0.0, ordinary_mean(None), memory, 0.0)
    settings = {name: square(name, getattr(kf, name), len(P), "{} parameters")[None].copy() for name in "QF"}
    settings["alpha_sq"] = np.array([vars(kf)["_alpha_sq"]])
    moved = np.zeros((1, record.itemsize // 8))
    now = State(moved, record, settings, kept_of(kf), starts, Watch.none(1, form.n_signals))
    return now.with_parts(theta=np.ravel(x), P=P, scale=scale, begun=begun, restarts=not begun, samples=samples)


def kept_of(kf: RobustKalmanFilter) -> tuple[dict[str, Array], ...]:
    """Return what a filter keeps besides x and P, of one that keeps nothing no dictionary."""
    unknown = {"filter_spread": spread.begin(1)} if "spread" in moved_shapes(kf) else {}
    kept = {**unknown, **kept_with(kf)}
    return (kept,) if kept else ()


def checked(state: Any, form: Form, axes: tuple[int, ...], kept: Iterable[str]) -> dict[str, Array]:
    """Return the arrays of a state with an axis of actuators in front, copied, or raise."""
    d = form.layout.n
    shapes: dict[str, Any] = {name: form.record[name].shape for name in form.record.names or ()}
    shapes |= {"usual": (USUAL,), "scores": (BLOCKS, 2), **dict.fromkeys(("enabled", "waits", "kept", "seen"), ())}
    shapes |= {"start": (None, form.n_signals), "followed": (None, 1 + form.n_signals)}
    whole = {name: (*axes, *shape) for name, shape in shapes.items()}
    settings = {name: (*axes, *shape) for name, shape in {"Q": (d, d), "F": (d, d), "alpha_sq": ()}.items()}
    stored = _state.checked(state, None, whole, settings, ("start", "followed"))
    plausible = (*_PLAUSIBLE, ("kept", "no more samples than in start", lambda kept: kept <= stored["start"].shape[-2]))
    for name, what, is_good in plausible:
        if name in stored and not np.all(is_good(stored[name])):
            raise _state.StateError(f"state: expected {what} in {name}, got {_checks.shown(stored[name])}")
    theta = np.atleast_2d(stored["theta"])
    if form.flags[1] > GUARDS.index("none") and not all(regressor.are_stable(row, form.layout.stable) for row in theta):
        raise _state.StateError(
            "state: expected theta of a stable model, got coefficients that feed back with roots outside the unit "
            "circle"
        )
    stored |= {name: np.array(np.broadcast_to(stored[name], settings[name])) for name in settings if name in stored}
    stored |= {name: np.asarray(state[name], dtype=float) for name in kept if name in state}
    rows = stored if axes else {name: value[None] for name, value in stored.items()}
    return {**rows, "enabled": rows["enabled"].astype(bool)}


# What arrays of a state hold, each with what must be so of it.
_PLAUSIBLE: Final[tuple[tuple[str, str, Callable[[Array], Any]], ...]] = (
    ("alpha_sq", "numbers >= 1", lambda alpha_sq: alpha_sq >= 1.0),
    ("scale", "variances > 0", lambda row: row[..., 0] > 0.0),
    ("scale", "counts of samples and rounding >= 0", lambda row: row[..., [1, 3, 4]] >= 0.0),
    ("scale", "a mean of min(e^2, 4) in [0, 4]", lambda row: np.abs(row[..., 2] - 2.0) <= 2.0),
    ("windup", "a limit of tr P > 0", lambda limit: limit > 0.0),
    *((name, "0 or 1", lambda value: np.isin(value, (0.0, 1.0))) for name in ("begun", "restarts")),
    ("samples", "a whole number >= 1", lambda count: _are_whole(count, 1.0)),
    ("waits", "a whole number of samples until the next look, or -1", lambda count: _are_whole(count, -1.0)),
    *((name, "a whole number >= 0", lambda count: _are_whole(count, 0.0)) for name in ("kept", "seen")),
    ("usual", "a variance >= 0", lambda row: row[..., 0] >= 0.0),
    ("scores", "information >= 0", lambda row: row[..., 1] >= 0.0),
    ("readings", "a scale and counts >= 0", lambda row: row[..., [2, 3, repeats.WIDTH]] >= 0.0),
)


def _are_whole(counts: Array, least: Any) -> Any:
    """Tell which numbers are whole and large enough."""
    return (counts >= least) & (counts % 1.0 == 0.0)


# One sample of one actuator.

# The sharpness of a sample is phi'phi tr(P)/R, about by how much it may shrink P in its direction.
# The rounding of one correction is about 1e-16 P times the sharpness; from here on it is mended.
SHARP: Final = 1e6

# Beyond this, rounding of a P that is right would exceed R in H P H' + R.
_SHARPEST: Final = 1e13

# Standard deviations from which on an innovation is as large as any.
_REACH: Final = 2.0
# The first samples count as if there had been none before, so that R may be wrong by many powers of ten.
_FIRST: Final = 5.0
#: Up to so many samples P grows with R: what was learned with an R far too small is less certain by as much.
EARLY: Final = 20.0
# min(e^2, 4) moves with R two thirds as much as e^2 does.
_PACE: Final = 1.5


class NoiseScale(NamedTuple):
    """What following R takes besides R itself."""

    #: How many samples R stands on.
    samples: float
    #: Mean of min(e^2, 4) where R is right.
    mean: float
    #: Number of samples that R is to remember; 0: R stays as it is.
    memory: float
    #: Steps of the sensor, or what arithmetic loses, in the unit of y; 0: unknown. R is what they make at least.
    rounding: float


class Recursion:
    """One of the actuators of a form on its way: a filter with theta as its state, what it remembers, how R moves."""

    def __init__(self, form: Form, enabled: bool, parts: Any) -> None:
        """Go on from what moves of an actuator, a record, by the form's filter, which is its own for now."""
        self.filter, self.layout, self.cleans, self.enabled = form.filter, form.layout, form.cleans, enabled
        self.judges, self.readings = form.judges, parts["readings"].copy()
        self.guard, self.filtered = GUARDS[form.flags[1]], bool(form.flags[0]) and form.layout.is_filtered
        self.memory, self.windup = Memory(*(parts[name] for name in Memory._fields)), float(parts["windup"])
        self.scale = NoiseScale(*parts["scale"][1:].tolist())

    def step(self, y: float, u: Array, R: float | None) -> Sample:
        """Take a sample, y from the center and u with the constant."""
        kf, layout, memory = self.filter, self.layout, self.memory
        inputs = memory.with_input(layout, u)
        H, outputs = memory.regressor(layout, inputs)[None], memory.outputs
        seen, gradients, prefiltered, old = y == y, memory.gradients, memory.prefiltered, np.ravel(kf.x)
        weight, event, outlying = math.nan, 0, False
        # Once P has wound up under forgetting theta and P stay.
        if self.enabled and (kf.alpha == 1.0 or np.trace(kf.P) <= self.windup):
            kf.predict()
        x = kf.x
        shown = predicted = H.dot(x).item()
        r = noise_variance(kf) if R is None else R
        stuck = seen and self.judges and self._is_stuck(y, predicted, H, r)
        # What is stuck counts as missing.
        seen = seen and not stuck
        if self.cleans and seen and not np.array_equal(outputs, memory.measured):
            other = H.copy()
            other[0, layout.outputs] = memory.measured
            explained = other.dot(x).item()
            if is_far(y - predicted, H, kf.P, r) and abs(y - explained) < abs(y - predicted):
                # Wild outputs explain no other wild one by being about as far out. Outputs that were replaced by what
                # a wrong theta predicted run away, and those as measured are the smaller ones.
                smaller = variance(other, kf.P, r) <= variance(H, kf.P, r)
                if smaller or not is_far(y - explained, other, kf.P, r):
                    H, outputs, predicted = other, memory.measured, explained
        G = H
        if self.filtered:
            past, newest = np.ravel(x), H[0] * layout.precedes_noise
            if self.guard != "none" or regressor.are_stable(past, layout.stable):
                psi, newest = regressor.gradient(layout, H[0], past, memory)
                G = psi[None, :]
            gradients, prefiltered = pushed(gradients, G[0]), pushed(prefiltered, newest)
        if self.enabled and seen:
            S = variance(G, kf.P, r)
            outlying = abs(y - predicted) > CLEANED_FROM * math.sqrt(S)
            weight = _corrected(kf, G, y, predicted, R, r, self.filtered)
            # What vanishes next to R brings no information, as while input and output rest, and says nothing of noise.
            if R is None and self.scale.memory and S + (y - predicted) * (y - predicted) != r:
                self.scale = _followed(kf, self.scale, r, y - predicted, S)
        if self.enabled and layout.stable:
            moved, event = regressor.restrained(np.ravel(kf.x), old, layout.stable, self.guard)
            if event:
                kf.x = moved.reshape(np.shape(kf.x))
        if stuck:
            self.readings[repeats.WIDTH] += 1.0
        elif seen and self.judges:
            note(self.readings, y, y - predicted)
        theta, phi = np.ravel(kf.x), H[0]
        believed = bounded(predicted) if not seen or (self.cleans and outlying) else y
        before = bounded(phi[layout.before_noise].dot(theta[layout.before_noise]).item())
        alone = bounded(phi[layout.through].dot(theta[layout.through]).item()) if layout.nf else 0.0
        self.memory = Memory(
            outputs=layout.remembered(outputs, believed, before),
            measured=layout.remembered(memory.measured, y if seen else bounded(predicted), before),
            inputs=inputs,
            residuals=pushed(memory.residuals, bounded(believed - phi.dot(theta).item()) if seen else 0.0),
            undisturbed=pushed(memory.undisturbed, -alone),
            prefiltered=prefiltered,
            gradients=gradients,
        )
        return Sample(shown, y - shown if seen else math.nan, weight, event)

    def _is_stuck(self, y: float, predicted: float, H: Array, r: float) -> bool:
        """Tell whether the sensor repeats itself far from what was predicted, or has done so since."""
        if not repeats.again(self.readings[: repeats.WIDTH], np.array(y), np.array(r)):
            return False
        return self.readings[repeats.WIDTH] > 0.0 or is_far(y - predicted, H, self.filter.P, r)


def _corrected(kf: Any, G: Array, y: float, predicted: float, R: float | None, r: float, filtered: bool) -> float:
    """Correct theta along the gradient and return the weight of the sample."""
    square, trace = G[0].dot(G[0]), np.trace(kf.P)
    factor, target = tempering(square, trace, r), y
    if filtered or factor < 1.0:
        G = G * factor
        # So that the filter's own innovation, target - G x, is y - phi' theta.
        target = (y - predicted) * factor + G.dot(kf.x).item()
    kf.H = G
    kf.update(target, R=R)
    if square * trace > SHARP * r:
        P = kf.P
        mended = repaired(P)
        if mended is not P:
            kf.P = mended
    return float(np.ravel(kf.weights)[0])


def _followed(kf: Any, scale: NoiseScale, R: float, nu: float, S: float) -> NoiseScale:
    """Let the filter's R follow the size of the innovations."""
    # What is followed is a scale of the standardized innovation e = nu/sqrt(S): the mean of min(e^2, 4), which no
    # outlier moves by more than 4 (Huber's proposal 2), against what it would be if R were right. The learned share and
    # size of the outliers belong to what it would be, so that R stays the variance of the ordinary samples.
    # A sample whose regressor overflows tells nothing of R.
    if not S < 1e290:
        return scale
    share = R / S
    gain = share * max(_PACE / scale.memory, min(1.0, _FIRST / (scale.samples + 1.0)))
    surprise = min(nu * nu / S, _REACH * _REACH) / scale.mean - 1.0
    # A plant at rest shows no noise in steps of its sensor, one that moves does.
    least = max(scale.rounding * scale.rounding / 12.0, 1e-290)
    estimate = max(R * math.exp(gain * surprise), least)
    kf.R = np.array([[estimate]])
    if scale.samples < EARLY and estimate > R:
        kf.P = kf.P * (estimate / R)
    return scale._replace(samples=scale.samples + share)


def note(readings: Array, y: float, nu: float) -> None:
    """Note in place a reading that was not left out and what was not foreseen of it."""
    row = readings[: repeats.WIDTH]
    if readings[repeats.WIDTH]:
        # While a sensor was stuck it has shown nothing of its habits.
        row[-1], readings[repeats.WIDTH] = abs(row[-1]), 0.0
    repeats.note_reading(row, y)
    repeats.note_change(row, nu)
    row[0] = nu


def is_far(nu: float, phi: Array, P: Array, r: float) -> bool:
    """Tell whether an innovation is one that a cleaned regressor replaces."""
    return abs(nu) > CLEANED_FROM * math.sqrt(variance(phi, P, r))


def variance(phi: Array, P: Array, r: float) -> float:
    """Return the variance of an innovation, phi' P phi + r, for a row phi."""
    # Rounding of a P that a spike in phi has made singular may have a sign.
    return max(float(phi.dot(P).dot(phi.T).item()), 0.0) + r


def ordinary_mean(influence: Any) -> float:
    """Return the mean of min(e^2, 4) for normal noise, or for a learned mixture."""
    if not isinstance(influence, Contaminated):
        return _mean(1.0)
    c = influence.contamination
    return (1.0 - c) * _mean(1.0) + c * _mean(influence.scale_ratio)


def _mean(scale: float) -> float:
    """Return the mean of min(s^2, 4) of a normal s with this standard deviation."""
    a = _REACH / scale
    # s^2 below a^2 has three degrees of freedom; as a difference it would be lost in a wide mixture.
    return scale * scale * float(gammainc(1.5, 0.5 * a * a)) + _REACH * _REACH * float(erfc(a / math.sqrt(2.0)))


# Where a sample is highly informative, as after a spike in a signal that stands in phi.


def tempering(square: float, trace: float, r: float) -> float:
    """Return the factor, at most 1, by which to shrink a sample whose regressor has phi'phi = square."""
    if square * trace <= _SHARPEST * r:
        return 1.0
    return math.sqrt(_SHARPEST / square) * math.sqrt(r / trace)


def repaired(P: Array) -> Array:
    """Return P, or if it has lost its symmetry or its sign the nearest covariance."""
    symmetric = 0.5 * (P + P.T)
    values, vectors = np.linalg.eigh(symmetric)
    floor = np.finfo(float).eps * values[-1]
    if values[0] >= -floor:
        return P if np.array_equal(P, symmetric) else symmetric
    return np.asarray((vectors * np.maximum(values, floor)).dot(vectors.T))


def noise_variance(kf: RobustKalmanFilter) -> float:
    """Return a filter's R as a number, or raise."""
    R = np.ravel(np.asarray(kf.R, dtype=float))
    if not (R.size and 0.0 < R[0] < math.inf):
        raise ValueError(f"R: expected a variance > 0, got {kf.R!r}; NaN in y is for a sample that is missing")
    return float(R[0])


def load(form: Form, now: State, i: int, theta: Array, P: Array, R: float) -> None:
    """Let the form's filter be that of an actuator, with these."""
    kf = form.filter
    if now.kept:
        go_on_with(kf, theta, P, now.kept[i])
    kf.x, kf.P, kf.R = theta.reshape(np.shape(kf.x)).copy(), P.copy(), np.array([[R]])
    for name, values in now.settings.items():
        attribute = "_alpha_sq" if name == "alpha_sq" else name
        if not np.array_equal(getattr(kf, attribute), values[i]):
            setattr(kf, attribute, values[i].copy() if values[i].ndim else float(values[i]))
