"""When the kernel serves, and when the definition does.

The kernel serves where numba can be used and either has the kernel in its cache, or the definition would take longer
than compiling it. ``python -m robust_filterpy compile`` fills the cache; until then only long recordings wait for a
compilation, and say so. What serves depends on the machine and the length of the call, never on what ran before in the
process; kernel and definition agree to rounding. With ROBUST_FILTERPY_KERNEL=off in the environment the definition
serves always.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.compiled import stamp
from robust_filterpy.compiled.records import ADAPTIVE_SIZES, SIZES, Copies, Model, Noise, Output, Run
from robust_filterpy.correction.options import GROUPINGS, INFORMATIONS, SCALINGS, Choices
from robust_filterpy.influence.information import expected_joint_information

#: Seconds that compiling one kernel takes at most, and that a step by the definition takes at least.
COMPILATION, DEFINITION = 20.0, 2e-5

#: Seconds that a step that learns the noise takes at least, by the definition and by the kernel of single steps.
LEARNING, LEARNING_STEP = 3e-4, 2e-5

#: Names of kernels in the list of those that are cached.
ONLINE, BANK, TRACKING = "single steps", "steps of a bank", "tracking parameters"
ADAPTIVE = "steps that learn the noise"

_KINDS = ("linear", "huber", "hampel", "tukey", "student_t")
_OLDEST = (0, 59)


def can_compile(choices: Choices) -> bool:
    """Return whether the kernel knows the influence function."""
    known = choices.derived.get("known")
    if known is None:
        known = choices.pointwise is not None and choices.pointwise[0].__name__ in _KINDS
        choices.derived["known"] = known
    return bool(known)


@lru_cache(maxsize=1)
def _cached() -> frozenset[str]:
    """Return the kernels that were cached when this process first asked."""
    return stamp.cached()


@lru_cache(maxsize=1)
def loops() -> Any:
    """Return the module of compiled loops, None (after one warning that says why) if numba cannot be used."""
    version = stamp.numba_version()
    if version is None:
        return None
    try:
        if tuple(int(part) for part in version.split(".")[:2]) < _OLDEST:
            raise ImportError(f"numba {version} is too old, 0.59 or newer is needed")
        from robust_filterpy.compiled import loops

        return loops
    except Exception as error:
        warnings.warn(
            f"robust_filterpy runs without numba, which is installed but cannot be used here: {error}",
            RuntimeWarning,
            stacklevel=2,
        )
        return None


def ready(kernel: str, seconds: float) -> bool:
    """Return whether a kernel is to be used for a call that takes so many seconds by the definition."""
    return (kernel in _cached() or seconds > COMPILATION) and stamp.numba_version() is not None and loops() is not None


_met: set[str] = set()


@contextmanager
def announced(kernel: str) -> Iterator[None]:
    """Say once if a kernel is about to be compiled, and how to avoid the wait; list it when it has been."""
    new = kernel not in _cached() and kernel not in _met and kernel not in stamp.cached()
    if new:
        logging.getLogger("robust_filterpy").warning(
            "robust_filterpy: compiling the kernel for %s with numba, once, about %.0f s; "
            "`python -m robust_filterpy compile` does it beforehand",
            kernel,
            COMPILATION,
        )
    yield
    if new:
        stamp.remember(kernel)
    _met.add(kernel)


class Steps(NamedTuple):
    """The kernels of a prediction and of a correction."""

    predict: Callable[..., Any]
    correct: Callable[..., Any]


@lru_cache(maxsize=1)
def online() -> Steps | None:
    """Return the kernels of one step of one filter, None if they are not in the cache."""
    if ONLINE in _cached() and loops() is not None:
        return Steps(loops().predict_step, loops().correct_step)
    return None


@lru_cache(maxsize=1)
def adaptive() -> Any:
    """Return the module with the kernels of filters side by side and of learnt noise, None if it is not cached."""
    if ADAPTIVE not in _cached() or loops() is None:
        return None
    from robust_filterpy.compiled import adaptive

    return adaptive


def bank(choices: Choices) -> Steps | None:
    """Return the kernels of one step of many filters, None if they are not in the cache or do not know psi."""
    if BANK in _cached() and can_compile(choices) and loops() is not None:
        return Steps(loops().predict_bank, loops().correct_bank)
    return None


def series_size(n: int, m: int, steps: float, seconds: float = DEFINITION) -> tuple[int, int] | None:
    """Return which of the kernels for series serves n states and m sensors, None if none does.

    steps: of all series; seconds: that each takes otherwise.
    """
    # Those for fewer sizes are faster.
    candidates = [size for size in ((n, m), (0, m), (0, 0)) if size in SIZES]
    for size in candidates:
        if series_name(size) in _cached() and loops() is not None:
            return size
    return candidates[0] if ready(series_name(candidates[0]), steps * seconds) else None


def fixed_series_size(n: int, m: int) -> tuple[int, int] | None:
    """Return which of the kernels serves whatever is cached and however long a call is, None if none can."""
    size = next(size for size in ((n, m), (0, m), (0, 0)) if size in SIZES)
    return size if ready(series_name(size), math.inf) else None


def series_name(size: tuple[int, int]) -> str:
    """Return the name of a kernel for series."""
    n, m = (str(k) if k else "any" for k in size)
    return f"series of {n} states and {m} sensors"


def encoded(choices: Choices, m: int) -> Array:
    """Return the options for up to m sensors as numbers: see `loops.decoded`."""
    found = choices.derived.get(m)
    if found is None:
        found = choices.derived[m] = _encode(choices, m)
    return found  # type: ignore[no-any-return]


def _encode(choices: Choices, m: int) -> Array:
    """Return the options as numbers."""
    function, a, b, c = choices.pointwise  # type: ignore[misc]
    expected = np.full(m + 1, choices.expected)
    joint = choices.grouping == "joint" and m > 1
    if joint and choices.information == "expected":
        for dim in range(1, m + 1):
            expected[dim] = min(max(expected_joint_information(choices.influence, dim), 0.0), 1.0)
    normalizer = [0.0] + [choices.influence.log_normalizer(dim) for dim in range(1, m + 1)]
    codes = (
        SCALINGS.index(choices.scaling),
        INFORMATIONS.index(choices.information),
        # One sensor alone is bounded as a component, in the definition too.
        GROUPINGS.index(choices.grouping) if joint else 0,
    )
    return np.array([_KINDS.index(function.__name__), a, b, c, *codes, *expected, *normalizer], dtype=float)


def usable(array: Array) -> Array:
    """Return an array as the kernels take it: numba would compile anew for one that is read only or strided."""
    if array.flags.carray and array.dtype == np.float64:
        return array
    return np.require(array, dtype=np.float64, requirements=("C", "W"))


def filter_series(
    size: tuple[int, int],
    choices: Choices,
    zs: Array,
    model: Model,
    x: Array,
    P: Array,
    output: Output,
    *,
    alpha_sq: float = 1.0,
    update_first: bool = False,
    every: int = 1,
    likely: bool = True,
    start: int = 0,
    span: tuple[int, int] | None = None,
) -> np.ndarray:
    """Advance series in place and return how many steps of each were taken.

    Parameters
    ----------
    size : tuple of int
        Which kernel, from `series_size`.
    choices : Choices
        Influence function, scaling, information, grouping.
    zs : ndarray, shape (series, steps, m)
        Measurements, NaN where missing.
    model : Model
        F, Q, H, R, B u.
    x, P : ndarray, shape (series, n) and (series, n, n)
        States, advanced in place; C-contiguous.
    output : Output
        What is written.
    alpha_sq, update_first, every, likely, start, span
        Fading memory; whether a step begins with its correction; which steps are kept; whether the likelihood is
        wanted; the first step; the first series and the one after the last.

    Returns
    -------
    ndarray of int, shape (series,)
    """
    done = np.zeros(len(zs), dtype=np.int64)
    low, high = (0, len(zs)) if span is None else span
    with announced(series_name(size)):
        loops().filter_series[size](
            usable(zs), Model(*map(usable, model)), x, P.reshape(len(P), -1), encoded(choices, zs.shape[2]),
            Run(float(alpha_sq), bool(update_first), int(every), bool(likely), int(start)), int(low), int(high),
            _flat(output), done,
        )  # fmt: skip
    return done


def adaptive_size(n: int, m: int, steps: float) -> tuple[int, int] | None:
    """Return which of the kernels serves series of n states and m sensors whose noise is learnt, None if none does."""
    candidates = [size for size in ((n, m), (0, 0)) if size in ADAPTIVE_SIZES]
    for size in candidates:
        if adaptive_name(size) in _cached() and loops() is not None:
            return size
    seconds = steps * (LEARNING if adaptive() is None else LEARNING_STEP)
    return candidates[0] if ready(adaptive_name(candidates[0]), seconds) else None


def adaptive_name(size: tuple[int, int]) -> str:
    """Return the name of a kernel for series whose noise is learnt."""
    n, m = (str(k) if k else "any" for k in size)
    return f"recordings of {n} states and {m} sensors that learn the noise"


def adaptive_series(
    size: tuple[int, int],
    zs: Array,
    model: Model,
    series: Copies,
    noise: Noise,
    output: Output,
    outlying: Array,
    scale: Array,
    *,
    alpha_sq: float = 1.0,
    update_first: bool = False,
    every: int = 1,
    start: int = 0,
    span: tuple[int, int] | None = None,
) -> np.ndarray:
    """Advance series whose noise is learnt in place and return how many steps of each were taken.

    Parameters
    ----------
    size : tuple of int
        Which kernel, from `adaptive_size`.
    zs, model, output, alpha_sq, update_first, every, start, span
        As in `filter_series`; covariances are kept where there is room for them.
    series : Copies
        Filters side by side, of each series; advanced in place, C-contiguous.
    noise : Noise
        What the filters are told of the noises.
    outlying, scale : ndarray, shape (series, kept step)
        Probability of an outlier and mean factor of Q are written here.

    Returns
    -------
    ndarray of int, shape (series,)
    """
    from robust_filterpy.compiled import adaptive

    done = np.zeros(len(zs), dtype=np.int64)
    low, high = (0, len(zs)) if span is None else span
    with announced(adaptive_name(size)):
        adaptive.filter_series[size](
            usable(zs), Model(*map(usable, model)), series, noise,
            Run(float(alpha_sq), bool(update_first), int(every), True, int(start)), int(low), int(high),
            _flat(output), outlying, scale, done,
        )  # fmt: skip
    return done


def _flat(output: Output) -> Output:
    """Return the same with flat covariances."""
    return Output(*(a.reshape(*a.shape[:2], a.shape[2] * a.shape[3]) if a.ndim == 4 else a for a in output))
