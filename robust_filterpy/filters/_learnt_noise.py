"""What the filters share that learn their measurement noise: options, what has been learnt, one correction."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._arrays import noise_covariance
from robust_filterpy._checks import Array
from robust_filterpy._state import Shape
from robust_filterpy.correction.adaptive import AdaptiveStep, NoiseClasses
from robust_filterpy.correction.adaptive_noise import LearntNoise, describe
from robust_filterpy.correction.options import Choices, Grouping
from robust_filterpy.filters._adaptive_step import corrected
from robust_filterpy.filters._hypotheses import WeightInfluence


class Learnt(NamedTuple):
    """A correction under learnt noise."""

    step: AdaptiveStep
    known: Array
    """What is known of the noise after it, a row for each sensor or one for all."""
    outlier_probability: float
    influence: WeightInfluence


class LearntNoiseMixin:
    """Learn r, the factor of R, and how often and how long each scale of the noise occurs.

    Comes before the filter's class among the bases. The filter calls `_set_noise` in its constructor and `_learn` in a
    correction, and assigns ``known`` to ``_learnt`` when the correction has been accepted.
    """

    R: Any
    dim_z: int
    _inverse: Any
    _choices: Choices
    _classes: NoiseClasses
    _learnt: Array
    _outlier_probability: float

    def _set_noise(self, classes: NoiseClasses, dim_z: int) -> None:
        """Start with nothing learnt."""
        self._classes, self._learnt, self._outlier_probability = classes, classes.start(dim_z), 0.0

    @property
    def measurement_scales(self) -> Array:
        """Factors of R, shape (K,)."""
        return np.array(self._classes.scales)

    @property
    def memory(self) -> float:
        """Samples for which it is remembered how often each scale occurs."""
        return self._classes.memory

    @property
    def r_memory(self) -> float:
        """Ordinary samples for which the size of the noise is remembered."""
        return self._classes.r_memory

    @property
    def learnt(self) -> Array:
        """What is known of the noise, shape (1 or sensors, 2 + 2 K + K^2); a copy."""
        return self._learnt.copy()

    @learnt.setter
    def learnt(self, value: ArrayLike) -> None:
        self._learnt = self._classes.checked(value, self.dim_z)

    @property
    def noise(self) -> LearntNoise:
        """What has been learnt about the measurement noise."""
        return describe(self._learnt, self.measurement_scales, self.dim_z if self.grouping == "joint" else 1)

    @property
    def R_learnt(self) -> Array:
        """Covariance of ordinary noise as learnt, shape (dim_z, dim_z)."""
        return self._ordinary(noise_covariance(self.R, None, self.dim_z), self._known(self.dim_z))

    @property
    def outlier_probability(self) -> float:
        """Probability that a component of the last measurement was an outlier."""
        return self._outlier_probability

    @property
    def influence(self) -> Any:
        """The noise as learnt, whose score is psi."""
        return self.noise

    @influence.setter
    def influence(self, value: Any) -> None:
        raise AttributeError(f"influence: follows from the noise, which an {type(self).__name__} learns")

    @property
    def grouping(self) -> Grouping:
        """Whether the sensors fail "joint", or each "component" on its own; another one starts to learn anew."""
        return self._classes.grouping

    @grouping.setter
    def grouping(self, value: Grouping) -> None:
        classes = replace(self._classes, grouping=value)
        if value != self._classes.grouping:
            self._learnt, self._classes = classes.start(self.dim_z), classes
            self._choices = self._choices.changed(grouping=value)

    def _moving(self) -> dict[str, Any]:
        """Return what a step moves, and what is known of the noise."""
        return {**super()._moving(), "learnt": self._learnt}  # type: ignore[misc]

    def _needed(self) -> dict[str, Shape]:
        """Return the shapes of these; sensors may have joined."""
        return {**super()._needed(), "learnt": (None, self._learnt.shape[1])}  # type: ignore[misc]

    def _go_on(self, found: dict[str, Array]) -> None:
        """Take over a checked state."""
        super()._go_on(found)  # type: ignore[misc]
        self._learnt, self._outlier_probability = found["learnt"], 0.0

    def _known(self, sensors: int) -> Array:
        """Return a copy of what is known, with rows for sensors that have joined."""
        if self.grouping == "joint" or sensors <= len(self._learnt):
            return self._learnt.copy()
        return np.concatenate([self._learnt, self._classes.start(sensors - len(self._learnt))])

    def _ordinary(self, R: Array, learnt: Array) -> Array:
        """Return the covariance of ordinary noise for an R that was given."""
        if len(learnt) == 1:
            return np.asarray(R * learnt[0, 0])
        r = np.sqrt(learnt[: len(R), 0])
        return np.asarray(R * np.multiply.outer(r, r))

    def _learn(
        self, copies: tuple[Array, Array, Array], z: Array, H: Array, R: Array, M: Any, known: Array, part: np.ndarray,
        first: int = 0,
    ) -> Learnt:  # fmt: skip
        """Correct copies of a state by the components `part` of z, which stands at `first` in the whole measurement.

        The copies are means, covariances and probabilities. What is `known` of the noise is written over.
        """
        rows = np.zeros(1, dtype=int) if self.grouping == "joint" else first + part
        if part.size < len(H):
            z, H, R, M = z[part], H[part], R[np.ix_(part, part)], None if M is None else M[:, part]
        step = corrected(*copies, known[rows], z, H, R, self._classes, M, self._inverse)
        known[rows] = step.learnt
        # Sensors that fail together have one probability.
        ordinary = (1.0 - step.outlier_probabilities[: rows.size]).prod()
        return Learnt(
            step, known, float(1.0 - ordinary), WeightInfluence(step.weights, step.outlier_probabilities > 0.5)
        )
