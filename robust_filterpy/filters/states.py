"""What a filter holds and has learned of its sensors; filters that are put away and go on later, elsewhere."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks, _state
from robust_filterpy._arrays import noise_covariance, state_of
from robust_filterpy._checks import Array
from robust_filterpy.correction.learning import LearntNoise, describe
from robust_filterpy.correction.mixed import ordinary_noise
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.side_by_side import slow
from robust_filterpy.correction.spread import NUMBERS, SPREAD, WEIGHT
from robust_filterpy.filters.policies import Bounded, Mixture, Prior
from robust_filterpy.filters.snapshot import whole

if TYPE_CHECKING:
    from robust_filterpy._filterpy import Assigned

# So many sensors that take turns through `update(z, R, H)` are distinguished; the one seen longest ago gives way.
_MOST = 32


class Memories(NamedTuple):
    """Memories of sensors, w numbers each; nothing in here is ever written to."""
    # A row of an H that was passed tells the sensor. One that is met for the first time begins with what was learned of
    # its place in z, so that an H that varies from step to step goes by places.

    #: Of the sensors in z, shape (m, w).
    places: Array
    #: Of those that were met in an H that was passed, by its row, each of shape (w,).
    rows: dict[bytes, Array]

    def of(self, begin: Array, keys: list[Any]) -> Array:
        """Return the memories of some sensors, begin for new ones; keys as `sensor_keys` makes them."""
        memories = begin.copy()
        for i, key in enumerate(keys):
            place = i if isinstance(key, bytes) else key
            if key in self.rows:
                memories[i] = self.rows[key]
            elif place < len(self.places):
                memories[i] = self.places[place]
        return memories

    def updated(self, memory: Array, begin: Array, keys: list[Any]) -> Memories:
        """Return these with the memories of some sensors replaced, named as in `of`."""
        places, rows = self.places.copy(), dict(self.rows)
        for i, (key, one) in enumerate(zip(keys, memory, strict=True)):
            place = i if isinstance(key, bytes) else key
            if place >= len(places):
                places = np.vstack((places, np.tile(begin[:1], (place + 1 - len(places), 1))))
            places[place] = one
            if isinstance(key, bytes):
                rows.pop(key, None)
                rows[key] = one.copy()
        for key in list(rows)[: max(len(rows) - _MOST, 0)]:
            del rows[key]
        return Memories(places, rows)


class StateMixin:
    """Hold what a step moves and what is learned of the sensors; give it as plain arrays, and go on from these.

    A subclass adds to `_moving` what a step moves besides x, P and what its policy knows, and takes it
    over in `_go_on`. Declared are filterpy's attributes that are written to, and those of `snapshot.SLOTS`.
    """

    # Not a literal: a type checker would then believe that there is no __dict__ at all.
    __slots__ = tuple(())

    #: What else the filter's behavior depends on: name in a state, attribute. A state without it leaves it as it is.
    _settings: ClassVar[dict[str, str]] = {"Q": "Q", "R": "R"}

    dim_x: int
    dim_z: int
    x: Assigned
    P: Assigned
    z: Any
    inv: Any
    x_prior: Array
    P_prior: Array
    x_post: Array
    P_post: Array
    _log_likelihood: float | None
    _likelihood: float | None
    _mahalanobis: float | None

    _policy: Any
    _choices: Choices
    #: What the policy keeps with x and P.
    _kept: Any
    #: Of the sensors by their places in z, by their rows of an H that was passed, by their names.
    _memory: Array
    _other_sensors: dict[bytes, Array]
    _named_sensors: dict[str, Array]
    #: The last correction, what makes one by `as_arrays`, or the kernel's record.
    _last: Any
    #: Made of it when they are asked for.
    _y: Any
    _S: Any
    _SI: Any
    _K: Any
    _window: Any
    _updates: int
    #: One number for each step of the last recording, None before one.
    _process_scales: Array | None

    def _remembered(self) -> Memories:
        """Return the memory of the sensors; the array alone is what the kernel reads and replaces."""
        return Memories(self._memory, self._other_sensors)

    def _keep_sensors(self, value: Memories) -> None:
        """Keep the memory of the sensors."""
        self._memory, self._other_sensors = value

    def _prior(self, m: int, passed: Array | None = None) -> Prior:
        """Return the memory before a correction by m sensors, by their places in z or their rows of H."""
        begin, keys = self._sensors_of(m, passed)
        return Prior(self._remembered().of(begin, keys) if self._policy.learns else begin, self._kept)

    def _sensors_of(self, m: int, passed: Array | None) -> tuple[Array, list[Any]]:
        """Return memories without any knowledge, and what tells the m sensors: their places, or their rows of an H."""
        begin = self._policy.begin(m)
        if self._policy.noise is not None and self._choices.grouping == "joint":
            return begin, [0]
        return begin, list(range(m)) if passed is None else sensor_keys(passed, getattr(self, "H", None))

    def _learn(self, memory: Array | None, m: int, passed: Array | None = None) -> None:
        """Keep what a correction by m sensors has taught, named as in `_prior`."""
        if memory is not None and self._policy.learns:
            self._keep_sensors(self._remembered().updated(memory, *self._sensors_of(m, passed)))

    def _spoken(self, sensor: str | int | None, correct: Callable[[], None]) -> None:
        """Correct by a sensor that is named, None for those that their places or rows of H tell."""
        if sensor is None:
            correct()
            return
        if not isinstance(sensor, (str, int)) or isinstance(sensor, bool):
            raise TypeError(f"sensor: expected a name or a number, got {_checks.shown(sensor)}")
        unnamed, name = self._remembered(), str(sensor)
        self._keep_sensors(Memories(self._named_sensors.get(name, self._policy.begin(self.dim_z)), {}))
        try:
            correct()
            spoken = self._memory
        finally:
            self._keep_sensors(unnamed)
        if self._policy.learns:
            self._named_sensors = {**self._named_sensors, name: spoken}

    @property
    def spread(self) -> Array:
        """How large each sensor's standardized innovations usually are, shape (dim_z,); NaN before the first.

        Under scaling "learnt" thresholds are in units of this: 1 where P, Q and R are right, 10 where they are 100
        times too small.
        """
        if not (type(self._policy) is Bounded and self._policy.learns):
            return np.full(self.dim_z, np.nan)
        memory = self._prior(self.dim_z).memory
        return np.where(memory[:, WEIGHT] > 0.0, memory[:, SPREAD], np.nan)

    @property
    def learnt(self) -> Array | None:
        """Under ``noise=Learnt(..)``, what was learned of the noise: a small array, r (a factor of R) first.

        Keep it, or assign it to another filter with the same R, grouping and scales of noise, which then starts with
        it. Shape (1 or sensors, 14 + 2 K + K^2); a copy. None where no noise is learned.
        """
        return self._memory.copy() if self._learns_noise else None

    @learnt.setter
    def learnt(self, value: ArrayLike) -> None:
        if not self._learns_noise:
            raise AttributeError(f"learnt: expected a filter with noise=Learnt(..), got noise={self._policy.noise!r}")
        self._memory, self._other_sensors = self._policy.classes.checked(value, self.dim_z), {}
        self._named_sensors = {}

    @property
    def noise_learnt(self) -> LearntNoise | None:
        """Under ``noise=Learnt(..)``, what has been learned of the noise: r, contamination, scale ratio, run length."""
        return self._described(self._memory, self.dim_z) if self._learns_noise else None

    @property
    def sensors_learnt(self) -> dict[str, LearntNoise] | None:
        """Under ``noise=Learnt(..)``, what has been learned of each sensor that `update` was given as `sensor`."""
        if not self._learns_noise:
            return None
        return {name: self._described(memory, len(memory)) for name, memory in self._named_sensors.items()}

    def _described(self, memory: Array, sensors: int) -> LearntNoise:
        """Return what a memory says of noise."""
        classes = self._policy.classes
        return describe(memory, np.array(classes.scales), sensors if classes.grouping == "joint" else 1)

    @property
    def R_learnt(self) -> Array | None:
        """Under ``noise=``, the covariance of ordinary noise as learned, shape (dim_z, dim_z); None without."""
        if type(self._policy) is not Mixture:
            return None
        kf: Any = self
        return ordinary_noise(noise_covariance(kf.R, None, self.dim_z), self._prior(self.dim_z).memory)

    @property
    def _learns_noise(self) -> bool:
        """Whether the measurement noise is learned."""
        return type(self._policy) is Mixture and self._policy.learns

    @property
    def process_probabilities(self) -> Array | None:
        """Under ``noise=``, the probability of each scale of Q for each state, shape (q, dim_x); None without.

        States that neither the model nor a sensor couples have their own, the others of one part the same.
        """
        if type(self._policy) is not Mixture:
            return None
        if self._kept is None:
            return np.ones((1, self.dim_x))
        return slow(self._kept.hypotheses, self._policy.scales)

    @property
    def process_scale(self) -> Array:
        """Mean factor of each state's Q in the step before the last measurement, given that measurement.

        Shape (dim_x,), equal for states of one part; 1 if Q is taken as given.
        """
        return self._policy.process_scale(self._kept, self.dim_x)  # type: ignore[no-any-return]

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
        entries = _state.checked(state, type(self).__name__, self._needed(), optional)
        foreign = sorted({"means", "learnt", "spread"} & set(state) - set(entries))
        if foreign:
            raise _state.StateError(
                f"state: expected one of a filter with the same noise=, process= and scaling=, got {foreign[0]} in it"
            )
        if entries.get("alpha_sq", 1.0) < 1.0:
            raise ValueError(f"state: expected alpha_sq >= 1, got {entries['alpha_sq']}")
        self._go_on(entries)

    @property
    def _sensors_name(self) -> str:
        """What the memory of the sensors is called in a state."""
        return "spread" if self._policy.noise is None else "learnt"

    def _sensor_shapes(self) -> dict[str, _state.Shape]:
        """Return the shapes of the sensors' memory: at each place of z, and by the rows of an H passed."""
        name, width = self._sensors_name, (None, self._memory.shape[1])
        shapes = {"sensors": (None, self.dim_x), "named": (None,), f"sensors_{name}": width, f"named_{name}": width}
        return shapes if name == "learnt" else {name: width, **shapes}

    def _sensors_in_state(self) -> dict[str, Array]:
        """Return the memory of the sensors, if there is any."""
        memories, name = self._remembered(), self._sensors_name
        entries = {name: memories.places} if name == "spread" and (memories.places.any() or memories.rows) else {}
        if memories.rows:
            entries["sensors"] = np.array([np.frombuffer(key) for key in memories.rows])
            entries[f"sensors_{name}"] = np.array(list(memories.rows.values()))
        if self._named_sensors:
            entries["named"] = _state.spelt(json.dumps({one: len(rows) for one, rows in self._named_sensors.items()}))
            entries[f"named_{name}"] = np.vstack(list(self._named_sensors.values()))
        return entries

    def _moving(self) -> dict[str, Any]:
        """Return what a step moves."""
        x, P = state_of(self)
        learnt = {"learnt": self._memory} if self._learns_noise else {}
        return {"x": x, "P": P, **self._policy.entries(self._kept, np.ravel(x), P), **learnt}

    def _needed(self) -> dict[str, _state.Shape]:
        """Return the shapes of what a step moves."""
        return {**_state.schema(self._moving()), "x": (self.dim_x,)}

    def _go_on(self, entries: dict[str, Array]) -> None:
        """Take over a checked state."""
        name = self._sensors_name
        rows = entries.get("sensors", np.zeros((0, 1)))
        memories = entries.get(f"sensors_{name}", np.tile(self._policy.begin(1), (len(rows), 1)))
        places = entries.get(name, self._policy.begin(self.dim_z))
        if name == "learnt":
            # Sensors may have joined since.
            places = self._policy.classes.checked(places, min(self.dim_z, len(places)))
        named = _by_name(entries, f"named_{name}")
        carried = self._policy.resumed(entries, np.ravel(entries["x"]), entries["P"])
        self.x, self.P, self._kept = entries["x"], entries["P"], carried
        self._show_nothing()
        self._keep_sensors(Memories(places, {row.tobytes(): one for row, one in zip(rows, memories, strict=True)}))
        self._named_sensors = named
        for key, name in self._settings.items():
            if key in entries:
                value = entries[key]
                setattr(self, name, value.item() if value.ndim == 0 else value)

    def _show_nothing(self) -> None:
        """Show what a filter shows that has corrected nothing."""
        n, m = self.dim_x, self.dim_z
        shape = (m, 1) if np.ndim(self.x) == 2 else (m,)
        self._last, self.z, self.y = None, np.full(shape, None), np.zeros(shape)
        self.S, self.SI, self.K = np.zeros((m, m)), np.zeros((m, m)), np.zeros((n, m))
        self.x_prior, self.x_post = self.x.copy(), self.x.copy()
        self.P_prior, self.P_post = self.P.copy(), self.P.copy()
        self._log_likelihood = self._likelihood = self._mahalanobis = None


def _by_name(entries: dict[str, Array], key: str) -> dict[str, Array]:
    """Return what a state knows of the sensors that have names."""
    if not np.size(entries.get("named", ())):
        return {}
    try:
        rows = {str(name): int(m) for name, m in json.loads(_state.read(entries["named"])).items()}
    except (ValueError, AttributeError, TypeError):
        rows = {}
    memories = entries.get(key, np.zeros((0, 1)))
    if not rows or min(rows.values()) < 1 or sum(rows.values()) != len(memories):
        raise _state.StateError(f"state: expected the names of {len(memories)} sensors in named, got others")
    ends = np.cumsum(list(rows.values()))[:-1]
    return dict(zip(rows, np.split(memories, ends), strict=True))


def sensor_keys(passed: Array, own: Any) -> list[Any]:
    """Return what tells each sensor of an H that was passed: its place in the filter's own, or the bytes of its row."""
    m = len(passed)
    places = {}
    if np.ndim(own) == 2 and np.shape(own)[1] == passed.shape[1]:
        places = {row.tobytes(): i for i, row in reversed(list(enumerate(np.asarray(own, dtype=float))))}
    keys = [places.get(row.tobytes(), row.tobytes()) for row in passed]
    # Sensors that see exactly the same are distinguished by their places.
    return keys if len(set(keys)) == m else list(range(m))


# For what keeps states of a filter apart from it, such as a tracker or a fleet.


def settings_of(kf: StateMixin) -> dict[str, Any]:
    """Return what else a filter's behavior depends on, by its name in a state; None where it is not set."""
    return {key: getattr(kf, name, None) for key, name in kf._settings.items()}


def moved_shapes(kf: StateMixin) -> dict[str, _state.Shape]:
    """Return the shapes of what a step moves, what is usual of the sensors among it."""
    by_typical = kf._policy.noise is None and kf._policy.learns
    shapes = {**kf._sensor_shapes(), "spread": (kf.dim_z, NUMBERS)} if by_typical else {}
    return {**kf._needed(), "x": np.shape(kf.x), **shapes}


def kept_with(kf: StateMixin) -> dict[str, Array]:
    """Return what a filter keeps with x and P, what it knows of its sensor among it."""
    entries = {**kf._moving(), **kf._sensors_in_state()}
    return {f"filter_{name}": value for name, value in entries.items() if name not in ("x", "P")}


def go_on_with(kf: StateMixin, x: Array, P: Array, state: Any) -> None:
    """Restore that from a state that has it, with the x and P it belongs to, or raise; nothing has changed then."""
    inner = {name.removeprefix("filter_"): state[name] for name in state if name.startswith("filter_")}
    if all(name in inner for name in kf._needed() if name not in ("x", "P")):
        kf.restore({"x": np.reshape(x, np.shape(kf.x)), "P": P, **inner})
