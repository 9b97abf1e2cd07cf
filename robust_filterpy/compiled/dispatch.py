"""When what numba compiles serves, and when the definition does: the smoothing pass, which is not in C yet.

The compiled form serves where numba can be used and either has it in its cache, or the definition would take longer
than compiling it. ``python -m robust_filterpy compile`` fills the cache; until then only long recordings wait for a
compilation, and say so. What serves depends on the machine and the length of the call, never on what ran before in the
process; kernel and definition agree to rounding. With ROBUST_FILTERPY_KERNEL=off in the environment the definition
serves always.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.compiled import stamp
from robust_filterpy.correction.options import GROUPINGS, INFORMATIONS, SCALINGS, Choices
from robust_filterpy.influence.information import expected_joint_information

#: Seconds that compiling one kernel takes at most.
COMPILATION = 20.0

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
def usable_numba() -> bool:
    """Return whether numba can be used; if it is installed and cannot, one warning says why."""
    version = stamp.numba_version()
    if version is None:
        return False
    try:
        if tuple(int(part) for part in version.split(".")[:2]) < _OLDEST:
            raise ImportError(f"numba {version} is too old, 0.59 or newer is needed")
        from numba import njit  # noqa: F401

        return True
    except Exception as error:
        warnings.warn(
            f"robust_filterpy runs without numba, which is installed but cannot be used here: {error}",
            RuntimeWarning,
            stacklevel=2,
        )
        return False


def ready(kernel: str, seconds: float) -> bool:
    """Return whether a kernel is to be used for a call that takes so many seconds by the definition."""
    return (kernel in _cached() or seconds > COMPILATION) and usable_numba()


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


def encoded(choices: Choices, m: int) -> Array:
    """Return the options for up to m sensors as numbers, as generated C takes them."""
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
