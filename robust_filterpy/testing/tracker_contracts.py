"""Promises between the lines of a tracker: memory, arrays, copies, missing and bad input."""

from __future__ import annotations

import functools
import inspect
from dataclasses import replace
from typing import Any

import numpy as np

from robust_filterpy.testing import contracts
from robust_filterpy.testing.checks import Promise, not_applicable, promise
from robust_filterpy.testing.consistency import assert_covariance_stays_one
from robust_filterpy.testing.tracker_subject import TrackerSubject, advance, theta_of

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
def two_trackers_share_nothing(subject: TrackerSubject) -> None:
    """A tracker at work changes neither another one nor what those made later find."""
    scenario = subject.draw("arx", 40)
    alone = theta_of(advance(subject.new(scenario), scenario))
    idle = subject.made(scenario.structure)
    before = theta_of(idle)
    advance(subject.new(scenario), scenario)
    if not np.array_equal(before, theta_of(idle)):
        raise AssertionError("another tracker's work changed theta")
    if not np.array_equal(alone, theta_of(advance(subject.new(scenario), scenario))):
        raise AssertionError("the same data gave another theta the second time: something is left of the first tracker")


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


@promise(ARRAYS)
def estimates_handed_out_stay_as_they_were(subject: TrackerSubject) -> None:
    """tracker.theta, kept in a list at each sample, is not changed by later samples."""
    scenario = subject.draw("arx", 20)
    tracker, kept = subject.new(scenario), []
    for k in range(20):
        advance(tracker, scenario, k, k + 1)
        kept.append((tracker.theta, theta_of(tracker)))
    if not all(np.array_equal(np.ravel(theta), then) for theta, then in kept):
        raise AssertionError("a theta that was kept from an earlier sample has changed: it is written in place")


@promise(ARRAYS)
def deepcopies_go_on_alike(subject: TrackerSubject) -> None:
    """A deepcopy goes on as the original does, bit for bit, and neither moves the other."""
    _round_trip(subject, "deepcopy")


@promise(ARRAYS, "pickle")
def pickles_go_on_alike(subject: TrackerSubject) -> None:
    """An unpickled tracker goes on as the original does, bit for bit."""
    _round_trip(subject, "pickle")


@promise(ARRAYS)
def covariance_stays_one(subject: TrackerSubject) -> None:
    """P stays symmetric and positive semidefinite while the input says nothing new."""
    scenario = subject.draw("arx", 400)
    scenario = replace(scenario, u=np.ones(400), y=scenario.y - scenario.y_clean)
    tracker, kept = subject.new(scenario), []
    if not hasattr(tracker, "P"):
        raise not_applicable("shows no P")
    for k in range(400):
        advance(tracker, scenario, k, k + 1)
        kept.append(np.array(tracker.P, dtype=float))
    assert_covariance_stays_one(kept)


def _round_trip(subject: TrackerSubject, way: str) -> None:
    """Copy in the middle of a recording."""
    scenario = subject.draw("armax" if "armax" in subject.claims else "arx", 60)
    # Inputs of +-1 would hide a memory that is shared.
    scenario = replace(scenario, u=subject.rng.standard_normal(60))
    tracker = advance(subject.new(scenario), scenario, 0, 30)
    contracts.assert_state_round_trip(tracker, lambda one: advance(one, scenario, 30), ways=(way,))


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
    """run(y, u) leaves the parameters that a loop over update(y, u) leaves, and goes on where the last run ended."""
    scenario = subject.draw("arx", 60)
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


BAD_SAMPLES: dict[str, tuple[Any, Any]] = {
    "an infinite y": (np.inf, 1.0),
    "text for y": ("high", 1.0),
    "two outputs": ([1.0, 2.0], 1.0),
    "a missing u": (1.0, np.nan),
    "an infinite u": (1.0, np.inf),
    "two inputs": (1.0, [1.0, 2.0]),
}


@promise(SAMPLES, "validates")
def bad_input_is_refused_and_changes_nothing(subject: TrackerSubject) -> None:
    """A y or u that cannot be right raises ValueError or TypeError, and theta, P and what follows are as before."""
    scenario, faults = subject.draw("arx", 20), []
    for words, (y, u) in BAD_SAMPLES.items():
        tracker, other = (advance(subject.new(scenario), scenario, 0, 10) for _ in range(2))
        try:
            call = functools.partial(_update, y=y, u=u)
            contracts.assert_refused_call_changes_nothing(tracker, call, names=("theta", "P"))
            ends = [theta_of(advance(one, scenario, 10)) for one in (tracker, other)]
            if not np.array_equal(ends[0], ends[1]):
                raise AssertionError("the samples after the refused one give another theta")
        except AssertionError as error:
            faults.append(f"{words}: {error}")
    if faults:
        raise AssertionError("; ".join(faults))


def _update(tracker: Any, y: Any, u: Any) -> None:
    """Make one call."""
    tracker.update(y, u)
