"""What a fleet's devices have in common: an immutable description of a filter or tracker and of its samples.

A model is made once, travels to every worker by pickle, and is never advanced: what moves is in the states.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal, NamedTuple, TypeAlias, TypeVar

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.filters._interruption import StateMixin
from robust_filterpy.fleet import _filters, _trackers
from robust_filterpy.fleet.timeline import POLICIES
from robust_filterpy.identification.structures import Structure

__all__ = ["FilterModel", "Late", "Model", "TrackerModel"]

#: What is done with samples that are not later than the one before them.
Late: TypeAlias = Literal["refuse", "drop"]
_Self = TypeVar("_Self", bound="Model")


class Job(NamedTuple):
    """What one key brings."""

    state: Mapping[str, Any] | None
    """None at its start."""
    z: Array
    """Measurements of each step, shape (N, m), NaN where missing."""
    u: Array | None
    """Inputs of each step, shape (N, p)."""


class Done(NamedTuple):
    """What became of it."""

    state: dict[str, Array]
    """What the next batch goes on from."""
    columns: Array
    """What the model gives for each step, shape (N, c)."""


@dataclass(frozen=True, eq=False)
class Model(ABC):
    """What `FilterModel` and `TrackerModel` share: where a sample's numbers stand, and when it came.

    Attributes
    ----------
    measurements : tuple of str, optional
        Columns of a table that are measured. Default: all but time and inputs.
    inputs : tuple of str, optional
        Columns that are inputs. Default: none.
    time : str, optional
        Column of the times, in seconds or as dates; an array has them first. Default: samples have no times.
    dt : float, optional
        Sampling period in seconds: what is missing between two times becomes steps without a measurement, with the
        input before it. Default: every sample is a step.
    late : {"refuse", "drop"}
        What is done with a sample that is not later than the one before it.
    """

    measurements: tuple[str, ...] | None = field(default=None, kw_only=True)
    inputs: tuple[str, ...] | None = field(default=None, kw_only=True)
    time: str | None = field(default=None, kw_only=True)
    dt: float | None = field(default=None, kw_only=True)
    late: Late = field(default="refuse", kw_only=True)

    def __post_init__(self) -> None:
        """Check the description of the samples."""
        for name in ("measurements", "inputs"):
            value = getattr(self, name)
            if isinstance(value, str):
                raise TypeError(f"{name}: expected a list of names, got {value!r}; use [{value!r}]")
            object.__setattr__(self, name, None if value is None else tuple(value))
        _checks.option("late", self.late, POLICIES)
        if self.dt is not None:
            _checks.positive("dt", self.dt)
            if self.time is None:
                raise ValueError("time: expected the name of the column of times for dt, got None")

    def reading(
        self: _Self,
        *,
        time: str | None = None,
        measurements: Sequence[str] | None = None,
        inputs: Sequence[str] | None = None,
    ) -> _Self:
        """Return the same model for a table with these columns.

        Parameters
        ----------
        time : str, optional
            Column of the times; as it is if not given.
        measurements, inputs : sequence of str, optional
            Columns of measurements and inputs; as they are if not given.

        Returns
        -------
        Model
        """
        given: dict[str, Any] = {"time": time, "measurements": measurements, "inputs": inputs}
        return replace(self, **{name: value for name, value in given.items() if value is not None})

    @property
    @abstractmethod
    def columns(self) -> tuple[str, ...]:
        """Names of what it gives for each sample."""

    @property
    @abstractmethod
    def widths(self) -> tuple[int, int]:
        """Number of measurements and of inputs."""

    @abstractmethod
    def advance(self, jobs: Sequence[Job]) -> list[Done | Exception]:
        """Advance many keys; one that is refused does not stop the others.

        Parameters
        ----------
        jobs : sequence of Job
            State, measurements and inputs of each key.

        Returns
        -------
        list of Done or Exception
            For each key its state and columns, or what was wrong.
        """


@dataclass(frozen=True, eq=False)
class FilterModel(Model):
    """A filter that every device of a fleet has.

    Attributes
    ----------
    filter : filter object
        Any filter of this package, set up: matrices, x and P to start from, choices. It is copied; `template` returns
        a copy.
    update : mapping of str to Any
        Further arguments of the filter's ``update``, such as ``HJacobian`` and ``Hx``.
    measurements, inputs, time, dt, late : optional
        Where a sample's numbers stand, and when it came, as in `Model`.

    Raises
    ------
    TypeError
        If filter has no ``state`` and ``restore``.
    ValueError
        If an argument is out of range, or the filter's matrices do not fit each other.

    Notes
    -----
    Columns: ``x0``, .. and their standard deviations ``std0``, .. after each sample, and ``weight0``, ..: how much each
    measurement was believed, NaN where it was missing.

    A plain `RobustKalmanFilter` goes through the compiled loops, all keys with equally many samples together.

    Examples
    --------
    >>> from robust_filterpy import RobustKalmanFilter
    >>> kf = RobustKalmanFilter(1, 1)
    >>> kf.H, kf.Q = np.eye(1), 0.01 * np.eye(1)
    >>> FilterModel(kf, time="t").columns
    ('x0', 'std0', 'weight0')
    """

    filter: Any = field(repr=False)
    update: Mapping[str, Any] = field(default_factory=dict, kw_only=True, repr=False)

    def __post_init__(self) -> None:
        """Copy the filter, and try it."""
        super().__post_init__()
        if not isinstance(self.filter, StateMixin):
            raise TypeError(
                f"filter: expected a filter of this package, with state() and restore(), got "
                f"{type(self.filter).__name__}; robust_filterpy.robust makes one of filterpy's"
            )
        object.__setattr__(self, "filter", copy.deepcopy(self.filter))
        object.__setattr__(self, "update", dict(self.update))
        _filters.require_consistent(self.filter, self.update)

    def template(self) -> Any:
        """Return a copy of the filter as it is at the start.

        Returns
        -------
        filter object
        """
        return copy.deepcopy(self.filter)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of what it gives for each sample."""
        n, m = self.filter.dim_x, self.filter.dim_z
        return (*(f"x{i}" for i in range(n)), *(f"std{i}" for i in range(n)), *(f"weight{i}" for i in range(m)))

    @property
    def widths(self) -> tuple[int, int]:
        """Number of measurements and of inputs."""
        B = getattr(self.filter, "B", None)
        return self.filter.dim_z, 0 if B is None or np.ndim(B) != 2 else np.shape(B)[1]

    def advance(self, jobs: Sequence[Job]) -> list[Done | Exception]:
        """Advance many keys; one that is refused does not stop the others.

        Parameters
        ----------
        jobs : sequence of Job
            State, measurements and inputs of each key.

        Returns
        -------
        list of Done or Exception
            For each key its state and columns, or what was wrong.
        """
        found = _filters.advance(self.filter, self.update, self._plain, jobs)
        return [one if isinstance(one, Exception) else Done(*one) for one in found]

    @cached_property
    def _plain(self) -> _filters.Plain | None:
        """What the compiled loops need, None if they do not serve."""
        return _filters.plain(self.filter)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what can be made anew."""
        return {name: value for name, value in vars(self).items() if name != "_plain"}


@dataclass(frozen=True, eq=False)
class TrackerModel(Model):
    """A `ParameterTracker` that every device of a fleet has.

    Attributes
    ----------
    structure : Structure
        ARX, OutputError, ARMAX, FIR or LinearRegression.
    options : mapping of str to Any
        Arguments of `ParameterTracker`, by name. No filter object: its class, if any.
    measurements, inputs, time, dt, late : optional
        Where a sample's numbers stand, and when it came, as in `Model`.

    Raises
    ------
    TypeError, ValueError
        As by `ParameterTracker`.

    Notes
    -----
    Columns: the parameters by name, ``std_`` and their names, ``prediction``, ``residual``, ``weight`` and ``guard`` as
    in `ParameterTracker.update`.

    Examples
    --------
    >>> from robust_filterpy import ARX
    >>> TrackerModel(ARX(1, 1), {"start": 0}, measurements=["y"], inputs=["u"]).columns
    ('a1', 'b1', 'std_a1', 'std_b1', 'prediction', 'residual', 'weight', 'guard')
    """

    structure: Structure
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the arguments by making a tracker."""
        super().__post_init__()
        object.__setattr__(self, "options", MappingProxyType(dict(self.options)))
        if not isinstance(self.options.get("filter", type), type):
            raise TypeError("options: expected the class of a filter, got an object, which trackers would share")
        self.template()

    def template(self) -> _trackers.EvenTracker:
        """Return a tracker as it is at the start.

        Returns
        -------
        ParameterTracker
        """
        return _trackers.EvenTracker(self.structure, **self.options)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of what it gives for each sample."""
        names = self.structure.names
        return (*names, *(f"std_{name}" for name in names), "prediction", "residual", "weight", "guard")

    @property
    def widths(self) -> tuple[int, int]:
        """Number of measurements and of inputs."""
        return 1, self.structure.n_inputs

    def advance(self, jobs: Sequence[Job]) -> list[Done | Exception]:
        """Advance many keys; one that is refused does not stop the others.

        Parameters
        ----------
        jobs : sequence of Job
            State, measurements and inputs of each key.

        Returns
        -------
        list of Done or Exception
            For each key its state and columns, or what was wrong.
        """
        found = _trackers.advance(self.template(), jobs)
        return [one if isinstance(one, Exception) else Done(*one) for one in found]

    def __getstate__(self) -> dict[str, Any]:
        """Return plain attributes: a read-only view has no pickle."""
        return {**vars(self), "options": dict(self.options)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make the options read only again."""
        for name, value in state.items():
            object.__setattr__(self, name, MappingProxyType(value) if name == "options" else value)
