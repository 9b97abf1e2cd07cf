"""From a tracker's arguments to a filter that carries them, and from a filter to plain arrays and back."""

from __future__ import annotations

import math
import warnings
from typing import Any

import numpy as np

from robust_filterpy import _checks, _state
from robust_filterpy._checks import FLOAT, Array
from robust_filterpy.filters._interruption import StateMixin
from robust_filterpy.filters._mixin import RobustFilterMixin
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.identification.models.guard import are_stable
from robust_filterpy.identification.models.structures import Structure

# Before the data have spoken the parameters may be anything of moderate size.
_VAGUE = 100.0

# What a filter's behaviour depends on besides x and P: name in a state, attribute.
_SETTINGS = {"Q": "Q", "R": "R", "F": "F", "alpha_sq": "_alpha_sq"}


def is_array(value: Any, shape: tuple[int, ...]) -> bool:
    """Tell whether value is a float array of this shape."""
    return type(value) is np.ndarray and value.dtype == FLOAT and value.shape == shape


def make_filter(n: int, given: Any, choices: dict[str, Any]) -> Any:
    """Return the filter that a tracker wraps, or raise if it cannot serve."""
    chosen = {name: value for name, value in choices.items() if value is not None}
    if given is None:
        # R is followed, so that S is right: there is no custom of wrong ones to learn.
        kf = RobustKalmanFilter(n, 1, **{"scaling": "innovation", **chosen})
        kf.x, kf.P, kf.Q = np.zeros(n), _VAGUE * np.eye(n), np.zeros((n, n))
        return _unwatched(kf)
    if chosen:
        raise ValueError(f"{', '.join(chosen)}: expected only without filter=; set them on the filter that you pass")
    kf = given
    if isinstance(given, type):
        kf = given(dim_x=n, dim_z=1)
    for name in ("x", "P", "H", "predict", "update"):
        if not hasattr(kf, name):
            raise TypeError(f"filter: expected x, P, H, predict() and update(z) as filterpy's filters have, no {name}")
    try:
        kf.P = _VAGUE * np.eye(n) if kf is not given else kf.P
        if kf is not given and hasattr(kf, "Q"):
            kf.Q = np.zeros((n, n))
    except AttributeError:
        raise TypeError(
            f"filter: expected P to be an attribute that can be set, {type(kf).__name__} has none"
        ) from None
    if np.size(kf.x) != n:
        raise ValueError(f"filter: expected dim_x={n} for the structure's parameters, got {np.size(kf.x)}")
    if getattr(kf, "dim_z", 1) != 1:
        raise ValueError(f"filter: expected dim_z=1, got {kf.dim_z}; a tracker has one output")
    return _unwatched(kf)


def _unwatched(kf: Any) -> Any:
    """Return the filter, which shall not warn of its samples: the tracker does."""
    if isinstance(kf, RobustFilterMixin):
        kf._counts_clipped = False
    return kf


def configure(
    kf: Any,
    structure: Structure,
    own: np.ndarray,
    *,
    theta: Any,
    P: Any,
    Q: Any,
    R: Any,
    F: Any,
    forgetting: float | None,
) -> None:
    """Check the arguments that are given and write them into the filter; own: the places of theta in its state."""
    n, size = structure.n_theta, np.size(kf.x)
    start = np.ravel(kf.x).astype(float)[own] if theta is None else _start(theta, n)
    if not are_stable(start, structure.stable_parts):
        got = " and ".join(str(start[part]) for part in structure.stable_parts)
        raise ValueError(
            f"theta: expected a stable model to start from, got {got} as the coefficients that feed back, whose roots "
            "leave the unit circle"
        )
    values = checked_values(n, P, Q, R, F)
    values = {
        name: value if name == "R" else embedded(getattr(kf, name, np.eye(size)), own, value)
        for name, value in values.items()
    }
    if F is None and (not hasattr(kf, "F") or np.shape(kf.F) != (size, size)):
        values["F"] = np.eye(size)
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
    if len(own) == len(values) == len(whole):
        return values
    found = np.array(whole, dtype=float)
    found[np.ix_(own, own)] = values
    return found


def warn_of_default_noise(kf: Any) -> None:
    """Warn if parameters would move by 1 a sample only because filterpy's filters begin with Q = I."""
    n = np.size(kf.x)
    if np.array_equal(getattr(kf, "Q", np.zeros(0)), np.eye(n)):
        warnings.warn(
            "filter: its Q is I, as filterpy's filters begin, so that every parameter is expected to move by 1 a "
            "sample; pass Q=0 for parameters that stand still, or Q=1 if that is meant",
            UserWarning,
            stacklevel=3,
        )


def checked_values(n: int, P: Any = None, Q: Any = None, R: Any = None, F: Any = None) -> dict[str, Array]:
    """Return those matrices that are given, as a filter of n parameters wants them, or raise."""
    values = {name: _covariance(name, value, n) for name, value in (("P", P), ("Q", Q)) if value is not None}
    if R is not None:
        variance = _checks.numbers("R", R)
        if variance.size != 1:
            raise ValueError(f"R: expected one variance for the one output, got {_checks.described(variance)}")
        values["R"] = np.array([[_checks.positive("R", variance.item())]])
    if F is not None:
        values["F"] = _finite("F", _checks.matrix("F", F, (n, n), f"{n} parameters")).copy()
    return values


def forget(kf: Any, forgetting: Any) -> None:
    """Give a filter a forgetting factor, or raise."""
    if not hasattr(kf, "alpha"):
        raise ValueError(f"forgetting: expected a filter with alpha, {type(kf).__name__} has none; use Q")
    if not 0.0 < _checks.real("forgetting", forgetting) <= 1.0:
        raise ValueError(f"forgetting: expected a number in (0, 1], got {forgetting!r}")
    kf.alpha = 1.0 / math.sqrt(forgetting)


def _start(theta: Any, n: int) -> Array:
    """Return the parameters to start from, shape (n,)."""
    values = _checks.numbers("theta", theta)
    if values.ndim == 0:
        values = np.full(n, values.item())
    if values.ndim > 2 or values.size != n:
        raise ValueError(f"theta: expected {n} parameters, got {_checks.described(values)}")
    return _finite("theta", values.ravel()).copy()


def _finite(name: str, values: Array) -> Array:
    """Return values or raise unless all of them are finite."""
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity among them")
    return values


def _covariance(name: str, value: Any, n: int) -> Array:
    """Return a covariance of the parameters; a number stands for a multiple of I."""
    scalar = np.ndim(value) == 0 and value is not None
    matrix = _checks.real(name, value) * np.eye(n) if scalar else _checks.matrix(name, value, (n, n), f"{n} parameters")
    _finite(name, matrix)
    _checks.covariance(name, matrix)
    return matrix.copy()


def noise_variance(kf: Any) -> float:
    """Return a filter's R as a number, 1 if it has none, or raise."""
    R = getattr(kf, "R", 1.0)
    try:
        r = float(np.ravel(R)[0])
    except (TypeError, ValueError, IndexError):
        r = math.nan
    if not 0.0 < r < math.inf:
        raise ValueError(f"R: expected a variance > 0, got {R!r}; NaN in y is for a sample that is missing")
    return r


def settings(kf: Any) -> dict[str, Array]:
    """Return what else a filter's behaviour depends on, as arrays."""
    found = {key: getattr(kf, name) for key, name in _SETTINGS.items() if hasattr(kf, name)}
    return {key: np.array(value, dtype=float) for key, value in found.items() if value is not None}


def kept_by(kf: Any) -> dict[str, Array]:
    """Return what a filter of this package keeps beside x and P, as arrays: what it knows of its sensor among it."""
    if not isinstance(kf, StateMixin):
        return {}
    kept = {**kf._moving(), **kf._sensors_in_state()}
    return {f"filter_{name}": value for name, value in kept.items() if name not in ("x", "P")}


def take_over(kf: Any, state: Any) -> None:
    """Restore that, with the x and P that it belongs to, or raise; nothing has changed then."""
    shape = np.shape(kf.x)
    if isinstance(kf, StateMixin):
        inner = {name.removeprefix("filter_"): state[name] for name in state if name.startswith("filter_")}
        if all(name in inner for name in kf._needed() if name not in ("x", "P")):
            kf.restore({"x": np.reshape(state["theta"], shape), "P": state["P"], **inner})


def apply_settings(kf: Any, state: dict[str, Array]) -> None:
    """Write them back where they differ."""
    for key, value in settings(kf).items():
        if key in state and not np.array_equal(state[key], value):
            setattr(kf, _SETTINGS[key], state[key].item() if state[key].ndim == 0 else state[key])


def checked_state(state: Any, shapes: dict[str, tuple[int, ...]], present: dict[str, Array]) -> dict[str, Array]:
    """Return a state's arrays, copied, or raise if one is missing or does not fit."""
    needed = {name: tuple(None if size == -1 else size for size in shape) for name, shape in shapes.items()}
    optional = {name: value.shape for name, value in present.items()}
    found = _state.checked(state, None, needed, optional, ("start", "followed"))
    for name in ("R", "alpha_sq"):
        if name in found and not (found[name] > 0.0).all():
            raise _state.StateError(f"state: expected {name} > 0, got {found[name]}")
    require_recursion(found["recursion"])
    if "watch" in found:
        _require_watch(found["watch"])
    return {**found, "enabled": found["enabled"].astype(bool)}


def require_recursion(recursion: Array) -> None:
    """Raise unless what the recursions of trackers keep, shape (.., 7), can be what `state` gave."""
    _, limit, samples, mean, memory, begun, waits = np.moveaxis(recursion, -1, 0)
    for what, good in (
        ("a limit of tr P > 0", limit > 0.0),
        ("counts of samples >= 0", (samples >= 0.0) & (memory >= 0.0)),
        ("a mean of min(e^2, 4) in [0, 4]", (mean >= 0.0) & (mean <= 4.0)),
        ("begun to be 0 or 1", (begun == 0.0) | (begun == 1.0)),
        ("a whole number of samples until the next look, or -1", (waits >= -1.0) & (waits % 1.0 == 0.0)),
    ):
        if not good.all():
            raise _state.StateError(f"state: expected {what} in recursion, got {_checks.shown(recursion)}")


def _require_watch(watch: Array) -> None:
    """Raise unless what decides about another start can be what `state` gave."""
    restarts, samples, seen, variance = watch[:4]
    for what, good in (
        ("whether it may start anew to be 0 or 1", restarts in (0.0, 1.0)),
        ("whole numbers of samples >= 0", samples >= 1.0 and seen >= 0.0 and samples % 1.0 == seen % 1.0 == 0.0),
        ("a variance >= 0", variance >= 0.0),
    ):
        if not good:
            raise _state.StateError(f"state: expected {what} in watch, got {_checks.shown(watch)}")


def require_consistent(state: dict[str, Array], parts: tuple[slice, ...]) -> None:
    """Raise unless a state's fading memory is none or more, and the model is stable where that is kept."""
    if "alpha_sq" in state and not (state["alpha_sq"] >= 1.0).all():
        raise ValueError(f"state: expected alpha_sq >= 1, got {state['alpha_sq']}")
    if not are_stable(state["theta"], parts):
        raise ValueError(
            "state: expected theta of a stable model, got coefficients that feed back with roots outside the unit "
            "circle"
        )
