"""What a filter promises where data go wrong: bounded influence, a way back, little lost; no unit or order matters."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.testing.assertions.contracts import apart, fail, furthest, probability
from robust_filterpy.testing.scenarios import runs
from robust_filterpy.testing.scenarios.drawing import Scenario, draw
from robust_filterpy.testing.scenarios.models import StateModel, random_stable
from robust_filterpy.testing.scenarios.runs import FilterRun, Runs, as_runs

Make = Callable[[int, int], Any]

# Innovations in standard deviations; the largest is beyond any sensor and far from overflow.
_SIZES = (1e2, -1e2, 1e4, -1e4, 1e6, -1e6, 1e9, -1e9, 1e12, -1e12)


def assert_bounded_influence(
    make: Make, model: StateModel | None = None, *, at_most: float = 10.0, rng: np.random.Generator | int | None = 0
) -> None:
    """Assert that one measurement, however wrong, moves the state by a bounded amount.

    Parameters
    ----------
    make : callable
        ``make(dim_x, dim_z)`` returns a filter.
    model : StateModel, optional
        Its model. Default: a random stable system of four states and two sensors.
    at_most : float, default 10
        Bound of the movement, sqrt(d' P^-1 d) with the P before the correction. A psi that is bounded by k moves the
        state by at most k sqrt(dim_z).
    rng : numpy.random.Generator or int, optional
        Draws the recording that goes before.

    Raises
    ------
    AssertionError
        If one of 1e2 .. 1e12 standard deviations, of either sign and any one sensor, moves it further.
    """
    model = random_stable(4, 2, rng=rng) if model is None else model
    n, m, _ = model.dims
    scenario = draw(model, 20, rng=rng)
    for sensor in range(m):
        for size in _SIZES:
            kf = runs.load(make(n, m), model)
            for z in scenario.z[:-1]:
                runs.step(kf, runs.or_none(z), model)
            runs.predict(kf, None)
            x, P = runs.state(kf)
            H = model.jacobian(x)
            z = model.measured(x)
            z[sensor] += size * np.sqrt((H @ P @ H.T + model.R)[sensor, sensor])
            runs.measure(kf, z, model)
            moved = _movement(np.ravel(kf.x) - x, P)
            if not moved <= at_most:
                raise AssertionError(
                    f"an innovation of {size:.0e} standard deviations of sensor {sensor} moved the state by "
                    f"{moved:.2g} of its own, expected at most {at_most:g} however wrong a sensor is: the "
                    f"correction is not bounded"
                )


def _movement(step: Array, P: Array) -> float:
    """Return the length of a step in standard deviations, infinite if it is not finite."""
    if not np.isfinite(step).all():
        return np.inf
    return math.sqrt(max(float(step @ np.linalg.solve(P, step)), 0.0))


def assert_recovers_from_jump(
    make: Make, *, size: float = 30.0, within: int = 100, deviations: float = 6.0,
    rng: np.random.Generator | int | None = 0,
) -> None:  # fmt: skip
    """Assert that a filter follows when the state has truly jumped.

    Parameters
    ----------
    make : callable
        ``make(dim_x, dim_z)`` returns a filter.
    size : float, default 30
        Jump of a wandering level, in standard deviations of its sensor.
    within : int, default 100
        After so many samples the filter is back.
    deviations : float, default 6
        Back is: this close to the truth, in standard deviations of the filter that knows of the jump. A normal error
        is further away with probability 2e-9.
    rng : numpy.random.Generator or int, optional
        Draws the recording.

    Raises
    ------
    AssertionError
        If it is not back.
    """
    at, within = 50, _checks.count("within", within, 1)
    scenario: Scenario = draw("level", at + within + 1, jumps={at: [size]}, rng=rng, jump_probability=0.0)
    run = runs.run_filter(scenario.load(make(1, 1)), scenario)
    sigma = np.sqrt(_required(scenario.reference.P)[-1, 0, 0])
    off = np.abs(run.error[at:, 0]) / sigma
    if not off[-1] <= deviations:
        P = _required(run.P)[:, 0, 0]
        # What a filter believes it is sure of: where P is as small as before, it has shrunk by what was not believed.
        grown = float(P[at:].max() / P[at - 1])
        why = (
            f"P has grown {grown:.2g} times, and the correction is cut off all the same"
            if grown > 2.0
            else "P stays as small as before, so it shrinks by measurements that are not believed"
        )
        raise AssertionError(
            f"{within} samples after a jump of the state by {size:g} standard deviations of the sensor the estimate is "
            f"off by {off[-1]:.3g} deviations, expected at most {deviations:g}: the filter takes the new state for an "
            f"outlier for good; {why}"
        )


def assert_efficient(
    runs_: Runs, *, at_least: float, relative_to: Sequence[FilterRun] | FilterRun, false_alarm: float = 1e-6
) -> None:
    """Assert that the squared error is not much larger than that of a reference on the same recordings.

    Parameters
    ----------
    runs_ : FilterRun or list of FilterRun
        At least ten independent runs.
    at_least : float
        Efficiency, the reference's mean squared error over the filter's, that must not be missed; in (0, 1].
    relative_to : list of FilterRun
        The reference, such as ``[scenario.reference for scenario in scenarios]``: it knows every label.
    false_alarm : float, default 1e-6
        Probability that a filter of just this efficiency fails.

    Raises
    ------
    AssertionError
        If it is missed.

    Notes
    -----
    Errors are squared in units of the reference's P, so that no state outweighs another. The test is Student's, on
    at_least * error - reference over the runs, which share their noise.
    """
    tested, reference = as_runs(runs_), as_runs(relative_to)
    if len(tested) != len(reference) or [len(run) for run in tested] != [len(run) for run in reference]:
        raise ValueError(
            f"relative_to: expected a run of the same length for each of the {len(tested)} runs, got {len(reference)}"
        )
    scales = [np.einsum("kii->ki", _required(run.P)) for run in reference]
    errors, best = (
        [float(np.mean(run.error**2 / np.where(s > 0, s, np.inf))) for run, s in zip(which, scales, strict=True)]
        for which in (tested, reference)
    )
    fail([ratio_of_errors(np.array(errors), np.array(best), at_least, false_alarm)])


def ratio_of_errors(errors: Array, reference: Array, at_least: float, false_alarm: float) -> str | None:
    """Return what is wrong if squared errors are too large against those of a reference, run by run."""
    M = len(errors)
    if M < 10:
        raise ValueError(f"runs: expected at least 10 independent runs for a mean and its deviation, got {M}")
    if not 0.0 < _checks.real("at_least", at_least) <= 1.0:
        raise ValueError(f"at_least: expected an efficiency in (0, 1], got {_checks.shown(at_least)}")
    alpha = probability(false_alarm)
    excess = at_least * errors - reference
    deviation = float(excess.std(ddof=1) / np.sqrt(M))
    limit = float(stats.t.isf(alpha, M - 1)) * deviation
    if np.isfinite(errors).all() and float(excess.mean()) <= limit:
        return None
    efficiency = float(reference.mean() / errors.mean())
    return (
        f"efficiency {efficiency:.2g} over {M} runs, expected at least {at_least:g}: the mean squared error is "
        f"{1 / efficiency:.3g} times the reference's"
    )


def _required(P: Array | None) -> Array:
    """Return P, which every run of a filter has."""
    if P is None:
        raise ValueError("P: expected a run with P; run_filter(kf, scenario) returns one")
    return P


#: Small ones show what has a unit of its own. States differ by a factor of 100 alone: in P that is 10,000, and what is
#: lost where roots are made by eigenvalues stays far below what is allowed.
STATE_UNITS, SENSOR_UNITS = np.array([1e-2, 1e-4, 5e-3, 2e-4]), np.array([1e-4, 1.0])


def assert_unit_equivariant(
    make: Make, scenario: Scenario, *, state: ArrayLike | None = None, sensors: ArrayLike | None = None,
    rtol: float = 1e-6,
) -> None:  # fmt: skip
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
    factors = _checks.finite_vector(name, given)
    if factors.size != default.size or not (factors > 0).all():
        raise ValueError(f"{name}: expected {default.size} factors > 0, got {factors}")
    return factors


def _states(make: Make, scenario: Scenario) -> list[tuple[Array, Array]]:
    """Return x and P of a new filter after each prediction and each correction."""
    model, states = scenario.model, []
    kf = runs.load(make(*model.dims[:2]), model)
    for k, z in enumerate(scenario.z):
        runs.predict(kf, None if scenario.u is None else scenario.u[k])
        states.append(runs.state(kf))
        runs.measure(kf, runs.or_none(z), model)
        states.append(runs.state(kf))
    return states


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
