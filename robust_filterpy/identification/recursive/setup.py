"""From the arguments of a tracker or a bank to a filter and arrays, and samples as they are given; what is refused."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._arrays import square
from robust_filterpy._checks import Array, described, numbers
from robust_filterpy._filterpy import KalmanFilter
from robust_filterpy._warning import warn
from robust_filterpy.filters.conversion import robust
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.shell import leave_unwatched
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.regressor import LARGEST, are_stable
from robust_filterpy.identification.models.signals import require_finite, with_squares
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive.recursion import Form, State
from robust_filterpy.influence.functions import Linear

# Before the data have spoken the parameters may be anything of moderate size.
_VAGUE = 100.0


def require_next_input(structure: Structure, u: Any) -> None:
    """Raise if a prediction needs the next input and there is none."""
    if u is None and any(nb and not nk for nb, nk in structure.inputs):
        raise ValueError(f"u: expected the next input, which acts at once in {structure}, got None")


def structure_of(given: Any) -> Structure:
    """Return a structure, or that of a model, or raise."""
    if isinstance(given, Model):
        return given.structure
    if not isinstance(given, Structure):
        raise TypeError(f"structure: expected ARX(..), OutputError(..) or another structure, or a Model, got {given!r}")
    return given


def has_offset(offset: Any, structure: Structure, model: Model | None, starts: bool) -> bool:
    """Return whether there is a constant besides theta, or raise."""
    if offset is not None and not isinstance(offset, (bool, np.bool_)):
        raise TypeError(f"offset: expected True or False, got {offset!r}")
    if model is not None and offset is not None and offset != model.has_offset:
        raise ValueError(f"offset: expected {model.has_offset} as the model has it, got {offset}; leave it out")
    usual = starts and not structure.takes_phi if model is None else model.has_offset
    return usual if offset is None else bool(offset)


def make_filter(n: int, given: Any, choices: dict[str, Any]) -> RobustKalmanFilter:
    """Return a filter of its own for a tracker or bank, or raise if what is given cannot serve."""
    chosen = {name: value for name, value in choices.items() if value is not None}
    if given is not None and chosen:
        raise ValueError(f"{', '.join(chosen)}: expected only without filter=; set them on the filter that you pass")
    makes = isinstance(given, type) and issubclass(given, KalmanFilter)
    # R is followed, so that S is right: no typical innovation of a wrong one has to be learned.
    options: dict[str, Any] = {"scaling": "innovation", **chosen}
    kf = RobustKalmanFilter(n, 1, **options) if given is None else given(dim_x=n, dim_z=1) if makes else given
    if type(kf) is KalmanFilter:
        kf = robust(kf, influence=Linear(), **options)
    if not isinstance(kf, RobustKalmanFilter):
        raise TypeError(
            "filter: expected a RobustKalmanFilter, an AdaptiveKalmanFilter, or filterpy's KalmanFilter itself as the "
            f"baseline, or the class of one, got {_checks.shown(given)}"
        )
    if given is None or makes:
        kf.x, kf.P, kf.Q = np.zeros(n), _VAGUE * np.eye(n), np.zeros((n, n))
    if np.size(kf.x) != n:
        raise ValueError(f"filter: expected dim_x={n} for the structure's parameters, got {np.size(kf.x)}")
    if kf.dim_z != 1:
        raise ValueError(f"filter: expected dim_z=1, got {kf.dim_z}; a tracker has one output")
    kf = copy.deepcopy(kf)
    leave_unwatched(kf)
    return kf


def warn_of_default_noise(kf: Any) -> None:
    """Warn if parameters would move by 1 a sample only because filterpy's filters begin with Q = I."""
    if np.array_equal(kf.Q, np.eye(np.size(kf.x))):
        warn(
            "filter: its Q is I, as filterpy's filters begin, so that every parameter is expected to move by 1 a "
            "sample; pass Q=0 for parameters that stand still, or Q=1 if that is meant",
            UserWarning,
        )


# What may be set: of a tracker, or of all actuators or each.


def with_given(form: Form, now: State, given: Mapping[str, Any]) -> State:
    """Return a state with those of theta, P, Q, R, F and forgetting that are given, or raise."""
    n, d = len(now.moved), form.structure.n_theta
    values = {name: of_each(n, name, given[name], d) for name in _AXES if given.get(name) is not None}
    parts: dict[str, Array] = {}
    if "theta" in values:
        parts["theta"] = np.zeros(now.theta.shape)
        parts["theta"][:, form.own] = values["theta"]
    whole = {"P": now.P, **now.settings}
    for name in values.keys() & {"P", "Q", "F"}:
        whole[name] = whole[name].copy()
        whole[name][:, form.own[:, None], form.own] = values[name]
    parts["P"] = whole.pop("P")
    if given.get("R") is not None:
        parts["scale"] = now.scale.copy()
        parts["scale"][:, 0], parts["scale"][:, 3] = variances(given["R"], n), 0.0
    return now.with_parts(**parts)._replace(settings={**whole, "alpha_sq": values.get("forgetting", whole["alpha_sq"])})


def require_stable(form: Form, theta: Array) -> None:
    """Raise if parameters (n, d) to start from are those of a model that is not stable."""
    parts = form.structure.stable_parts
    which = [i for i, row in enumerate(theta) if not are_stable(row, parts)]
    if which:
        got = " and ".join(str(theta[which[0]][part]) for part in parts)
        raise ValueError(
            f"theta: expected a stable model to start from, got {got} as the coefficients that feed back, whose roots "
            f"leave the unit circle{_among(len(theta), which)}"
        )


# How many axes an option has that all actuators share, of any other it is a list of one for each; and what it may be.
_AXES: Final[dict[str, tuple[tuple[int, ...], Callable[[Any, int], Any]]]] = {
    "theta": ((0, 1), lambda value, d: _checks.finite(
        "theta", np.full(d, value) if np.ndim(value) == 0 else value, (d,), reshaped=True)),
    "P": ((0, 2), lambda value, d: covariance("P", value, d)),
    "Q": ((0, 2), lambda value, d: covariance("Q", value, d)),
    "F": ((2,), lambda value, d: _checks.finite("F", _checks.matrix("F", value, (d, d), f"{d} parameters"), (d, d))),
    "forgetting": ((0,), lambda value, d: forgetting_factor(value)),
}  # fmt: skip


def of_each(n: int, name: str, value: Any, d: int) -> Array:
    """Return what is set of each of n actuators, of one value for all or a list of n, or raise with the actuators."""
    (axes, checked), values, refused = _AXES[name], numbers(name, value), {}
    rows: Any = [values] if values.ndim in axes else values
    if len(rows) not in (1, n):
        if n == 1:
            checked(values, d)
        raise ValueError(f"{name}: expected one for all or a list of {n}, got {len(rows)}")
    made = []
    for i, row in enumerate(rows):
        try:
            made.append(checked(row, d))
        except ValueError as error:
            refused[i] = error
    for first in refused.values():
        first.args = (f"{first}{_among(len(rows), list(refused))}", *first.args[1:])
        raise first
    return np.array(made) if len(made) == n else np.repeat(made, n, axis=0)


def forgetting_factor(value: Any) -> float:
    """Return by how much P grows in a step, or raise."""
    if not 0.0 < _checks.real("forgetting", value) <= 1.0:
        raise ValueError(f"forgetting: expected a number in (0, 1], got {value!r}")
    return (1.0 / math.sqrt(value)) ** 2


def covariance(name: str, value: Any, n: int) -> Array:
    """Return a covariance of the parameters; a number stands for a multiple of I."""
    matrix = square(name, value, n, "{} parameters")
    _checks.covariance(name, matrix)
    return matrix


def actuators(where: np.ndarray) -> str:
    """Name the actuators of a mask."""
    places = np.flatnonzero(where).tolist()
    names = ", ".join(map(str, places[:5])) + (f" and {len(places) - 5} more" if len(places) > 5 else "")
    return f"actuator{'s' if len(places) > 1 else ''} {names}"


def _among(n: int, which: list[int]) -> str:
    """Return the end of a message that names some of n actuators, if there are several."""
    return f": {actuators(np.isin(np.arange(n), which))}" if n > 1 else ""


def variances(value: Any, n: int, length: int | None = None) -> Array:
    """Return R of each actuator, shape (n,), or (length, n) of each sample of a recording too; or raise."""
    values = numbers("R", value)
    values = values.reshape(()) if values.size == n == 1 else values
    shapes = [(), (n,)] if length is None else [(), (length,), (length, n)]
    if values.shape not in shapes:
        expected = "one variance" if n == 1 == len(shapes) - 1 else f"shape {shapes[-1]}, or {shapes[-2]} for all"
        raise ValueError(f"R: expected {expected}, got {described(values)}")
    values = np.broadcast_to(values[:, None] if values.ndim < len(shapes[-1]) and values.ndim else values, shapes[-1])
    good = (values > 0.0) & (values < np.inf)
    if not good.all():
        raise ValueError(
            f"R: expected variances > 0, got {values[~good][0]}{_where(~good)}; NaN in y is for a missing sample"
        )
    return values


# Samples.


def outputs(y: Any, n: int, recorded: bool = False) -> Array:
    """Return measured outputs, shape (n,) or (N, n), NaN where they are missing, or raise."""
    if isinstance(y, float) and n == 1 and -LARGEST <= y <= LARGEST and not recorded:
        return np.array([y])
    values = numbers("y", np.full(n, np.nan) if y is None and not recorded else y)
    values = values.reshape(1) if n == values.size == 1 and not recorded else values
    if values.ndim != 1 + recorded or values.shape[-1] != n or values.size == 0:
        shape = f"(N, {n}), N >= 1," if recorded else f"({n},) or a number" if n == 1 else f"({n},)"
        raise ValueError(f"y: expected shape {shape} for n={n}, got {described(values)}")
    if _have_squares(values):
        # A single sample waits to be looked at, and whoever gave it may write the next one into the same array.
        return values if recorded else values.copy()
    return with_squares(values, _where)


def inputs(structure: Structure, u: Any, n: int, length: int | None = None) -> Array:
    """Return inputs, shape (n, n_inputs), or (N, n, n_inputs) for a recording of a given length; or raise."""
    width, time = structure.n_inputs, () if length is None else (length,)
    if isinstance(u, float) and n == width == 1 and -LARGEST <= u <= LARGEST and length is None:
        return np.array([[u]])
    if u is None:
        if width:
            what = "phi" if structure.takes_phi else "input"
            raise ValueError(f"u: expected the {what} of each sample, {width} number(s) for {structure}, got None")
        return np.zeros((*time, n, 0))
    signal = numbers("u", u)
    if n == 1 and length is None and signal.size == width and signal.ndim < 3:
        signal = signal.reshape(1, width)
    values = signal[..., None] if width == 1 and signal.shape in (time, (*time, n)) else signal
    if values.shape == (*time, width):
        values = values[..., None, :]
    elif values.shape != (*time, n, width):
        forms = [time, (*time, n)] if width == 1 else [(*time, width), (*time, n, width)]
        raise ValueError(
            f"u: expected shape {forms[0]} for all or {forms[1]} for {structure} and n={n}, got {described(signal)}"
        )
    if not _have_squares(values):
        require_finite(values, lambda bad: _where(np.asarray(np.broadcast_to(bad, (*time, n, width)).any(axis=-1))))
    if values.shape != (*time, n, width):
        values = np.broadcast_to(values, (*time, n, width))
    return values if time else values.copy()


def _have_squares(values: Array) -> bool:
    """Tell whether the squares of all values are numbers; of few Python knows it sooner."""
    if values.size < 9:
        return all(-LARGEST <= value <= LARGEST for value in values.ravel().tolist())
    return bool((np.abs(values) <= LARGEST).all())


def _where(bad: np.ndarray) -> str:
    """Name the first sample and its actuators, if there are several, of a mask (n,) or (N, n)."""
    k = int(bad.any(axis=1).argmax()) if bad.ndim > 1 else None
    who = f" from {actuators(bad if k is None else bad[k])}" if bad.shape[-1] > 1 else ""
    return who if k is None else f" in sample {k}{who}"
