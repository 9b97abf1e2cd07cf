"""The samples that are kept until they make a model, and when to look at them."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array

__all__ = ["ColdStart"]

# A recording that tells nothing yet may become so many times as long before its oldest samples go.
_LONGEST: Final = 4


class ColdStart(NamedTuple):
    """A recording that grows; a model is made of an eighth, a quarter, half and all of the samples asked for."""

    samples: int
    """How many samples it may look at."""
    y: Array
    u: Array
    waits: int
    """Samples until the next look."""

    @classmethod
    def of(cls, n_theta: int, n_inputs: int, samples: int) -> ColdStart:
        """Keep nothing yet.

        Parameters
        ----------
        n_theta : int
            Number of parameters.
        n_inputs : int
            Number of inputs.
        samples : int
            How many samples it may look at.

        Returns
        -------
        ColdStart
        """
        return cls(samples, np.zeros(0), np.zeros((0, n_inputs)), _until_next(samples, 0, n_theta))

    def added(self, y: Array, u: Array) -> ColdStart:
        """Return it with more samples, at most as many as it waits for.

        Parameters
        ----------
        y : ndarray, shape (N,)
            Outputs.
        u : ndarray, shape (N, n_inputs)
            Inputs.

        Returns
        -------
        ColdStart
        """
        # A frozen tracker does not look: it stays due, and a count below 0 would say in a state that there is no start.
        waits, keep = max(self.waits - len(y), 0), max(0, _LONGEST * self.samples - len(y))
        return ColdStart(self.samples, np.append(self.y[-keep:], y), np.concatenate((self.u[-keep:], u)), waits)

    @property
    def is_last_look(self) -> bool:
        """Whether there are as many samples as were asked for."""
        return self.y.size >= self.samples

    def waiting(self, n_theta: int) -> ColdStart:
        """Return it waiting for the next look."""
        return self._replace(waits=_until_next(self.samples, self.y.size, n_theta))

    def levels(self, more: Array) -> Array:
        """Return the median of the outputs before each of some more, and after the last, 0 while there are none."""
        y = np.append(self.y, more)
        found = np.zeros(more.size + 1)
        for k in range(more.size + 1):
            known = y[: self.y.size + k]
            known = known[known == known]
            found[k] = np.median(known) if known.size else 0.0
        return found


def _until_next(samples: int, size: int, n_theta: int) -> int:
    """Return after how many samples the next look is."""
    least = max(20, 5 * (n_theta + 1))
    lengths = [max(samples >> k, 1) for k in (3, 2, 1, 0)]
    later = [length for length in lengths if length > size and (length >= least or length == samples)]
    return later[0] - size if later else max(samples // 4, 1)
