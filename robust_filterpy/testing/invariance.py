"""What must not matter: the units, the order of the sensors, and measurements that are not there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.testing import runs
from robust_filterpy.testing.scenarios import Scenario

__all__ = ["assert_missing_is_no_information", "assert_sensor_order_irrelevant", "assert_unit_equivariant"]

Make = Callable[[int, int], Any]


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
        Factors. Default: 1000, .001, 100, .01, .. for the states, .01, 100, .. for the sensors.
    rtol : float, default 1e-6
        Difference that is allowed, in standard deviations of the state.

    Raises
    ------
    AssertionError
        If not: something in the filter has a unit of its own, such as a threshold or a term added for safety.
    """
    n, m, _ = scenario.model.dims
    a = _factors("state", state, np.tile([1e3, 1e-3, 1e2, 1e-2], n)[:n])
    b = _factors("sensors", sensors, np.tile([1e-2, 1e2], m)[:m])
    model = scenario.model.in_units(a, b)
    one = _states(runs.load(make(n, m), scenario.model), scenario.model, scenario.z, scenario.u)
    two = _states(runs.load(make(n, m), model), model, scenario.z * b, scenario.u)
    back = [(x / a, P / np.outer(a, a)) for x, P in two]
    _same(one, back, rtol, "in other units", "something in the filter has a unit of its own")


def assert_sensor_order_irrelevant(
    make: Make, scenario: Scenario, *, order: Sequence[int] | None = None, rtol: float = 1e-6
) -> None:
    """Assert that it does not matter which sensor comes first.

    Parameters
    ----------
    make : callable
        ``make(dim_x, dim_z)`` returns a filter.
    scenario : Scenario
        Model and recording, with at least two sensors.
    order : sequence of int, optional
        The other order. Default: backwards.
    rtol : float, default 1e-6
        Difference that is allowed, in standard deviations of the state.

    Raises
    ------
    AssertionError
        If it does.
    """
    n, m, _ = scenario.model.dims
    if m < 2:
        raise ValueError(f"scenario: expected at least two sensors, got {m}")
    rows = np.arange(m)[::-1] if order is None else np.asarray(order, dtype=int)
    if sorted(rows.tolist()) != list(range(m)):
        raise ValueError(f"order: expected each of 0 .. {m - 1} once, got {rows.tolist()}")
    model = scenario.model.of_sensors(rows)
    one = _states(runs.load(make(n, m), scenario.model), scenario.model, scenario.z, scenario.u)
    two = _states(runs.load(make(n, m), model), model, scenario.z[:, rows], scenario.u)
    _same(one, two, rtol, f"with the sensors in the order {rows.tolist()}", "the sensors are not treated alike")


def assert_missing_is_no_information(
    make: Make, scenario: Scenario, *, components: bool = True, rtol: float = 1e-6
) -> None:
    """Assert that a missing measurement changes nothing, and a missing component leaves the others as they are.

    Parameters
    ----------
    make : callable
        ``make(dim_x, dim_z)`` returns a filter.
    scenario : Scenario
        Model and recording without missing samples.
    components : bool, default True
        Whether NaN in z is tried, all of it and one sensor's; otherwise only ``update(None)``.
    rtol : float, default 1e-6
        Difference that is allowed, in standard deviations of the state.

    Raises
    ------
    AssertionError
        If x or P move at ``update(None)`` or at a z of NaN, or if a filter with NaN for a sensor differs from a filter
        without that sensor.
    """
    model, m = scenario.model, scenario.model.dims[1]
    n = model.dims[0]
    for nothing, name in ((None, "update(None)"), (np.full(m, np.nan), "update of a z that is all NaN")):
        if nothing is not None and not components:
            continue
        kf = runs.load(make(n, m), model)
        _states(kf, model, scenario.z[:5], scenario.u)
        runs.predict(kf, None)
        before = np.ravel(kf.x).copy(), np.array(kf.P)
        runs.measure(kf, nothing, model)
        _same([before], [(np.ravel(kf.x), np.array(kf.P))], rtol, f"after {name}", "a missing measurement was used")
    if not components or m < 2:
        return
    for gone in range(m):
        rest = np.delete(np.arange(m), gone)
        z = scenario.z.copy()
        z[:, gone] = np.nan
        fewer = model.of_sensors(rest)
        one = _states(runs.load(make(n, m - 1), fewer), fewer, z[:, rest], scenario.u)
        two = _states(runs.load(make(n, m), model), model, z, scenario.u)
        why = "expected what the other sensors alone give"
        _same(one, two, rtol, f"with NaN for sensor {gone}", why)


def _factors(name: str, given: ArrayLike | None, default: Array) -> Array:
    """Return factors > 0 of the right number or raise."""
    if given is None:
        return default
    found = _checks.finite_vector(name, given)
    if found.size != default.size or not (found > 0).all():
        raise ValueError(f"{name}: expected {default.size} factors > 0, got {found}")
    return found


def _states(kf: Any, model: Any, zs: Array, us: Array | None) -> list[tuple[Array, Array]]:
    """Return x and P after each prediction and each correction."""
    found = []
    for k, z in enumerate(zs):
        runs.predict(kf, None if us is None else us[k])
        found.append((np.ravel(kf.x).astype(float), np.array(kf.P, dtype=float)))
        runs.measure(kf, runs.or_none(z), model)
        found.append((np.ravel(kf.x).astype(float), np.array(kf.P, dtype=float)))
    return found


def _same(
    one: Sequence[tuple[Array, Array]], two: Sequence[tuple[Array, Array]], rtol: float, when: str, why: str
) -> None:
    """Compare states in their standard deviations and covariances as correlations."""
    for call, ((x, P), (x2, P2)) in enumerate(zip(one, two, strict=True)):
        deviation = np.sqrt(np.maximum(P.diagonal(), np.finfo(float).tiny))
        for name, difference in (("x", (x2 - x) / deviation), ("P", (P2 - P) / np.outer(deviation, deviation))):
            size = float(np.abs(difference).max()) if np.isfinite(difference).all() else np.inf
            if not size <= rtol:
                what = "NaN or infinity" if np.isinf(size) else f"another {name}, by {size:.2g} of its deviation"
                place = f"{'update' if call % 2 else 'predict'} {call // 2}: " if len(one) > 1 else ""
                raise AssertionError(f"{when}, {place}{what}: {why}")
