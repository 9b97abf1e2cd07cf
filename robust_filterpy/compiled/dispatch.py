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
from robust_filterpy.correction.options import GROUPINGS, INFORMATIONS, SCALINGS, Choices
from robust_filterpy.influence.information import expected_joint_information

#: Shorter recordings are filtered by the definition. Loading the loops from numba's cache takes .35 s, as long as
#: 8,000 steps by the definition with 20 states and 5 sensors, 20,000 with 2 and 1: a study of a few dozen recordings
#: of this length has paid for it, one recording alone loses a third of a second at most. The rule looks at nothing but
#: the recording, so that the numbers of a study do not depend on how its runs are spread over processes.
LONG = 1000

_KINDS = ("linear", "huber", "hampel", "tukey", "student_t")


@lru_cache(maxsize=1)
def available() -> bool:
    """Return whether numba is installed."""
    return find_spec("numba") is not None


def can_compile(choices: Choices) -> bool:
    """Return whether the loops know the influence function and numba is installed."""
    return choices.pointwise is not None and choices.pointwise[0].__name__ in _KINDS and available()


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
                    "robust_filterpy: compiling its loops for such calls with numba, about 20 s; kept for the next time"
                )

        def on_end(self, event: Any) -> None:
            """Say nothing."""

        said = False

    event.register("numba:compile", Announcement())


@lru_cache(maxsize=1)
def loops() -> Any:
    """Return the module of compiled loops."""
    announce_compilation()
    from robust_filterpy.compiled import filter_loop

    return filter_loop


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


def ready(array: Array) -> Array:
    """Return an array that the loops take as it is: numba compiles anew for one that is read only or strided."""
    return np.require(array, dtype=np.float64, requirements=("C", "W"))


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
        ready(zs), *map(ready, model), alpha_sq, x, P, rule, psi.parameters, psi.expected, psi.normalizer,
        start, low, high, *kept, done,
    )  # fmt: skip
    return done
