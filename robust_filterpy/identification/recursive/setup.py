"""From the arguments of a tracker or a bank to filters and arrays, what is asked of a filter, samples of a bank."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeVar

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._arrays import square
from robust_filterpy._checks import FLOAT, Array, described, numbers
from robust_filterpy._filterpy import KalmanFilter
from robust_filterpy._warning import warn
from robust_filterpy.filters.conversion import robust
from robust_filterpy.filters.kalman import RobustKalmanFilter, replaced
from robust_filterpy.filters.shell import leave_unwatched
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.regressor import LARGEST, are_stable
from robust_filterpy.identification.models.signals import require_finite, with_squares
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive.recursion import given_variance
from robust_filterpy.influence.functions import Linear

_Made = TypeVar("_Made")
# Before the data have spoken the parameters may be anything of moderate size.
_VAGUE = 100.0


def is_array(value: Any, shape: tuple[int, ...]) -> bool:
    """Tell whether value is a float array of this shape."""
    return type(value) is np.ndarray and value.dtype == FLOAT and value.shape == shape


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
    """Return the filter that a tracker wraps, or raise if it cannot serve."""
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
    if given is None:
        kf.x = np.zeros(n)
    if given is None or makes:
        kf.P, kf.Q = _VAGUE * np.eye(n), np.zeros((n, n))
    if np.size(kf.x) != n:
        raise ValueError(f"filter: expected dim_x={n} for the structure's parameters, got {np.size(kf.x)}")
    if kf.dim_z != 1:
        raise ValueError(f"filter: expected dim_z=1, got {kf.dim_z}; a tracker has one output")
    leave_unwatched(kf)
    return kf


def configure(kf: Any, structure: Structure, own: np.ndarray, given: Mapping[str, Any]) -> None:
    """Check theta, P, Q, R, F and forgetting as given and write them into the filter; own: where theta stands in it."""
    theta, P, Q, R, F, forgetting = (given.get(name) for name in ("theta", "P", "Q", "R", "F", "forgetting"))
    n, size = structure.n_theta, np.size(kf.x)
    given_start = np.ravel(kf.x)[own] if theta is None else np.full(n, theta) if np.ndim(theta) == 0 else theta
    start = _checks.finite("theta", given_start, (n,), reshaped=True).copy()
    if not are_stable(start, structure.stable_parts):
        got = " and ".join(str(start[part]) for part in structure.stable_parts)
        raise ValueError(
            f"theta: expected a stable model to start from, got {got} as the coefficients that feed back, whose roots "
            "leave the unit circle"
        )
    values = checked_values(n, P, Q, R, F)
    values = {name: value if name == "R" else embedded(getattr(kf, name), own, value) for name, value in values.items()}
    if forgetting is not None:
        forget(kf, forgetting)
    if theta is not None:
        x = np.zeros(size)
        x[own] = start
        kf.x = x.reshape(np.shape(kf.x))
    for name, value in values.items():
        setattr(kf, name, value)


def embedded(whole: Any, own: np.ndarray, values: Array) -> Array:
    """Return a matrix of all that a filter estimates, with these values in the places of theta."""
    matrix = np.array(whole, dtype=float)
    matrix[np.ix_(own, own)] = values
    return matrix


def warn_of_default_noise(kf: Any) -> None:
    """Warn if parameters would move by 1 a sample only because filterpy's filters begin with Q = I."""
    if np.array_equal(kf.Q, np.eye(np.size(kf.x))):
        warn(
            "filter: its Q is I, as filterpy's filters begin, so that every parameter is expected to move by 1 a "
            "sample; pass Q=0 for parameters that stand still, or Q=1 if that is meant",
            UserWarning,
        )


def checked_values(n: int, P: Any = None, Q: Any = None, R: Any = None, F: Any = None) -> dict[str, Array]:
    """Return those matrices that are given, as a filter of n parameters wants them, or raise."""
    values = {name: covariance(name, value, n) for name, value in (("P", P), ("Q", Q)) if value is not None}
    if R is not None:
        values["R"] = variances(R, 1)[:, None].copy()
    if F is not None:
        values["F"] = _checks.finite("F", _checks.matrix("F", F, (n, n), f"{n} parameters"), (n, n)).copy()
    return values


def forget(kf: Any, forgetting: Any) -> None:
    """Give a filter a forgetting factor, or raise."""
    if not 0.0 < _checks.real("forgetting", forgetting) <= 1.0:
        raise ValueError(f"forgetting: expected a number in (0, 1], got {forgetting!r}")
    kf.alpha = 1.0 / math.sqrt(forgetting)


def covariance(name: str, value: Any, n: int) -> Array:
    """Return a covariance of the parameters; a number stands for a multiple of I."""
    matrix = square(name, value, n, "{} parameters")
    _checks.covariance(name, matrix)
    return matrix.copy()


def load(kf: RobustKalmanFilter, theta: Array, P: Array, R: float) -> None:
    """Let a filter go on from these."""
    kf.x, kf.P = theta.reshape(np.shape(kf.x)).copy(), P.copy()
    if given_variance(kf) != R == R:
        kf.R = np.array([[R]])


def is_plain(kf: Any, n: int) -> bool:
    """Tell whether a filter of n parameters is our own as it comes: the kernel then gives the numbers of `update`."""
    if type(kf) is not RobustKalmanFilter or replaced(kf) or kf.policy.noise or kf.choices.patience:
        return False
    square = all(is_array(getattr(kf, name), (n, n)) for name in "FQP")
    x_fits = is_array(kf.x, (n,)) or is_array(kf.x, (n, 1))
    return square and x_fits and is_array(kf.R, (1, 1)) and 0.0 < kf.R.item() < math.inf


def settings(kf: RobustKalmanFilter) -> dict[str, Array]:
    """Return what a filter's behavior depends on besides x, P and R."""
    values = {"Q": kf.Q, "F": kf.F, "alpha_sq": vars(kf)["_alpha_sq"]}
    return {name: np.array(value, dtype=float) for name, value in values.items() if value is not None}


def apply_settings(kf: RobustKalmanFilter, state: Mapping[str, Array]) -> None:
    """Write them back where they differ."""
    for name, value in settings(kf).items():
        if name in state and not np.array_equal(state[name], value):
            attribute = "_alpha_sq" if name == "alpha_sq" else name
            setattr(kf, attribute, state[name].item() if state[name].ndim == 0 else state[name])


# A bank: options and samples, shared by all actuators or with an axis of n.


def actuators(where: np.ndarray) -> str:
    """Name the actuators of a mask."""
    places = np.flatnonzero(where).tolist()
    names = ", ".join(map(str, places[:5])) + (f" and {len(places) - 5} more" if len(places) > 5 else "")
    return f"actuator{'s' if len(places) > 1 else ''} {names}"


# How many axes an option has that all actuators share; of any other a list is one for each.
_AXES: Final = {"theta": (0, 1), "P": (0, 2), "Q": (0, 2), "F": (2,), "R": (0,), "forgetting": (0,)}


def of_each(n: int, given: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the options of each actuator, of one where none has its own."""
    own, shared = {}, dict(given)
    for name, value in given.items():
        if value is None:
            continue
        values: Any = numbers(name, value) if name in _AXES else value
        if isinstance(values, np.ndarray) and not values.ndim:
            shared[name] = values = values.item()
        several = np.ndim(values) not in _AXES[name] if name in _AXES else isinstance(values, (list, tuple, np.ndarray))
        if several and len(values) != n:
            raise ValueError(f"{name}: expected one for all or a list of {n}, got {len(values)}")
        if several:
            own[name] = values
            del shared[name]
    return [{**shared, **{name: values[i] for name, values in own.items()}} for i in range(n if own else 1)]


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


def for_each(make: Callable[[dict[str, Any]], _Made], rows: list[dict[str, Any]]) -> list[_Made]:
    """Return what is made of the options of each actuator, or raise with the actuators whose options are refused."""
    made: list[_Made] = []
    refused: dict[int, Exception] = {}
    for i, row in enumerate(rows):
        try:
            made.append(make(row))
        except (ValueError, TypeError) as error:
            refused[i] = error
    for first in refused.values():
        if len(rows) > 1:
            first.args = (f"{first}: {actuators(np.isin(np.arange(len(rows)), list(refused)))}", *first.args[1:])
        raise first
    return made


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
