"""Promises that filters and trackers share: memory, copies, refused calls, the size of a step, robustness."""

from __future__ import annotations

import numpy as np

from robust_filterpy.testing.assertions import contracts
from robust_filterpy.testing.assertions.consistency import assert_covariance_stays_one
from robust_filterpy.testing.assertions.contracts import deviations
from robust_filterpy.testing.checks.bench import OLD, Promise, promise, through
from robust_filterpy.testing.checks.filter_subject import FilterSubject

#: What is looked at first, in the middle, and at the end.
CONTRACTS: list[Promise] = []
STEPS: list[Promise] = []
STATISTICS: list[Promise] = []


@promise(CONTRACTS)
def estimates_handed_out_stay_as_they_were(subject: FilterSubject) -> None:
    """What the estimator showed, kept in a list after each call, is not changed by later calls."""
    new, steps = subject.work()
    estimator, shown_before = new(), []
    # As often as it takes for a buffer of past estimates to be written over.
    for step in OLD // len(steps) * list(steps):
        step(estimator)
        shown = {name: getattr(estimator, name) for name in subject.shown if hasattr(estimator, name)}
        shown_before += [(name, value, np.array(value, dtype=float)) for name, value in shown.items()]
    for name, value, then in shown_before:
        if not np.array_equal(value, then, equal_nan=True):
            raise AssertionError(f"a {name} that was kept from an earlier step has changed: it is written in place")


@promise(CONTRACTS)
def two_estimators_share_nothing(subject: FilterSubject) -> None:
    """An estimator at work changes neither another one, nor those made later, nor what these find."""
    new, steps = subject.work()
    idle = new()
    before = contracts.visible(idle)
    after = contracts.visible(through(new(), steps), subject.shown)
    contracts.assert_unchanged(before, idle, "another one's work")
    contracts.assert_unchanged(before, new(), "the first one's work, in those made later,")
    contracts.assert_unchanged(after, through(new(), steps), "something that is left of the first one")


@promise(CONTRACTS)
def deepcopies_go_on_alike(subject: FilterSubject) -> None:
    """A deepcopy goes on as the original does, bit for bit, and neither moves the other."""
    _round_trip(subject, "deepcopy")


@promise(CONTRACTS, "pickle")
def pickles_go_on_alike(subject: FilterSubject) -> None:
    """An unpickled estimator goes on as the original does, bit for bit."""
    _round_trip(subject, "pickle")


def _round_trip(subject: FilterSubject, way: str) -> None:
    """Copy in the middle of a recording."""
    new, steps = subject.work()
    half = len(steps) // 2
    estimator = through(new(), steps[:half])
    contracts.assert_state_round_trip(estimator, lambda one: through(one, steps[half:]), ways=(way,))


@promise(CONTRACTS, "validates")
def bad_input_is_refused_and_changes_nothing(subject: FilterSubject) -> None:
    """What cannot be right raises ValueError or TypeError; the estimate, and what it is later, are as without it."""
    (new, steps), faults = subject.work(), []
    half = len(steps) // 2
    wanted = contracts.visible(through(new(), steps), subject.shown)
    for words, call in subject.bad_calls().items():
        estimator = through(new(), steps[:half])
        try:
            contracts.assert_refused_call_changes_nothing(estimator, call, names=subject.shown)
            contracts.assert_unchanged(wanted, through(estimator, steps[half:]), "after it, what followed")
        except AssertionError as error:
            faults.append(f"{words}: {error}")
    if faults:
        raise AssertionError("; ".join(faults))


@promise(STEPS, "linear")
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


@promise(STEPS, "linear")
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


@promise(STEPS, "robust", "recovers")
def what_is_cut_off_makes_nothing_certain(subject: FilterSubject) -> None:
    """A measurement of a hundred deviations makes P shrink by less than half of what an ordinary one does."""
    ordinary, outlier = (_gained(subject, e) for e in (0.01, 100.0))
    if not outlier < 0.5 * ordinary:
        raise AssertionError(
            f"after a measurement of 100 deviations P shrinks {outlier / ordinary:.2g} times as much as after an "
            f"ordinary one: P is sure of what was cut off; keep that part of P"
        )


def _gained(subject: FilterSubject, e: float) -> float:
    """Return by how much P shrinks, in units of itself."""
    _, _, P, after = subject.corrected(e, age=20)
    return float(np.trace(np.linalg.solve(P, P - after)))


@promise(STATISTICS, stochastic=True)
def clean_data_are_used_well(subject: FilterSubject) -> None:
    """On clean normal data the squared error is not much more than the Kalman filter's, or that of least squares."""
    subject.assert_efficient("none")


@promise(STATISTICS, "robust", stochastic=True)
def outliers_cost_little(subject: FilterSubject) -> None:
    """With one sample in ten of 30 times the noise the squared error stays near that of who knows the labels."""
    subject.assert_efficient({"mixture": {"scale_ratio": 30.0}})


@promise(STATISTICS)
def covariance_stays_one(subject: FilterSubject) -> None:
    """P stays symmetric and positive semidefinite, also where rounding errors are not damped."""
    assert_covariance_stays_one(subject.covariances())
