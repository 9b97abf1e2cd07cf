"""Series and recordings by the kernel: the options of a filter as numbers, and one call for many steps."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import kernel
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import GROUPINGS, Choices
from robust_filterpy.influence.functions import Linear

__all__ = ["JOINT_MOST", "filter_series", "options", "plain", "rule", "run", "serves"]

#: Which half of a step is taken.
PREDICTION, CORRECTION, BOTH = 1, 2, 3


class Model(NamedTuple):
    """Matrices with the axes (series, step) in front, of length 1 where one serves all."""

    F: Array
    Q: Array
    H: Array
    R: Array
    Bu: Array
    """(series, step, n)"""


class Output(NamedTuple):
    """What a run writes into: arrays over (series, kept step, ..), of length 0 where nothing is wanted."""

    means: Array
    covariances: Array
    """(.., n, n), or (.., 1, n) for the diagonals."""
    means_p: Array
    """Predicted, as covariances_p."""
    covariances_p: Array
    weights: Array
    log_likelihood: Array
    """(series,)"""


class State(NamedTuple):
    """Where one recording stands; arrays that a run changes in place. Under psi x, P and learned alone move."""

    means: Array
    """(q, n)"""
    covariances: Array
    """(q, n, n)"""
    belief: Array
    """(q + 2, n)"""
    learnt: Array
    """(m, ..)"""
    x: Array
    """Mean of all, (n,)."""
    P: Array
    """Its covariance, (n, n)."""


class Rows(NamedTuple):
    """What a run writes into, a row for each kept step; None where nothing is wanted."""

    means: Array | None = None
    covariances: Array | None = None
    """(rows, n n) or, for the diagonals, (rows, n); as covariances_p."""
    means_p: Array | None = None
    covariances_p: Array | None = None
    weights: Array | None = None
    outlying: Array | None = None
    """(rows, m), as weights."""
    scale: Array | None = None
    """(rows, n)"""
    log_likelihood: Array | None = None
    """(1,), added to."""


# As psi.h and correction.h number them, too.
_KINDS = ("linear", "huber", "hampel", "tukey", "student_t")
#: As correction.h numbers them.
SCALINGS = ("learnt", "innovation", "unit", "bounded")
_INFORMATIONS = ("realized", "expected", "weight")
#: As correction.h has it.
JOINT_MOST = 16


def rule(choices: Choices) -> Array | None:
    """Return the options as numbers: psi, scaling, information, E[psi'], normalizer, patience, and those of groups."""
    numbers, called = options(choices)
    return numbers if called is None else None


def options(choices: Choices) -> tuple[Array | None, Choices | None]:
    """Return the options as numbers, None if the kernel does not know them, and whom to ask for psi if it has none."""
    if "rule" not in choices.derived:
        choices.derived["rule"] = _encoded(choices), None if choices.kernel_psi is not None else choices
    return choices.derived["rule"]  # type: ignore[no-any-return]


def _encoded(choices: Choices) -> Array | None:
    """Return the options as numbers, if the kernel knows them."""
    if choices.grouping not in GROUPINGS or choices.scaling not in SCALINGS:
        return None
    joint = choices.grouping == "joint"
    by_number = choices.kernel_psi is not None and choices.information != "expected"
    if joint and not (by_number and choices.scaling in ("learnt", "innovation")):
        return None
    kind, numbers = choices.kernel_psi or ("linear", {})
    a, b, c = [*numbers.values(), 0.0, 0.0, 0.0][:3]
    # Without thresholds there is nothing to learn.
    scaling = "innovation" if choices.is_linear and choices.scaling == "learnt" else choices.scaling
    codes = _KINDS.index(kind), a, b, c, SCALINGS.index(scaling)
    information = _INFORMATIONS.index(choices.information)
    expected = choices.expected if choices.information == "expected" else 1.0
    of = getattr(choices.influence, "log_normalizer", Linear().log_normalizer)
    normalizers = [of(k) for k in range(1, JOINT_MOST + 1 if joint else 2)]
    numbers_of_all = *codes, information, expected, normalizers[0], choices.patience or 0
    return np.array([*numbers_of_all, *(normalizers if joint else ())], dtype=float)


def serves(choices: Choices) -> bool:
    """Return whether the kernel is there and knows these options."""
    return kernel.available() and rule(choices) is not None


def filter_series(
    choices: Choices,
    zs: Array,
    model: Model,
    x: Array,
    P: Array,
    output: Output,
    *,
    memory: Array | None = None,
    alpha_sq: float = 1.0,
    every: int = 1,
    start: int = 0,
    span: tuple[int, int] | None = None,
) -> np.ndarray:
    """Advance series in place by psi and return the first step of each that was not taken."""
    rows = zs.shape[1] // every
    into = [a.reshape(len(zs), rows, -1) if a.shape[1] else None for a in output[:5]]
    return _taken(
        rule(choices), zs, zs, (*model, None), (x, P, memory, None, None, None), (*into, None, None),
        output.log_likelihood, (start, zs.shape[1]), span or (0, len(zs)), alpha_sq, False, every, BOTH,
    )  # fmt: skip


def run(
    rule: Array | None, state: State, zs: Array, model: tuple[Any, ...], rows: Rows,
    *, first: int = 0, last: int | None = None, every: int = 1, alpha_sq: float = 1.0, update_first: bool = False,
    which: int = BOTH, readings: Array | None = None, M: Array | None = None,
) -> int:  # fmt: skip
    """Take the steps of one recording as far as the kernel can, in place, and return the first that was not taken.

    rule: of psi, or of `robust_filterpy.kernel.learnt`; M has no axis of steps.
    """
    if rule is None or not kernel.available():
        return first
    given = (None if a is None else plain(a)[None] for a in (*model, None if M is None else M[None]))
    moving = (state.x, state.P, state.learnt, *state[:3])
    done = _taken(
        rule, zs[None], (zs if readings is None else readings)[None], tuple(given), tuple(a[None] for a in moving),
        tuple(None if a is None else a[None] for a in rows[:-1]),
        np.zeros(1) if rows.log_likelihood is None else rows.log_likelihood,
        (first, len(zs) if last is None else last), (0, 1), alpha_sq, update_first, every, which,
    )  # fmt: skip
    return int(done[0])


def _taken(
    rule: Array | None, zs: Array, readings: Array, model: Any, moving: Any, into: Any, log_likelihood: Array,
    steps: tuple[int, int], span: tuple[int, int], alpha_sq: float, update_first: bool, every: int, which: int,
) -> np.ndarray:  # fmt: skip
    """Call the kernel, and return the first step of each series that was not taken."""
    done = np.full(len(zs), steps[0], dtype=np.intp)
    width = next((a.shape[2] for a in (into[1], into[3]) if a is not None), 0)
    kernel.extension().filter_series(
        rule, plain(zs), plain(readings), tuple(None if a is None else plain(a) for a in model), moving,
        tuple(None if a is not None and a.shape[2] == 0 else a for a in into), log_likelihood, done,
        (*steps, *span, float(alpha_sq), bool(update_first), every, which, width),
    )  # fmt: skip
    return done


def plain(array: Array) -> Array:
    """Return an array as the kernel takes it."""
    return np.ascontiguousarray(array, dtype=np.float64)
