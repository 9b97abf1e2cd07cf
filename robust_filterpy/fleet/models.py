"""What a fleet's devices have in common: an immutable description of a filter or tracker and of its samples.

A model is made once, travels to every worker by pickle, and is never advanced: what moves is in the states.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._brief import wrapped
from robust_filterpy._checks import Array
from robust_filterpy._state import LABEL, Shape, labelled
from robust_filterpy.filters.states import StateMixin, moved_shapes, settings_of
from robust_filterpy.fleet import _advancing
from robust_filterpy.fleet._advancing import Plain, Work
from robust_filterpy.fleet.reading import POLICIES
from robust_filterpy.fleet.states import FLEET, checked
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive.tracker import ParameterTracker

#: What is done with samples that are not later than the one before them.
Late: TypeAlias = Literal["refuse", "drop"]


@dataclass(frozen=True, eq=False)
class Model:
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
    late : {"refuse", "drop"}, optional
        What is done with a sample that is not later than the one before it: named in ``error``, or left out and
        counted. Default: streams of messages drop it, tables and batches name it.
    """

    #: Names of what it gives for each sample; number of measurements and of inputs; what its states belong to; entries
    #: of a state that may hold NaN; at the start, their shapes, what makes the model this one, steps of many keys.
    columns: ClassVar[Any]
    widths: ClassVar[Any]
    kind: ClassVar[Any]
    gaps: ClassVar[tuple[str, ...]] = ()
    start: ClassVar[Any]
    _shapes: ClassVar[Any]
    _said: ClassVar[Any]
    advance: ClassVar[Any]

    measurements: tuple[str, ...] | None = field(default=None, kw_only=True)
    inputs: tuple[str, ...] | None = field(default=None, kw_only=True)
    time: str | None = field(default=None, kw_only=True)
    dt: float | None = field(default=None, kw_only=True)
    late: Late | None = field(default=None, kw_only=True)

    def __str__(self) -> str:
        """Return what it is made of, on lines that a screen holds."""
        return wrapped(repr(self))

    def __post_init__(self) -> None:
        """Check the description of the samples."""
        for name in ("measurements", "inputs"):
            value = getattr(self, name)
            if isinstance(value, str):
                raise TypeError(f"{name}: expected a list of names, got {_checks.shown(value)}; use [{value!r}]")
            object.__setattr__(self, name, None if value is None else tuple(value))
        if self.late is not None:
            _checks.option("late", self.late, POLICIES)
        if self.dt is not None:
            _checks.positive("dt", self.dt)
            if self.time is None:
                raise ValueError("time: expected the name of the column of times for dt, got None")

    @cached_property
    def shapes(self) -> dict[str, Shape]:
        """Shapes of the entries of a state, those that a fleet adds among them."""
        shapes = {**self._shapes(), **FLEET, "input": (self.widths[1],)}
        return shapes if self.widths[1] else {name: shape for name, shape in shapes.items() if name != "input"}

    @cached_property
    def label(self) -> Array:
        """``format`` of its states."""
        label = labelled(self.kind, {})[LABEL]
        label.flags.writeable = False
        return label

    @cached_property
    def fingerprint(self) -> float:
        """A number that another model does not have: of its matrices, to nine digits, choices and sampling period."""
        hashed = hashlib.sha256(self.kind.encode())
        for name, value in (*self._said(), ("dt", self.dt)):
            hashed.update(f"{name}:{_spelt(value)}\n".encode())
        return float(int.from_bytes(hashed.digest()[:6], "big"))

    def adopt(self, state: Any) -> dict[str, Array]:
        """Return a state of another model as one of this one: asked for, it is gone on from.

        Parameters
        ----------
        state : mapping of str to ndarray
            From `step`, of one key.

        Returns
        -------
        dict of str to ndarray

        Raises
        ------
        ValueError
            If it is of another class or structure, or damaged.
        """
        entries = checked(state, self)
        return {LABEL: self.label.copy(), **entries, "model": np.array([self.fingerprint])}

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what can be made anew."""
        return {name: value for name, value in vars(self).items() if name not in _DERIVED}


# What is made of a model's fields when it is first asked for.
_DERIVED = ("shapes", "label", "fingerprint", "_plain", "_tracker")


def _spelt(value: Any) -> str:
    """Return a value as text that is the same on every machine."""
    if isinstance(value, np.ndarray) or (np.isscalar(value) and not isinstance(value, str)):
        array = np.asarray(value)
        if array.dtype.kind in "fiub":
            # An exponential may differ in its last digit from one machine to another.
            return f"{array.shape}{[format(number, '.9g') for number in array.ravel().tolist()]}"
    if isinstance(value, (list, tuple)):
        return f"[{','.join(map(_spelt, value))}]"
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{name}={_spelt(value[name])}' for name in sorted(value))}}}"
    if callable(value):
        return f"{getattr(value, '__module__', '')}.{getattr(value, '__qualname__', type(value).__qualname__)}"
    text = repr(value)
    # An object that does not say what it is has its address in its name.
    return type(value).__qualname__ if " at 0x" in text else text


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

    A plain `RobustKalmanFilter` goes through the kernel, all keys with equally many samples together.

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
        _advancing.require_consistent(self.filter, self.update)
        if self.measurements is not None and len(self.measurements) != self.filter.dim_z:
            raise ValueError(
                f"measurements: expected {self.filter.dim_z} column(s) for dim_z={self.filter.dim_z}, got "
                f"{list(self.measurements)}"
            )

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

    @property
    def kind(self) -> str:
        """What its states belong to."""
        return type(self.filter).__name__

    def start(self) -> dict[str, Array]:
        """Return the entries of a state at the start.

        Returns
        -------
        dict of str to ndarray
        """
        # Of sensors of which nothing was learned yet, zeros.
        empty = {name: np.zeros([size or 0 for size in shape]) for name, shape in self._shapes().items()}
        return {**empty, **{name: part for name, part in self.filter.state().items() if name in empty}}

    def _shapes(self) -> dict[str, Shape]:
        """Return the shapes of these."""
        return moved_shapes(self.filter)

    def _said(self) -> Iterator[tuple[str, Any]]:
        """Yield what makes the model this one: matrices, choices, functions."""
        kf = self.filter
        yield from (item for item in sorted(settings_of(kf).items()) if item[0] not in _MOVED)
        choices = ("influence", "scaling", "information", "grouping", "process", "noise", "patience", "hx", "fx", "dt")
        yield from ((name, getattr(kf, name)) for name in choices if name in vars(kf))
        yield "choices", repr(kf.choices)
        yield "update", self.update

    def advance(self, work: Work) -> None:
        """Take the steps of many keys; one that is refused does not stop the others.

        Parameters
        ----------
        work : Work
            States and samples, written into.
        """
        _advancing.advance_filters(self.filter, self.update, self._plain, work)

    @cached_property
    def _plain(self) -> Plain | None:
        """What the kernel needs, None if it does not serve."""
        return _advancing.plain(self.filter, self.update)


# What a correction shows, among what a filter calls its settings; what of a tracker's state the model says.
_MOVED, _SETTINGS = ("K", "S", "SI", "sigmas_f"), ("Q", "F", "alpha_sq", LABEL)


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

    gaps: ClassVar[tuple[str, ...]] = ("start", "followed")

    structure: Structure
    options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the arguments by making a tracker."""
        super().__post_init__()
        object.__setattr__(self, "options", dict(self.options))
        if hasattr(self.options.get("filter", type), "update") and not isinstance(self.options["filter"], type):
            raise TypeError("options: expected the class of a filter, got an object, which trackers would share")
        self.template()

    def template(self) -> ParameterTracker:
        """Return a tracker as it is at the start.

        Returns
        -------
        ParameterTracker
        """
        return ParameterTracker(self.structure, **self.options)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of what it gives for each sample."""
        names = self.structure.names
        return (*names, *(f"std_{name}" for name in names), "prediction", "residual", "weight", "guard")

    @property
    def widths(self) -> tuple[int, int]:
        """Number of measurements and of inputs."""
        return 1, self.structure.n_inputs

    @property
    def kind(self) -> str:
        """What its states belong to."""
        return self._tracker.kind

    def start(self) -> dict[str, Array]:
        """Return the entries of a state at the start.

        Returns
        -------
        dict of str to ndarray
        """
        return {name: value for name, value in self._tracker.state().items() if name not in _SETTINGS}

    def _shapes(self) -> dict[str, Shape]:
        """Return the shapes of these; how long a recording is kept for a start or watched, no one knows beforehand."""
        shapes: dict[str, Shape] = {name: value.shape for name, value in self.start().items()}
        return {**shapes, **{name: (None, *shapes[name][1:]) for name in ("start", "followed")}}

    @cached_property
    def _tracker(self) -> ParameterTracker:
        """A tracker at the start, never advanced."""
        return self.template()

    def _said(self) -> Iterator[tuple[str, Any]]:
        """Yield what makes the model this one."""
        yield "structure", repr(self.structure)
        yield "options", self.options

    def advance(self, work: Work) -> None:
        """Take the steps of many keys; one that is refused does not stop the others.

        Parameters
        ----------
        work : Work
            States and samples, written into.
        """
        _advancing.advance_trackers(self.template(), work)
