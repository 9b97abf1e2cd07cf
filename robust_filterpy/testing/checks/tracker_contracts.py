"""Promises between the lines of a tracker: memory, arrays, copies, missing and bad input."""

from __future__ import annotations

import inspect
from dataclasses import replace

import numpy as np

from robust_filterpy.testing.checks.bench import Promise, not_applicable, promise
from robust_filterpy.testing.checks.tracker_subject import TrackerSubject, advance, theta_of

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
        raise AssertionError("asking for predictions changed what was learnt")


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
