"""The three independent choices of a robust filter, and how psi meets several sensors: checked, and evaluated."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, fields, replace
from functools import cached_property, lru_cache
from typing import Any, Final, Literal, TypeAlias

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.influence.functions import Huber, Influence, Linear
from robust_filterpy.influence.information import expected_information, expected_joint_information

__all__ = ["GROUPINGS", "INFORMATIONS", "NO_PART", "SCALINGS", "Choices", "Grouping", "Information", "Scaling"]

Scaling: TypeAlias = Literal["learnt", "innovation", "unit", "bounded"]
Information: TypeAlias = Literal["realized", "expected", "weight"]
Grouping: TypeAlias = Literal["component", "joint"] | tuple[tuple[int, ...], ...]
SCALINGS: Final[tuple[Scaling, ...]] = ("learnt", "innovation", "unit", "bounded")
INFORMATIONS: Final[tuple[Information, ...]] = ("realized", "expected", "weight")
GROUPINGS: Final[tuple[str, ...]] = ("component", "joint")

# Above this a third-party psi may overflow: norms of statsmodels take the eighth power of e.
_BEARABLE = 1e30
# Below this correlation with every state a sensor is one that the state has no part in.
NO_PART = 1e-12


@dataclass(frozen=True)
class Choices:
    """Hold the choices of a robust filter.

    Parameters
    ----------
    influence : Influence, default Huber(1.345)
        psi, with its rho, psi_deriv and weights.
    scaling : {"learnt", "innovation", "unit", "bounded"}
        t in e = t y, sensor by sensor: S_ii^(-1/2) with thresholds in units of what that is usually, S_ii^(-1/2) with
        thresholds as they are (paper 36), 1 (42), or 1/sqrt(max(S_ii, 1)).
    information : {"realized", "expected", "weight"}
        d in P+ = P - C T' D T C': psi'(e) (46, 49), E[psi'] (40, 45), or psi(e)/e; clipped to [0, 1].
    grouping : {"component", "joint"} or tuple of tuple of int
        Which sensors fail together: none, all, or those named, such as ``((0, 1), (2,))``; sensors in no tuple fail
        on their own.
    patience : int, optional
        Under "learnt", after how many innovations in a row that agree the state has jumped, >= 2; default: learned.

    Raises
    ------
    TypeError
        If influence lacks one of ``rho, psi, psi_deriv, weights``, or an option is no string.
    ValueError
        If an option is unknown, or patience is given where no jump is believed.

    Examples
    --------
    >>> Choices(scaling="bounded").information
    'realized'
    """

    influence: Any = Huber()
    scaling: Scaling = "innovation"
    information: Information = "realized"
    grouping: Grouping = "component"
    patience: int | None = None

    def __post_init__(self) -> None:
        """Check every choice."""
        if isinstance(self.influence, type) or not isinstance(self.influence, Influence):
            raise TypeError(
                f"influence: expected an object with rho, psi, psi_deriv and weights, such as Huber(1.345), "
                f"got {self.influence!r}"
            )
        _checks.option("scaling", self.scaling, SCALINGS)
        _checks.option("information", self.information, INFORMATIONS)
        object.__setattr__(self, "grouping", checked_grouping(self.grouping))
        if self.patience is not None and _checks.count("patience", self.patience, 2) and not self.by_typical:
            raise ValueError(
                "patience: expected none, or scaling='learnt' with a psi that bounds innovations, which believes "
                f"a jump after so many readings; got scaling={self.scaling!r} and {self.influence!r}"
            )

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
    def kernel_psi(self) -> tuple[str, dict[str, float]] | None:
        """The kernel's name of psi and its numbers by the names of their attributes, None if it does not know it."""
        name = getattr(self.influence, "kernel_name", None)
        if name is None:
            return None
        return name, {field: getattr(self.influence, field) for field in self.influence.kernel_fields}

    @cached_property
    def derived(self) -> dict[Any, Any]:
        """What the kernel makes of these choices, kept here since they never change."""
        return {}

    @cached_property
    def is_linear(self) -> bool:
        """Whether psi is the identity, that is, the filter is Kalman's."""
        unbounded = isinstance(self.influence, Linear) or getattr(self.influence, "threshold", 0.0) == np.inf
        # A user's subclass of Linear may have a psi of its own, which the kernel does not know.
        return unbounded and self.kernel_psi is not None

    @cached_property
    def by_typical(self) -> bool:
        """Whether thresholds are in units of a spread that is learnt; the Kalman filter has none."""
        return self.scaling == "learnt" and not self.is_linear

    @cached_property
    def expected(self) -> float:
        """E[psi'] clipped to [0, 1] (paper 40, 45)."""
        return min(max(expected_information(self.influence), 0.0), 1.0)

    def groups(self, y: Array, C: Array, S: Array, P: Array) -> list[list[int]]:
        """Return which sensors fail together, those that were observed.

        Parameters
        ----------
        y : ndarray, shape (m,)
            Innovation; NaN marks a missing component.
        C : ndarray, shape (n, m)
            Covariance of the state and the innovation.
        S : ndarray, shape (m, m)
            Innovation covariance.
        P : ndarray, shape (n, n)
            Covariance of the state.

        Returns
        -------
        list of list of int
            A sensor that the state has no part in can tell the state nothing, and is in a group of its own: its
            innovation would only lengthen the others'.
        """
        m = len(y)
        seen = (y == y).tolist()
        if self.grouping == "component":
            return [[i] for i in range(m) if seen[i]]
        named = (tuple(range(m)),) if self.grouping == "joint" else self.grouping
        # Sigma points leave rounding, not zeros.
        unit = np.sqrt(np.outer(np.maximum(P.diagonal(), 0.0), np.maximum(S.diagonal(), 0.0)))
        visible = (np.abs(C) > NO_PART * unit).any(axis=0).tolist()
        together = [[i for i in group if i < m and seen[i] and visible[i]] for group in named]
        alone = set(range(m)) - {i for group in together for i in group}
        return [group for group in together if group] + [[i] for i in sorted(alone) if seen[i]]

    def influence_on(self, e: Array, s: float) -> tuple[Array, Array, Array, Array, float]:
        """Apply psi to the standardized innovation of a group of sensors, with its threshold in units of s.

        Parameters
        ----------
        e : ndarray, shape (k,)
            Standardized innovation, finite.
        s : float
            Spread of this group's standardized innovations.

        Returns
        -------
        psi : ndarray, shape (k,)
            s psi(e/s); for a group, psi of the length in the direction of e.
        D : ndarray, shape (k, k)
            Information, symmetric, its eigenvalues in [0, 1]: psi' for one sensor; for a group the Jacobian of psi, its
            mean, or psi(|e|)/|e| times I.
        weights : ndarray, shape (k,)
            psi(e)/e.
        psi_deriv : ndarray, shape (k,)
            psi'(e); for a group psi'(|e|) in every place.
        length : float
            How far out the group is: |e| over the median of what its length is without outliers, times that of one.
        """
        k = len(e)
        # One sensor keeps its sign, for a psi that is not odd.
        size, direction = (float(e[0]), np.ones(1)) if k == 1 else length_and_direction(e)
        relative = size / s
        along, psi_deriv = self.psi_of(relative)
        weight = along / relative if relative != 0.0 else 1.0
        if self.information == "expected":
            across = radial = _bounded(self.expected if k == 1 else expected_joint_information(self.influence, k))
        else:
            across = _bounded(weight)
            radial = _bounded(psi_deriv) if self.information == "realized" and size != 0.0 else across
        if k == 1:
            D = np.array([[radial]])
        else:
            D = across * np.eye(k) + (radial - across) * np.outer(direction, direction)
        # An innovation that is not bounded stays as it is to the last bit.
        psi = e if weight == 1.0 else s * along * direction
        return psi, D, np.full(k, weight), np.full(k, psi_deriv), abs(size) * typical_length(k)

    def psi_of(self, length: float) -> tuple[float, float]:
        """Return psi and psi' of one number."""
        at = np.array([length])
        return self.evaluated("psi", at).item(), self.evaluated("psi_deriv", at).item()

    def rho_of(self, length: float) -> float:
        """Return rho of one number."""
        return self.evaluated("rho", np.array([length])).item()

    def evaluated(self, name: str, e: Array) -> Array:
        """Return rho, psi or psi_deriv of e, shape (m,), by the influence function's own vectorized method.

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
        if self.kernel_psi is not None:
            return np.asarray(getattr(self.influence, name)(e), dtype=float)
        values = np.asarray(getattr(self.influence, name)(np.clip(e, -_BEARABLE, _BEARABLE)), dtype=float)
        if values.shape != e.shape or not np.isfinite(values).all():
            got = f"shape {values.shape}" if values.shape != e.shape else f"{values} for e = {e}"
            raise ValueError(
                f"influence: expected finite numbers of shape {e.shape} from {self.influence!r}.{name}, got {got}"
            )
        return values


def checked_grouping(value: Any) -> Any:
    """Return a grouping as a string or a tuple of tuples of int, or raise."""
    if isinstance(value, str):
        return _checks.option("grouping", value, GROUPINGS)
    try:
        groups = tuple(tuple(_checks.count("grouping", i) for i in group) for group in value)
    except TypeError:
        raise TypeError(
            f"grouping: expected 'component', 'joint' or groups of sensors such as ((0, 1), (2,)), got {value!r}"
        ) from None
    sensors = [i for group in groups for i in group]
    if len(set(sensors)) < len(sensors) or not all(groups):
        raise ValueError(f"grouping: expected groups of sensors that name each sensor once, got {_checks.shown(value)}")
    return groups


def leads(grouping: Grouping, m: int) -> np.ndarray:
    """Return for each of m sensors the first one of those that fail together with it, itself if none does."""
    named: Any = {"component": (), "joint": (range(m),)}.get(grouping, grouping)  # type: ignore[arg-type]
    first = np.arange(m)
    for group in named:
        first[[i for i in group if i < m]] = min(group, default=0)
    return first


@lru_cache(maxsize=64)
def typical_length(k: int) -> float:
    """Return the median of \\|e\\| for one sensor over that for k, without outliers."""
    if k == 1:
        return 1.0
    from scipy import stats

    return float(stats.chi.median(1) / stats.chi.median(k))


def _bounded(number: float) -> float:
    """Return a number clipped to [0, 1]."""
    return min(max(number, 0.0), 1.0)


def length_and_direction(e: Array) -> tuple[float, Array]:
    """Return |e|, at most the largest float, and e/|e| (0 if e = 0), without overflow."""
    peak = max(map(abs, e.tolist()))
    if peak == 0.0:
        return 0.0, e
    relative = e / peak
    length = math.sqrt(relative.dot(relative))
    return min(peak * length, sys.float_info.max), relative / length
