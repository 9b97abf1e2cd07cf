"""What the functions of many series have in common: their arguments, checked, their threads, where series stand."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array, numbers
from robust_filterpy._state import widened
from robust_filterpy.correction import copies
from robust_filterpy.correction.learning import NoiseClasses
from robust_filterpy.kernel.series import Output

__all__ = ["began", "continued"]

_COVARIANCES = ("full", "diagonal", "none")
_REFUSED = ("raise", "nan")


class SeriesArguments(NamedTuple):
    """Arguments of a function of many series, checked, and room for its results."""

    z: Array
    """(series, steps, m)"""
    model: tuple[Array, Array, Array, Array]
    """F, Q, H, R, with the axes (series or 1, steps or 1) in front."""
    x: Array
    """Start of each series, (series, n); a copy, as P."""
    P: Array
    """(series, n, n)"""
    kept: Output
    every: int
    """Distance of kept steps."""
    skips: bool
    """Whether a series that is refused becomes NaN."""

    def covariances(self, covariance: str) -> Array | None:
        """Return what was asked for of the covariances."""
        if covariance == "none":
            return None
        return self.kept.covariances[:, :, 0] if covariance == "diagonal" else self.kept.covariances


def series_arguments(
    zs: Any, F: Any, H: Any, Q: Any, R: Any, x0: Any, P0: Any, keep: Any, covariance: Any, refused: Any
) -> SeriesArguments:
    """Return the arguments as arrays, or raise."""
    _checks.option("covariance", covariance, _COVARIANCES)
    skips = _checks.option("refused", refused, _REFUSED) == "nan"
    z = np.ascontiguousarray(numbers("zs", zs))
    if z.ndim != 3:
        mend = "; use zs[:, :, None] for series of one sensor, zs[None] for one series" if z.ndim == 2 else ""
        raise ValueError(f"zs: expected shape (series, steps, dim_z), got {z.shape}{mend}")
    if np.isinf(z).any():
        raise ValueError("zs: expected finite numbers or NaN (missing), got infinity")
    series, steps, m = z.shape
    if m == 0:
        raise ValueError(f"zs: expected dim_z >= 1, got shape {z.shape}")
    x0, P0 = numbers("x0", x0), numbers("P0", P0)
    # A column, as filterpy keeps its state, would pass for one number for each series.
    unclear = x0.ndim == 0 or (x0.ndim == 2 and x0.shape[1] == 1)
    n = P0.shape[-1] if unclear and P0.ndim else x0.shape[-1] if x0.ndim else 1
    if n == 0:
        raise ValueError(f"x0: expected dim_x >= 1, got shape {x0.shape}")
    if x0.shape not in ((n,), (series, n)):
        mend = "; use x0.ravel()" if x0.shape == (n, 1) else f"; use x0*np.ones({n})" if x0.ndim == 0 else ""
        raise ValueError(f"x0: expected shape {(n,)} or {(series, n)}, got {x0.shape}{mend}")
    if P0.shape not in ((n, n), (series, n, n)):
        raise ValueError(f"P0: expected shape {(n, n)} or {(series, n, n)} for dim_x={n}, got {P0.shape}")
    model: Any = tuple(
        leading(name, value, shape, series, steps)
        for name, value, shape in (("F", F, (n, n)), ("Q", Q, (n, n)), ("H", H, (m, n)), ("R", R, (m, m)))
    )
    _checks.covariance("R", model[3])
    _checks.covariance("Q", model[1], math.inf)
    # A series whose start is not finite is refused by itself.
    started = np.where(np.isfinite(P0).all(axis=(-2, -1), keepdims=True), P0, np.eye(n))
    _checks.covariance("P0", started, _checks.GATHERED, _checks.ROUNDING)
    x, P = np.broadcast_to(x0, (series, n)).copy(), np.broadcast_to(P0, (series, n, n)).copy()
    every = _every(keep, steps)
    rows = steps // every if every else 0
    shape = {"full": (n, n), "diagonal": (1, n), "none": (0, 0)}[covariance]
    kept = Output(
        np.empty((series, rows, n)), np.empty((series, rows, *shape)), np.empty((series, 0, n)),
        np.empty((series, 0, n, n)), np.empty((series, rows, m)), np.zeros(series),
    )  # fmt: skip
    return SeriesArguments(z, model, x, P, kept, every, skips)


def threads(n_threads: int | None) -> int:
    """Return how many threads to use: by default as many as the process may."""
    if n_threads is not None:
        return _checks.count("n_threads", n_threads, 1)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def spread(part: Callable[[int, int], np.ndarray], series: int, n_threads: int) -> np.ndarray:
    """Call part(low, high) over all series, which lets go of the interpreter, on threads; join the results."""
    n_threads = min(n_threads, max(series, 1))
    edges = np.unique(np.linspace(0, series, 4 * n_threads + 1).astype(int)).tolist() if n_threads > 1 else [0, series]
    spans = list(itertools.pairwise(edges))
    if len(spans) < 2:
        done = [part(*span) for span in spans or [(0, 0)]]
    else:
        # Compile, or load from the cache, in one thread, before two do the same work.
        part(0, 0)
        with ThreadPoolExecutor(n_threads) as pool:
            done = list(pool.map(lambda span: part(*span), spans))
    return np.concatenate(done)


def leading(name: str, value: Any, shape: tuple[int, int], series: int, steps: int) -> Array:
    """Return a matrix with the axes (series or 1, step or 1) in front, or raise."""
    found = numbers(name, value)
    if found.ndim in (2, 3):
        found = found[(None,) * (4 - found.ndim)]
    good = found.ndim == 4 and found.shape[2:] == shape and found.shape[0] in (1, series)
    if not good or found.shape[1] not in (1, steps):
        raise ValueError(
            f"{name}: expected shape {shape}, ({steps}, ..) with one a step, or ({series}, {steps} or 1, ..) with each "
            f"series' own, got {np.shape(value)}"
        )
    if not np.isfinite(found).all():
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
    return np.ascontiguousarray(found)


def _every(keep: Any, steps: int) -> int:
    """Return the distance of kept steps."""
    if isinstance(keep, str):
        _checks.option("keep", keep, ("all", "last"))
        return 1 if keep == "all" else max(steps, 1)
    return _checks.count("keep", keep, 1)


def began(policy: Any, given: SeriesArguments, learnt: ArrayLike | None) -> dict[str, Array]:
    """Return where series stand that begin, or raise."""
    (series, n), m = given.x.shape, given.z.shape[2]
    stands, is_mixture = {"x": given.x, "P": given.P}, policy.noise is not None
    if learnt is not None and not (is_mixture and policy.learns):
        raise ValueError("learnt: expected none without noise=Learnt(..), got some")
    if policy.learns and not is_mixture:
        stands["spread"] = np.tile(policy.begin(m), (series, 1, 1))
    if is_mixture and policy.scales.count > 1:
        patterns, which = np.unique(given.P != 0.0, axis=0, return_inverse=True)
        beliefs = [copies.start(np.zeros(n), pattern, policy.scales).belief for pattern in patterns]
        stands |= {
            "means": np.repeat(given.x[:, None], policy.scales.count, axis=1),
            "covariances": np.repeat(given.P[:, None], policy.scales.count, axis=1),
            "belief": np.array(beliefs)[which.ravel()],
        }
    if policy.learns and is_mixture:
        stands["learnt"] = _learnt(policy.classes, learnt, series, m)
    return stands


def continued(policy: Any, given: SeriesArguments, state: Mapping[str, Any]) -> dict[str, Array]:
    """Return a copy of where an earlier part of the same series has ended, or raise."""
    stands = began(policy, given, None)
    if set(state) != set(stands):
        raise ValueError(
            f"state: expected {', '.join(stands)} in it, got {', '.join(state)}; it goes on with the same noise=, "
            "process= and scaling="
        )
    for name in [name for name in stands if name not in ("x", "P")]:
        value = np.array(numbers(f"state[{name!r}]", state[name]), order="C")
        value = widened(name, value, stands[name].shape[-1])
        if value.shape != stands[name].shape:
            raise ValueError(
                f"state[{name!r}]: expected shape {stands[name].shape}, got {value.shape}; it goes on with the same "
                "series, noise= and process="
            )
        stands[name] = value
    if "belief" in stands:
        copies.require_belief("state['belief']", stands["belief"])
    if "learnt" in stands:
        stands["learnt"] = _learnt(policy.classes, stands["learnt"], len(given.x), given.z.shape[2])
    if not np.isfinite(stands.get("spread", 0.0)).all():
        raise ValueError("state['spread']: expected finite numbers, got NaN or infinity")
    return stands


def _learnt(classes: NoiseClasses, learnt: ArrayLike | None, series: int, m: int) -> Array:
    """Return what is known of each series' noise before its first step, or raise."""
    if learnt is None:
        return np.tile(classes.start(m), (series, 1, 1))
    values = numbers("learnt", learnt)
    if values.ndim != 3:
        return np.tile(classes.checked(values, m), (series, 1, 1))
    if len(values) != series:
        raise ValueError(f"learnt: expected an entry for each of the {series} series, got {len(values)}")
    return np.array([classes.checked(one, m) for one in values]).reshape(values.shape)
