"""Assertions on runs: exact where they say so; they hold of a right estimator and name what is wrong with others."""

import copy
import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from filterpy.common import Saver
from filterpy.kalman import KalmanFilter
from support import by_night, paper_tracker

from robust_filterpy import ParameterTracker, RobustKalmanFilter
from robust_filterpy.testing import (
    assert_consistent,
    assert_innovations_white,
    assert_recovers_parameters,
    assert_tracks,
    assert_unbiased,
    draw,
    run_filter,
    run_tracker,
)
from robust_filterpy.testing.checks import assert_refused_call_changes_nothing, assert_unchanged, visible
from robust_filterpy.testing.consistency import _correlation, ratio_of_errors
from robust_filterpy.testing.models import random_stable
from robust_filterpy.testing.runs import Run, load


def misfit(scenario, **factors):
    """Run filterpy's filter with some of its matrices multiplied."""
    kf = scenario.load(KalmanFilter(*scenario.model.dims[:2]))
    for name, factor in factors.items():
        setattr(kf, name, getattr(kf, name) * factor)
    return run_filter(kf, scenario)


def words(assertion, *args, **kwargs):
    """Return what a failing assertion says."""
    with pytest.raises(AssertionError) as error:
        assertion(*args, **kwargs)
    return str(error.value)


@pytest.mark.parametrize(
    "assertion", by_night([assert_consistent, assert_unbiased, assert_innovations_white], assert_consistent)
)
def test_the_false_alarm_probability_is_what_it_says(assertion):
    """At 20 % a right filter fails in at most 20 % of recordings, and not in much fewer: Bonferroni wastes little."""
    fails, trials = 0, 400
    for seed in range(trials):
        scenario = draw("constant velocity", 25, rng=seed)
        try:
            assertion(scenario.reference, false_alarm=0.2)
        except AssertionError:
            fails += 1
    low, high = scipy.stats.binom.interval(1 - 1e-6, trials, 0.2)
    assert 0.5 * low <= fails <= high, fails


@pytest.mark.parametrize(("factors", "expected"), [
    ({"contamination": "mixture"}, r"outliers \(the ordinary samples alone give"),
    ({"R": 0.1}, r"NIS mean .* expected 2 .* S is about \S+ times too small: R too small"),
    ({"Q": 0.01}, r"times too small: Q too small, or the state moves otherwise \(the innovations are correlated by"),
    ({"R": 10.0}, r"times too large: R or Q too large"),
    ({"Q": 1000.0}, r"times too large: R or Q too large"),
])  # fmt: skip
def test_a_wrong_model_is_named_in_words_and_figures(factors, expected):
    run = misfit(draw("constant velocity", 500, contamination=factors.pop("contamination", "none"), rng=1), **factors)
    with pytest.raises(AssertionError, match=expected):
        assert_consistent(run)


def test_nis_mean_and_band_are_the_chi_square_ones():
    run = misfit(draw("constant velocity", 500, rng=1), R=0.25)
    text = words(assert_consistent, Run(run.y, run.S), false_alarm=1e-3)
    nis = np.mean([y @ np.linalg.solve(S, y) for y, S in zip(run.y, run.S, strict=True)])
    low, high = scipy.stats.chi2.ppf([0.0005, 0.9995], 1000) / 500
    assert f"NIS mean {nis:.3g}, expected 2 ({low:.3g} to {high:.3g}) over 500 steps" in text
    assert f"about {nis / 2:.2g} times too small" in text


def test_errors_are_judged_by_p_even_where_innovations_are_right():
    run = draw("constant velocity", 100, rng=1).reference
    assert "NEES mean" in words(assert_consistent, Run(run.y, run.S, run.x, run.P / 25, truth=run.truth))
    vain = [draw("constant velocity", 100, rng=seed).reference for seed in range(5)]
    vain = [Run(run.y, run.S, run.x, run.P * 25, truth=run.truth) for run in vain]
    assert "less sure than it could be" in words(assert_consistent, vain)


def test_a_factor_is_granted_both_ways():
    scenario = draw("constant velocity", 500, rng=1)
    for factor in (0.25, 4.0):
        run = misfit(scenario, R=factor, Q=factor, P=factor)
        assert_consistent(run, factor=6.0)
        words(assert_consistent, run)


def test_missing_components_are_no_degrees_of_freedom():
    for seed in range(10):
        assert_consistent(draw("random stable", 100, contamination="missing", rng=seed).reference)


def test_a_saver_is_a_run_without_a_truth():
    scenario = draw("constant velocity", 400, rng=1)
    kf = scenario.load(RobustKalmanFilter(4, 2))
    saver = Saver(kf)
    kf.batch_filter(scenario.z, saver=saver)
    assert_consistent(saver, factor=1.5)
    assert "times too small" in words(assert_consistent, Run(np.array(saver.y)[..., 0], 0.05 * np.array(saver.S)))


def test_a_bias_is_named_with_its_state():
    class Biased(KalmanFilter):
        def update(self, z):
            super().update(z)
            self.x[2] += 0.3

    scenarios = [draw("constant velocity", 40, rng=seed) for seed in range(20)]
    runs = [run_filter(scenario.load(Biased(4, 2)), scenario) for scenario in scenarios]
    assert re.match(
        r"state 3 is off by -1\.\d of its standard deviations on average over 20", words(assert_unbiased, runs)
    )
    assert_unbiased([draw("constant velocity", 40, rng=seed).reference for seed in range(20)])


def test_whiteness_does_not_depend_on_the_scale_of_s_and_tells_slow_from_eager():
    scenario = draw("constant velocity", 500, rng=1)
    slow, eager = misfit(scenario, Q=0.001), misfit(scenario, Q=1000.0)
    assert "follows too slowly" in words(assert_innovations_white, slow)
    assert "follows too eagerly" in words(assert_innovations_white, eager)
    right = misfit(scenario)
    assert_innovations_white(Run(right.y, 100.0 * right.S))
    assert_innovations_white(slow, tolerance=0.99)


def test_correlation_at_a_later_lag_is_found():
    e = np.random.default_rng(0).standard_normal((400, 1))
    e[3:] += 0.6 * e[:-3]
    run = Run(e, np.ones((400, 1, 1)))
    assert "at lag 3" in words(assert_innovations_white, run)
    assert_innovations_white(run, lags=2)
    # Of fewer steps than lags there is nothing to say.
    assert_innovations_white(Run(run.y[:3], run.S[:3]), lags=5)


# What a filter makes of outliers


def many(make, contamination, count=30):
    scenarios = [draw("constant velocity", 40, contamination=contamination, rng=seed) for seed in range(count)]
    return [run_filter(s.load(make(4, 2)), s) for s in scenarios], [s.reference for s in scenarios]


def test_efficiency_is_the_ratio_of_squared_errors():
    robust, best = many(RobustKalmanFilter, "mixture")
    plain, _ = many(KalmanFilter, "mixture")
    assert_tracks(robust, at_least=0.6, relative_to=best)
    assert_tracks(best, at_least=1.0, relative_to=best)
    text = words(assert_tracks, plain, at_least=0.6, relative_to=best)
    assert "over 30 runs, expected at least 0.6" in text
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
    accepted = words(assert_refused_call_changes_nothing, kf, lambda kf: kf.update([1.0, 2.0]))
    assert "the call was accepted" in accepted

    def changes_and_refuses(kf):
        kf.x, kf.P[0, 0] = kf.x + 1.0, 7.0
        raise ValueError("too late")

    said = words(assert_refused_call_changes_nothing, copy.deepcopy(kf), changes_and_refuses)
    assert "too late" in said and "P, x" in said
    assert_refused_call_changes_nothing(copy.deepcopy(kf), changes_and_refuses, names=("F", "H"))
    assert "got ZeroDivisionError" in words(assert_refused_call_changes_nothing, kf, lambda kf: 1 / 0)


def test_visible_is_what_can_be_read_as_numbers():
    kf = RobustKalmanFilter(2, 1)
    kf.update(None)
    kept = visible(kf)
    assert {"x", "P", "F", "K", "S", "weights", "z", "alpha", "log_likelihood"} <= set(kept)
    assert not {"update", "inv", "influence"} & set(kept)
    kf.x += 1.0
    assert kept["x"][0, 0] == 0.0
    assert "a step changed x" in words(assert_unchanged, kept, kf, "a step")


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
    signs = altered(tracked(paper_tracker, "arx", sigma=0.1), lambda theta: theta * [-1.0, -1.0, 1.0, 1.0])
    said = words(assert_recovers_parameters, signs)
    assert "a1 = 1." in said and "signs are not" in said
    order = altered(tracked(paper_tracker, "fir", samples=400, sigma=0.1), lambda theta: theta[:, ::-1])
    said = words(assert_recovers_parameters, order)
    assert "run 0: b" in said and "their order is not" in said


LEVEL = draw("level", 20, rng=0).reference


@pytest.mark.parametrize(("call", "error", "match"), [
    (lambda run: assert_tracks([run] * 3), ValueError, "at least 10 independent runs, got 3|runs: expected at least"),
    (lambda run: assert_tracks([run] * 12, at_least=2.0), ValueError, "at_least: expected an efficiency"),
    (lambda run: assert_consistent(np.zeros(3)), TypeError, "runs: expected a Run, a Saver or a list"),
    (lambda run: assert_consistent([]), TypeError, "runs"),
    (lambda run: assert_consistent(LEVEL, factor=0.5), ValueError, "factor: expected a number >= 1"),
    (lambda run: assert_consistent(LEVEL, false_alarm=0.0), ValueError, "false_alarm: expected a probability"),
    (lambda run: assert_unbiased(Run(LEVEL.y, LEVEL.S)), ValueError, "truth|P"),
    (lambda run: assert_innovations_white(LEVEL, lags=0), ValueError, "lags"),
    (lambda run: assert_consistent(Run(LEVEL.y * np.nan, LEVEL.S)), ValueError, "at least one measurement"),
    (lambda run: assert_consistent(Run(LEVEL.y, -LEVEL.S)), AssertionError, "S of step 0 is no covariance"),
    (lambda run: assert_tracks([run] * 12, skip=30), ValueError, "skip: expected fewer than the 30 samples"),
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
