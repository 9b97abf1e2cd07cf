"""Many series at once, as a pure function of arrays: what runs on one machine's cores, or on a cluster's blocks."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._brief import brief
from robust_filterpy._checks import Array, numbers
from robust_filterpy.correction import side_by_side
from robust_filterpy.correction.learning import NoiseClasses
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.spread import FILLED
from robust_filterpy.filters.driver import run
from robust_filterpy.filters.notices import say_stuck_among
from robust_filterpy.filters.policies import Carried, Options, policy_of, with_options
from robust_filterpy.kernel import series as kernel
from robust_filterpy.kernel.series import Model, Rows

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["FilteredSeries", "began", "continued", "filter_series"]

_COVARIANCES = ("full", "diagonal", "none")
_REFUSED = ("raise", "nan")


class SeriesArguments(NamedTuple):
    """Arguments of a function of many series, checked, and room for its results."""

    #: (series, steps, m)
    z: Array
    #: F, Q, H, R, with the axes (series or 1, steps or 1) in front.
    model: tuple[Array, Array, Array, Array]
    #: Start of each series, (series, n); a copy, as P.
    x: Array
    #: (series, n, n)
    P: Array
    #: `Rows`
    rows: Any
    #: Distance of kept steps.
    every: int
    #: Whether a series that is refused becomes NaN.
    skips: bool

    def covariances(self, covariance: str) -> Array | None:
        """Return what was asked for of the covariances."""
        kept: Array | None = self.rows.covariances
        return kept if kept is None or covariance != "full" else kept.reshape(*self.rows.means.shape, self.P.shape[1])


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
    kept, width = steps // every, {"full": n * n, "diagonal": n, "none": 0}[covariance]
    covariances = np.empty((series, kept, width)) if width else None
    weights, likelihood = np.empty((series, kept, m)), np.zeros(series)
    rows = Rows(np.empty((series, kept, n)), covariances, weights=weights, log_likelihood=likelihood)
    return SeriesArguments(z, model, x, P, rows, every, skips)


def _in_parts(part: Callable[[int, int], None], series: int, n_threads: int | None) -> None:
    """Call part(low, high), which lets go of the interpreter, over all series on threads, as many as may be used."""
    if n_threads is None:
        most = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    else:
        most = _checks.count("n_threads", n_threads, 1)
    edges = np.linspace(0, series, 4 * most + 1 if 1 < most <= series else 2).astype(int)
    spans = list(itertools.pairwise(np.unique(edges).tolist()))
    if len(spans) < 2:
        for span in spans:
            part(*span)
        return
    with ThreadPoolExecutor(most) as pool:
        list(pool.map(lambda span: part(*span), spans))


def leading(name: str, value: Any, shape: tuple[int, int], series: int, steps: int) -> Array:
    """Return a matrix with the axes (series or 1, step or 1) in front, or raise."""
    matrices = numbers(name, value)
    if matrices.ndim in (2, 3):
        matrices = matrices[(None,) * (4 - matrices.ndim)]
    good = matrices.ndim == 4 and matrices.shape[2:] == shape and matrices.shape[0] in (1, series)
    if not good or matrices.shape[1] not in (1, steps):
        raise ValueError(
            f"{name}: expected shape {shape}, ({steps}, ..) with one a step, or ({series}, {steps} or 1, ..) with each "
            f"series' own, got {np.shape(value)}"
        )
    if not np.isfinite(matrices).all():
        raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
    return np.ascontiguousarray(matrices)


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
        beliefs = [side_by_side.start(np.zeros(n), pattern, policy.scales).packed[2] for pattern in patterns]
        rows = policy.scales.rows
        stands |= {
            "means": np.repeat(given.x[:, None], rows, axis=1),
            "covariances": np.repeat(given.P[:, None], rows, axis=1),
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
        if value.shape != stands[name].shape:
            raise ValueError(
                f"state[{name!r}]: expected shape {stands[name].shape}, got {value.shape}; it goes on with the same "
                "series, noise= and process="
            )
        stands[name] = value
    if "belief" in stands:
        side_by_side.require_belief("state['belief']", stands["belief"], policy.scales)
    if "learnt" in stands:
        stands["learnt"] = _learnt(policy.classes, stands["learnt"], len(given.x), given.z.shape[2])
    if not np.isfinite(stands.get("spread", 0.0)).all():
        raise ValueError("state['spread']: expected finite numbers, got NaN or infinity")
    return stands


def _learnt(classes: NoiseClasses, learnt: ArrayLike | None, series: int, m: int) -> Array:
    """Return the memory of each series' noise before its first step, or raise."""
    if learnt is None:
        return np.tile(classes.start(m), (series, 1, 1))
    values = numbers("learnt", learnt)
    if values.ndim != 3:
        return np.tile(classes.checked(values, m), (series, 1, 1))
    if len(values) != series:
        raise ValueError(f"learnt: expected an entry for each of the {series} series, got {len(values)}")
    return np.array([classes.checked(one, m) for one in values]).reshape(values.shape)


class FilteredSeries(NamedTuple):
    """What `filter_series` returns; K is the number of kept steps.

    Attributes
    ----------
    x : ndarray, shape (S, K, dim_x)
        Corrected states.
    P : ndarray, shape (S, K, dim_x, dim_x), (S, K, dim_x), or None
        Their covariances, the diagonals of these, or nothing, as asked for.
    log_likelihood : ndarray, shape (S,)
        Log-likelihood of each whole series.
    weights : ndarray, shape (S, K, dim_z)
        psi(e)/e; under ``noise=`` the expected precision over that of ordinary noise, in (0, 1]; NaN where a component
        was missing.
    outlier_probability : ndarray, shape (S, K), or None
        Under ``noise=``, the probability that a component of the measurement was an outlier.
    process_scale : ndarray, shape (S, K, n), or None
        Under ``noise=``, the mean factor of Q in the step before the measurement.
    state : dict of str to ndarray
        Where each series stands after its last step, what `RobustKalmanFilter.state` calls so with the series in front:
        x, P, the memory of its sensors (``spread`` or ``learnt``), and the models under ``process=``. x and P are
        NaN where a series was refused.
    """

    x: Array
    P: Array | None
    log_likelihood: Array
    weights: Array
    outlier_probability: Array | None
    process_scale: Array | None
    state: dict[str, Array]

    def __str__(self) -> str:
        """Return what fits a screen."""
        return brief(self)


@with_options
def filter_series(
    zs: ArrayLike,
    F: ArrayLike,
    H: ArrayLike,
    Q: ArrayLike,
    R: ArrayLike,
    x0: ArrayLike | None = None,
    P0: ArrayLike | None = None,
    *,
    learnt: ArrayLike | None = None,
    state: Mapping[str, Any] | None = None,
    keep: str | int = "all",
    covariance: str = "full",
    refused: str = "raise",
    n_threads: int | None = None,
    **options: Unpack[Options],
) -> FilteredSeries:
    """Filter S series of N measurements each, every step a prediction and then a correction.

    Parameters
    ----------
    zs : array_like, shape (S, N, dim_z)
        Measurements; NaN marks a missing component.
    F, Q : array_like, shape (dim_x, dim_x), (N, dim_x, dim_x) or (S or 1, N or 1, dim_x, dim_x)
        Transition matrix and process noise covariance: shared, one a step, or each series' own.
    H : array_like, shape (dim_z, dim_x), or with the same axes in front
        Measurement matrix.
    R : array_like, shape (dim_z, dim_z), or with the same axes in front
        Measurement noise covariance.
    x0 : array_like, shape (dim_x,) or (S, dim_x)
        Mean before the first prediction.
    P0 : array_like, shape (dim_x, dim_x) or (S, dim_x, dim_x)
        Its covariance.
    influence, scaling, information, grouping, noise, process, patience
        As in `RobustKalmanFilter`; with ``noise=Learnt()`` what is learned is each series' own.
    learnt : array_like, shape (1 or dim_z, w), or (S, ..) for each series its own, optional
        What was learned of the noise before the first step: the ``learnt`` of a filter, or of a state, with the same
        ``noise=``.
    state : mapping of str to ndarray, optional
        Where an earlier part of the same series, with the same options, has ended, instead of x0, P0 and learned: many
        filters go on together, a sample at a time if need be, and the numbers are those of one call.
    keep : {"all", "last"} or int, default "all"
        Which steps to return: all, the last, or every keep-th (steps keep - 1, 2 keep - 1, ..), so that memory is
        bounded.
    covariance : {"full", "diagonal", "none"}
        What to return of the covariances.
    refused : {"raise", "nan"}
        What becomes of a series with a correction that is impossible, a state or covariance that overflows, or NaN
        in its x0 or P0: an error for all, or NaN from that step on.
    n_threads : int, optional
        Threads of the kernel; by default as many as the process may use.

    Returns
    -------
    FilteredSeries
        x, P, log_likelihood, weights, outlier_probability, process_scale, state.

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, a number is infinite, or an option unknown.
    LinAlgError
        If a correction is impossible and refused is "raise"; the message names series and step.

    Notes
    -----
    Same numbers, to rounding, as a loop over `RobustKalmanFilter`; by the kernel, where that is there, many times
    faster. A function of arrays alone, so an engine for data that do not fit one machine can call it block by block
    over the series: with Dask
    ``dask.array.map_blocks(lambda z: filter_series(z, F, H, Q, R, x0, P0).x, zs, dtype=float, chunks=..)``. A series
    that is refused keeps what it had learned.

    Examples
    --------
    >>> zs = np.array([[[1.0], [2.0], [3e6]], [[0.0], [np.nan], [0.5]]])
    >>> F = np.array([[1.0, 1.0], [0.0, 1.0]])
    >>> result = filter_series(zs, F, [[1.0, 0.0]], 0.01 * np.eye(2), np.eye(1), np.zeros(2), np.eye(2))
    >>> result.x.shape, result.weights[1, :, 0]
    ((2, 3, 2), array([ 1., nan,  1.]))

    Where R is a guess, it is learned, for each series; and later samples go on from there:

    >>> rng, scales = np.random.default_rng(0), np.array([1.0, 5.0])
    >>> zs = (scales * np.where(rng.random((400, 2)) < 0.1, 10.0, 1.0) * rng.normal(size=(400, 2))).T[:, :, None]
    >>> model = [[1.0]], [[1.0]], [[1e-4]], [[1.0]]
    >>> result = filter_series(zs, *model, [0.0], [[1.0]], noise="learnt")
    >>> bool(np.abs(np.log(result.state["learnt"][:, 0, 0] ** 0.5 / scales)).max() < 0.4)
    True
    >>> more = rng.normal(size=(2, 1, 1))
    >>> filter_series(more, *model, noise="learnt", state=result.state).x.shape
    (2, 1, 1)
    """
    if state is not None:
        if not (x0 is None and P0 is None and learnt is None):
            raise ValueError("state: expected none of x0, P0, `learnt` with it; it holds them")
        if not (isinstance(state, Mapping) and {"x", "P"} <= set(state)):
            raise TypeError(f"state: expected what filter_series returned as state, got {type(state).__name__}")
        x0, P0 = state["x"], state["P"]
    given = series_arguments(zs, F, H, Q, R, x0, P0, keep, covariance, refused)
    steps, rows = given.z.shape[1], given.rows
    policy = policy_of(**options)
    is_mixture = policy.noise is not None
    stands = began(policy, given, learnt) if state is None else continued(policy, given, state)
    before = None if is_mixture or "spread" not in stands else stands["spread"][:, :, FILLED].copy()
    if is_mixture:
        rows = rows._replace(outlying=np.empty(rows.weights.shape), scale=np.empty(rows.means.shape))

    def part(low: int, high: int) -> None:
        """Advance some series: all together by psi and the kernel, then each from where that declined."""
        done = np.zeros(high - low, dtype=int) if is_mixture else _together(policy.choices, given, stands, low, high)
        for s in (low + np.flatnonzero(done < steps)).tolist():
            _alone(policy, given, rows, stands, s, int(done[s - low]))

    _in_parts(part, len(given.z), n_threads)
    if is_mixture or before is not None:
        stuck = (rows.weights == 0.0).any(axis=1) if before is None else stands["spread"][:, :, FILLED] > before
        say_stuck_among("filter_series", "series", stuck)
    probability = None if rows.outlying is None else policy.any_outlier(rows.outlying)  # type: ignore[union-attr]
    return FilteredSeries(
        rows.means, given.covariances(covariance), rows.log_likelihood, rows.weights, probability, rows.scale, stands
    )  # fmt: skip


def _together(choices: Choices, given: SeriesArguments, stands: dict[str, Array], low: int, high: int) -> np.ndarray:
    """Run the kernel, which lets go of the interpreter, over some series; return how many steps of each were taken."""
    if not kernel.serves(choices) or not given.z.size:
        return np.zeros(high - low, dtype=int)
    return kernel.filter_series(
        choices, given.z, Model(*given.model, np.zeros((1, 1, given.x.shape[1]))), stands["x"], stands["P"],
        given.rows, memory=stands.get("spread"), every=given.every, span=(low, high),
    )[low:high]  # fmt: skip


def _alone(policy: Any, given: SeriesArguments, rows: Any, stands: dict[str, Array], s: int, first: int) -> None:
    """Take the steps of one series from one on."""
    every, at = given.every, {name: array[s] for name, array in stands.items()}
    one = (None if column is None else column[s] for column in rows[:-1])
    into = Rows._make((*one, rows.log_likelihood[s : s + 1]))
    apart = Carried(at["means"], at["covariances"], at["belief"], at["x"], at["P"]) if "means" in at else None
    memory = at.get("learnt", at.get("spread", policy.begin(given.z.shape[2])))
    state = policy.standing(apart, at["x"], at["P"], memory)
    lost: tuple[str, ...] = ()
    try:
        model = (*(array[s % len(array)] for array in given.model), None)
        run(policy, state, given.z[s], model, into, of="filter_series", first=first, every=every)
    except (ValueError, np.linalg.LinAlgError) as error:
        if not given.skips:
            error.args = (f"series {s}, {error}", *error.args[1:])
            raise
        for column in into[:-1]:
            if column is not None:
                column[error.step // every :] = np.nan  # type: ignore[attr-defined]
        # What was learned of its noise stays.
        rows.log_likelihood[s], lost = np.nan, ("means", "covariances", "x", "P")
    for name, value in zip(("means", "covariances", "belief", "spread", "x", "P"), state, strict=True):
        name = "learnt" if name == "spread" and "learnt" in at else name
        if name in at:
            stands[name][s] = np.nan if name in lost else value
