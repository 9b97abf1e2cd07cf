"""What judges a filter's measurements: one of two policies, and which of them was asked for.

`Bounded` lets psi bound what an innovation does; `Mixture` weighs what noise may have been, given or learned: models of
the state, each corrected under every class of noise and weighed; who assigns x or P from outside has assigned it to
every model. A policy never changes. What it knows is the filter's, arrays and tuples that are never written to: a
memory, one row for each sensor, and what else it keeps (models of the state). It is handed to every call, and what
comes back takes its place when the whole call has gone well: so a refused call changes nothing, and a filter is copied,
stored and put back without asking the policy. A correction is a `Correction`, or has its x, P, memory, weights and
log_density and makes one by ``as_arrays``; that of `corrected` is by a linear sensor, z of shape (m,) with NaN where
missing. Which steps are the kernel's is a policy's affair; each that the kernel declines it takes by the definition.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, TypeAlias, TypedDict, TypeVar

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction import side_by_side, spread
from robust_filterpy.correction.definition import (
    Innovation,
    correct,
    correct_by_typical,
    innovation_moments,
    nothing_observed,
)
from robust_filterpy.correction.learning import R_FACTOR, NoiseClasses, describe, usual
from robust_filterpy.correction.mixed import Mixed, any_outlier, lags, ordinary_noise
from robust_filterpy.correction.options import NO_PART, Choices, Grouping, Information, Scaling, leads
from robust_filterpy.correction.policies import (
    Contaminated,
    Learnt,
    noise_classes,
    noise_policy,
    process_policy,
    process_scales,
)
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.side_by_side import Models, Scales
from robust_filterpy.filters.notices import LOOKS
from robust_filterpy.influence.functions import Huber, Influence
from robust_filterpy.kernel import series
from robust_filterpy.kernel.series import Rows, State

__all__ = [
    "Bounded", "Mixture", "Options", "Policy", "finite_product", "policy_of", "regressed", "with_options",
]  # fmt: skip


class Prior(NamedTuple):
    """What a policy knows before a correction."""

    #: Of the sensors of this measurement, a row each (one for all that fail together).
    memory: Array
    #: What it keeps besides.
    carried: Any


class Carried(NamedTuple):
    """The models, and the x and P merged from them."""

    #: Shape (q, n).
    means: Array
    #: Shape (q, n, n).
    covariances: Array
    #: Which of them are likely, in which part of the state, shape (q + 2, n).
    belief: Array
    #: Shape (n,).
    x: Array
    #: Shape (n, n).
    P: Array

    @property
    def hypotheses(self) -> Models:
        """The models alone."""
        return Models.unpacked(*self[:3])

    def at(self, x: Array) -> Carried:
        """Return them with their mean at x, each as far from it as it is now."""
        return self._replace(means=self.means + (x - self.x), x=x)


@dataclass(frozen=True)
class Bounded:
    """Correct by psi."""

    choices: Choices
    noise: ClassVar[None] = None
    process: ClassVar[None] = None

    def __deepcopy__(self, memo: dict[int, Any]) -> Bounded:
        """Return self: nothing in here changes."""
        return self

    # Asked for at every step.
    @cached_property
    def rule(self) -> tuple[Array | None, Choices | None]:
        """The options as the kernel takes them, and whom it asks where psi is somebody else's."""
        return series.options(self.choices)

    @cached_property
    def looks(self) -> dict[int, int]:
        """Which corrections of a period are looked at: whether they clip; under "learnt" psi expects no share."""
        return LOOKS[True] if self.choices.scaling == "innovation" else {}

    @cached_property
    def calls(self) -> bool:
        """Whether psi is somebody else's, which may do anything before it raises."""
        return self.choices.kernel_psi is None

    @property
    def learns(self) -> bool:
        """Whether thresholds are in units of the spread; the Kalman filter has none."""
        return self.choices.by_typical

    def begin(self, sensors: int) -> Array:
        """Return the memory of sensors of which nothing was learned."""
        return spread.begin(sensors)

    def start(self, x: Array, P: Array, runs: bool = False) -> None:
        """Return nothing: the memory is all that is kept."""

    def predicted(
        self, carried: Any, x: Array, P: Array, F: Array, Q: Array, Bu: Array | None, alpha_sq: float
    ) -> tuple[Array, Array, Any]:
        """Return x = F x + B u, P = alpha^2 F P F' + Q."""
        x = F.dot(x)
        if Bu is not None:
            x = x + Bu
        P = F.dot(P).dot(F.T)
        if alpha_sq != 1.0:
            P *= alpha_sq
        P += Q
        return x, 0.5 * (P + P.T), carried

    def corrected(
        self, before: Any, x: Array, P: Array, z: Array, H: Array, R: Array, M: Array | None, skips: bool
    ) -> tuple[Correction, Any]:
        """Return the correction by a linear sensor."""
        y = z - finite_product(H, x)
        return self.corrected_by_moments(before, x, P, Innovation(z, y, *innovation_moments(P, H, R, M), R, H), skips)

    def corrected_by_moments(
        self, before: Any, x: Array, P: Array, innovation: Innovation, skips: bool
    ) -> tuple[Correction, Any]:
        """Return the correction."""
        if self.learns:
            return correct_by_typical(before.memory, x, P, innovation, self.choices, skips), before.carried
        return correct(x, P, *innovation[1:4], self.choices, skip_singular=skips), before.carried

    def current(self, carried: Any, x: Array, P: Array) -> Carried:
        """Return the one model that there is."""
        return alone(x, P)

    def standing(self, carried: Any, x: Array, P: Array, memory: Array) -> State:
        """Return where a recording begins, in arrays of its own."""
        none = np.empty((0, len(x)))
        return State(none, none[:, :, None], none, memory.copy(), x.copy(), P.copy())

    def carried_of(self, carried: Any, state: State) -> Any:
        """Return what is kept besides where a recording has come to."""
        return carried

    def advance(self, state: State, zs: Array, model: tuple[Any, ...], into: Rows, **how: Any) -> int:
        """Take the steps of a recording as far as the kernel can, and return the first that was not taken."""
        return series.run(series.rule(self.choices), state, zs, model, into, **how)

    def factors(self, memory: Array) -> Array:
        """Return the variance of a sensor's innovations over the nominal one, as learned."""
        return np.where((memory[:, spread.WEIGHT] > 0) & self.learns, memory[:, spread.SPREAD] ** 2, 1.0)

    def contamination(self, memory: Array) -> Array:
        """Return the share of far innovations of each sensor, NaN where none is learned."""
        return np.where((memory[:, spread.WEIGHT] > 0) & self.learns, memory[:, spread.SHARE], np.nan)

    def shares(self, memory: Array) -> tuple[Array, Array]:
        """Return the factors of ordinary noise's variance that outliers may have, and their shares."""
        share = np.clip(np.nan_to_num(self.contamination(memory)), 0.01, 0.4)[:, None]
        return np.array([1.0, 100.0]), np.concatenate([1.0 - share, share], axis=1)

    def slack(self, carried: Any) -> float:
        """Return the factor of Q that is thought likely."""
        return 1.0

    def process_scale(self, carried: Any, n: int) -> Array:
        """Return the mean factor of each state's Q."""
        return np.ones(n)

    def entries(self, carried: Any, x: Array, P: Array) -> dict[str, Array]:
        """Return nothing: the memory is all that is kept."""
        return {}

    def resumed(self, entries: dict[str, Array], x: Array, P: Array) -> None:
        """Return nothing: the memory is all that is kept."""


def alone(x: Array, P: Array) -> Carried:
    """Return the model of a filter that trusts its process; of a P that is not symmetric the part that is."""
    n, P = len(x), 0.5 * (P + P.T)
    return Carried(x[None], P[None], np.array([np.ones(n), np.zeros(n), np.zeros(n)]), x, P)


def regressed(P: Array, C: Array, S: Array) -> tuple[Array, Array]:
    """Return H of the line through a state with covariance P, from moments (n, m), (m, m), and what it leaves of S."""
    unit = np.sqrt(np.where(P.diagonal() > 0.0, P.diagonal(), 1.0))
    rounding = NO_PART * np.sqrt(np.maximum(S.diagonal(), 0.0))
    H = (np.linalg.pinv(P / np.outer(unit, unit), hermitian=True) @ (C / unit[:, None])).T
    H = np.where(np.abs(H) > rounding[:, None], H / unit, 0.0)
    values, vectors = np.linalg.eigh(S - H @ C)
    left = (vectors * np.maximum(values, 0.0)) @ vectors.T
    left = 0.5 * (left + left.T)
    return H, np.where(np.abs(left) > np.outer(rounding, rounding) / NO_PART, left, 0.0)


def finite_product(H: Array, x: Array) -> Array:
    """Return H x, shape (m,), or raise: NaN would pass for a missing measurement."""
    predicted = H.dot(x)
    if not np.isfinite(predicted).all():
        if not np.isfinite(H).all():
            raise ValueError("H: expected finite numbers, got NaN or infinity")
        raise ValueError(f"x: expected finite numbers, got H x = {predicted}")
    return np.asarray(predicted)


@dataclass(frozen=True)
class Mixture:
    """Correct by the score of the innovation."""

    noise: Contaminated | Learnt
    process: Contaminated | Scales | None = None
    grouping: Grouping = "component"
    classes: NoiseClasses = field(init=False, repr=False, compare=False)
    scales: Scales = field(init=False, repr=False, compare=False)
    choices: Choices = field(init=False, repr=False, compare=False)
    #: What the kernel takes.
    rule: Array = field(init=False, repr=False, compare=False)
    looks: ClassVar[dict[int, int]] = LOOKS[False]
    calls: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Make of what was given what the correction takes."""
        is_given = isinstance(self.noise, Contaminated)
        steady = Huber.from_contamination(self.noise.contamination) if is_given else Huber()  # type: ignore[union-attr]
        for name, value in (
            ("classes", noise_classes(self.noise, self.grouping)),
            ("scales", process_scales(self.process)),
            ("choices", Choices(steady, "innovation", "realized", self.grouping)),
        ):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "rule", series.mixture_rule(self.classes, self.scales))

    def __deepcopy__(self, memo: dict[int, Any]) -> Mixture:
        """Return self: nothing in here changes."""
        return self

    @property
    def learns(self) -> bool:
        """Whether anything is learned of the sensors."""
        return self.classes.learns

    def begin(self, sensors: int) -> Array:
        """Return the memory of sensors of which nothing was learned."""
        return self.classes.start(sensors)

    def start(self, x: Array, P: Array, runs: bool = False) -> Carried | None:
        """Return the models, all at x, P, where a filter starts or runs; None where there is but one."""
        begun = side_by_side.start(x, P, self.scales, runs)
        return Carried(*begun.packed, x.copy(), P.copy()) if self.scales.count > 1 else None

    def current(self, carried: Carried | None, x: Array, P: Array) -> Carried:
        """Return the models; all of them at x, P if these have been assigned from outside."""
        if carried is None:
            return alone(x, P)
        if x.tobytes() == carried.x.tobytes() and P.tobytes() == carried.P.tobytes():
            return carried
        now, scales = carried.hypotheses, len(self.scales.scales)
        count, belief = len(now.x), now.belief.copy()
        # Where the program puts the state there is no candidate.
        belief[scales:count] = 0.0
        belief[:scales] = side_by_side.slow(now, self.scales)
        x, P = x.copy(), 0.5 * (P + P.T)
        given = now.given and now.given._replace(x=x, P=P)
        tiled = Models(np.tile(x, (count, 1)), np.tile(P, (count, 1, 1)), belief, given)
        return Carried(*side_by_side.coupled(tiled, P, self.scales).packed, x, P)

    def predicted(
        self, carried: Carried | None, x: Array, P: Array, F: Array, Q: Array, Bu: Array | None, alpha_sq: float
    ) -> tuple[Array, Array, Carried | None]:
        """Return x and P of all models after a prediction: mixed as the scale may have changed, then moved."""
        control = None if Bu is None else Bu.ravel()
        now = self.current(carried, x.ravel(), P).hypotheses
        moved, *merged_to = series.predict_models(now, F, Q, self.scales, control, alpha_sq)
        after = Carried(*moved.packed, *merged_to)
        return after.x.reshape(x.shape).copy(), after.P.copy(), None if carried is None else after

    def predicted_to(self, now: Carried, x: Array, F: Array, Q: Array, curvature: Array | None = None) -> Carried:
        """Return the models after a prediction that takes their mean to x, and what is near it as F says.

        `curvature`, shape (n, n), is the covariance of what F does not explain of the prediction.
        """
        moved, *merged_to = series.predict_models(now.hypotheses, F, Q, self.scales, x - F @ now.x)
        if curvature is not None:
            moved = side_by_side.coupled(moved, curvature, self.scales)
            given = moved.given and moved.given._replace(P=moved.given.P + curvature)
            moved = moved._replace(P=moved.P + curvature, given=given)
            merged_to = list(side_by_side.merged(moved, self.scales))
        return Carried(*moved.packed, *merged_to)

    def corrected(
        self, before: Any, x: Array, P: Array, z: Array, H: Array, R: Array, M: Array | None, skips: bool
    ) -> tuple[Correction | Mixed, Carried | None]:
        """Return the correction of every model, merged."""
        prior = self.current(before.carried, x, P)
        # Raises where H x is not finite.
        finite_product(H, x)
        last, *merged = series.correct_models(prior.hypotheses, before.memory, z, H, R, self.classes, self.scales, M)
        after = Carried(*last.models.packed, *merged)
        if np.isnan(last.weights).all():
            ordinary = ordinary_noise(R, before.memory)
            return nothing_observed(x, P, H.dot(P).dot(H.T) + ordinary, len(H)), before.carried
        record = Mixed(
            after.x.copy(), after.P.copy(), *last[1:], prior.x.copy(), prior.P.copy(), H.copy(), R.copy(),
            None if M is None else M.copy(), z, before.memory,
            lags(z - H.dot(prior.x), (H.dot(prior.P) * H).sum(axis=1) + ordinary_noise(R, before.memory).diagonal()),
            leads(self.grouping, len(z)),
        )  # fmt: skip
        return record, None if before.carried is None else after

    def corrected_by_moments(
        self, before: Any, x: Array, P: Array, innovation: Innovation, skips: bool
    ) -> tuple[Correction | Mixed, Any]:
        """Return the correction of every model by one line; what the line does not explain of z is a state of its own.
        """
        readings, y, C, S, R, H = innovation
        curvature = np.zeros((0, 0))
        if H is None:
            H, curvature = regressed(P, C, S - R)
        n, m, extra = len(x), len(y), len(curvature)
        y = np.where(H.any(axis=1), y, np.nan)
        whole, prior = np.hstack((H, np.eye(m)[:, :extra])), self.current(before.carried, x, P).hypotheses
        if extra:
            prior = side_by_side.extended(prior, curvature, np.argmax(H != 0.0, axis=1), self.scales)
        last, *merged = series.correct_models(
            prior, before.memory, y, whole, R, self.classes, self.scales, None, readings
        )
        unexplained = curvature if curvature.size else np.zeros((m, m))
        if np.isnan(last.weights).all():
            ordinary = ordinary_noise(R, before.memory) + unexplained
            return nothing_observed(x, P, H @ P @ H.T + ordinary, m), before.carried
        # What F P F' leaves of asymmetry would grow where F does.
        mean, covariance = merged[0][:n], merged[1][:n, :n]
        covariance = 0.5 * (covariance + covariance.T)
        means, covariances, belief = last.models.packed
        # The kernel takes no views.
        after = Carried(means[:, :n].copy(), covariances[:, :n, :n].copy(), belief[:, :n].copy(), mean, covariance)
        return Mixed(
            mean, covariance, *last[1:], np.zeros(n), P.copy(), H.copy(), R.copy(), None, y, before.memory,
            lags(y, (H.dot(P) * H).sum(axis=1) + (ordinary_noise(R, before.memory) + unexplained).diagonal()),
            leads(self.grouping, m), unexplained,
        ), None if before.carried is None else after  # fmt: skip

    def standing(self, carried: Carried | None, x: Array, P: Array, memory: Array) -> State:
        """Return where a recording begins, in arrays of its own."""
        return State(*(part.copy() for part in (*self.current(carried, x, P)[:3], memory, x, P)))

    def carried_of(self, carried: Carried | None, state: State) -> Carried | None:
        """Return what is kept besides where a recording has come to."""
        return None if carried is None else Carried(*state[:3], state.x, state.P)

    def advance(self, state: State, zs: Array, model: tuple[Any, ...], into: Rows, **how: Any) -> int:
        """Take the steps of a recording as far as the kernel can, and return the first that was not taken."""
        return series.run(self.rule, state, zs, model, into, **how)

    def any_outlier(self, outlying: Array) -> Array:
        """Return the probability that any sensor, the last axis, was an outlier."""
        return any_outlier(outlying, leads(self.grouping, outlying.shape[-1]))

    def factors(self, memory: Array) -> Array:
        """Return what a sensor's ordinary noise is over R, in variance, as learned."""
        return np.asarray(memory[:, R_FACTOR])

    def contamination(self, memory: Array) -> Array:
        """Return the share of outliers of each sensor, as learned."""
        return describe(memory, np.array(self.classes.scales)).contamination

    def shares(self, memory: Array) -> tuple[Array, Array]:
        """Return the factors of ordinary noise's variance that outliers may have, and their shares."""
        scales = np.array(self.classes.scales)
        return scales, usual(memory, len(scales))

    @cached_property
    def _logs(self) -> Array:
        """Logarithms of the scales of Q."""
        return np.log(self.scales.scales)

    def slack(self, carried: Carried | None) -> float:
        """Return the factor of Q that is thought likely."""
        if carried is None:
            return 1.0
        slow = carried.belief[: len(self.scales.scales)]
        return math.exp(float((self._logs @ (slow / slow.sum(axis=0))).mean()))

    def process_scale(self, carried: Carried | None, n: int) -> Array:
        """Return the mean factor of each state's Q."""
        if carried is None:
            return np.ones(n)
        given = carried.hypotheses.given
        mean = np.asarray(self.scales.scales @ side_by_side.slow(carried.hypotheses, self.scales))
        return mean if given is None else mean * given.factor

    def entries(self, carried: Carried | None, x: Array, P: Array) -> dict[str, Array]:
        """Return the models as arrays of a state."""
        if carried is None:
            return {}
        now = self.current(carried, x, P)
        return {"means": now.means, "covariances": now.covariances, "belief": now.belief}

    def resumed(self, entries: dict[str, Array], x: Array, P: Array) -> Carried | None:
        """Return the models of a state, if their probabilities are some."""
        if self.scales.count == 1:
            return None
        side_by_side.require_belief("state: belief", entries["belief"], self.scales)
        return Carried(entries["means"], entries["covariances"], entries["belief"], x.copy(), P.copy())


#: What judges a filter's measurements. Both have the attributes and methods that `Bounded` has.
Policy: TypeAlias = Bounded | Mixture


class Options(TypedDict, total=False):
    """How a filter judges measurements; `RobustKalmanFilter` says what each means."""

    influence: Influence
    scaling: Scaling | None
    information: Information
    grouping: Grouping
    noise: Contaminated | Learnt | str | None
    process: Contaminated | Scales | str | None
    patience: int | None


def policy_of(
    influence: Influence = Huber(),
    scaling: Scaling | None = None,
    information: Information = "realized",
    grouping: Grouping = "component",
    noise: Contaminated | Learnt | str | None = None,
    process: Contaminated | Scales | str | None = None,
    patience: int | None = None,
) -> Policy:
    """Return the policy that a filter's arguments ask for, or raise where they make no sense together."""
    fails, moves = noise_policy(noise), process_policy(process)
    if fails is None:
        if isinstance(moves, Scales) or (moves is not None and not moves.is_ordinary):
            raise ValueError(
                f"process: expected None or 'given' without noise=, got {moves!r}; how likely a reading is under each "
                "process follows from its noise: say noise='learnt' or noise=Contaminated(..), Contaminated(0) for "
                "noise without outliers"
            )
        return Bounded(Choices(influence, scaling or "learnt", information, grouping, patience))
    if patience is not None:
        raise ValueError(
            f"patience: expected None with noise=, got {patience!r}; there a jump is believed by its probability: say "
            "process=Scales(jump=..)"
        )
    for name, value, usual_ones in (
        ("influence", influence, (Huber(),)),
        ("scaling", scaling, (None, "innovation")),
        ("information", information, ("realized",)),
    ):
        if value not in usual_ones:
            raise ValueError(f"{name}: expected none with noise=, got {value!r}; psi follows from the noise there")
    if moves is None and isinstance(fails, Learnt):
        # A program that does not know R hardly knows Q, the start and the model.
        moves = Scales()
    return Mixture(fails, moves, grouping)


_Function = TypeVar("_Function", bound=Callable[..., Any])


def with_options(function: _Function) -> _Function:
    """Show in the signature of a function the options, with their defaults, that it takes as ``**options``."""
    own = inspect.signature(function)
    options = [one.replace(kind=one.KEYWORD_ONLY) for one in inspect.signature(policy_of).parameters.values()]
    function.__signature__ = own.replace(parameters=[*list(own.parameters.values())[:-1], *options])  # type: ignore
    return function
