"""Promises of a tracker: memory, arrays, missing and bad input; what it finds, with which sign, how surely."""

from __future__ import annotations

import copy
import inspect
from dataclasses import replace
from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification import ARX, FIR, OutputError
from robust_filterpy.testing.assertions.tracking import assert_interval_coverage, assert_stable_model, assert_tracks
from robust_filterpy.testing.checks.bench import OLD, Promise, not_applicable, promise
from robust_filterpy.testing.checks.tracker_subject import TrackerSubject, advance, theta_of
from robust_filterpy.testing.scenarios.plants import Plant, PlantScenario

#: What is looked at before the parameters, and after them.
ARRAYS: list[Promise] = []
SAMPLES: list[Promise] = []


@promise(ARRAYS)
def output_counts_at_once(subject: TrackerSubject) -> None:
    """theta after update(y, u) depends on this y, not only on those before."""
    scenario = subject.draw("arx", 20)
    found = []
    for shift in (0.0, 1.0):
        tracker = advance(subject.new(scenario), scenario, 0, 19)
        tracker.update(float(scenario.y[19] + shift * np.sqrt(scenario.R)), scenario.u[19])
        found.append(theta_of(tracker))
    if np.array_equal(found[0], found[1]):
        raise AssertionError("two outputs a standard deviation apart gave the same theta: y is used later, or never")


@promise(ARRAYS)
def inputs_are_copied(subject: TrackerSubject) -> None:
    """The caller may fill the same array with the next input: what is remembered is a copy."""
    scenario = subject.draw("arx", 30)
    buffer, found = np.zeros(1), []
    for reused in (False, True):
        tracker = subject.new(scenario)
        for y, u in zip(scenario.y, scenario.u, strict=True):
            buffer[:] = u
            tracker.update(float(y), buffer if reused else buffer.copy())
        found.append(theta_of(tracker))
    if not np.array_equal(found[0], found[1]):
        raise AssertionError("an input array that is filled anew changes what was given before: keep a copy of it")


@promise(SAMPLES)
def stored_states_go_on_alike(subject: TrackerSubject) -> None:
    """What state() returned, restored into a new tracker, goes on as the original does, bit for bit."""
    scenario = subject.draw("armax" if "armax" in subject.claims else "arx", 60)
    tracker = advance(subject.new(scenario), scenario, 0, 30)
    if not hasattr(tracker, "state") or not hasattr(tracker, "restore"):
        raise not_applicable("has no state() and restore()")
    twin = subject.made(scenario.structure)
    twin.restore(tracker.state())
    for one in (tracker, twin):
        advance(one, scenario, 30)
    if not np.array_equal(theta_of(tracker), theta_of(twin)):
        raise AssertionError("the restored tracker ended elsewhere: something of the memory is not in the state")


@promise(SAMPLES)
def run_is_update_by_update(subject: TrackerSubject) -> None:
    """run(y, u) leaves the parameters that a loop over update(y, u) leaves, gaps or not, and goes on where it ended."""
    scenario = subject.draw("arx", 60)
    if "missing" in subject.claims:
        scenario = replace(scenario, y=np.where(np.arange(60) % 20 == 13, np.nan, scenario.y))
    one, other = subject.new(scenario), advance(subject.new(scenario), scenario)
    if not hasattr(one, "run"):
        raise not_applicable("has no run(y, u)")
    one.run(scenario.y[:25], scenario.u[:25])
    one.run(scenario.y[25:], scenario.u[25:])
    if not np.allclose(theta_of(one), theta_of(other), rtol=1e-9, atol=1e-12):
        raise AssertionError(f"run gives theta = {np.round(theta_of(one), 4)}, update {np.round(theta_of(other), 4)}")


@promise(SAMPLES)
def prediction_changes_nothing(subject: TrackerSubject) -> None:
    """predict() returns phi(k+1)' theta of the past, and the tracker goes on as if it had not been called."""
    scenario = subject.draw("arx", 40)
    asked, other = subject.new(scenario), advance(subject.new(scenario), scenario)
    if not callable(getattr(asked, "predict", None)):
        raise not_applicable("has no predict()")
    needs_input = any(
        p.default is inspect.Parameter.empty for p in inspect.signature(asked.predict).parameters.values()
    )
    phi = scenario.structure.regressors(scenario.u, scenario.y)
    for k in range(40):
        got, wanted = asked.predict(scenario.u[k]) if needs_input else asked.predict(), phi[k] @ theta_of(asked)
        if not np.isclose(float(got), wanted, rtol=1e-6, atol=1e-6 * np.sqrt(scenario.R)):
            raise AssertionError(f"the prediction of sample {k} is {float(got):.4g}, phi' theta is {wanted:.4g}")
        advance(asked, scenario, k, k + 1)
    if not np.array_equal(theta_of(asked), theta_of(other)):
        raise AssertionError("asking for predictions changed what was learned")


@promise(SAMPLES, "missing")
def missing_output_is_no_information(subject: TrackerSubject) -> None:
    """update(NaN, u) leaves theta as it is and P no smaller; what it cannot measure a tracker predicts."""
    scenario = subject.clean("arx", 120)
    tracker = advance(subject.new(scenario), scenario, 0, 60)
    theta, P = theta_of(tracker), np.array(getattr(tracker, "P", np.eye(4)), dtype=float)
    for k in range(60, 65):
        tracker.update(float("nan"), scenario.u[k])
        now = np.array(getattr(tracker, "P", np.eye(4)), dtype=float)
        if not np.allclose(theta_of(tracker), theta, rtol=1e-9, atol=1e-12):
            raise AssertionError(f"theta went from {np.round(theta, 3)} to {np.round(theta_of(tracker), 3)} at NaN")
        if np.trace(now) < np.trace(P) * (1 - 1e-9):
            raise AssertionError("P shrank at a missing output")
    advance(tracker, scenario, 65)
    if not np.abs(theta_of(tracker) - theta).max() <= 0.01:
        raise AssertionError(
            f"after a gap theta went from {np.round(theta, 3)} to {np.round(theta_of(tracker), 3)} on data without "
            f"noise: in the gap phi holds something else than the prediction"
        )


_FOUND = 0.02

PARAMETERS: list[Promise] = []


@promise(PARAMETERS)
def autoregression_has_the_sign_of_A(subject: TrackerSubject) -> None:
    """A(q) = 1 + a_1 q^-1 + ..: without noise y(k) = .8 y(k-1) + .. gives a_1 = -.8, not .8."""
    found, truth = _last(subject, Plant(ARX(1, 1), np.array([-0.8, 1.0])))
    if abs(found[0] + truth[0]) < 0.1:
        raise AssertionError(f"a1 = {found[0]:.3g}, expected {truth[0]:g}: phi holds y(k-1), expected -y(k-1)")


@promise(PARAMETERS)
def parameters_stand_in_the_order_of_the_structure(subject: TrackerSubject) -> None:
    """theta = [a_1 .. a_na, b_1 .. b_nb], b_1 with the latest input."""
    for plant in (Plant(FIR(3), np.array([1.0, 2.0, 3.0])), Plant(ARX(1, 2), np.array([-0.5, 1.0, 2.0]))):
        found, truth = _last(subject, plant)
        if np.abs(found - truth).max() > 0.1 and np.allclose(np.sort(found), np.sort(truth), atol=0.1):
            raise AssertionError(f"{plant.structure}: theta = {np.round(found, 2)}, expected {truth}: another order")


@promise(PARAMETERS)
def inputs_act_after_their_delay(subject: TrackerSubject) -> None:
    """With nk = 1 and nk = 3 the input of nk samples ago is what b_1 multiplies."""
    for nk in (1, 3):
        found, truth = _last(subject, Plant(FIR(1, nk), np.array([2.0])))
        if abs(found[0]) < 0.5 * truth[0]:
            raise AssertionError(f"b1 = {found[0]:.3g} for y(k) = 2 u(k-{nk}) without noise, expected 2")


@promise(PARAMETERS)
def regressor_holds_the_past_alone(subject: TrackerSubject) -> None:
    """Where y is noise of its own, theta stays near 0: y(k) is not explained by itself."""
    scenario = subject.draw(Plant(ARX(1, 1), np.array([0.0, 0.0])), 200)
    theta = theta_of(advance(subject.new(scenario), scenario))
    if -1.2 < theta[0] < -0.5:
        raise AssertionError(
            f"theta = {np.round(theta, 2)} for white noise, expected about 0: y(k) stands in its own phi"
        )


@promise(PARAMETERS)
def noiseless_parameters_are_found(subject: TrackerSubject) -> None:
    """Without noise the parameters of FIR and ARX models are found."""
    for plant in ("fir", "arx"):
        found, truth = _last(subject, plant)
        if not np.abs(found - truth).max() <= _FOUND:
            raise AssertionError(f"{plant}: theta = {np.round(found, 3)} without noise, expected {truth}")


@promise(PARAMETERS, "several inputs")
def several_inputs_are_told_apart(subject: TrackerSubject) -> None:
    """Without noise the parameters of a model with two inputs are found."""
    structure, theta = FIR((2, 1), nk=(1, 2)), np.array([1.0, -0.5, 2.0])
    u = subject.rng.standard_normal((100, 2))
    y = structure.regressors(u) @ theta
    tracker = subject.made(structure)
    for k in range(len(y)):
        tracker.update(float(y[k]), u[k])
    if not np.abs(theta_of(tracker) - theta).max() <= _FOUND:
        raise AssertionError(f"theta = {np.round(theta_of(tracker), 3)} without noise, expected {theta}")


@promise(PARAMETERS, "exact")
def covariance_is_that_of_least_squares(subject: TrackerSubject) -> None:
    """P = (Phi' Phi / R + P_0^-1)^-1: nothing is forgotten, and R counts."""
    for samples in (60, OLD):
        tracker, _, P = _least_squares(subject, subject.draw("arx", samples))
        if not np.allclose(tracker.P, P, rtol=0.0, atol=1e-6 * np.abs(P).max()):
            ratio = float(np.trace(tracker.P) / np.trace(P))
            raise AssertionError(f"the trace of P is {ratio:.3g} times that of least squares after {samples} samples")


@promise(PARAMETERS, "exact")
def parameters_are_those_of_least_squares(subject: TrackerSubject) -> None:
    """theta = (Phi' Phi / R + P_0^-1)^-1 (Phi' y / R + P_0^-1 theta_0), with the prior that the tracker starts from."""
    for scenario in (subject.draw("fir", 60), subject.draw("arx", 60)):
        tracker, theta, _ = _least_squares(subject, scenario)
        off = float(np.abs(theta_of(tracker) - theta).max() / np.abs(theta).max())
        if not off <= 1e-6:
            raise AssertionError(
                f"{scenario.structure}: theta = {np.round(theta_of(tracker), 4)} after 60 samples, least squares gives "
                f"{np.round(theta, 4)}"
            )


@promise(PARAMETERS)
def standard_deviations_are_the_roots_of_P(subject: TrackerSubject) -> None:
    """std = sqrt(diag P), where a tracker shows both."""
    scenario = subject.draw("arx", 20)
    tracker = advance(subject.new(scenario), scenario)
    if not hasattr(tracker, "std") or not hasattr(tracker, "P"):
        raise not_applicable("shows no std or P")
    if not np.allclose(tracker.std, np.sqrt(np.diagonal(tracker.P)), rtol=1e-6):
        raise AssertionError(f"std = {tracker.std}, expected {np.sqrt(np.diagonal(tracker.P))}")


@promise(PARAMETERS, "intervals", stochastic=True)
def intervals_hold_the_truth(subject: TrackerSubject) -> None:
    """The 90 % intervals theta -+ 1.64 std hold the truth in 90 % of runs."""
    runs = [subject.run(subject.draw("fir", 30)) for _ in range(200)]
    if runs[0].std is None:
        raise not_applicable("shows no P")
    tolerance = 0.0 if subject.is_exact else 0.05
    assert_interval_coverage(runs, level=0.9, tolerance=tolerance, false_alarm=subject.false_alarm)


@promise(PARAMETERS, "drift", stochastic=True)
def moving_parameters_are_followed(subject: TrackerSubject) -> None:
    """Parameters on a random walk are followed almost as well as by the Kalman tracker that is told Q."""
    runs = [subject.run(subject.draw("fir", 80, drift=0.05)) for _ in range(30)]
    assert_tracks(runs, at_least=0.9 if subject.is_exact else 0.5, skip=20, false_alarm=subject.false_alarm)


@promise(PARAMETERS, "drift", "missing")
def Q_is_added_at_any_age(subject: TrackerSubject) -> None:
    """A sample without an output adds Q to P, in an old tracker as in a new one."""
    scenario = subject.draw("fir", OLD + 1, drift=0.05)
    tracker = subject.showing_P(scenario)
    for start, age in ((0, 20), (20, OLD)):
        before = np.array(advance(tracker, scenario, start, age).P, dtype=float)
        twin = copy.deepcopy(tracker)
        twin.update(np.nan, scenario.u[age])
        grown = np.array(twin.P, dtype=float) - before
        if not np.allclose(grown, scenario.Q, rtol=0.0, atol=1e-6 * scenario.Q.max()):
            ratio = np.trace(grown) / np.trace(scenario.Q)
            raise AssertionError(f"after {age} samples a missing one adds {ratio:.3g} times Q to P")


@promise(PARAMETERS, "robust")
def influence_of_one_output_is_bounded(subject: TrackerSubject) -> None:
    """An output of 1e2 to 1e12 standard deviations moves theta by at most ten of its own, once it is known a little."""
    scenario = subject.draw("fir", 30)
    for size in (sign * size for size in (1e2, 1e6, 1e12) for sign in (1.0, -1.0)):
        tracker = advance(subject.new(scenario), scenario, 0, 29)
        theta = theta_of(tracker)
        deviation = np.sqrt(np.diagonal(getattr(tracker, "P", np.eye(theta.size))))
        tracker.update(float(scenario.y_clean[29] + size * np.sqrt(scenario.R)), scenario.u[29])
        step = (theta_of(tracker) - theta) / deviation
        moved = float(np.linalg.norm(step)) if np.isfinite(step).all() else np.inf
        if not moved <= 10.0:
            raise AssertionError(f"an outlier of {size:.0e} standard deviations moved theta by {moved:.2g} of its own")


@promise(PARAMETERS, "output error", stochastic=True)
def noise_on_the_output_gives_no_bias(subject: TrackerSubject) -> None:
    """An output-error model finds a_1 = -1.5 through noise: phi holds the model's outputs, not the measured ones."""
    _unbiased(subject, [subject.draw("output error", 400, sigma=1.0) for _ in range(9)], {0: 0.2})


@promise(PARAMETERS, "armax", stochastic=True)
def coloured_noise_gives_no_bias(subject: TrackerSubject) -> None:
    """An ARMAX model finds a_1 = -1.5 and c_1 = -.8: phi holds past residuals with their sign, and they are kept."""
    _unbiased(subject, [subject.draw("armax", 400, sigma=1.0) for _ in range(9)], {0: 0.1, 4: 0.4})


@promise(PARAMETERS, "stable")
def model_stays_stable(subject: TrackerSubject) -> None:
    """Whatever the outputs, the roots of an output-error model stay inside the unit circle."""
    wild = Plant(OutputError(2, 2), np.array([-1.5, 0.7, 1.0, 0.5]), drift=0.01)
    scenario = subject.draw(wild, 300)
    y = 20.0 * subject.rng.standard_t(1, 300)
    assert_stable_model(subject.run(replace(scenario, y=y)))


def _last(subject: TrackerSubject, plant: str | Plant) -> tuple[Array, Array]:
    """Return what is found of a plant without noise, and its parameters."""
    scenario = subject.clean(plant)
    truth = scenario.theta[-1] if scenario.theta is not None else np.empty(0)
    return theta_of(advance(subject.new(scenario), scenario)), truth


def _least_squares(subject: TrackerSubject, scenario: PlantScenario) -> tuple[Any, Array, Array]:
    """Return the tracker after the recording, and the parameters and covariance of regularised least squares."""
    tracker = subject.showing_P(scenario)
    prior, start = np.linalg.inv(np.array(tracker.P, dtype=float)), theta_of(tracker)
    advance(tracker, scenario)
    phi = scenario.structure.regressors(scenario.u, scenario.y)
    P = np.linalg.inv(phi.T @ phi / scenario.R + prior)
    return tracker, P @ (phi.T @ scenario.y / scenario.R + prior @ start), P


def _unbiased(subject: TrackerSubject, scenarios: list[PlantScenario], limits: dict[int, float]) -> None:
    """Compare the medians of parameters over the runs with the truth."""
    found = [theta_of(advance(subject.new(scenario), scenario)) for scenario in scenarios]
    median, truth, names = np.median(found, axis=0), scenarios[0].theta[-1], scenarios[0].structure.names  # type: ignore[index]
    for index, limit in limits.items():
        if not abs(median[index] - truth[index]) <= limit:
            raise AssertionError(
                f"{names[index]} = {median[index]:.3g}, the median of {len(found)} runs, expected {truth[index]:g} -+ "
                f"{limit}: noise biases it, or it acts with another sign"
            )
