"""Filters that are put away and go on later, elsewhere: `state` and `restore`."""

from __future__ import annotations

import json
from typing import Any, ClassVar, Final

import numpy as np

from robust_filterpy import _state
from robust_filterpy._arrays import state_of
from robust_filterpy._checks import Array
from robust_filterpy.correction.spread import NUMBERS
from robust_filterpy.filters._learning import LearningMixin
from robust_filterpy.filters._sensors import Customs
from robust_filterpy.filters.snapshot import whole

#: Arrays of a state that may hold NaN.
GAPS: Final = ("insisting",)


class StateMixin(LearningMixin):
    """Give a filter's state as plain arrays, and go on from one.

    A subclass adds to `_moving` and `_needed` what a step moves besides x, P and what its policy knows, and takes it
    over in `_go_on`.
    """

    __slots__ = ()

    #: What else the filter's behaviour depends on: name in a state, attribute. A state without it leaves it as it is.
    _settings: ClassVar[dict[str, str]] = {"Q": "Q", "R": "R"}

    def state(self) -> dict[str, Array]:
        """Return everything that the filter needs to go on, as plain arrays.

        Returns
        -------
        dict of str to ndarray
            ``format``: version, and the name of the class as character codes; x and P; what the class keeps besides;
            and the matrices as they are now, those that are set. All of float64. ``numpy.savez(file, **state)`` stores
            it, `robust_filterpy.fleet.pack` makes bytes of it.

        Notes
        -----
        Model functions, the influence function and other choices are not in it: it is restored into a filter that was
        made like this one. What the last correction showed is not in it either.

        Examples
        --------
        >>> from robust_filterpy import RobustKalmanFilter
        >>> kf, other = RobustKalmanFilter(1, 1), RobustKalmanFilter(1, 1)
        >>> kf.H = np.eye(1)
        >>> kf.update(0.5)
        >>> other.restore(kf.state())
        >>> bool(other.x == kf.x), bool(other.H == kf.H)
        (True, True)
        """
        settings = {**settings_of(self), **self._sensors_in_state()}
        return _state.labelled(
            type(self).__name__, {**self._moving(), **{k: v for k, v in settings.items() if v is not None}}
        )

    @whole
    def restore(self, state: Any) -> None:
        """Go back to a state of this filter, or of another one made like it.

        Parameters
        ----------
        state : mapping of str to ndarray
            From `state`, or what ``numpy.load`` makes of a file that holds it. x and P are needed, and what else a
            step moves; matrices that it does not hold stay as they are.

        Raises
        ------
        ValueError
            If it is of another kind of filter or a newer format, an array is missing, does not fit, or is not finite,
            or P is no covariance; nothing has changed then.
        TypeError
            If state is no mapping.

        Notes
        -----
        The continuation is the same to the last bit. What the last correction showed (y, e, weights, ..) is as if there
        had been none.
        """
        n, m = self.dim_x, self.dim_z
        shapes: dict[str, _state.Shape] = {
            "F": (n, n), "Q": (n, n), "H": (m, n), "R": (m, m), "B": (n, None), "M": (n, m),
            "K": (n, None), "S": (None, None), "SI": (None, None), "alpha_sq": (), "sigmas_f": (None, n),
        }  # fmt: skip
        optional = {name: shapes[name] for name in self._settings}
        optional |= self._sensor_shapes()
        found = _state.checked(state, type(self).__name__, self._needed(), optional, GAPS)
        foreign = sorted({"means", "counts", "learnt", "spread"} & set(state) - set(found))
        if foreign:
            raise _state.StateError(
                f"state: expected one of a filter with the same noise=, process= and patience=, got {foreign[0]} in it"
            )
        if found.get("alpha_sq", 1.0) < 1.0:
            raise ValueError(f"state: expected alpha_sq >= 1, got {found['alpha_sq']}")
        self._go_on(found)

    @property
    def _sensors_name(self) -> str:
        """What the memory of the sensors is called in a state."""
        return "spread" if self._policy.noise is None else "learnt"

    def _sensor_shapes(self) -> dict[str, _state.Shape]:
        """Return the shapes of what is known of the sensors: at each place of z, and by the rows of an H passed."""
        name, width = self._sensors_name, self._memory.shape[1]
        by_row: dict[str, _state.Shape] = {"sensors": (None, self.dim_x), f"sensors_{name}": (None, width)}
        by_row |= {"named": (None,), f"named_{name}": (None, width)}
        return by_row if name == "learnt" else {name: (None, width), **by_row}

    def _sensors_in_state(self) -> dict[str, Array]:
        """Return what is known of the sensors, if anything is."""
        customs, name = self._known_sensors(), self._sensors_name
        known = {name: customs.places} if name == "spread" and (customs.places.any() or customs.rows) else {}
        if customs.rows:
            known["sensors"] = np.array([np.frombuffer(key) for key in customs.rows])
            known[f"sensors_{name}"] = np.array(list(customs.rows.values()))
        if self._named_sensors:
            known["named"] = _state.spelt(json.dumps({one: len(rows) for one, rows in self._named_sensors.items()}))
            known[f"named_{name}"] = np.vstack(list(self._named_sensors.values()))
        return known

    def _moving(self) -> dict[str, Any]:
        """Return what a step moves."""
        x, P = state_of(self)
        learnt = {"learnt": self._memory} if self._learns_noise else {}
        return {"x": x, "P": P, **self._policy.entries(self._kept, np.ravel(x), P), **learnt}

    def _needed(self) -> dict[str, _state.Shape]:
        """Return the shapes of what a step moves."""
        learnt: dict[str, _state.Shape] = {"learnt": (None, self._memory.shape[1])} if self._learns_noise else {}
        return {"x": (self.dim_x,), "P": (self.dim_x, self.dim_x), **self._policy.shapes(self.dim_x), **learnt}

    def _go_on(self, found: dict[str, Array]) -> None:
        """Take over a checked state."""
        name = self._sensors_name
        rows = found.get("sensors", np.zeros((0, 1)))
        memories = found.get(f"sensors_{name}", np.tile(self._policy.begin(1), (len(rows), 1)))
        places = found.get(name, self._policy.begin(self.dim_z))
        if name == "learnt":
            # Sensors may have joined since.
            places = self._policy.classes.checked(places, min(self.dim_z, len(places)))
        named = _by_name(found, f"named_{name}")
        kept = self._policy.resumed(found, np.ravel(found["x"]), found["P"])
        self.x, self.P, self._kept = found["x"], found["P"], kept
        self._show_nothing()
        self._keep_sensors(Customs(places, {row.tobytes(): one for row, one in zip(rows, memories, strict=True)}))
        self._named_sensors = named
        for key, name in self._settings.items():
            if key in found:
                value = found[key]
                setattr(self, name, value.item() if value.ndim == 0 else value)

    def _show_nothing(self) -> None:
        """Show what a filter shows that has corrected nothing."""
        n, m = self.dim_x, self.dim_z
        shape = (m, 1) if np.ndim(self.x) == 2 else (m,)
        self._last, self.z, self.y, self._outlier_probability = None, np.full(shape, None), np.zeros(shape), 0.0
        self.S, self.SI, self.K = np.zeros((m, m)), np.zeros((m, m)), np.zeros((n, m))
        self.x_prior, self.x_post = self.x.copy(), self.x.copy()
        self.P_prior, self.P_post = self.P.copy(), self.P.copy()
        self._log_likelihood = self._likelihood = self._mahalanobis = None


def _by_name(found: dict[str, Array], key: str) -> dict[str, Array]:
    """Return what a state knows of the sensors that have names."""
    if not np.size(found.get("named", ())):
        return {}
    try:
        rows = {str(name): int(m) for name, m in json.loads(_state.read(found["named"])).items()}
    except (ValueError, AttributeError, TypeError):
        rows = {}
    memories = found.get(key, np.zeros((0, 1)))
    if not rows or min(rows.values()) < 1 or sum(rows.values()) != len(memories):
        raise _state.StateError(f"state: expected the names of {len(memories)} sensors in named, got others")
    ends = np.cumsum(list(rows.values()))[:-1]
    return dict(zip(rows, np.split(memories, ends), strict=True))


# For what keeps states of a filter apart from it, such as a tracker or a fleet.


def settings_of(kf: StateMixin) -> dict[str, Any]:
    """Return what else a filter's behaviour depends on, by its name in a state; None where it is not set."""
    return {key: getattr(kf, name, None) for key, name in kf._settings.items()}


def moved_shapes(kf: StateMixin) -> dict[str, _state.Shape]:
    """Return the shapes of what a step moves, what is usual of the sensors among it."""
    by_custom = kf._policy.noise is None and kf._policy.learns
    known = {**kf._sensor_shapes(), "spread": (kf.dim_z, NUMBERS)} if by_custom else {}
    return {**kf._needed(), "x": np.shape(kf.x), **known}


def kept_beside(kf: StateMixin) -> dict[str, Array]:
    """Return what a filter keeps beside x and P, what it knows of its sensor among it."""
    kept = {**kf._moving(), **kf._sensors_in_state()}
    return {f"filter_{name}": value for name, value in kept.items() if name not in ("x", "P")}


def go_on_beside(kf: StateMixin, x: Array, P: Array, state: Any) -> None:
    """Restore that from a state that has it, with the x and P it belongs to, or raise; nothing has changed then."""
    inner = {name.removeprefix("filter_"): state[name] for name in state if name.startswith("filter_")}
    if all(name in inner for name in kf._needed() if name not in ("x", "P")):
        kf.restore({"x": np.reshape(x, np.shape(kf.x)), "P": P, **inner})
