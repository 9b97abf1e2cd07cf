"""Promises in numbers: on many recordings, what is the error, and does the filter know it?"""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy._checks import Array
from robust_filterpy.testing.assertions.bounds import furthest
from robust_filterpy.testing.assertions.consistency import (
    assert_consistent,
    assert_innovations_white,
    assert_unbiased,
)
from robust_filterpy.testing.assertions.contracts import assert_same_filter
from robust_filterpy.testing.assertions.robustness import (
    assert_bounded_influence,
    assert_recovers_from_jump,
)
from robust_filterpy.testing.checks.bench import Promise, promise
from robust_filterpy.testing.checks.filter_subject import FilterSubject
from robust_filterpy.testing.scenarios import runs
from robust_filterpy.testing.scenarios.models import StateModel
from robust_filterpy.testing.scenarios.runs import state

PROMISES: list[Promise] = []


@promise(PROMISES)
def ordinary_data_keep_everything_finite(subject: FilterSubject) -> None:
    """On 50 ordinary measurements x and P stay finite and the error stays below 1000 standard deviations."""
    model = subject.model()
    kf = subject.new(model)
    for k, z in enumerate(subject.recording(model, 50)):
        runs.step(kf, z, model)
        x, P = state(kf)
        if not (np.isfinite(P).all() and furthest(model.H @ x - z, model.R) < 1e3):
            raise AssertionError(f"after step {k} the state has run away from the measurements, or is not finite")


@promise(PROMISES, "exact")
def recording_is_filtered_as_by_the_kalman_filter(subject: FilterSubject) -> None:
    """x and P are those of filterpy's KalmanFilter, call by call, over a recording."""
    for dims in ((1, 1), (4, 2), (5, 3)):
        model = subject.model(*dims)
        zs = subject.recording(model, 40)
        kf, reference = subject.new(model), runs.load(KalmanFilter(*dims), model)

        def step(one: Any, z: Array, model: StateModel = model) -> None:
            runs.step(one, z, model)

        reference.x = reference.x.reshape(np.shape(kf.x))
        assert_same_filter(kf, reference, zs, rtol=1e-6, step=step)


@promise(PROMISES, stochastic=True)
def errors_are_as_large_as_P_says(subject: FilterSubject) -> None:
    """NIS and NEES are chi-square: innovations have covariance S, errors have covariance P."""
    assert_consistent(subject.many()[1], factor=subject.factor, false_alarm=subject.false_alarm)


@promise(PROMISES, stochastic=True)
def errors_have_mean_zero(subject: FilterSubject) -> None:
    """Over independent runs the error of each state has mean 0."""
    assert_unbiased(subject.many()[1], factor=subject.factor, false_alarm=subject.false_alarm)


@promise(PROMISES, stochastic=True)
def innovations_are_white(subject: FilterSubject) -> None:
    """An innovation tells nothing about the next ones: all that could be learnt was learnt."""
    tolerance = 0.0 if subject.is_exact else 0.15
    assert_innovations_white(subject.many()[1], tolerance=tolerance, false_alarm=subject.false_alarm)


@promise(PROMISES, "robust")
def influence_of_one_measurement_is_bounded(subject: FilterSubject) -> None:
    """A measurement of 1e2 to 1e12 standard deviations moves the state by at most ten of its own."""
    assert_bounded_influence(subject.made, rng=subject.rng)


@promise(PROMISES, "recovers", stochastic=True)
def a_true_jump_is_followed(subject: FilterSubject) -> None:
    """A hundred samples after a jump of the state by 30 sigma the estimate is back at the truth."""
    assert_recovers_from_jump(subject.made, rng=subject.rng)
