"""The continuous-time system that, sampled with inputs held between the samples, is a model in discrete time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.linalg import logm

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models import regressor as coefficients
from robust_filterpy.identification.models.reduction import observer_form
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.models.time_axis import table
from robust_filterpy.identification.models.uncertainty import Regions, regions

if TYPE_CHECKING:
    import control

# A pole this near to the negative real axis, or to 0, is on it.
_ON: Final = 1e-9


@dataclass(frozen=True, eq=False, repr=False)
class ContinuousModel:
    """x' = A x + B u(t - dead_time), y = C x + D u, which holds for inputs that are held between the samples.

    Attributes
    ----------
    A, B, C, D : ndarray, shape (n, n), (n, m), (p, n), (p, m)
        The matrices, in units of s.
    dead_time : ndarray, shape (m,)
        Of each input, in s, beside the delay of one sample that sampling itself makes.
    poles : Regions
        In 1/s, with regions.
    dt : float
        Sampling period that it was found at, in s.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    dead_time: Array
    poles: Regions
    dt: float

    def __repr__(self) -> str:
        """Show poles and dead times."""
        dead = ", ".join(f"{value:.4g}" for value in self.dead_time)
        return f"ContinuousModel(poles in 1/s: {self.poles!r}, dead time {dead} s)"

    @property
    def time_constants(self) -> Array:
        """1 over the size of each pole, s, shape (n,): the time constant, of a pair one over its natural frequency."""
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / np.abs(self.poles.values))

    def to_control(self) -> control.StateSpace:
        """Return the system without its dead times, which no rational system has.

        Returns
        -------
        control.StateSpace
        """
        import control

        return control.ss(self.A, self.B, self.C, self.D)

    def to_frame(self) -> Any:
        """Return poles and time constants as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            A row for each pole: real, imag, std_real, std_imag, time_constant.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        columns = self.poles.columns() | {"time_constant": self.time_constants}
        return table(columns, range(1, len(self.A) + 1), "pole")


def continuous(
    matrices: tuple[Array, Array, Array, Array], delays: Any, dt: Any, theta: Array, P: Array, roots: Any, level: float
) -> ContinuousModel:
    """Return the system whose samples a model gives."""
    if dt is None:
        raise ValueError("dt: expected the sampling period in s, since the index of the recording did not tell it")
    period = _checks.positive("dt", dt)
    A, B, C, D = matrices
    for pole in np.linalg.eigvals(A):
        if abs(pole.imag) <= _ON and pole.real <= _ON:
            raise ValueError(
                f"poles: expected none at 0 or on the negative real axis, where nothing in continuous time has its "
                f"samples, got {pole.real:.4g}; take a smaller order, or sample faster"
            )
    n, m = B.shape
    whole = np.real(logm(np.block([[A, B], [np.zeros((m, n)), np.eye(m)]]))) / period
    found = regions(theta, P, lambda row: np.log(roots(row).astype(complex)) / period, level, None)
    return ContinuousModel(whole[:n, :n], whole[:n, n:], C, D, period * np.asarray(delays, float), found, period)


def realized(structure: Structure, theta: Array) -> tuple[tuple[Array, Array, Array, Array], list[int]]:
    """Return a polynomial model as matrices in observer form, and the dead time of each input in samples."""
    if structure.takes_phi or not structure.inputs:
        raise ValueError(f"{structure}: expected a model with an input, this one has no way from u to y")
    a = coefficients.denominator(structure, theta)[1:]
    n, delays = a.size, []
    numerators = np.zeros((structure.n_inputs, n + 1))
    for i, (place, (nb, nk)) in enumerate(zip(structure.polynomials.b, structure.inputs, strict=True)):
        least = min(nk, 1)
        if least + nb > n + 1:
            raise ValueError(
                f"nb: expected at most {n + 1 - least} b's with {n} poles, got {nb} for input {i}: more have poles "
                "at 0, which nothing in continuous time has; identify one with more poles or fewer b's"
            )
        numerators[i, least : least + nb] = theta[place]
        delays.append(max(nk - 1, 0))
    return observer_form(a, numerators), delays
