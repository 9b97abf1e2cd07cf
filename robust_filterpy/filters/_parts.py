"""A measurement taken up part by part, by `update_sequential`: shown as one correction when that is asked for."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.definition import correct, embed_block
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.spread import settled

__all__ = ["Part", "Parts", "as_arrays", "log_density"]


class Part(NamedTuple):
    """A correction by some of the sensors."""

    start: int
    """Place of the first sensor."""
    number: int
    correction: Any
    """A correction, or what makes one by ``as_arrays``."""


class Parts(NamedTuple):
    """Corrections by parts of a measurement, the last one last."""

    before: Any
    """The correction before the first, or None."""
    sensors: int
    """How many there are in all."""
    parts: tuple[Part, ...]
    settings: tuple[Choices, Array | None, bool] | None
    """What the density of the whole follows from; None where that of the last part is shown."""

    @classmethod
    def of(cls, before: Any, sensors: int, part: Part, settings: Any) -> Parts:
        """Return these with one more; a part that it covers shows nothing any more."""
        earlier: tuple[Part, ...] = ()
        if type(before) is cls and before.sensors == sensors:
            before, earlier = before.before, before.parts
        end = part.start + part.number
        left = tuple(p for p in earlier if p.start < part.start or p.start + p.number > end)
        return cls(before, sensors, (*left, part), settings)

    @property
    def first(self) -> Any:
        """The correction before all of them."""
        return self.before.first if type(self.before) is Parts else self.before

    def as_arrays(self) -> Correction:
        """Return them next to each other."""
        last: Any = as_arrays(self.before)
        for part in self.parts:
            last = embed_block(last, as_arrays(part.correction), part.start, self.sensors)
        if self.settings is None:
            return last  # type: ignore[no-any-return]
        seen = np.where(np.isnan(last.weights), np.nan, last.y)
        return last._replace(log_density=log_density(seen, last.S, *self.settings))  # type: ignore[no-any-return]

    @property
    def outlier_probability(self) -> float:
        """That of the last part."""
        return getattr(self.parts[-1].correction, "outlier_probability", 0.0)

    @property
    def log_density(self) -> float:
        """Log-likelihood of all of them."""
        return self.as_arrays().log_density


def log_density(y: Array, S: Array, choices: Choices, memory: Array | None, skip: bool) -> float:
    """Return the log-likelihood of an innovation: the correction of a state without components."""
    nothing, none = np.zeros((0, 0)), np.zeros((0, len(y)))
    widths = None if memory is None else settled(memory)
    return correct(nothing.ravel(), nothing, y, none, S, choices, widths, skip).log_density


def as_arrays(correction: Any) -> Any:
    """Return a correction as arrays, or None."""
    return correction if correction is None or isinstance(correction, Correction) else correction.as_arrays()
