"""The samples that a tracker keeps until they make a model, and when it looks at them."""

from __future__ import annotations

from typing import Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.structures import Structure

# A recording that tells nothing yet may become so many times as long before its oldest samples go.
_LONGEST: Final = 4


class ColdStart:
    """A recording that grows, and the lengths at which a model is made of it: an eighth, a quarter, half and all.

    Parameters
    ----------
    structure : Structure
        What the model is to be.
    samples : int
        How many samples it may look at.
    """

    def __init__(self, structure: Structure, samples: int) -> None:
        """Keep nothing yet."""
        self.samples = samples
        self.least = max(20, 5 * (structure.n_theta + 1))
        self.y, self.u = np.zeros(0), np.zeros((0, structure.n_inputs))
        self.waits = self._until_next(0)

    def add(self, y: Array, u: Array) -> None:
        """Keep samples, at most as many as it waits for."""
        # A frozen tracker does not look: it stays due, and a count below 0 would say in a state that there is no start.
        self.waits = max(self.waits - len(y), 0)
        keep = max(0, _LONGEST * self.samples - len(y))
        self.y, self.u = np.append(self.y[-keep:], y), np.concatenate((self.u[-keep:], u))

    @property
    def is_last_look(self) -> bool:
        """Whether there are as many samples as were asked for."""
        return self.y.size >= self.samples

    def wait(self) -> None:
        """Wait for the next look."""
        self.waits = self._until_next(self.y.size)

    def level(self) -> float:
        """Return the median of the outputs so far, 0 if there are none."""
        known = self.y[self.y == self.y]
        return float(np.median(known)) if known.size else 0.0

    def _until_next(self, size: int) -> int:
        """Return after how many samples the next look is."""
        lengths = [max(self.samples >> k, 1) for k in (3, 2, 1, 0)]
        later = [length for length in lengths if length > size and (length >= self.least or length == self.samples)]
        return later[0] - size if later else max(self.samples // 4, 1)
