"""Series and recordings by the kernel: the options of a filter as numbers, one call for many steps or half a step."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import kernel
from robust_filterpy._checks import Array
from robust_filterpy.correction import learning, learnt, side_by_side
from robust_filterpy.correction.learning import NoiseClasses
from robust_filterpy.correction.learnt import Corrected
from robust_filterpy.correction.options import GROUPINGS, Choices, leads
from robust_filterpy.correction.side_by_side import Models, Scales
from robust_filterpy.influence.functions import Linear

__all__ = [
    "JOINT_MOST", "Head", "begin_models", "correct_models", "filter_series", "mixture_rule", "options", "plain",
    "predict_models", "rule", "run", "serves",
]  # fmt: skip

#: Which half of a step is taken.
PREDICTION, CORRECTION, BOTH = 1, 2, 3


class Model(NamedTuple):
    """Matrices with the axes (series, step) in front, of length 1 where one serves all."""

    F: Array
    Q: Array
    H: Array
    R: Array
    #: (series, step, n)
    Bu: Array


class State(NamedTuple):
    """Where one recording stands; arrays that a run changes in place. Under psi x, P and learned alone move."""

    #: (q, n)
    means: Array
    #: (q, n, n)
    covariances: Array
    #: (q + 2, n)
    belief: Array
    #: (m, ..)
    learnt: Array
    #: Mean of all, (n,).
    x: Array
    #: Its covariance, (n, n).
    P: Array


class Rows(NamedTuple):
    """What a run writes into, a row for each kept step, of many series with these in front; None: not wanted."""

    means: Array | None = None
    #: (rows, n n) or, for the diagonals, (rows, n); as covariances_p.
    covariances: Array | None = None
    #: Predicted, as covariances_p.
    means_p: Array | None = None
    covariances_p: Array | None = None
    weights: Array | None = None
    #: (rows, m), as weights.
    outlying: Array | None = None
    #: (rows, n)
    scale: Array | None = None
    #: (1,) or (series,), added to.
    log_likelihood: Array | None = None


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
    rows: Rows,
    *,
    memory: Array | None = None,
    alpha_sq: float = 1.0,
    every: int = 1,
    start: int = 0,
    span: tuple[int, int] | None = None,
) -> np.ndarray:
    """Advance series in place by psi and return the first step of each that was not taken."""
    return _taken(
        rule(choices), zs, zs, (*model, None), (x, P, memory), rows, (start, zs.shape[1]), span or (0, len(zs)),
        alpha_sq, False, every, BOTH,
    )  # fmt: skip


def run(
    rule: Array | None, state: State, zs: Array, model: tuple[Any, ...], rows: Rows,
    *, first: int = 0, last: int | None = None, every: int = 1, alpha_sq: float = 1.0, update_first: bool = False,
    which: int = BOTH, readings: Array | None = None, M: Array | None = None,
) -> int:  # fmt: skip
    """Take the steps of one recording as far as the kernel can, in place, and return the first that was not taken.

    rule: of psi, or of a mixture; M has no axis of steps.
    """
    if rule is None or not kernel.available():
        return first
    given = [None if a is None else a[None] for a in (*model, None if M is None else M[None])]
    moving = tuple([a[None] for a in (state.x, state.P, state.learnt, *state[:3])])
    likelihood = np.zeros(1) if rows.log_likelihood is None else rows.log_likelihood
    done = _taken(
        rule, zs[None], (zs if readings is None else readings)[None], given, moving,
        Rows._make([*[None if a is None else a[None] for a in rows[:-1]], likelihood]),
        (first, len(zs) if last is None else last), (0, 1), alpha_sq, update_first, every, which,
    )  # fmt: skip
    return int(done[0])


def _taken(
    rule: Array | None, zs: Array, readings: Array, model: Any, moving: Any, rows: Rows,
    steps: tuple[int, int], span: tuple[int, int], alpha_sq: float, update_first: bool, every: int, which: int,
) -> np.ndarray:  # fmt: skip
    """Call the kernel, and return the first step of each series that was not taken."""
    done = np.full(len(zs), steps[0], dtype=np.intp)
    kernel.extension().filter_series(
        rule, tuple([None if a is None else plain(a) for a in (zs, readings, *model)]), moving, (*rows, done),
        (*steps, *span, float(alpha_sq), bool(update_first), every, which),
    )  # fmt: skip
    return done


def plain(array: Array) -> Array:
    """Return an array as the kernel takes it."""
    contiguous = np.ascontiguousarray(array, dtype=np.float64)
    # A field of a packed record may begin anywhere.
    return contiguous if contiguous.flags.aligned else contiguous.copy()


# Learned noise: its rule, and half a step of a filter's models, by the definition where the kernel declines.


class Head(NamedTuple):
    """How the numbers of a rule begin, in the order of `rule_head` in glue.c."""

    #: Scales of Q; they follow, and the scales of R.
    models: float
    classes: float
    stay: float
    jump: float
    memory: float
    r_memory: float
    learns: float
    #: Whether the scale of Q is drawn anew in each step.
    draws: float
    #: So many sensors fail with the first one of their group; -1: all with each other.
    grouped: float


@lru_cache(maxsize=64)
def mixture_rule(noise: NoiseClasses, process: Scales) -> Array:
    """Return what the kernel takes: sizes and options, scales of Q, scales of R, the memory at first, and who fails
    with whom.
    """
    drawn = () if process.probabilities is None else process.probabilities
    named = 0 if isinstance(noise.grouping, str) else 1 + max(i for group in noise.grouping for i in group)
    head = Head(
        len(process.scales), len(noise.scales), process.stay, process.jump, noise.memory, noise.r_memory, noise.learns,
        len(drawn) > 0, -1 if noise.grouping == "joint" else named,
    )  # fmt: skip
    start = learning.start(len(noise.scales), noise.probabilities)
    return np.array([*head, *process.scales, *noise.scales, *start, *drawn, *leads(noise.grouping, named)])


def begin_models(models: Models, memory: Array) -> State:
    """Return copies of the arrays as a state, with room for the mean and the covariance of all."""
    n = models.x.shape[1]
    x, P, belief = models.packed
    return State(x.copy(), P.copy(), belief.copy(), memory.copy(), np.zeros(n), np.zeros((n, n)))


def predict_models(
    models: Models, F: Array, Q: Array, process: Scales, Bu: Array | None = None, alpha_sq: float = 1.0
) -> tuple[Models, Array, Array]:
    """Predict models of a filter: `robust_filterpy.correction.side_by_side.predict`."""
    n = len(F)
    state = begin_models(models, _SENSOR)
    model = (F[None], Q[None], np.zeros((1, 1, n)), np.ones((1, 1, 1)), None if Bu is None else Bu[None])
    rule, none = mixture_rule(_NOISE, process), np.full((1, 1), np.nan)
    if run(rule, state, none, model, Rows(), alpha_sq=alpha_sq, which=PREDICTION):
        return Models.unpacked(*state[:3]), state.x, state.P
    moved = side_by_side.predict(models, F, Q, process, Bu, alpha_sq)
    return moved, *side_by_side.merged(moved, process)


def correct_models(
    models: Models,
    memory: Array,
    z: Array,
    H: Array,
    R: Array,
    noise: NoiseClasses,
    process: Scales,
    M: Array | None = None,
    readings: Array | None = None,
) -> tuple[Corrected, Array, Array]:
    """Correct models of a filter by one measurement: `robust_filterpy.correction.learnt.correct`."""
    (m, n), state = H.shape, begin_models(models, memory)
    weights, outlying, likelihood = np.full((1, m), np.nan), np.zeros((1, m)), np.zeros(1)
    model = (_nothing(n), _nothing(n), H[None], R[None], None)
    into = Rows(weights=weights, outlying=outlying, log_likelihood=likelihood)
    said = None if readings is None else readings[None]
    if run(mixture_rule(noise, process), state, z[None], model, into, which=CORRECTION, readings=said, M=M):
        after = Models.unpacked(*state[:3])
        corrected = Corrected(after, state.learnt, float(likelihood[0]), weights[0], outlying[0])
        return corrected, state.x, state.P
    corrected = learnt.correct(models, memory, z, H, R, noise, process, M, readings)
    return corrected, *side_by_side.merged(corrected.models, process)


#: A prediction tells nothing of noise.
_NOISE = NoiseClasses((1.0,))
_SENSOR = _NOISE.start(1)


@lru_cache(maxsize=64)
def _nothing(n: int) -> Array:
    """Return F and Q of a half step that has none."""
    return np.zeros((1, n, n))
