"""What a filter did with a recording, as arrays; figures of its innovations, and what a right model makes them."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.correction.contaminated import Contaminated
from robust_filterpy.influence.information import clipping_point


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
    clipped: Array  # (N, m), bool
    influence: Any
    scaling: str
    grouping: str
    contamination: float  # share of outliers that it is made for
    by_noise: bool  # by noise= rather than by psi
    model: LinearModel | None


def is_saver(source: Any) -> bool:
    """Tell a filterpy Saver."""
    return hasattr(source, "_kf") and hasattr(source, "save")


def of_saver(saver: Any) -> FilterRecord:
    """Return what a Saver kept, or say what it lacks."""
    epochs = saver.__dict__
    for name in ("z", "y", "S"):
        if name not in epochs:
            raise ValueError(f"saver: expected one that kept {name}, got {sorted(k for k in epochs if k[:1] != '_')}")
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
    epochs: dict[str, list[Any]] = {}
    kf: Any = None
    for output, kf in zip(y, tracker.corrections(y, u), strict=True):
        _keep(epochs, kf, len(y))
        epochs["z"][-1] = output
    return _recording(epochs, kf)


_NAMES = ("z", "y", "S", "weights", "clipped", "F", "Q", "H", "R", "x", "x_prior", "P_prior", "x_post", "alpha")


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
    # A filter that weighs by noise given or learned has no psi.
    influence = getattr(kf, "influence", None)
    influence = influence if hasattr(influence, "psi_deriv") else None
    learns = influence is None and getattr(kf, "noise", None) is not None
    # Any where noise is learned, none of a psi that is made for no share of outliers.
    contamination = 1.0 if learns else getattr(influence, "contamination", 0.0)
    return FilterRecord(
        np.where(absent, np.nan, z), y, S, clipped & ~absent, influence,
        getattr(kf, "scaling", "innovation"), getattr(kf, "grouping", "component"), contamination,
        learns or isinstance(influence, Contaminated), _model(epochs, y, z, m),
    )  # fmt: skip


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


# Correlations that tell whether innovations are white.
_LAGS = 10
# Where angles, hours and counters begin anew.
_PERIODS = (360.0, 2.0 * math.pi, 180.0, math.pi, 400.0, 24.0, *(2.0**bits for bits in (8, 10, 12, 16, 32)))


class Band(NamedTuple):
    """Hold a mean of the normalized innovation squared, what it should be, and a 99 % band around that."""

    mean: float
    expected: float
    lower: float
    upper: float


def of_sensor(e: Array, clipped: Array) -> tuple[float, ...]:
    """Return share of clipped, longest run, that by chance, share beyond 3, scale, outliers, correlation, its p-value.
    """
    share = clipped.mean() if len(e) else np.nan
    run, by_chance = longest_run(clipped), expected_run(np.nan_to_num(share), len(e))
    beyond = np.mean(np.abs(e) > 3) if len(e) else np.nan
    return float(share), run, by_chance, float(beyond), *bulk(e), *whiteness(e)


def normalized(recording: FilterRecord) -> Array:
    """Return y_i / sqrt(S_ii), shape (N, m): the innovation of each sensor in its own standard deviations."""
    variance = np.einsum("kii->ki", recording.S)
    return recording.y / np.sqrt(np.where(variance > 0, variance, np.nan))


def bulk(e: Array) -> tuple[float, float]:
    """Return the scale of the ordinary values by the median, and the share of outliers among them."""
    # The median of |e| belongs to a higher quantile of the ordinary values the more outliers there are.
    size = np.abs(e[~np.isnan(e)])
    if not len(size):
        return math.nan, math.nan
    share = 0.0
    scale = float(np.median(size) / stats.norm.ppf(0.75))
    for _ in range(20):
        beyond = float(np.mean(size > 3.0 * scale)) if scale else 0.0
        share = min(max(beyond - 0.0027, 0.0) / (1 - 0.0027), 0.45)
        scale = float(np.median(size) / stats.norm.ppf(0.5 + 0.25 / (1.0 - share)))
    return scale, share


def expected_clipped(recording: FilterRecord) -> tuple[Array, Array]:
    """Return the share of clipped samples of each sensor without outliers, and with all outliers clipped; or NaN."""
    k, m, contamination = clipping_point(recording.influence), recording.y.shape[1], recording.contamination
    if recording.influence is None and recording.clipped.any():
        # Weights of noise that is learned have no threshold.
        return np.full(m, np.nan), np.full(m, np.nan)
    if recording.grouping == "joint":
        low = np.full(m, stats.chi2.sf(k * k, m))
    else:
        # Under "unit" and "bounded" e has the unit of the measurement.
        deviation = np.ma.median(np.sqrt(np.ma.masked_invalid(np.einsum("kii->ki", recording.S))), axis=0).filled(1.0)
        spread = {"unit": deviation, "bounded": np.minimum(deviation, 1.0)}.get(recording.scaling, np.ones(m))
        low = 2.0 * stats.norm.sf(k / spread)
    return low, (1.0 - contamination) * low + (contamination if math.isfinite(k) else 0.0)


def longest_run(flags: np.ndarray) -> int:
    """Return the length of the longest run of True."""
    edges = np.flatnonzero(np.diff(np.r_[0, flags.astype(int), 0]))
    return int((edges[1::2] - edges[::2]).max(initial=0))


def expected_run(share: float, samples: int) -> float:
    """Return the longest run of independent events that 99 % of recordings stay below."""
    if share <= 0.0 or samples == 0:
        return 0.0
    if share >= 1.0:
        return float(samples)
    # About samples * (1 - share) runs begin; each reaches length L with probability share^L.
    return min(max(math.log(0.01 / (samples * (1 - share))) / math.log(share), 1.0), float(samples))


def whiteness(e: Array) -> tuple[float, float]:
    """Return the lag-one autocorrelation and the p-value of Ljung and Box, outliers cut at two deviations."""
    e = e[~np.isnan(e)]
    scale = bulk(e)[0]
    if len(e) <= 2 * _LAGS or not scale > 0:
        return math.nan, math.nan
    e = np.clip(e / scale, -2.0, 2.0)
    centred = e - e.mean()
    power = float(centred @ centred)
    if power == 0.0:
        return math.nan, math.nan
    r = np.array([centred[j:] @ centred[:-j] for j in range(1, _LAGS + 1)]) / power
    N = len(e)
    statistic = N * (N + 2) * float(np.sum(r**2 / (N - np.arange(1, _LAGS + 1))))
    return float(r[0]), float(stats.chi2.sf(statistic, _LAGS))


def unclipped_nis(recording: FilterRecord) -> Band:
    """Return the mean of y' S^-1 y over the samples of which nothing is clipped, and what it should be."""
    # What is left after clipping has the moments of a truncated normal (joint: chi-square) distribution.
    k, m = clipping_point(recording.influence), recording.y.shape[1]
    if not math.isfinite(k) or recording.scaling != "innovation":
        k = 3.0
    whole, is_joint = ~np.isnan(recording.y).any(axis=1), recording.grouping == "joint"
    eigenvalues, vectors = np.linalg.eigh(recording.S[whole])
    with np.errstate(all="ignore"):
        turned = np.einsum("kji,kj->ki", vectors, recording.y[whole]) / np.sqrt(eigenvalues)
        e = np.einsum("kij,kj->ki", vectors, turned)
        values = (e * e).sum(axis=1)
        inside = values <= k * k if is_joint else (np.abs(e) <= k).all(axis=1)
    values = values[inside & (eigenvalues > 0).all(axis=1)]
    # All components are one square of m degrees of freedom, or m squares of one.
    d, squares = (m, 1) if is_joint else (1, m)
    within, *moments = stats.chi2.cdf(k * k, [d, d + 2, d + 4])
    first, second = d * moments[0] / within, d * (d + 2) * moments[1] / within
    first, variance = squares * first, squares * (second - first**2)
    half = stats.norm.ppf(0.995) * math.sqrt(variance / len(values)) if len(values) else math.nan
    mean = float(np.mean(values)) if len(values) else math.nan
    return Band(mean, float(first), float(first - half), float(first + half))


def saturated(z: Array) -> float | None:
    """Return the value at which a sensor sticks at the end of its range, None if it does not."""
    # The extreme value comes back, with neighbors in time, far more often than the second extreme one: a coarse sensor
    # repeats every value.
    values, counts = np.unique(z, return_counts=True)
    if len(values) < 20:
        return None
    least = max(5, 0.01 * len(z))
    for end, inner in ((0, slice(1, 6)), (-1, slice(-6, -1))):
        if counts[end] >= least and counts[end] > 5 * counts[inner].max() and longest_run(z == values[end]) >= 2:
            return float(values[end])
    return None


def frozen(z: Array) -> int:
    """Return the length of the longest run of one and the same value if the sensor is otherwise alive, else 0."""
    if len(z) < 20:
        return 0
    same = np.diff(z) == 0
    run = longest_run(same) + 1
    alive = 1.0 - float(same.sum() - (run - 1)) / len(same)
    return run if run >= 10 and alive > 0.9 else 0


def breaks_loose(z: Array, value: float) -> bool:
    """Tell a sensor that was frozen at its extreme value: once, and what comes next is far from it."""
    # A signal that saturates comes back the way it went.
    at = np.flatnonzero(z == value)
    if len(at) != at[-1] - at[0] + 1 or at[-1] == len(z) - 1:
        return False
    steps = np.abs(np.diff(z))
    return bool(abs(z[at[-1] + 1] - value) > 5.0 * np.median(steps[steps > 0]))


def wraps(z: Array) -> float | None:
    """Return the period at which an angle or a counter begins anew, None if it does not.

    Where it jumps by more than half of a period it lies near both ends of the range, and without the period it moves
    there as it moves elsewhere.
    """
    for period in _PERIODS:
        for low in (0.0, -0.5 * period):
            inside = z[(z >= low) & (z <= low + period)]
            steps = np.diff(inside)
            jumps = np.abs(steps) > 0.5 * period
            if len(inside) < max(20, 0.95 * len(z)) or not jumps.any() or np.ptp(inside) < 0.9 * period:
                continue
            moves = np.abs(steps - period * np.round(steps / period))
            if np.quantile(moves, 0.9) < 0.1 * period and moves[jumps].mean() < 3.0 * moves[~jumps].mean():
                return period
    return None
