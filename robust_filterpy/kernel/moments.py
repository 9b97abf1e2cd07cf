"""A correction of arrays by the kernel: by linear sensors, and by an innovation that is not z - H x."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robust_filterpy import kernel
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction
from robust_filterpy.kernel.record import correction_of, weights_of
from robust_filterpy.kernel.series import rule

__all__ = ["Taken", "correct", "correct_linear"]


class Taken(NamedTuple):
    """A correction; what few programs look at is made of its record on request."""

    x: Array
    """Posterior mean, shape (n,)."""
    P: Array
    """Posterior covariance, shape (n, n)."""
    record: Array
    """As `robust_filterpy.kernel.record.correction_of` reads it."""
    memory: Array | None
    """Of the sensors afterwards, shape (m, 15), under scaling "learnt"."""

    @property
    def log_density(self) -> float:
        """Log-likelihood of the innovation under the density of psi."""
        return float(self.record[3])

    @property
    def weights(self) -> Array:
        """Of the sensors, shape (m,), NaN where missing."""
        return weights_of(self.record)

    def as_arrays(self) -> Correction:
        """Return everything that led to it."""
        return correction_of(self.record, self.x, self.P)


def correct_linear(
    choices: Choices, memory: Array, x: Array, P: Array, z: Array, H: Array, R: Array, M: Array | None
) -> Taken | None:
    """Correct a state by linear sensors, to the last bit as a filter's step by the kernel does.

    Parameters
    ----------
    choices : Choices
        Influence function, scaling, information, grouping.
    memory : ndarray, shape (m, 15)
        What is known of the sensors; not changed.
    x, P, z, H, R, M
        Shapes (n,), (n, n), (m,) with NaN where missing, (m, n), (m, m) and (n, m).

    Returns
    -------
    Taken or None
        None where that is for the definition; nothing has changed in any case.
    """
    return _by_extension("correct_arrays", choices, (x, P, z, H, R, M), memory)


def correct(
    choices: Choices, memory: Array, P: Array, z: Array, y: Array, C: Array, S: Array | None, R: Array
) -> Taken | None:
    """Correct a state at 0: `robust_filterpy.correction.definition.correct` and `correct_by_custom`.

    Parameters
    ----------
    choices, memory
        As in `correct_linear`.
    P, z, y, C, S, R
        As in these; or the Jacobian H, shape (m, n), as C, and None as S.

    Returns
    -------
    Taken or None
        None where that is for the definition; nothing has changed in any case.
    """
    return _by_extension("correct_moments", choices, (P, z, y, C, S, R), memory)


def _by_extension(name: str, choices: Choices, arrays: tuple[Array | None, ...], memory: Array) -> Taken | None:
    """Call a function of the extension, if there is one and it knows the options."""
    extension, what = kernel.extension(), rule(choices)
    if extension is None or what is None:
        return None
    plain = (None if a is None else np.ascontiguousarray(a) for a in arrays)
    found = getattr(extension, name)(what, *plain, memory)
    return None if found is None else Taken(*found)
