"""The three independent choices of a robust filter, and how psi meets several sensors: checked, and evaluated."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.influence.functions import Huber, Influence, Linear
from robust_filterpy.influence.information import expected_information, expected_joint_information

__all__ = ["GROUPINGS", "INFORMATIONS", "SCALINGS", "Choices", "Grouping", "Information", "Scaling"]

Scaling: TypeAlias = Literal["innovation", "unit", "bounded"]
Information: TypeAlias = Literal["realized", "expected", "weight"]
Grouping: TypeAlias = Literal["component", "joint"]
SCALINGS: Final[tuple[Scaling, ...]] = ("innovation", "unit", "bounded")
INFORMATIONS: Final[tuple[Information, ...]] = ("realized", "expected", "weight")
GROUPINGS: Final[tuple[Grouping, ...]] = ("component", "joint")

# Above this a third-party psi may overflow: norms of statsmodels take the eighth power of e.
_BEARABLE = 1e30


@dataclass(frozen=True)
class Choices:
    """Hold the choices of a robust filter.

    Parameters
    ----------
    influence : Influence, default Huber(1.345)
        psi, with its rho, psi_deriv and weights.
    scaling : {"innovation", "unit", "bounded"}
        T in e = T y: S^(-1/2) (paper 36), I (42), or S^(-1/2) with the eigenvalues of S floored at 1.
    information : {"realized", "expected", "weight"}
        d in P+ = P - C T' D T C': psi'(e) (46, 49), E[psi'] (40, 45), or psi(e)/e; clipped to [0, 1].
    grouping : {"component", "joint"}
        psi of each component of e, or of its length.

    Raises
    ------
    TypeError
        If influence lacks one of ``rho, psi, psi_deriv, weights``, or an option is no string.
    ValueError
        If an option is unknown.

    Examples
    --------
    >>> Choices(scaling="bounded").information
    'realized'
    """

    influence: Any = Huber()
    scaling: Scaling = "innovation"
    information: Information = "realized"
    grouping: Grouping = "component"

    def __post_init__(self) -> None:
        """Check every choice."""
        if isinstance(self.influence, type) or not isinstance(self.influence, Influence):
            raise TypeError(
                f"influence: expected an object with rho, psi, psi_deriv and weights, such as Huber(1.345), "
                f"got {self.influence!r}"
            )
        _checks.option("scaling", self.scaling, SCALINGS)
        _checks.option("information", self.information, INFORMATIONS)
        _checks.option("grouping", self.grouping, GROUPINGS)

    def changed(self, **choice: Any) -> Choices:
        """Return the same choices but for the ones given."""
        return replace(self, **choice)

    def __getstate__(self) -> dict[str, Any]:
        """Return the choices alone: the rest follows from them."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def __deepcopy__(self, memo: dict[int, Any]) -> Choices:
        """Return self: nothing in here changes, and filterpy's Saver copies a filter at every epoch."""
        return self

    @cached_property
    def pointwise(self) -> tuple[Callable[..., tuple[float, float]], float, float, float] | None:
        """psi and psi' of one float and their parameters, if the influence function has that form."""
        if getattr(self.influence, "pointwise", None) is not None:
            return (self.influence.pointwise, *self.influence.parameters)
        return None

    @cached_property
    def derived(self) -> dict[Any, Any]:
        """What the kernel makes of these choices, kept here since they never change."""
        return {}

    @cached_property
    def is_linear(self) -> bool:
        """Whether psi is the identity, that is, the filter is Kalman's."""
        unbounded = isinstance(self.influence, Linear) or getattr(self.influence, "threshold", 0.0) == np.inf
        # A user's subclass of Linear may have a psi of its own, and then has no pointwise form.
        return unbounded and self.pointwise is not None

    @cached_property
    def expected(self) -> float:
        """E[psi'] clipped to [0, 1] (paper 40, 45)."""
        return min(max(expected_information(self.influence), 0.0), 1.0)

    def apply_influence(self, e: Array, visible: Any = None) -> tuple[Array, Array | list[float], list[float]]:
        """Apply psi to a standardized innovation.

        Parameters
        ----------
        e : ndarray, shape (m,)
            Standardized innovation, finite.
        visible : ndarray of bool, shape (m,), optional
            For joint grouping: the components that the state has a part in. The length is taken over these;
            the others, which cannot tell the state anything, are treated one by one.

        Returns
        -------
        psi : ndarray, shape (m,)
            psi(e).
        D : list of m floats, or ndarray, shape (m, m)
            Information: its diagonal, or the matrix if that is not diagonal.
        psi_deriv : list of m floats
            psi'(e); for joint grouping psi'(\\|e\\|) in every place.
        """
        if self.grouping == "component":
            return self._componentwise(e)
        if visible is None or visible.all():
            return self._jointly(e)
        return self._jointly_where(e, visible)

    def evaluated(self, name: str, e: Array) -> Array:
        """Return rho, psi or psi_deriv of e, shape (m,), by the influence function's own vectorised method.

        Parameters
        ----------
        name : {"rho", "psi", "psi_deriv"}
            Which method.
        e : ndarray, shape (m,)
            Standardized innovation, finite.

        Returns
        -------
        ndarray, shape (m,)

        Raises
        ------
        ValueError
            If a third-party influence function returns another shape, or numbers that are not finite.
        """
        if self.pointwise is not None:
            return np.asarray(getattr(self.influence, name)(e), dtype=float)
        found = np.asarray(getattr(self.influence, name)(np.clip(e, -_BEARABLE, _BEARABLE)), dtype=float)
        if found.shape != e.shape or not np.isfinite(found).all():
            got = f"shape {found.shape}" if found.shape != e.shape else f"{found} for e = {e}"
            raise ValueError(
                f"influence: expected finite numbers of shape {e.shape} from {self.influence!r}.{name}, got {got}"
            )
        return found

    def _componentwise(self, e: Array) -> tuple[Array, list[float], list[float]]:
        """Apply psi to each component."""
        if self.pointwise is not None and len(e) <= 8:
            function, a, b, c = self.pointwise
            values, moved, psi_deriv = e.tolist(), [], []
            for value in values:
                p, d = function(value, a, b, c)
                moved.append(p)
                psi_deriv.append(d)
            psi = e if moved == values else np.array(moved)
        else:
            psi, psi_deriv = self.evaluated("psi", e), self.evaluated("psi_deriv", e).tolist()
        if self.information == "expected":
            return psi, [self.expected] * len(e), psi_deriv
        D = psi_deriv if self.information == "realized" else ratio(psi, e).tolist()
        if D.count(1.0) + D.count(0.0) < len(D):
            D = [min(max(d, 0.0), 1.0) for d in D]
        return psi, D, psi_deriv

    def _jointly(self, e: Array) -> tuple[Array, Array | list[float], list[float]]:
        """Apply psi to the length: psi(e) = w(|e|) e, D its Jacobian, its mean, or w I."""
        m = e.size
        length, direction = length_and_direction(e)
        along, psi_deriv, across, radial = self.apply_to_length(length, m)
        if across == radial:
            return along * direction, [across] * m, [psi_deriv] * m
        column = direction[:, None]
        D = (radial - across) * column.dot(column.T)
        D.ravel()[:: m + 1] += across
        return along * direction, D, [psi_deriv] * m

    def apply_to_length(self, length: float, m: int) -> tuple[float, float, float, float]:
        """Apply psi to the length of several components.

        Parameters
        ----------
        length : float
            Length of e, >= 0.
        m : int
            How many components it is taken over.

        Returns
        -------
        psi, psi_deriv : float
            psi and psi' of the length.
        across, along : float
            Eigenvalues of D: of the directions across e, and of that along e.
        """
        if self.pointwise is not None:
            function, a, b, c = self.pointwise
            along, psi_deriv = function(length, a, b, c)
        else:
            at = np.array([length])
            along, psi_deriv = self.evaluated("psi", at).item(), self.evaluated("psi_deriv", at).item()
        if self.information == "expected":
            across = min(max(expected_joint_information(self.influence, m), 0.0), 1.0)
        else:
            across = min(max(along / length, 0.0), 1.0) if length > 0.0 else 1.0
        radial = min(max(psi_deriv, 0.0), 1.0) if self.information == "realized" and length > 0.0 else across
        return along, psi_deriv, across, radial

    def _jointly_where(self, e: Array, visible: np.ndarray) -> tuple[Array, Array, list[float]]:
        """Take the visible components together and the others one by one."""
        psi, diagonal, derivatives = self._componentwise(e.copy())
        D, psi_deriv = np.diag(diagonal), np.array(derivatives)
        if visible.any():
            psi[visible], together, psi_deriv[visible] = self._jointly(e[visible])
            D[np.ix_(visible, visible)] = np.diag(together) if isinstance(together, list) else together
        return psi, D, psi_deriv.tolist()


def length_and_direction(e: Array) -> tuple[float, Array]:
    """Return |e|, at most the largest float, and e/|e| (0 if e = 0), without overflow."""
    peak = max(map(abs, e.tolist()))
    if peak == 0.0:
        return 0.0, e
    relative = e / peak
    length = math.sqrt(relative.dot(relative))
    return min(peak * length, sys.float_info.max), relative / length


def ratio(psi: Array, e: Array) -> Array:
    """Return psi/e, 1 where e = 0."""
    weights = np.ones_like(e)
    with np.errstate(under="ignore"):
        np.divide(psi, e, out=weights, where=e != 0.0)
    return weights
