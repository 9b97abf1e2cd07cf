"""Robustness, invariance, contracts, tracking: each assertion holds of a right estimator and fails of a wrong one."""

import copy
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from support import paper_tracker

from robust_filterpy import ParameterTracker, RobustKalmanFilter
from robust_filterpy.testing import (
    assert_consistent,
    assert_recovers_parameters,
    assert_tracks,
    draw,
    run_filter,
    run_tracker,
)
from robust_filterpy.testing.consistency import _correlation, ratio_of_errors
from robust_filterpy.testing.contracts import assert_refused_call_changes_nothing, assert_unchanged, visible
from robust_filterpy.testing.models import random_stable
from robust_filterpy.testing.runs import Run, load


def fails(call, *match):
    """Return what a failing assertion says."""
    with pytest.raises(AssertionError) as error:
        call()
    for words in match:
        assert words in str(error.value), str(error.value)
    return str(error.value)


# Robustness


def many(make, contamination, count=30):
    scenarios = [draw("constant velocity", 40, contamination=contamination, rng=seed) for seed in range(count)]
    return [run_filter(s.load(make(4, 2)), s) for s in scenarios], [s.reference for s in scenarios]


def test_efficiency_is_the_ratio_of_squared_errors():
    robust, best = many(RobustKalmanFilter, "mixture")
    plain, _ = many(KalmanFilter, "mixture")
    assert_tracks(robust, at_least=0.6, relative_to=best)
    assert_tracks(best, at_least=1.0, relative_to=best)
    text = fails(lambda: assert_tracks(plain, at_least=0.6, relative_to=best), "over 30 runs, expected at least 0.6")
    errors = [np.mean([run.error**2 / np.einsum("kii->ki", one.P) for run, one in zip(runs, best, strict=True)])
              for runs in (plain, best)]  # fmt: skip
    assert f"efficiency {errors[1] / errors[0]:.2g} " in text


def test_efficiency_of_just_the_limit_seldom_fails():
    """Errors of a filter with exactly the efficiency that is asked for; 5 standard errors of the binomial."""
    rng, alarms = np.random.default_rng(0), 0
    for _ in range(2000):
        reference = rng.chisquare(8, 30)
        alarms += ratio_of_errors(2.0 * rng.chisquare(8, 30), reference, 0.5, 0.05) is not None
    assert alarms < 2000 * 0.05 + 5 * np.sqrt(2000 * 0.05 * 0.95)


# Contracts


def test_a_refused_call_is_named_with_what_it_changed():
    kf = load(RobustKalmanFilter(4, 2), random_stable(4, 2, rng=1))
    kf.predict()
    kf.update([0.1, 0.2])
    message = assert_refused_call_changes_nothing(kf, lambda kf: kf.update([1.0, 2.0, 3.0]))
    assert message.startswith("z: expected 2")
    fails(lambda: assert_refused_call_changes_nothing(kf, lambda kf: kf.update([1.0, 2.0])), "the call was accepted")

    def changes_and_refuses(kf):
        kf.x, kf.P[0, 0] = kf.x + 1.0, 7.0
        raise ValueError("too late")

    fails(lambda: assert_refused_call_changes_nothing(copy.deepcopy(kf), changes_and_refuses), "too late", "P, x")
    assert_refused_call_changes_nothing(copy.deepcopy(kf), changes_and_refuses, names=("F", "H"))
    fails(lambda: assert_refused_call_changes_nothing(kf, lambda kf: 1 / 0), "got ZeroDivisionError")
    assert_refused_call_changes_nothing(kf, lambda kf: 1 / 0, raises=ZeroDivisionError)


def test_visible_is_what_can_be_read_as_numbers():
    kf = RobustKalmanFilter(2, 1)
    kf.update(None)
    kept = visible(kf)
    assert {"x", "P", "F", "K", "S", "weights", "z", "alpha", "log_likelihood"} <= set(kept)
    assert not {"update", "inv", "influence"} & set(kept)
    kf.x += 1.0
    assert kept["x"][0, 0] == 0.0
    fails(lambda: assert_unchanged(kept, kf, "a step"), "a step changed x")


# Tracking


def tracked(make, plant, seeds=range(12), samples=120, **options):
    scenarios = [draw(plant, samples, rng=seed, **options) for seed in seeds]
    return [run_tracker(s.load(make(s.structure)), s) for s in scenarios]


def altered(runs, change):
    """Runs whose parameters are those of a tracker with a fault."""
    return [replace(run, x=change(run.x)) for run in runs]


def test_parameters_are_recovered_in_every_unit_of_noise():
    for sigma in (0.01, 0.5):
        assert_recovers_parameters(tracked(paper_tracker, "arx", sigma=sigma))
    assert_recovers_parameters(tracked(paper_tracker, "fir", contamination="mixture"), factor=3.0)
    signs = altered(tracked(paper_tracker, "arx"), lambda theta: theta * [-1.0, -1.0, 1.0, 1.0])
    fails(lambda: assert_recovers_parameters(signs), "a1 = 1.", "signs are not")
    order = altered(tracked(paper_tracker, "fir", samples=400, sigma=0.1), lambda theta: theta[:, ::-1])
    fails(lambda: assert_recovers_parameters(order), "run 0: b", "their order is not")


@pytest.mark.parametrize(("call", "error", "match"), [
    (lambda run: assert_tracks([run] * 3), ValueError, "at least 10 independent runs, got 3|runs: expected at least"),
    (lambda run: assert_tracks([run] * 12, at_least=2.0), ValueError, "at_least: expected an efficiency"),
    (lambda run: assert_tracks(run.x), TypeError, "runs: expected a Run"),
    (lambda run: assert_tracks([run] * 12, relative_to=[run]), ValueError, "relative_to"),
    (lambda run: assert_consistent(Run(x=run.x, truth=run.truth)), ValueError, "y: expected a run with y"),
    (lambda run: assert_recovers_parameters(Run(x=run.x, truth=run.truth)), ValueError, "scenario"),
    (lambda run: Run(x=run.x, truth=run.truth[:-1]), ValueError, r"truth: expected shape \(30, 4\)"),
    (lambda run: Run(x=run.x[0]), ValueError, r"x: expected shape \(N, n\)"),
    (lambda run: Run(x=run.x).error, ValueError, "truth: expected a run with truth"),
    (lambda run: run_tracker(ParameterTracker(run.scenario.structure), draw("arx", 5, nothing=1)), TypeError,
     "nothing"),
    (lambda run: assert_tracks([], at_least=1, relative_to=[]), TypeError, "runs"),
])  # fmt: skip
def test_bad_input_is_named(call, error, match):
    scenario = draw("fir", 30, rng=0)
    with pytest.raises(error, match=match):
        call(run_tracker(scenario.load(paper_tracker(scenario.structure)), scenario))


def test_a_single_innovation_among_zeros_is_no_correlation():
    assert _correlation([np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0])], 1)[:2] == (0.0, 0.0)
    assert _correlation([np.zeros(6)], 1)[:2] == (0.0, 0.0)
