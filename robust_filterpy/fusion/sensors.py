"""Sensors by name, and how the measurements of all of them stand in one vector."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy._warning import RobustFilterWarning

__all__ = ["OFTEN", "FusionWarning", "Layout", "Sensor", "angle"]

#: Readings from which it is no accident that the sensors of a group never have the same stamp.
OFTEN = 50
# Seconds of delay by which the earliest instant still is one.
_LATEST = 100 * 86400.0


class FusionWarning(RobustFilterWarning):
    """Say what a fusion cannot use, or whom it does not believe."""


def angle(z: ArrayLike, predicted: ArrayLike) -> Array:
    """Return the difference of two angles in radians, between -pi and pi: a ``residual`` for a compass.

    Parameters
    ----------
    z, predicted : array_like, shape (m,)
        Angles.

    Returns
    -------
    ndarray, shape (m,)

    Examples
    --------
    >>> angle([3.1], [-3.1]).round(4)
    array([-0.0832])
    """
    apart = np.subtract(z, predicted)
    return np.asarray((apart + math.pi) % (2.0 * math.pi) - math.pi)


@dataclass(frozen=True, eq=False)
class Sensor:
    """Say what a sensor measures: z = H x + noise, or z = h(x) + noise.

    Parameters
    ----------
    H : array_like, shape (m, n) or (n,), optional
        Measurement matrix.
    R : array_like, shape (m, m), or float, optional
        Covariance of its ordinary noise; a float means times I. Where the noise is learned it is where learning starts,
        and without it
        the sensor's first readings say how large it is; six of them serve for nothing else.
    h : callable, optional
        Instead of H: ``h(x)``, shape (m,), for x of shape (n,).
    jacobian : callable, optional
        With h: ``jacobian(x)``, shape (m, n).
    residual : callable, optional
        With h: ``residual(z, h(x))``, shape (m,), for what does not subtract; `angle` for angles. By default z - h(x).
    dim_z : int, default 1
        With h: m.
    delay : float, default 0
        Seconds between the moment that is measured and the stamp, known and constant: the reading counts as of
        stamp - delay.
    every : float, optional
        Seconds between two readings when all is well: a sensor that has said nothing for three of them is silent.
        Without it, it is learned, and the window is waited for besides.
    group : str, optional
        Name of what it shares with other sensors, so that they fail together: a receiver, a cable. What they say at one
        stamp is one reading, an outlier as a whole or not at all, each with a noise of its own size; ``watch`` judges
        them as one sensor. With a name that no other sensor has its own components fail together.

    Raises
    ------
    ValueError, TypeError
        If neither or both of H and h are given, h comes without its Jacobian, or a number is out of range.

    Examples
    --------
    >>> gps = Sensor([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]], R=4.0)
    >>> gps.dim_z
    2
    """

    H: Any = None
    R: Any = None
    h: Callable[[Array], Any] | None = None
    jacobian: Callable[[Array], Any] | None = None
    residual: Callable[[Array, Array], Any] | None = None
    dim_z: int = 1
    delay: float = 0.0
    every: float | None = None
    group: str | None = None

    __str__ = brief

    def __post_init__(self) -> None:
        """Check what does not depend on the state."""
        if (self.H is None) == (self.h is None):
            raise ValueError("Sensor: expected H or h, one of them")
        if self.H is not None:
            H = _checks.numbers("H", self.H)
            H = H[None] if H.ndim == 1 else H
            if H.ndim != 2 or not H.size or not np.isfinite(H).all():
                raise ValueError(
                    f"H: expected a finite matrix, a row for each number of z, got {_checks.shown(self.H)}"
                )
            if self.jacobian is not None or self.residual is not None:
                raise ValueError("Sensor: expected jacobian and residual with h only; H is its own Jacobian")
            object.__setattr__(self, "H", H.copy())
            object.__setattr__(self, "dim_z", len(H))
        elif not callable(self.h) or not callable(self.jacobian):
            raise TypeError("Sensor: expected functions h(x) and jacobian(x), got h without jacobian or no function")
        _checks.count("dim_z", self.dim_z, 1)
        if self.R is not None:
            R = _checks.numbers("R", self.R)
            R = R * np.eye(self.dim_z) if R.ndim == 0 else R
            R = _checks.matrix("R", R, (self.dim_z, self.dim_z), f"dim_z={self.dim_z}").copy()
            _checks.covariance("R", R)
            if not (R.diagonal() > 0.0).all():
                raise ValueError(f"R: expected variances > 0, got {R.diagonal()}")
            object.__setattr__(self, "R", R)
        if not 0.0 <= _checks.real("delay", self.delay) <= _LATEST:
            raise ValueError(f"delay: expected finite seconds >= 0, 100 days at most, got {self.delay!r}")
        if self.every is not None:
            _checks.positive("every", self.every)
        if not (self.group is None or (isinstance(self.group, str) and self.group)):
            raise TypeError(f"group: expected the name of what sensors share, got {self.group!r}")


class Seen(NamedTuple):
    """What a state says that some sensors should read, and how that depends on the state."""

    #: Readings as if every sensor were linear, z - h(x) + H x; NaN where missing, (M,).
    z: Array
    #: (M, n)
    H: Array
    #: Sensors whose functions have no answer for this state, and why; their readings are missing.
    failed: tuple[tuple[str, str], ...] = ()


class Layout:
    """Place the measurements of all sensors in one vector of length M, in the order of declaration."""

    def __init__(self, sensors: Mapping[str, Sensor], n: int) -> None:
        """Check and keep them."""
        if not isinstance(sensors, Mapping) or not sensors:
            raise TypeError(f"sensors: expected a dict from names to Sensor, got {_checks.shown(sensors)}")
        self.sensors, self.places, at = dict(sensors), {}, 0
        for name, sensor in self.sensors.items():
            if not isinstance(name, str) or not isinstance(sensor, Sensor):
                raise TypeError(f"sensors: expected Sensor by name, got {_checks.shown(name)}: {_checks.shown(sensor)}")
            if sensor.H is not None and sensor.H.shape[1] != n:
                raise ValueError(
                    f"sensor {name!r}: expected H with {n} columns, as the state has, got {sensor.H.shape}"
                )
            self.places[name] = slice(at, at + sensor.dim_z)
            at += sensor.dim_z
        self.size, self.n = at, n
        self.names = tuple(self.sensors)
        groups = [sensor.group or (name,) for name, sensor in self.sensors.items()]
        distinct = list(dict.fromkeys(groups))
        #: Names of the sensors that are judged as one: those of a group, else each alone.
        self.parties = tuple(
            tuple(name for name, group in zip(self.names, groups, strict=True) if group == one) for one in distinct
        )
        sizes = [s.dim_z for s in self.sensors.values()]
        #: Which sensor, and which party, each component belongs to, (M,).
        self.owner = np.repeat(np.arange(len(sizes)), sizes)
        self.party = np.repeat([distinct.index(group) for group in groups], sizes)
        shared = {one: np.flatnonzero(self.party == k) for k, one in enumerate(distinct) if isinstance(one, str)}
        for one, components in shared.items():
            if len(components) < 2:
                raise ValueError(
                    f"sensor {self.names[self.owner[components[0]]]!r}: expected another sensor of the group {one!r}, "
                    "got none; name another one so, or leave group out"
                )
        #: Components that fail together, as `correction` takes them.
        self.grouping: Any = tuple(tuple(components.tolist()) for components in shared.values()) or "component"
        self.H, self.R = np.zeros((at, n)), np.eye(at)
        #: Components whose R nobody gave, (M,).
        self.without_R = np.zeros(at, dtype=bool)
        for name, place in self.places.items():
            sensor = self.sensors[name]
            if sensor.H is not None:
                self.H[place] = sensor.H
            if sensor.R is None:
                self.without_R[place] = True
            else:
                self.R[place, place] = sensor.R
        self.any_without_R = bool(self.without_R.any())
        self.is_curved = np.repeat([s.h is not None for s in self.sensors.values()], sizes)
        self.curved = tuple(name for name, sensor in self.sensors.items() if sensor.h is not None)

    def reading(self, name: str, z: Any) -> Array:
        """Return a sensor's reading, NaN where a component is missing, or raise."""
        if not isinstance(name, Hashable) or name not in self.places:
            raise ValueError(f"sensor: expected one of {list(self.sensors)}, got {_checks.shown(name)}")
        m = self.sensors[name].dim_z
        if isinstance(z, np.ma.MaskedArray):
            z = np.ma.filled(z.astype(float), np.nan)
        values = np.full(m, np.nan) if z is None else _checks.numbers(f"z of {name!r}", z).ravel()
        if len(values) != m:
            raise ValueError(f"z of {name!r}: expected {m} number(s), got {_checks.shown(z)}")
        if np.isinf(values).any():
            raise ValueError(f"z of {name!r}: expected finite numbers or NaN (missing), got {values}")
        return values.copy()

    def never_together(self, zs: Array) -> list[tuple[str, ...]]:
        """Return groups of sensors that have all spoken often, and never two of them at one stamp."""
        spoke = {name: (~np.isnan(zs[:, place])).any(axis=1) for name, place in self.places.items()}
        groups = []
        for party in self.parties:
            of_each = np.array([spoke[name] for name in party])
            often = (of_each.sum(axis=1) >= OFTEN).all()
            if len(party) > 1 and often and (of_each.sum(axis=0) < 2).all():
                groups.append(party)
        return groups

    def seen_from(self, x: Array, z: Array) -> Seen:
        """Return readings and H as they are about a state; sensors without a reading are not asked."""
        curved = [name for name in self.curved if not np.isnan(z[self.places[name]]).all()]
        if not curved:
            return Seen(z, self.H)
        z, H, failed = z.copy(), self.H.copy(), []
        for name in curved:
            place = self.places[name]
            try:
                apart, slope = _compared(self.sensors[name], x, z[place])
            except Exception as error:
                # A user's function may know no answer far from the truth: that is no reason to stop.
                failed.append((name, f"{type(error).__name__}: {error}"))
                z[place] = np.nan
            else:
                H[place] = slope
                z[place] = apart + slope @ x
        return Seen(z, H, tuple(failed))


def _compared(sensor: Sensor, x: Array, z: Array) -> tuple[Array, Array]:
    """Return z - h(x), NaN where z is missing, and the Jacobian of a sensor that is no matrix."""
    m, missing, z = sensor.dim_z, np.isnan(z), z.copy()
    at = _checks.finite("h", sensor.h(x.copy()), (m,), True)  # type: ignore[misc]
    slope = _checks.finite("jacobian", sensor.jacobian(x.copy()), (m, len(x)), True)  # type: ignore[misc]
    # A residual is asked about whole readings: what is missing agrees.
    z[missing] = at[missing]
    apart = z - at
    if sensor.residual is not None:
        apart = _checks.finite("residual", sensor.residual(z, at.copy()), (m,), True)
    return np.where(missing, np.nan, apart), slope
