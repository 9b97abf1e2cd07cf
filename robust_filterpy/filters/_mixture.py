"""Noise that is a mixture, told or learnt: copies of the state, each corrected under every class of noise and weighed.

What is kept beside x and P are the copies, one for each scale of the process, and what they merge to: a program that
assigns x or P from outside has assigned it to every copy.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag

from robust_filterpy._checks import Array
from robust_filterpy._state import Shape
from robust_filterpy.correction import copies as side_by_side
from robust_filterpy.correction.copies import Copies, Scales
from robust_filterpy.correction.definition import Innovation, innovation_moments, nothing_observed
from robust_filterpy.correction.learning import NoiseClasses
from robust_filterpy.correction.options import Choices, Grouping
from robust_filterpy.correction.policies import Contaminated, Learnt, noise_classes, process_scales
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.standardization import ordered_scaling
from robust_filterpy.correction.whitening import Inverse
from robust_filterpy.filters._bounded import finite_product
from robust_filterpy.influence.functions import Huber
from robust_filterpy.kernel import learnt as half_step
from robust_filterpy.kernel.records import Kept as Rows
from robust_filterpy.kernel.records import State

__all__ = ["Kept", "Mixture", "ordinary_noise"]


class Kept(NamedTuple):
    """The copies, and the x and P merged from them."""

    means: Array
    """Shape (q, n)."""
    covariances: Array
    """Shape (q, n, n)."""
    belief: Array
    """Which of them are likely, in which part of the state, shape (q + 2, n)."""
    x: Array
    """Shape (n,)."""
    P: Array
    """Shape (n, n)."""

    @property
    def copies(self) -> Copies:
        """The copies alone."""
        return Copies(*self[:3])


@dataclass(frozen=True)
class Mixture:
    """Correct by the score of the innovation; how a filter uses it: `robust_filterpy.filters._policy`."""

    noise: Contaminated | Learnt
    process: Contaminated | Scales | None = None
    grouping: Grouping = "component"
    classes: NoiseClasses = field(init=False, repr=False, compare=False)
    scales: Scales = field(init=False, repr=False, compare=False)
    choices: Choices = field(init=False, repr=False, compare=False)
    patience: None = field(init=False, repr=False, default=None)
    #: What the kernel takes, and puts a correction into.
    rule: Array = field(init=False, repr=False, compare=False)
    record: Any = field(init=False, repr=False, compare=False)
    by_kernel = False

    def __post_init__(self) -> None:
        """Make of what was told what the correction takes."""
        told = isinstance(self.noise, Contaminated)
        steady = Huber.from_contamination(self.noise.contamination) if told else Huber()  # type: ignore[union-attr]
        for name, value in (
            ("classes", noise_classes(self.noise, self.grouping)),
            ("scales", process_scales(self.process)),
            ("choices", Choices(steady, "innovation", "realized", self.grouping)),
        ):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "rule", half_step.rule(self.classes, self.scales))
        object.__setattr__(self, "record", partial(Mixed, together=self._named) if self._named else Mixed)

    def __deepcopy__(self, memo: dict[int, Any]) -> Mixture:
        """Return self: nothing in here changes."""
        return self

    @property
    def learns(self) -> bool:
        """Whether anything is learnt of the sensors."""
        return self.classes.learns

    @property
    def _named(self) -> tuple[tuple[int, ...], ...]:
        """Sensors that fail together, where they are named."""
        return () if isinstance(self.grouping, str) else self.grouping

    def begin(self, sensors: int) -> Array:
        """Return the memory of sensors of which nothing is known."""
        return self.classes.start(sensors)

    def start(self, x: Array, P: Array, sensors: int) -> Kept | None:
        """Return the copies, all at x, P; None where there is but one."""
        return Kept(*side_by_side.start(x, P, self.scales), x.copy(), P.copy()) if self.scales.count > 1 else None

    def current(self, kept: Kept | None, x: Array, P: Array) -> Kept:
        """Return the copies; all of them at x, P if these have been assigned from outside."""
        if kept is None:
            return Kept(*side_by_side.start(x, P, self.scales), x, P)
        if x.tobytes() == kept.x.tobytes() and P.tobytes() == kept.P.tobytes():
            return kept
        count, belief, scales = len(kept.means), kept.belief.copy(), len(self.scales.scales)
        # Where the program puts the state there is no candidate.
        belief[scales:count] = 0.0
        belief[:scales] = side_by_side.slow(kept.copies, self.scales)
        x, P = x.copy(), P.copy()
        copies = Copies(np.tile(x, (count, 1)), np.tile(P, (count, 1, 1)), belief)
        return Kept(*side_by_side.coupled(copies, P, self.scales), x, P)

    def predicted(
        self, kept: Kept | None, x: Array, P: Array, F: Array, Q: Array, Bu: Array | None, alpha_sq: float
    ) -> tuple[Array, Array, Kept | None]:
        """Return x and P of all copies after a prediction: mixed as the scale may have changed, then moved."""
        control = None if Bu is None else Bu.ravel()
        now = self.current(kept, x.ravel(), P).copies
        copies, *merged_to = half_step.predict(now, F, Q, self.scales, control, alpha_sq)
        after = Kept(*copies, *merged_to)
        return after.x.reshape(x.shape).copy(), after.P.copy(), None if kept is None else after

    def corrected(
        self, known: Any, x: Array, P: Array, z: Array, H: Array, R: Array, M: Array | None, inv: Inverse | None
    ) -> tuple[Correction | Mixed, Kept | None]:
        """Return the correction of every copy, merged."""
        kept = self.current(known.kept, x, P)
        # Raises where H x is not finite.
        finite_product(H, x)
        found, *merged_to = half_step.correct(kept.copies, known.memory, z, H, R, self.classes, self.scales, M, inv)
        if np.isnan(found.weights).all():
            ordinary = ordinary_noise(R, known.memory)
            return nothing_observed(x, P, H.dot(P).dot(H.T) + ordinary, len(H)), known.kept
        after = Kept(*found.copies, *merged_to)
        record = Mixed(
            after.x.copy(), after.P.copy(), *found[1:], kept.x.copy(), kept.P.copy(), H.copy(), R.copy(),
            None if M is None else M.copy(), z, known.memory, together=self._named,
        )  # fmt: skip
        return record, None if known.kept is None else after

    def corrected_by_moments(
        self, known: Any, x: Array, P: Array, innovation: Innovation, inv: Inverse | None,
        difference: Callable[[Array, Array], Array] = np.subtract,
    ) -> tuple[Correction | Mixed, Any]:  # fmt: skip
        """Return the correction of one copy; what a line does not explain of z is a state of its own."""
        readings, y, C, S, R, H = innovation
        curvature = np.zeros((0, 0))
        if H is None:
            unit = np.sqrt(np.where(P.diagonal() > 0.0, P.diagonal(), 1.0))
            H = (np.linalg.pinv(P / np.outer(unit, unit), hermitian=True) @ (C / unit[:, None])).T / unit
            values, vectors = np.linalg.eigh(S - R - H @ C)
            curvature = (vectors * np.maximum(values, 0.0)) @ vectors.T
        n, m = len(x), len(y)
        y = np.where(H.any(axis=1), y, np.nan)
        whole, states = np.hstack((H, np.eye(m)[:, : len(curvature)])), block_diag(P, curvature)
        prior = side_by_side.start(np.zeros(n + len(curvature)), states, process_scales(None))
        found, *_ = half_step.correct(prior, known.memory, y, whole, R, self.classes, self.scales, None, inv, readings)
        unexplained = curvature if curvature.size else np.zeros((m, m))
        if np.isnan(found.weights).all():
            ordinary = ordinary_noise(R, known.memory) + unexplained
            return nothing_observed(x, P, H @ P @ H.T + ordinary, m), known.kept
        # What F P F' leaves of asymmetry would grow where F does.
        covariance = found.copies.P[0, :n, :n]
        mean, covariance = x + found.copies.x[0, :n], 0.5 * (covariance + covariance.T)
        return Mixed(
            mean, covariance, *found[1:], np.zeros(n), P.copy(), H.copy(), R.copy(), None, y, known.memory, unexplained,
            self._named,
        ), known.kept  # fmt: skip

    def standing(self, kept: Kept | None, x: Array, P: Array, memory: Array) -> State:
        """Return where a recording begins, in arrays of its own."""
        return half_step.begin(self.current(kept, x, P).copies, memory)

    def kept_of(self, kept: Kept | None, state: State) -> Kept | None:
        """Return what is kept besides where a recording has come to."""
        return None if kept is None else Kept(*state[:3], state.x, state.P)

    def advance(self, state: State, zs: Array, model: tuple[Any, ...], into: Rows, **how: Any) -> int:
        """Take the steps of a recording as far as the kernel can, and return the first that was not taken."""
        return half_step.run(state, zs, model, self.classes, self.scales, into, **how)

    def any_outlier(self, outlying: Array) -> Array:
        """Return the probability that any sensor, the last axis, was an outlier."""
        return _any_outlier(outlying, self.grouping)

    def entries(self, kept: Kept | None, x: Array, P: Array) -> dict[str, Array]:
        """Return the copies as arrays of a state."""
        if kept is None:
            return {}
        now = self.current(kept, x, P)
        return {"means": now.means, "covariances": now.covariances, "belief": now.belief}

    def shapes(self, n: int) -> dict[str, Shape]:
        """Return the shapes of these."""
        q = self.scales.count
        if q == 1:
            return {}
        return {"means": (q, n), "covariances": (q, n, n), "belief": (q + 2, n)}

    def resumed(self, found: dict[str, Array], x: Array, P: Array) -> Kept | None:
        """Return the copies of a state, if their probabilities are some."""
        if self.scales.count == 1:
            return None
        side_by_side.require_belief("state: belief", found["belief"])
        return Kept(found["means"], found["covariances"], found["belief"], x.copy(), P.copy())


class Mixed(NamedTuple):
    """A correction under a mixture; what few programs look at is computed on request."""

    x: Array
    """Posterior mean, shape (n,)."""
    P: Array
    """Posterior covariance, shape (n, n)."""
    memory: Array
    """Of the noise after it."""
    log_density: float
    """log p(z)."""
    weights: Array
    """Shape (m,), NaN where missing."""
    outlier_probabilities: Array
    """Shape (m,), or (1,) where all sensors fail together."""
    prior_x: Array
    """Prior mean, shape (n,), or 0 where z is an innovation."""
    prior_P: Array
    H: Array
    R: Array
    """As it was told."""
    M: Array | None
    z: Array
    """Shape (m,); NaN where missing."""
    before: Array
    """What was known of the noise."""
    curvature: Array | None = None
    """Covariance of what a line does not explain of z."""
    together: tuple[tuple[int, ...], ...] = ()
    """Sensors that fail together, where they are named."""

    @property
    def outlier_probability(self) -> float:
        """Probability that a component was an outlier; sensors that fail together have one."""
        return float(_any_outlier(self.outlier_probabilities, "joint" if len(self.memory) == 1 else self.together))

    def as_arrays(self) -> Correction:
        """Return everything that a correction shows, of the merged prior and ordinary noise as it was learnt before."""
        m, M = len(self.H), self.M
        R = ordinary_noise(self.R, self.before)
        if self.curvature is not None:
            R = R + self.curvature
        # A noise that is larger by a factor keeps its correlation with the state.
        C, S = innovation_moments(self.prior_P, self.H, R, None if M is None else M * np.sqrt(self.before[:, 0]))
        y = np.where(np.isnan(self.weights), np.nan, self.z - self.H.dot(self.prior_x))
        part = np.flatnonzero(y == y)
        y = np.where(np.isnan(y), 0.0, y)
        order = tuple((int(i),) for i in part[np.argsort(np.abs(y[part]) / np.sqrt(S.diagonal()[part]))])
        T = ordered_scaling(S, order, "innovation")
        e, weights, psi_deriv, score = T.dot(y), np.full(m, np.nan), np.full(m, np.nan), np.zeros(m)
        weights[part] = self.weights[part]
        # The more likely an outlier than not, the more it counts as clipped.
        psi_deriv[part] = np.where(self.outlier_probabilities[part] > 0.5, 0.0, weights[part])
        score[part] = T[np.ix_(part, part)].T.dot(weights[part] * e[part])
        return Correction(
            self.x, self.P, C, y, S, score, T.T.dot(T), e, weights, psi_deriv, order, "innovation",
            self.log_density,
        )  # fmt: skip


def _any_outlier(outlying: Array, grouping: Any) -> Array:
    """Return the probability that any sensor, the last axis, was an outlier; those that fail together have one."""
    m = outlying.shape[-1]
    named = [range(m)] if grouping == "joint" else [] if grouping == "component" else grouping
    leads = {i: min(group) for group in named for i in group}
    places = [[i for i in range(m) if leads.get(i, i) == lead] for lead in range(m)]
    each = [outlying[..., group].max(axis=-1) for group in places if group]
    return np.asarray(each[0] if len(each) == 1 else 1.0 - np.prod([1.0 - p for p in each], axis=0))


def ordinary_noise(R: Array, memory: Array) -> Array:
    """Return the covariance of ordinary noise for an R that was told, memory a row for each sensor or one for all."""
    if len(memory) == 1:
        return np.asarray(R * memory[0, 0])
    r = np.sqrt(memory[: len(R), 0])
    return np.asarray(R * np.multiply.outer(r, r))
