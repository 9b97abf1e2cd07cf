"""The way to the compiled loops: whether they can be used, loading them, and saying so when they are compiled.

numba is optional, and importing it takes longer than filtering a short recording, so nothing of it is imported here.
"""

from __future__ import annotations

import logging
from functools import lru_cache
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._expectation import expected_joint_information
from robust_filterpy.choices import GROUPINGS, INFORMATIONS, SCALINGS, Choices

#: Steps by the definition that take as long as loading the loops from numba's cache: 0.35 s, which with 18 to 45 us a
#: step is 8,000 (20 states, 5 sensors) to 20,000 of them (2 states, 1 sensor).
LONG = 10_000
#: Steps from which on loops that are loaded are the faster: getting the arrays ready takes as long as 5 to 7 steps.
SHORT = 10

_KINDS = ("linear", "huber", "hampel", "tukey", "student_t")


@lru_cache(maxsize=1)
def available() -> bool:
    """Return whether numba is installed."""
    return find_spec("numba") is not None


def can_compile(choices: Choices) -> bool:
    """Return whether the loops know the influence function and numba is installed."""
    return choices.pointwise is not None and choices.pointwise[0].__name__ in _KINDS and available()


class _Waiting:
    """How many steps this process has left to the definition since the loops could have been loaded."""

    steps = 0.0


def worthwhile(steps: float) -> bool:
    """Return whether so many steps should go through the loops, and remember those that should not.

    Loops that are loaded serve from `SHORT` steps on. They are loaded once this recording and those before it have
    `LONG` steps together: then loading takes no longer than what has been spent already, whatever is still to come.
    The two ways agree to rounding, not to the last bit.
    """
    if loops.cache_info().currsize:
        return steps >= SHORT
    _Waiting.steps += steps
    return _Waiting.steps >= LONG


@lru_cache(maxsize=1)
def announce_compilation() -> None:
    """Have one line logged when numba starts to compile rather than to load from its cache."""
    from numba.core import event

    class Announcement(event.Listener):
        """Speak once."""

        def on_start(self, event: Any) -> None:
            """Say what the wait is for."""
            if not self.said and "robust_filterpy" in str(getattr(event.data["dispatcher"], "py_func", "").__module__):
                self.said = True
                logging.getLogger("robust_filterpy").warning(
                    "robust_filterpy: compiling its loops with numba, once per machine, about half a minute"
                )

        def on_end(self, event: Any) -> None:
            """Say nothing."""

        said = False

    event.register("numba:compile", Announcement())


@lru_cache(maxsize=1)
def loops() -> Any:
    """Return the module of compiled loops."""
    announce_compilation()
    from robust_filterpy import _compiled_loops

    return _compiled_loops


class Psi(NamedTuple):
    """The choices of a filter as numbers: kind, scaling, information, grouping; and tables by number of sensors."""

    codes: tuple[int, int, int, int]
    parameters: tuple[float, float, float]
    expected: Array
    normalizer: Array


@lru_cache(maxsize=64)
def encoded(choices: Choices, m: int) -> Psi:
    """Return the choices for up to m sensors as numbers."""
    function, a, b, c = choices.pointwise  # type: ignore[misc]
    codes = (
        _KINDS.index(function.__name__),
        SCALINGS.index(choices.scaling),
        INFORMATIONS.index(choices.information),
        GROUPINGS.index(choices.grouping) if m > 1 else 0,
    )
    expected = np.full(m + 1, choices.expected)
    if m > 1 and choices.grouping == "joint" and choices.information == "expected":
        for dim in range(1, m + 1):
            expected[dim] = min(max(expected_joint_information(choices.influence, dim), 0.0), 1.0)
        # A component that the state has no part in is bounded by itself, and the first place is for those.
        expected[0] = choices.expected
    # One sensor alone is bounded as a component, in the filter too.
    normalizer = np.array([0.0] + [choices.influence.log_normalizer(dim) for dim in range(1, m + 1)])
    return Psi(codes, (float(a), float(b), float(c)), expected, normalizer)


class Kept(NamedTuple):
    """What a run writes into: arrays over (series, kept step, ...), of length 0 where nothing is wanted."""

    means: Array
    covariances: Array
    means_p: Array
    covariances_p: Array
    weights: Array
    log_likelihood: Array


def recurse(
    choices: Choices,
    zs: Array,
    model: tuple[Array, Array, Array, Array, Array],
    x: Array,
    P: Array,
    kept: Kept,
    *,
    alpha_sq: float = 1.0,
    update_first: bool = False,
    every: int = 1,
    likely: bool = True,
    start: int = 0,
    span: tuple[int, int] | None = None,
) -> np.ndarray:
    """Advance series in place and return how many steps of each were taken; model: F, Q, H, R, B u.

    Every array has the axes (series, step) in front, of length 1 where one serves all; x and P have (series,).
    """
    psi = encoded(choices, zs.shape[2])
    rule = np.array([*psi.codes, int(update_first), every, int(likely)])
    done = np.zeros(len(zs), dtype=np.int64)
    low, high = (0, len(zs)) if span is None else span
    loops().recurse(
        zs, *model, alpha_sq, x, P, rule, psi.parameters, psi.expected, psi.normalizer,
        start, low, high, *kept, done,
    )  # fmt: skip
    return done
