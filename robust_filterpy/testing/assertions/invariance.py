"""What must not matter: the units, the order of the sensors, and measurements that are not there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.testing.assertions.bounds import apart, furthest
from robust_filterpy.testing.scenarios import runs
from robust_filterpy.testing.scenarios.drawing import Scenario

__all__ = ["assert_missing_is_no_information", "assert_sensor_order_irrelevant", "assert_unit_equivariant"]

Make = Callable[[int, int], Any]

#: Small ones show what has a unit of its own. States differ by a factor of 100 alone: in P that is 10,000, and what is
#: lost where roots are made by eigenvalues stays far below what is allowed.
STATE_UNITS, SENSOR_UNITS = np.array([1e-2, 1e-4, 5e-3, 2e-4]), np.array([1e-4, 1.0])


def assert_unit_equivariant(
    make: Make,
    scenario: Scenario,
    *,
    state: ArrayLike | None = None,
    sensors: ArrayLike | None = None,
    rtol: float = 1e-6,
) -> None:
    """Assert that in other units a filter gives the same answer in other units.

    Parameters
    ----------
    make : callable
        ``make(dim_x, dim_z)`` returns a filter.
    scenario : Scenario
        Model and recording.
    state, sensors : array_like, shape (n,) and (m,), optional
        Factors. Default: .01, .0001, .005, .0002, .. for the states, .0001, 1, .. for the sensors.
    rtol : float, default 1e-6
        Difference that is allowed, in standard deviations of the state.

    Raises
    ------
    AssertionError
        If not: something in the filter has a unit of its own, such as a threshold or a term added for safety.
    """
    n, m, _ = scenario.model.dims
    a, b = (
        _factors(name, given, np.tile(units, size)[:size])
        for name, given, units, size in (("state", state, STATE_UNITS, n), ("sensors", sensors, SENSOR_UNITS, m))
    )
    model = scenario.model.in_units(a, b)
    one, two = _states(make, scenario), _states(make, replace(scenario, model=model, z=scenario.z * b))
    back = [(x / a, P / np.outer(a, a)) for x, P in two]
    _same(one, back, rtol, "in other units", "something in the filter has a unit of its own")


def assert_sensor_order_irrelevant(
    make: Make, scenario: Scenario, *, order: Sequence[int] | None = None, rtol: float = 1e-6
) -> None:
    """Assert that it does not matter which sensor comes first.

    Parameters
    ----------
    make : callable
        As in `assert_unit_equivariant`.
    scenario : Scenario
        Model and recording, with at least two sensors.
    order : sequence of int, optional
        The other order. Default: backwards.
    rtol : float, default 1e-6
        As in `assert_unit_equivariant`.

    Raises
    ------
    AssertionError
        If it does.
    """
    m = scenario.model.dims[1]
    if m < 2:
        raise ValueError(f"scenario: expected at least two sensors, got {m}")
    rows = np.arange(m)[::-1] if order is None else np.asarray(order, dtype=int)
    if sorted(rows.tolist()) != list(range(m)):
        raise ValueError(f"order: expected each of 0 .. {m - 1} once, got {rows.tolist()}")
    one, two = _states(make, scenario), _states(make, _of_sensors(scenario, rows))
    _same(one, two, rtol, f"with the sensors in the order {rows.tolist()}", "the sensors are not treated alike")


def assert_missing_is_no_information(
    make: Make, scenario: Scenario, *, components: bool = True, rtol: float = 1e-6
) -> None:
    """Assert that a missing measurement changes nothing, and a missing component leaves the others as they are.

    Parameters
    ----------
    make : callable
        As in `assert_unit_equivariant`.
    scenario : Scenario
        Model and recording without missing samples.
    components : bool, default True
        Whether NaN in z is tried, all of it and one sensor's; otherwise only ``update(None)``.
    rtol : float, default 1e-6
        As in `assert_unit_equivariant`.

    Raises
    ------
    AssertionError
        If x or P move at ``update(None)`` or at a z of NaN, or if a filter with NaN for a sensor differs from a filter
        without that sensor.
    """
    n, m, _ = scenario.model.dims
    for nothing, name in ((None, "update(None)"), (np.full(m, np.nan), "update of a z that is all NaN")):
        if nothing is not None and not components:
            continue
        kf = runs.load(make(n, m), scenario.model)
        for k, z in enumerate(scenario.z[:5]):
            runs.step(kf, z, scenario.model, None if scenario.u is None else scenario.u[k])
        runs.predict(kf, None)
        before = runs.state(kf)
        runs.measure(kf, nothing, scenario.model)
        _same([before], [runs.state(kf)], rtol, f"after {name}", "a missing measurement was used")
    for gone in range(m) if components and m > 1 else ():
        z = scenario.z.copy()
        z[:, gone] = np.nan
        one = _states(make, _of_sensors(scenario, np.delete(np.arange(m), gone)))
        two = _states(make, replace(scenario, z=z))
        _same(one, two, rtol, f"with NaN for sensor {gone}", "expected what the other sensors alone give")


def _of_sensors(scenario: Scenario, rows: NDArray[np.intp]) -> Scenario:
    """Return what some of the sensors give, in this order."""
    return replace(scenario, model=scenario.model.of_sensors(rows), z=scenario.z[:, rows])


def _factors(name: str, given: ArrayLike | None, default: Array) -> Array:
    """Return factors > 0 of the right number or raise."""
    if given is None:
        return default
    found = _checks.finite_vector(name, given)
    if found.size != default.size or not (found > 0).all():
        raise ValueError(f"{name}: expected {default.size} factors > 0, got {found}")
    return found


def _states(make: Make, scenario: Scenario) -> list[tuple[Array, Array]]:
    """Return x and P of a new filter after each prediction and each correction."""
    model, found = scenario.model, []
    kf = runs.load(make(*model.dims[:2]), model)
    for k, z in enumerate(scenario.z):
        runs.predict(kf, None if scenario.u is None else scenario.u[k])
        found.append(runs.state(kf))
        runs.measure(kf, runs.or_none(z), model)
        found.append(runs.state(kf))
    return found


def _same(
    one: Sequence[tuple[Array, Array]], two: Sequence[tuple[Array, Array]], rtol: float, when: str, why: str
) -> None:
    """Compare states in their standard deviations and covariances as correlations."""
    for call, ((x, P), (x2, P2)) in enumerate(zip(one, two, strict=True)):
        size = apart((x, P), (x2, P2))
        if not size <= rtol:
            name = "x" if furthest(x2 - x, P) > rtol else "P"
            what = "NaN or infinity" if np.isinf(size) else f"another {name}, by {size:.2g} of its deviation"
            place = f"{'update' if call % 2 else 'predict'} {call // 2}: " if len(one) > 1 else ""
            raise AssertionError(f"{when}, {place}{what}: {why}")
