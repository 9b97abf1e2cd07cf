"""What the filters share that learn their measurement noise: options, what has been learnt, one correction."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._arrays import noise_covariance
from robust_filterpy._checks import Array
from robust_filterpy._state import Shape
from robust_filterpy.correction import learnt as learnt_step
from robust_filterpy.correction.copies import Scales, merged
from robust_filterpy.correction.learning import LearntNoise, NoiseClasses, describe
from robust_filterpy.correction.options import Choices, Grouping
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.whitening import Inverse, SingularInnovationError
from robust_filterpy.filters._hypotheses import MergedCorrection, WeightInfluence, finite_product
from robust_filterpy.filters._interacting import Bank


class Learnt(NamedTuple):
    """A correction under learnt noise."""

    bank: Bank
    known: Array
    """What is known of the noise after it, a row for each sensor or one for all."""
    log_density: float
    outlier_probability: float
    weights: Array
    """Expected precision of each component over that of ordinary noise, NaN where it tells nothing, shape (m,)."""
    outlying: Array
    """Probability that each component was an outlier, shape (m,)."""

    def correction(
        self, z: Array, x: Array, P: Array, H: Array, R: Array, M: Array | None, inv: Inverse | None
    ) -> Correction:
        """Return what a filter shows of it; R is the covariance of ordinary noise as it was learnt before."""
        y = np.where(np.isnan(self.weights), np.nan, z - H.dot(x))
        part = np.flatnonzero(y == y)
        influence = WeightInfluence(self.weights[part], self.outlying[part] > 0.5)
        merged = MergedCorrection(self.bank.x, self.bank.P, y, P, H, R, M, inv, influence)
        try:
            return merged.as_arrays()
        except SingularInnovationError:
            # Sensors are taken one after the other, which takes no inverse of S as a whole.
            return merged._replace(inv=_what_is_seen).as_arrays()


def _what_is_seen(S: Array) -> Array:
    """Return the inverse of S without the directions that rounding alone shows."""
    unit = np.sqrt(S.diagonal())
    return np.asarray(np.linalg.pinv(S / unit / unit[:, None], 1e-12, hermitian=True) / unit / unit[:, None])


def ordinary_noise(R: Array, learnt: Array) -> Array:
    """Return the covariance of ordinary noise for an R that was given, learnt a row for each sensor or one for all."""
    if len(learnt) == 1:
        return np.asarray(R * learnt[0, 0])
    r = np.sqrt(learnt[: len(R), 0])
    return np.asarray(R * np.multiply.outer(r, r))


class LearntNoiseMixin:
    """Learn r, the factor of R, and how often and how long each scale of the noise occurs.

    Comes before the filter's class among the bases. The filter calls `_set_noise` in its constructor and `_learn` in a
    correction, and assigns ``known`` to ``_learnt`` when the correction has been accepted.
    """

    R: Any
    dim_z: int
    _choices: Choices
    _classes: NoiseClasses
    # A filter that trusts its process is one copy of itself.
    _process: Scales = Scales((1.0,), jump=0.0)
    _learnt: Array
    _outlier_probability: float
    _inverse: Any

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
        """What is known of the noise, shape (1 or sensors, 6 + 2 K + K^2); a copy."""
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
        return ordinary_noise(noise_covariance(self.R, None, self.dim_z), self._known(self.dim_z))

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
        """Take over a checked state, if it holds what can be learnt."""
        # Sensors may have joined since.
        learnt = self._classes.checked(found["learnt"], min(self.dim_z, len(found["learnt"])))
        super()._go_on(found)  # type: ignore[misc]
        self._learnt, self._outlier_probability = learnt, 0.0

    def _known(self, sensors: int) -> Array:
        """Return what is known, with rows for sensors that have joined."""
        if sensors <= len(self._learnt) or self.grouping == "joint":
            return self._learnt
        return np.concatenate([self._learnt, self._classes.start(sensors - len(self._learnt))])

    def _learn(self, bank: Bank, z: Array, H: Array, R: Array, M: Any, known: Array, first: int = 0) -> Learnt | None:
        """Correct copies of a state by z, NaN where missing, which stands at `first` in the whole measurement.

        None if nothing of z tells anything.
        """
        joint = self._classes.grouping == "joint"
        # Raises where H x is not finite.
        finite_product(H, bank.x)
        rows = known if joint else known[first : first + len(z)]
        found = learnt_step.correct(bank.copies, rows, z, H, R, self._classes, self._process, M, self._inverse)
        if np.isnan(found.weights).all():
            return None
        learnt = found.memory
        if len(learnt) < len(known):
            learnt = known.copy()
            learnt[first : first + len(z)] = found.memory
        # Sensors that fail together have one probability.
        outlying = found.outlier_probabilities.tolist()
        probability = max(outlying) if joint else 1.0 - math.prod(1.0 - p for p in outlying)
        after = Bank(*found.copies[:3], *merged(found.copies, self._process), found.copies.unseen)
        return Learnt(after, learnt, found.log_density, probability, found.weights, found.outlier_probabilities)
