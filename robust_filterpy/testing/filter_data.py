"""Promises about data: the size of a step, what changes nothing, errors over recordings, outliers and jumps."""

from __future__ import annotations

import math
import unittest
from dataclasses import replace
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy import stats

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.testing import runs
from robust_filterpy.testing.bench import OLD, RUNS, Check, FilterSubject, promise
from robust_filterpy.testing.consistency import (
    assert_consistent,
    assert_innovations_white,
    assert_tracks,
    assert_unbiased,
)  # fmt: skip
from robust_filterpy.testing.contamination import Kinds
from robust_filterpy.testing.drawing import Scenario, draw
from robust_filterpy.testing.models import StateModel
from robust_filterpy.testing.runs import apart, deviations, state

#: What is looked at after the equations.
LATER: list[Check] = []

# How far a filter that is no Kalman filter may be off in its own judgment of its errors on clean normal data.
_FACTOR = 1.5

# Innovations in standard deviations; the largest is beyond any sensor and far from overflow.
_SIZES = (1e2, -1e2, 1e4, -1e4, 1e6, -1e6, 1e9, -1e9, 1e12, -1e12)
# Standard deviations that one measurement may move a state; of a jump of the state in those of its sensor, and from the
# truth within which the estimate is back, which a normal error is not with probability 2e-9; the samples that it has.
_MOST, _JUMP, _BACK, _WITHIN = 10.0, 30.0, 6.0, 100
# Small units show what has one of its own. States differ by a factor of 100 alone: in P that is 10,000, and what is
# lost where roots are made by eigenvalues stays far below what is allowed.
_STATE_UNITS, _SENSOR_UNITS = np.array([1e-2, 1e-4, 5e-3, 2e-4]), np.array([1e-4, 1.0])


@promise(LATER, "linear")
def small_innovations_are_believed(subject: FilterSubject) -> None:
    """An innovation of a hundredth of its deviation makes the step of the Kalman gain, by the P shown, at any age."""
    for age in (0, OLD):
        ratio, other = _share(subject, 0.01, age=age)
        if not (abs(ratio - 1.0) < 0.01 and other < 0.01):
            why = "" if age == 0 else " where that of a new one is right: something of earlier steps is still used"
            raise AssertionError(
                f"after {age} samples the step is {ratio:.3g} times the Kalman gain's and {other:.2g} of it across "
                f"it{why}"
            )


@promise(LATER, "linear")
def innovations_are_judged_by_their_own_deviation(subject: FilterSubject) -> None:
    """An innovation of half its deviation, the root of S, is ordinary, be R the smallest or the largest part of S."""
    for R_ratio in (1e-4, 1e4):
        ratio, _ = _share(subject, 0.5, R_ratio=R_ratio)
        if not abs(ratio - 1.0) < 0.1:
            raise AssertionError(
                f"with {R_ratio:g} times the R, an innovation of half its deviation makes {ratio:.2g} of the Kalman "
                f"gain's step: it is not judged by S"
            )


def _share(subject: FilterSubject, e: float, *, age: int = 0, R_ratio: float = 1.0) -> tuple[float, float]:
    """Return the step in units of the Kalman gain's: along it, and across it."""
    step, wanted, P, _ = subject.corrected(e, age, R_ratio)
    step, wanted = step / deviations(P), wanted / deviations(P)
    ratio = float(step @ wanted / (wanted @ wanted))
    return ratio, float(np.linalg.norm(step - ratio * wanted) / np.linalg.norm(wanted))


@promise(LATER, "robust", "recovers")
def what_is_cut_off_makes_nothing_certain(subject: FilterSubject) -> None:
    """A measurement of a hundred deviations makes P shrink by less than half of what an ordinary one does."""
    gained = []
    for e in (0.01, 100.0):
        _, _, P, after = subject.corrected(e, age=20)
        # In units of P itself.
        gained.append(float(np.trace(np.linalg.solve(P, P - after))))
    ordinary, outlier = gained
    if not outlier < 0.5 * ordinary:
        raise AssertionError(
            f"after a measurement of 100 deviations P shrinks {outlier / ordinary:.2g} times as much as after an "
            f"ordinary one: P is sure of what was cut off; keep that part of P"
        )


def _require_alike(one: Any, two: Any, words: str) -> None:
    """Fail with these words, and by how much, where two filters, or x and P of each, are not the same."""
    off = apart(*(pair if isinstance(pair, tuple) else state(pair) for pair in (one, two)))
    if not off <= 1e-6:
        raise AssertionError(words.format(f"{off:.2g}"))


@promise(LATER, "memoryless")
def nothing_is_remembered_but_x_and_P(subject: FilterSubject) -> None:
    """A filter given the x and P of another goes on as that one does, whatever either has seen before, at any age."""
    model, rest = subject.model(), "something of earlier steps (a gain, a measurement, a covariance) is still used"
    past = draw(model, OLD, contamination=_outliers(subject), rng=subject.rng).z
    zs, old = subject.recording(model, 3), subject.new(model)
    for age, z in enumerate(past):
        fresh = subject.new(model)
        fresh.x, fresh.P = np.array(old.x), np.array(old.P)
        for kf in (fresh, old):
            runs.step(kf, z, model)
        _require_alike(fresh, old, f"after {age} steps the next one differs by {{}} from that of a new filter with "
                       f"this x and P: {rest}")  # fmt: skip
    fresh = subject.new(model)
    old.x, old.P = np.array(fresh.x), np.array(fresh.P)
    for call, z in enumerate(zs):
        for name in ("update", "predict"):
            for kf in (fresh, old):
                if name == "update":
                    runs.measure(kf, z, model)
                else:
                    kf.predict()
            _require_alike(fresh, old, f"{name} {call + 1} after x and P were set differs by {{}} from that of a new "
                           f"filter: {rest}")  # fmt: skip


@promise(LATER, "memoryless")
def matrices_may_change_between_calls(subject: FilterSubject) -> None:
    """F, H, Q and R that are replaced, or written into, count from the next call."""
    model, other = subject.model(), subject.model()
    zs = subject.recording(model, 6)
    for name in ("F", "H", "Q", "R"):
        new = getattr(other, name) * (0.5 if name == "F" else 3.0)
        for way in ("replaced", "written into"):
            kf = subject.advance(subject.new(model), zs[:3], model)
            fresh = subject.new(model.with_(**{name: new}))
            fresh.x, fresh.P = np.array(kf.x), np.array(kf.P)
            if way == "replaced":
                setattr(kf, name, new.copy())
            elif isinstance(getattr(kf, name), np.ndarray) and getattr(kf, name).flags.writeable:
                getattr(kf, name)[:] = new
            else:
                continue
            changed = model.with_(**{name: new})
            words = f"{name} {way} between two steps does not count: {{}} off, an old one is used"
            _require_alike(subject.advance(fresh, zs[3:], changed), subject.advance(kf, zs[3:], changed), words)


@promise(LATER)
def order_of_sensors_changes_nothing(subject: FilterSubject) -> None:
    """Permuting the sensors permutes H, R and z and nothing else."""
    scenario = draw(subject.model(4, 3), 20, contamination=_outliers(subject), rng=subject.rng)
    backwards = _of_sensors(scenario, np.arange(3)[::-1])
    _same(subject, scenario, _states(subject, backwards), "with the sensors backwards", "they are not treated alike")


@promise(LATER, "units")
def units_change_nothing(subject: FilterSubject) -> None:
    """In other units of the states and of each sensor the estimate is the same in those units."""
    scenario = draw(subject.model(), 20, contamination=_outliers(subject), rng=subject.rng)
    for size in (1.0, 1e6):
        a, b = size * _STATE_UNITS, size * _SENSOR_UNITS
        other = replace(scenario, model=scenario.model.in_units(a, b), z=scenario.z * b)
        back = [(x / a, P / np.outer(a, a)) for x, P in _states(subject, other)]
        _same(subject, scenario, back, "in other units", "something in the filter has a unit of its own")


def _outliers(subject: FilterSubject) -> str:
    """Return outliers for a filter that does something about them."""
    return "mixture" if "robust" in subject.claims else "none"


@promise(LATER)
def mirror_image_of_the_data_gives_the_mirror_image(subject: FilterSubject) -> None:
    """From -x with -z the filter gives -x+ and the same P+: it does not prefer one sign."""
    scenario = draw(subject.model(), 10, contamination=_outliers(subject), rng=subject.rng)
    # An outlier of either sign is certain to be among them.
    scenario.z[4] += 50.0 if "robust" in subject.claims else 0.0
    mirrored = replace(scenario, model=scenario.model.with_(x=-scenario.model.x), z=-scenario.z)
    back = [(-x, P) for x, P in _states(subject, mirrored)]
    _same(subject, scenario, back, "with the signs of x and z turned", "one sign is preferred")


@promise(LATER, "missing")
def none_is_no_information(subject: FilterSubject) -> None:
    """update(None) leaves x and P as they are."""
    _require_no_information(subject, None, "update(None)")


@promise(LATER, "nan")
def nan_is_a_sensor_that_is_not_there(subject: FilterSubject) -> None:
    """With NaN for a sensor the filter is the one without that sensor; all NaN is no measurement."""
    _require_no_information(subject, np.full(2, np.nan), "update of a z that is all NaN")
    scenario = draw(subject.model(4, 3), 10, rng=subject.rng)
    for gone in range(3):
        z = scenario.z.copy()
        z[:, gone] = np.nan
        others = _of_sensors(scenario, np.delete(np.arange(3), gone))
        words = f"with NaN for sensor {gone}", "expected what the other sensors alone give"
        _same(subject, others, _states(subject, replace(scenario, z=z)), *words)


def _require_no_information(subject: FilterSubject, nothing: Array | None, words: str) -> None:
    """Fail where a measurement of nothing moves x or P."""
    model = subject.model()
    kf, x, P = subject.predicted(model, 5)
    runs.measure(kf, nothing, model)
    _require_alike((x, P), state(kf), f"{words} moved x or P by {{}} deviations: a missing measurement was used")


def _of_sensors(scenario: Scenario, rows: Any) -> Scenario:
    """Return what some of the sensors give, in this order."""
    model = scenario.model.with_(H=scenario.model.H[rows], R=scenario.model.R[np.ix_(rows, rows)])
    return replace(scenario, model=model, z=scenario.z[:, rows])


def _states(subject: FilterSubject, scenario: Scenario) -> list[tuple[Array, Array]]:
    """Return x and P of a new filter after each prediction and each correction."""
    kf = subject.new(scenario.model)
    return [state(kf) for _ in runs.calls(kf, scenario.z, scenario.model)]


def _same(subject: FilterSubject, scenario: Scenario, other: list[tuple[Array, Array]], when: str, why: str) -> None:
    """Fail where other states are not those of a scenario, in standard deviations and correlations."""
    for call, (one, two) in enumerate(zip(_states(subject, scenario), other, strict=True)):
        place = f"{when}, {'update' if call % 2 else 'predict'} {call // 2}"
        _require_alike(one, two, f"{place}: another x or P, by {{}} of its deviation: {why}")


@promise(LATER)
def innovation_and_its_covariance_are_shown(subject: FilterSubject) -> None:
    """kf.y = z - H x_prior and kf.S = H P_prior H' + R after update(z), where shown; R as learned, if it is."""
    model = subject.model()
    kf = subject.predicted(model, 2)[0]
    if not hasattr(kf, "y") or not hasattr(kf, "S"):
        raise unittest.SkipTest("shows no y or S")
    learnt = getattr(kf, "R_learnt", None)
    x, _, S, z = subject.meet(kf, model if learnt is None else model.with_(R=learnt), 0.3)
    for name, got, wanted in (("y", np.ravel(kf.y), z - model.H @ x), ("S", np.asarray(kf.S), S)):
        if np.shape(got) != wanted.shape or not np.allclose(got, wanted, rtol=1e-6, atol=1e-9 * np.abs(wanted).max()):
            sign = "; it has the other sign" if np.shape(got) == wanted.shape and np.allclose(got, -wanted) else ""
            raise AssertionError(
                f"{name} is {np.round(got, 4).tolist()}, expected {np.round(wanted, 4).tolist()}{sign}"
            )


@promise(LATER, "likelihood", "exact")
def likelihood_is_the_gaussian_density_of_the_innovation(subject: FilterSubject) -> None:
    """log_likelihood = -(y' S^-1 y + log det S + m log 2 pi)/2, of the Kalman filter."""
    model = subject.model()
    kf = subject.predicted(model, 3)[0]
    if not hasattr(kf, "log_likelihood"):
        raise unittest.SkipTest("has no log_likelihood")
    x, _, S, z = subject.meet(kf, model, 1.0)
    wanted = float(stats.multivariate_normal(model.H @ x, S).logpdf(z))
    got = float(kf.log_likelihood)
    if not abs(got - wanted) <= 1e-6 * max(abs(wanted), 1.0):
        terms = {
            "-y' S^-1 y / 2": -0.5 * (z - model.H @ x) @ np.linalg.solve(S, z - model.H @ x),
            "-log det S / 2": -0.5 * np.linalg.slogdet(S)[1],
            "-m log(2 pi) / 2": -0.5 * len(z) * np.log(2 * np.pi),
        }
        guilty = [name for name, value in terms.items() if abs(got - (wanted - value)) < 1e-6]
        lacks = f"; {guilty[0]} is missing" if guilty else ""
        raise AssertionError(f"log_likelihood {got:.6g}, expected {wanted:.6g}{lacks}")


@promise(LATER, "likelihood")
def likelihood_integrates_to_one(subject: FilterSubject) -> None:
    """The integral of exp(log_likelihood) over all z is 1, or filters cannot be compared with each other."""
    model = subject.model(2, 1)
    kf = subject.new(model)
    if not hasattr(kf, "log_likelihood"):
        raise unittest.SkipTest("has no log_likelihood")
    # Steps that grow with the distance reach heavy tails.
    t, density = np.linspace(-6.0, 6.0, 301), np.empty(301)
    for k, e in enumerate(np.sinh(t)):
        kf = subject.at_prior(model)
        _, _, S, _ = subject.meet(kf, model, e)
        density[k] = np.exp(float(kf.log_likelihood)) * np.sqrt(S[0, 0])
    integral = float(np.sum(density * np.cosh(t)) * (t[1] - t[0]))
    if not abs(integral - 1.0) <= 0.02:
        raise AssertionError(f"the likelihood integrates to {integral:.3g} over z, expected 1: it is no density")


@promise(LATER, "exact")
def recording_is_filtered_as_by_the_kalman_filter(subject: FilterSubject) -> None:
    """x and P are those of filterpy's KalmanFilter, call by call, over a recording."""
    for dims in ((1, 1), (4, 2), (5, 3)):
        scenario = draw(subject.model(*dims), 40, rng=subject.rng)
        reference = runs.load(KalmanFilter(*dims), scenario.model)
        states = [state(reference) for _ in runs.calls(reference, scenario.z, scenario.model)]
        _same(subject, scenario, states, "next to filterpy's KalmanFilter", "it is another filter")


@promise(LATER, stochastic=True)
def errors_are_as_large_as_P_says(subject: FilterSubject) -> None:
    """NIS and NEES are chi-square: innovations have covariance S, errors have covariance P."""
    assert_consistent(subject.many(), factor=1.0 if subject.is_exact else _FACTOR, false_alarm=subject.false_alarm)


@promise(LATER, stochastic=True)
def errors_have_mean_zero(subject: FilterSubject) -> None:
    """Over independent runs the error of each state has mean 0."""
    assert_unbiased(subject.many(), factor=1.0 if subject.is_exact else _FACTOR, false_alarm=subject.false_alarm)


@promise(LATER, stochastic=True)
def innovations_are_white(subject: FilterSubject) -> None:
    """An innovation tells nothing about the next ones: all that could be learned was learned."""
    tolerance = 0.0 if subject.is_exact else 0.15
    assert_innovations_white(subject.many(), tolerance=tolerance, false_alarm=subject.false_alarm)


@promise(LATER, "robust")
def influence_of_one_measurement_is_bounded(subject: FilterSubject) -> None:
    """A measurement of 1e2 to 1e12 standard deviations moves the state by at most ten of its own."""
    model = subject.model()
    zs = subject.recording(model, 19)
    for sensor in range(len(model.R)):
        for size in _SIZES:
            kf = subject.advance(subject.new(model), zs, model)
            kf.predict()
            x, P, _, _ = subject.meet(kf, model, size * np.eye(len(model.R))[sensor])
            step = np.ravel(kf.x) - x
            moved = math.sqrt(max(float(step @ np.linalg.solve(P, step)), 0.0)) if np.isfinite(step).all() else np.inf
            if not moved <= _MOST:
                raise AssertionError(
                    f"an innovation of {size:.0e} standard deviations of sensor {sensor} moved the state by "
                    f"{moved:.2g} of its own, expected at most {_MOST:g} however wrong a sensor is: the correction is "
                    f"not bounded"
                )


@promise(LATER, "recovers", stochastic=True)
def a_true_jump_is_followed(subject: FilterSubject) -> None:
    """A hundred samples after a jump of the state by 30 sigma the estimate is back at the truth."""
    at = 50
    scenario: Scenario = draw(
        "level", at + _WITHIN + 1, jumps={at: [_JUMP]}, rng=subject.rng, jump_probability=0.0
    )  # fmt: skip
    x, P = (np.array(part) for part in zip(*_states(subject, scenario)[1::2], strict=True))
    off = abs(float((x[-1, 0] - scenario.x[-1, 0]) / scenario.reference.deviation[-1, 0]))
    if not off <= _BACK:
        # What a filter believes it is sure of: where P is as small as before, it has shrunk by what was not believed.
        grown = float(P[at:].max() / P[at - 1].max())
        why = (
            f"P has grown {grown:.2g} times, and the correction is cut off all the same"
            if grown > 2.0
            else "P stays as small as before, so it shrinks by measurements that are not believed"
        )
        raise AssertionError(
            f"{_WITHIN} samples after a jump of the state by {_JUMP:g} standard deviations of the sensor the estimate "
            f"is off by {off:.3g} deviations, expected at most {_BACK:g}: the filter takes the new state for an "
            f"outlier for good; {why}"
        )


@promise(LATER, stochastic=True)
def clean_data_are_used_well(subject: FilterSubject) -> None:
    """On clean normal data the squared error is not much more than the Kalman filter's, or that of least squares."""
    _require_efficient(subject, "none", RUNS, 0.9999 if subject.is_exact else 0.6)


@promise(LATER, "robust", stochastic=True)
def outliers_cost_little(subject: FilterSubject) -> None:
    """With one sample in ten of 30 times the noise the squared error stays near that of who knows the labels."""
    _require_efficient(subject, {"mixture": {"scale_ratio": 30.0}}, 2 * RUNS, 0.5)


def _require_efficient(subject: FilterSubject, contamination: Kinds, count: int, at_least: float) -> None:
    """Compare with the filter that knows every label, over many recordings."""
    assert_tracks(subject.many(contamination, count), at_least=at_least, false_alarm=subject.false_alarm)


@promise(LATER)
def covariance_stays_one(subject: FilterSubject) -> None:
    """P stays symmetric and positive semidefinite, also where rounding errors are not damped."""
    # Without damping from both sides rounding grows at each step by the unstable pole.
    F = np.array([[1.3, 0.3], [0.0, 0.98]])
    model = StateModel(np.zeros(2), np.eye(2), F, np.array([[1.0, 0.5]]), 0.01 * np.eye(2), np.eye(1))
    covariances = []
    for start in (1.0, 1e6):
        kf = subject.new(model.with_(P=start * np.eye(2)))
        for _ in range(300):
            kf.predict()
            x, P = state(kf)
            runs.measure(kf, model.H @ x, model)
            covariances += [P, state(kf)[1]]
    try:
        _checks.covariance("P", np.array(covariances), slack=1e-6)
    except ValueError as error:
        raise AssertionError(
            f"{error}; P = (P + P') / 2 after each step keeps it symmetric, (I - K H) P (I - K H)' + K R K' positive"
        ) from None
