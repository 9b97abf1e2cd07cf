"""What a filter has learnt of its sensors: the memory that its policy works with, and how it is shown."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._arrays import noise_covariance
from robust_filterpy._checks import Array
from robust_filterpy.correction.copies import slow
from robust_filterpy.correction.learning import LearntNoise, describe
from robust_filterpy.correction.spread import SPREAD, WEIGHT
from robust_filterpy.filters._bounded import Bounded
from robust_filterpy.filters._held import Held
from robust_filterpy.filters._insistence import Insistence
from robust_filterpy.filters._mixture import Mixture, ordinary_noise
from robust_filterpy.filters._policy import Known
from robust_filterpy.filters._sensors import Customs, sensor_keys


class LearningMixin(Held):
    """Hold the memory of the sensors, hand it to a policy and take it back."""

    __slots__ = ()

    def _known_sensors(self) -> Customs:
        """Return what is known of the sensors; the array alone is what the kernel reads and replaces."""
        return Customs(self._memory, self._other_sensors)

    def _keep_sensors(self, value: Customs) -> None:
        """Keep what is known of the sensors."""
        self._memory, self._other_sensors = value

    def _known(self, m: int, passed: Array | None = None, first: int = 0) -> Known:
        """Return what is known before a correction by m sensors, from place `first` in z on or by their rows of H."""
        learns = self._policy.learns
        if learns and passed is None and first + m <= len(self._memory):
            return Known(self._memory[first : first + m], self._kept)
        begin, keys = self._sensors_of(m, passed, first)
        return Known(self._known_sensors().of(begin, keys) if learns else begin, self._kept)

    def _sensors_of(self, m: int, passed: Array | None, first: int) -> tuple[Array, list[Any]]:
        """Return memories without any knowledge, and what tells the m sensors: their places, or their rows of an H."""
        begin = self._policy.begin(first + m)
        if self._policy.noise is not None and self._choices.grouping == "joint":
            return begin, [0]
        places = list(range(first, first + m))
        return begin[first:], places if passed is None else sensor_keys(passed, getattr(self, "H", None))

    def _learn(self, memory: Array | None, m: int, passed: Array | None = None, first: int = 0) -> None:
        """Keep what a correction by m sensors has taught, named as in `_known`."""
        if memory is None or not self._policy.learns:
            return
        if passed is None and first + m <= len(self._memory) and len(memory) == m:
            places = self._memory.copy()
            places[first : first + m] = memory
            self._memory = places
            return
        self._keep_sensors(self._known_sensors().updated(memory, *self._sensors_of(m, passed, first)))

    def _spoken(self, sensor: str | int | None, correct: Callable[[], None]) -> None:
        """Correct by a sensor that is named, None for those that their places or rows of H tell."""
        if sensor is None:
            correct()
            return
        if not isinstance(sensor, (str, int)) or isinstance(sensor, bool):
            raise TypeError(f"sensor: expected a name or a number, got {_checks.shown(sensor)}")
        known, name = self._known_sensors(), str(sensor)
        self._keep_sensors(Customs(self._named_sensors.get(name, self._policy.begin(self.dim_z)), {}))
        try:
            correct()
            spoken = self._memory
        finally:
            self._keep_sensors(known)
        if self._policy.learns:
            self._named_sensors = {**self._named_sensors, name: spoken}

    @property
    def _learns_spread(self) -> bool:
        """Whether thresholds are in units of the spread; the Kalman filter has none."""
        return type(self._policy) is Bounded and self._policy.learns

    @property
    def spread(self) -> Array:
        """How large each sensor's standardized innovations usually are, shape (dim_z,); NaN before the first.

        Under scaling "learnt" thresholds are in units of this: 1 where P, Q and R are right, 10 where they are told 100
        times too small.
        """
        if not self._learns_spread:
            return np.full(self.dim_z, np.nan)
        memory = self._known(self.dim_z).memory
        return np.where(memory[:, WEIGHT] > 0.0, memory[:, SPREAD], np.nan)

    @property
    def refused(self) -> int:
        """Under ``patience=``, how many refused measurements agree so far."""
        return self._kept.refused if isinstance(self._kept, Insistence) else 0

    @property
    def recoveries(self) -> int:
        """Under ``patience=``, how often that many were refused and P was widened."""
        return self._kept.recoveries if isinstance(self._kept, Insistence) else 0

    @property
    def outlier_probability(self) -> float:
        """Under ``noise=``, the probability that a component of the last measurement was an outlier."""
        return self._outlier_probability

    @property
    def learnt(self) -> Array | None:
        """Under ``noise=Learnt(..)``, what is known of the noise: a small array, r (a factor of R) first.

        Keep it, or assign it to another filter with the same R, grouping and scales of noise, which then starts with
        it. Shape (1 or sensors, 14 + 2 K + K^2); a copy. None where no noise is learnt.
        """
        return self._memory.copy() if self._learns_noise else None

    @learnt.setter
    def learnt(self, value: ArrayLike) -> None:
        if not self._learns_noise:
            raise AttributeError(f"learnt: expected a filter with noise=Learnt(..), got noise={self._policy.noise!r}")
        self._memory, self._other_sensors = self._policy.classes.checked(value, self.dim_z), {}
        self._named_sensors = {}

    @property
    def noise_learnt(self) -> LearntNoise | None:
        """Under ``noise=Learnt(..)``, what has been learnt of the noise: r, contamination, scale ratio, run length."""
        if not self._learns_noise:
            return None
        classes = self._policy.classes
        return describe(self._memory, np.array(classes.scales), self.dim_z if classes.grouping == "joint" else 1)

    @property
    def sensors_learnt(self) -> dict[str, LearntNoise] | None:
        """Under ``noise=Learnt(..)``, what has been learnt of each sensor that `update` was told by `sensor`."""
        if not self._learns_noise:
            return None
        classes = self._policy.classes
        return {
            name: describe(known, np.array(classes.scales), len(known) if classes.grouping == "joint" else 1)
            for name, known in self._named_sensors.items()
        }

    @property
    def R_learnt(self) -> Array | None:
        """Under ``noise=``, the covariance of ordinary noise as learnt, shape (dim_z, dim_z); None without."""
        if type(self._policy) is not Mixture:
            return None
        kf: Any = self
        return ordinary_noise(noise_covariance(kf.R, None, self.dim_z), self._known(self.dim_z).memory)

    @property
    def _learns_noise(self) -> bool:
        """Whether the measurement noise is learnt."""
        return type(self._policy) is Mixture and self._policy.learns

    @property
    def process_probabilities(self) -> Array | None:
        """Under ``noise=``, the probability of each scale of Q for each state, shape (q, dim_x); None without.

        States that neither the model nor a sensor couples have their own, the others of one part the same.
        """
        if type(self._policy) is not Mixture:
            return None
        if self._kept is None:
            return np.ones((1, self.dim_x))
        return slow(self._kept.copies, self._policy.scales)

    @property
    def process_scale(self) -> Array:
        """Mean factor of each state's Q in the step before the last measurement, given that measurement.

        Shape (dim_x,), equal for states of one part; 1 if Q is taken as told.
        """
        probabilities = self.process_probabilities
        if probabilities is None:
            return np.ones(self.dim_x)
        return np.asarray(np.array(self._policy.scales.scales) @ probabilities)
