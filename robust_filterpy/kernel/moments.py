"""A correction by an innovation that is not z - H x, by the kernel: that of a nonlinear sensor."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robust_filterpy import kernel
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction
from robust_filterpy.kernel.record import correction_of
from robust_filterpy.kernel.series import rule

__all__ = ["Taken", "correct"]


class Taken(NamedTuple):
    """A correction; what few programs look at is made of its record on request."""

    x: Array
    """Posterior mean, shape (n,)."""
    P: Array
    """Posterior covariance, shape (n, n)."""
    record: Array
    """As `robust_filterpy.kernel.record.correction_of` reads it."""
    memory: Array | None
    """Of the sensors afterwards, shape (m, 10), under scaling "learnt"."""

    @property
    def log_density(self) -> float:
        """Log-likelihood of the innovation under the density of psi."""
        return float(self.record[3])

    def as_arrays(self) -> Correction:
        """Return everything that led to it."""
        return correction_of(self.record, self.x, self.P)


def correct(
    choices: Choices, memory: Array, P: Array, z: Array, y: Array, C: Array, S: Array | None, R: Array
) -> Taken | None:
    """Correct a state at 0: `robust_filterpy.correction.definition.correct` and `correct_by_custom`.

    Parameters
    ----------
    choices : Choices
        Influence function, scaling, information, grouping.
    memory : ndarray, shape (m, 10)
        What is known of the sensors; not changed.
    P, z, y, C, S, R
        As there; or the Jacobian H, shape (m, n), as C, and None as S.

    Returns
    -------
    Taken or None
        None where that is for the definition; nothing has changed in any case.
    """
    extension, what = kernel.extension(), rule(choices)
    if extension is None or what is None:
        return None
    arrays = (None if a is None else np.ascontiguousarray(a) for a in (P, z, y, C, S, R))
    found = extension.correct_moments(what, *arrays, memory)
    return None if found is None else Taken(*found)
