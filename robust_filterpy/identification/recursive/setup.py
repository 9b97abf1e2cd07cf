"""From a tracker's arguments to a filter that carries them, and what is asked of the filter."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import FLOAT, Array
from robust_filterpy._filterpy import KalmanFilter
from robust_filterpy._warning import warn
from robust_filterpy.filters.conversion import robust
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.shell import leave_unwatched
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.regressor import are_stable
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.influence.functions import Linear

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
    """Return whether there is a constant beside theta, or raise."""
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
    is_class = isinstance(given, type)
    makes = issubclass(given, KalmanFilter) if is_class else callable(given) and not isinstance(given, KalmanFilter)
    # R is followed, so that S is right: there is no custom of wrong ones to learn.
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
    start = np.ravel(kf.x).astype(float)[own] if theta is None else _start(theta, n)
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
    if len(own) == len(values) == len(whole):
        return values
    found = np.array(whole, dtype=float)
    found[np.ix_(own, own)] = values
    return found


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
        variance = _checks.numbers("R", R)
        if variance.size != 1:
            raise ValueError(f"R: expected one variance for the one output, got {_checks.described(variance)}")
        values["R"] = np.array([[_checks.positive("R", variance.item())]])
    if F is not None:
        values["F"] = finite("F", _checks.matrix("F", F, (n, n), f"{n} parameters")).copy()
    return values


def forget(kf: Any, forgetting: Any) -> None:
    """Give a filter a forgetting factor, or raise."""
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
    return finite("theta", values.ravel()).copy()


def finite(name: str, values: Array) -> Array:
    """Return values or raise unless all of them are finite."""
    if not np.isfinite(values).all():
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity among them")
    return values


def covariance(name: str, value: Any, n: int) -> Array:
    """Return a covariance of the parameters; a number stands for a multiple of I."""
    scalar = np.ndim(value) == 0 and value is not None
    matrix = _checks.real(name, value) * np.eye(n) if scalar else _checks.matrix(name, value, (n, n), f"{n} parameters")
    finite(name, matrix)
    _checks.covariance(name, matrix)
    return matrix.copy()


def noise_variance(kf: RobustKalmanFilter) -> float:
    """Return a filter's R as a number, or raise."""
    r = told_variance(kf)
    if math.isnan(r):
        raise ValueError(f"R: expected a variance > 0, got {kf.R!r}; NaN in y is for a sample that is missing")
    return r


def told_variance(kf: RobustKalmanFilter) -> float:
    """Return that, NaN where it would raise: the next sample that needs it does."""
    R = kf.R
    try:
        r = float(R.item() if type(R) is np.ndarray and R.size == 1 else np.ravel(R)[0])
    except (TypeError, ValueError, IndexError):
        return math.nan
    return r if 0.0 < r < math.inf else math.nan


def load(kf: RobustKalmanFilter, theta: Array, P: Array, R: float) -> None:
    """Let a filter go on from these."""
    kf.x, kf.P = theta.reshape(np.shape(kf.x)).copy(), P.copy()
    if told_variance(kf) != R == R:
        kf.R = np.array([[R]])


def is_plain(kf: Any, n: int) -> bool:
    """Tell whether a filter of n parameters is our own as it comes: the kernel then gives the numbers of `update`."""
    return bool(
        type(kf) is RobustKalmanFilter
        # Not one whose methods somebody has wrapped.
        and "predict" not in vars(kf)
        and "update" not in vars(kf)
        and kf.policy.noise is None
        and kf.policy.patience is None
        and kf.inv is np.linalg.inv
        and is_array(kf.F, (n, n))
        and is_array(kf.Q, (n, n))
        and is_array(kf.P, (n, n))
        and is_array(kf.R, (1, 1))
        and (is_array(kf.x, (n,)) or is_array(kf.x, (n, 1)))
        and 0.0 < kf.R.item() < math.inf
    )


def settings(kf: RobustKalmanFilter) -> dict[str, Array]:
    """Return what a filter's behaviour depends on besides x and P."""
    values = {name: getattr(kf, name) for name in ("Q", "R", "F")} | {"alpha_sq": vars(kf)["_alpha_sq"]}
    return {name: np.array(value, dtype=float) for name, value in values.items() if value is not None}


def apply_settings(kf: RobustKalmanFilter, state: Mapping[str, Array]) -> None:
    """Write them back where they differ."""
    for name, value in settings(kf).items():
        if name in state and not np.array_equal(state[name], value):
            attribute = "_alpha_sq" if name == "alpha_sq" else name
            setattr(kf, attribute, state[name].item() if state[name].ndim == 0 else state[name])
