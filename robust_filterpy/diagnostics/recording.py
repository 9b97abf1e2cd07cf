"""What a filter did with a recording, as arrays: from a filter, a Saver or a tracker."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.correction.contaminated import Contaminated
from robust_filterpy.influence.functions import Huber


@dataclass(frozen=True)
class LinearModel:
    """Hold the linear model of every step, as the filter used it."""

    F: Array  # (N, n, n)
    Q: Array  # (N, n, n)
    H: Array  # (N, m, n)
    R: Array  # (N, m, m)
    fading: Array  # (N,), factor of F P F'
    offset: Array  # (N, n), x_prior - F x of the step before: input, and what else moved the state
    x: Array  # (n,), the first prediction
    P: Array  # (n, n), its covariance


@dataclass(frozen=True)
class FilterRecord:
    """Hold innovations and what was made of them; NaN where a component was missing."""

    z: Array  # (N, m)
    y: Array  # (N, m)
    S: Array  # (N, m, m)
    e: Array  # (N, m), T y by the filter's own scaling
    weights: Array  # (N, m)
    clipped: Array  # (N, m), bool
    influence: Any
    scaling: str
    grouping: str
    contamination: float  # share of outliers that it is made for
    is_told: bool  # by noise= rather than by psi
    model: LinearModel | None


def is_saver(source: Any) -> bool:
    """Tell a filterpy Saver."""
    return hasattr(source, "_kf") and hasattr(source, "save")


def of_saver(saver: Any) -> FilterRecord:
    """Return what a Saver kept, or say what it lacks."""
    epochs = saver.__dict__
    for name in ("z", "y", "S"):
        if name not in epochs:
            raise ValueError(f"saver: expected one that kept {name}, found {sorted(k for k in epochs if k[:1] != '_')}")
    if not len(epochs["y"]):
        raise ValueError("saver: expected at least one epoch, got an empty Saver; call save() after each update")
    # Lists, or what `to_array` has made of them; the Saver's other attributes are no columns.
    columns = {name: list(values) for name, values in epochs.items() if isinstance(values, list) or np.ndim(values)}
    return _recording(columns, saver._kf)


def of_filter(kf: Any, zs: Any, per_step: dict[str, Any]) -> FilterRecord:
    """Run a copy of the filter over zs."""
    zs = _checks.entries("zs", zs)
    per_step = {name: _checks.entries(name, values) for name, values in per_step.items()}
    if not hasattr(zs, "__len__"):
        raise TypeError(f"zs: expected a sequence of measurements, got {_checks.shown(zs)}")
    if len(zs) == 0:
        raise ValueError("zs: expected at least one measurement, got none")
    kf = copy.deepcopy(kf)
    epochs: dict[str, list[Any]] = {}
    # Where filterpy puts its Saver.
    recorder = SimpleNamespace(save=lambda: _keep(epochs, kf, len(zs)))
    kf.batch_filter(zs, saver=recorder, **per_step)
    for name in "FQHR":
        given, size = per_step.get(f"{name}s"), len(kf.x) if name == "Q" else kf.dim_z
        for k, value in enumerate(epochs[name]):
            value = value if given is None or given[k] is None else copy.copy(given[k])
            epochs[name][k] = float(value) * np.eye(size) if name in "QR" and np.ndim(value) == 0 else value
    return _recording(epochs, kf)


def of_tracker(tracker: Any, y: Any, u: Any) -> FilterRecord:
    """Run a copy of the tracker over a recording."""
    y = _checks.numbers("zs", y).ravel()
    # By place, not by a label of a table or a column of one.
    u = np.asarray(u) if hasattr(u, "to_numpy") else u
    if len(y) == 0:
        raise ValueError("zs: expected at least one output, got none")
    tracker = copy.deepcopy(tracker)
    kf = tracker.filter
    epochs: dict[str, list[Any]] = {}
    for k, output in enumerate(y):
        tracker.update(output, None if u is None else u[k])
        _keep(epochs, kf, len(y))
        epochs["z"][-1] = output
        if np.isnan(output):
            epochs["y"][-1] = np.full((1, 1), np.nan)
    return _recording(epochs, kf)


_NAMES = ("z", "y", "S", "e", "weights", "clipped", "F", "Q", "H", "R", "x", "x_prior", "P_prior", "x_post", "alpha")


def _keep(epochs: dict[str, list[Any]], kf: Any, steps: int) -> None:
    """Keep what a filter shows now."""
    stage(f"sample {len(epochs.get('y', []))} of {steps}")
    for name in _NAMES:
        if hasattr(kf, name):
            epochs.setdefault(name, []).append(copy.copy(getattr(kf, name)))


def _recording(epochs: dict[str, list[Any]], kf: Any) -> FilterRecord:
    """Put what was kept of each epoch into arrays."""
    n = len(epochs["y"])
    y = _stacked("y", epochs["y"], n)
    m = y.shape[1]
    z = np.full((n, m), np.nan)
    for k, value in enumerate(epochs["z"]):
        row = _checks.numbers("z", value).ravel()
        if row.size == m:
            z[k] = row
    weights = _stacked("weights", epochs["weights"], n) if "weights" in epochs else np.ones((n, m))
    absent = np.isnan(weights) | np.isnan(z)
    y = np.where(absent, np.nan, y)
    S = _stacked("S", epochs["S"], n).reshape(n, m, m)
    S = np.where(np.all(absent, axis=1)[:, None, None], np.nan, S)
    clipped = _stacked("clipped", epochs["clipped"], n).astype(bool) if "clipped" in epochs else np.zeros((n, m), bool)
    e = _stacked("e", epochs["e"], n) if "e" in epochs else np.full((n, m), np.nan)
    # A filter that weighs by noise given or learned has no psi.
    influence = getattr(kf, "influence", None)
    influence = influence if hasattr(influence, "psi_deriv") else None
    learns = influence is None and getattr(kf, "noise", None) is not None
    # Any where noise is learned, none of a psi that is made for no share of outliers.
    contamination = 1.0 if learns else getattr(influence, "contamination", 0.0)
    return FilterRecord(
        np.where(absent, np.nan, z), y, S, np.where(absent, np.nan, e), weights, clipped & ~absent, influence,
        getattr(kf, "scaling", "innovation"), getattr(kf, "grouping", "component"), contamination,
        learns or isinstance(influence, Contaminated), _model(epochs, y, z, m),
    )  # fmt: skip


def threshold(influence: Any) -> float:
    """Return where psi' ceases to be positive, infinite if nowhere below 100."""
    if influence is None:
        return math.inf
    if isinstance(influence, Huber):
        return influence.threshold
    grid = np.linspace(0.0, 100.0, 100001)
    flat = np.asarray(influence.psi_deriv(grid)) <= 0
    return float(grid[flat.argmax()]) if flat.any() else math.inf


def _stacked(name: str, values: list[Any], n: int) -> Array:
    """Return one row for each epoch."""
    sizes = {np.size(value) for value in values}
    if len(sizes) != 1:
        raise ValueError(f"{name}: expected as many components at every step, got {sorted(sizes)}; diagnose each kind")
    return np.array([np.asarray(value, dtype=float).ravel() for value in values]).reshape(n, -1)


def _model(epochs: dict[str, list[Any]], y: Array, z: Array, m: int) -> LinearModel | None:
    """Return the linear model, None where the filter did something else than it says."""
    x_post = epochs.get("x_post", epochs.get("x"))
    if x_post is None or any(name not in epochs for name in ("F", "Q", "H", "R", "x_prior", "P_prior")):
        return None
    N, n = len(y), np.size(epochs["x_prior"][0])
    shapes = {"x_prior": (n,), "F": (n, n), "Q": (n, n), "H": (m, n), "R": (m, m), "P_prior": (n, n)}
    try:
        post = _stacked("x", x_post, N)
        prior, F, Q, H, R, P = (_stacked(name, epochs[name], N).reshape(N, *s) for name, s in shapes.items())
    except (TypeError, ValueError):
        return None
    predicted = np.einsum("kij,kj->ki", H, prior)
    size = np.nanmax(np.abs(np.vstack([predicted, np.nan_to_num(z), np.ones((1, m)) * 1e-300])))
    if np.nanmax(np.abs(np.nan_to_num(z - predicted - y)), initial=0.0) > 1e-6 * size:
        return None
    offset = np.zeros((N, n))
    offset[1:] = prior[1:] - np.einsum("kij,kj->ki", F[1:], post[:-1])
    alpha = np.array([float(a) for a in epochs.get("alpha", np.ones(N))])
    return LinearModel(F, Q, H, R, alpha**2, offset, prior[0], P[0])
