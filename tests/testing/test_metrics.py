"""The metrics drawn from studies."""

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from recordings import assert_refused

from robust_filterpy.testing import bootstrap_interval, fit_percent


def test_fit_percent_is_the_root_of_the_coefficient_of_determination():
    rng = default_rng(2)
    y = rng.normal(size=50)
    model = y + 0.3 * rng.normal(size=50)
    determination = 1 - np.sum((y - model) ** 2) / np.sum((y - y.mean()) ** 2)
    assert_allclose(fit_percent(y, model), 100 * (1 - np.sqrt(1 - determination)))
    assert fit_percent(y, y) == 100
    assert_allclose(fit_percent(y, np.full(50, y.mean())), 0, atol=1e-10)
    assert_allclose(fit_percent(7 * y - 2, 7 * model - 2), fit_percent(y, model))
    both = fit_percent(np.stack([y, 2 * y]), np.stack([model, y]), axis=1)
    assert_allclose(both, [fit_percent(y, model), fit_percent(2 * y, y)])


def test_fit_percent_leaves_missing_samples_out():
    rng = default_rng(3)
    y, model = rng.normal(size=20), rng.normal(size=20)
    gaps = np.where(np.arange(20) % 3 == 0, np.nan, y)
    present = ~np.isnan(gaps)
    assert_allclose(fit_percent(gaps, model), fit_percent(y[present], model[present]))
    for constant in (np.full(10, 0.1), np.full(10, np.nan)):
        with pytest.raises(ValueError, match="constant output"):
            fit_percent(constant, np.zeros(10))
    with pytest.raises(ValueError, match=r"y_model: expected shape \(20,\)"):
        fit_percent(y, model[:, None])


# --- intervals -----------------------------------------------------------------------------------------------


def test_bootstrap_interval_covers_as_often_as_it_says():
    # One call bootstraps 2000 samples of 60 runs at once.
    samples = default_rng(4).exponential(size=(60, 2000))
    interval = bootstrap_interval(samples, level=0.9, rng=0, n_resamples=999)
    covered = np.mean((interval.low < 1) & (1 < interval.high))
    # 5 standard errors, and .02 more because the coverage is nominal only for many runs.
    assert abs(covered - 0.9) < 5 * np.sqrt(0.9 * 0.1 / 2000) + 0.02
    assert_allclose(np.mean(interval.standard_error), 1 / np.sqrt(60), rtol=0.05)
    assert_allclose(interval.estimate, samples.mean(axis=0))


def test_paired_resampling_profits_from_common_noise():
    rng = default_rng(5)
    luck = rng.exponential(size=200)
    error = 2 * luck * rng.uniform(0.9, 1.1, size=200)
    paired = bootstrap_interval((error, luck), "ratio", rng=0, n_resamples=999)
    unpaired = bootstrap_interval((error, rng.permutation(luck)), "ratio", rng=0, n_resamples=999)
    assert paired.low < 2 < paired.high
    assert paired.estimate == error.mean() / luck.mean()
    assert paired.high - paired.low < 0.2 * (unpaired.high - unpaired.low)
    # The linearised standard error of a ratio of means.
    residual = error - paired.estimate * luck
    assert_allclose(paired.standard_error, residual.std() / luck.mean() / np.sqrt(200), rtol=0.15)


def test_bootstrap_interval_depends_on_its_generator_alone():
    sample = default_rng(6).normal(size=30)
    same = [bootstrap_interval(sample, rng=default_rng(7), n_resamples=99) for _ in range(2)]
    assert same[0] == same[1] == bootstrap_interval(sample, rng=7, n_resamples=99)
    assert same[0] != bootstrap_interval(sample, rng=8, n_resamples=99)


@pytest.mark.parametrize("method", ["BCa", "percentile", "basic"])
def test_a_step_common_to_all_runs_gives_a_point(method):
    sample = np.stack([np.full(20, 3.0), np.arange(20.0)], axis=1)
    interval = bootstrap_interval(sample, "mean", rng=0, n_resamples=199, method=method)
    assert interval.low[0] == interval.high[0] == 3.0
    assert interval.low[1] < 9.5 < interval.high[1]


def test_batches_and_callables_change_nothing():
    sample = default_rng(8).normal(size=(40, 3))
    named = bootstrap_interval(sample, "rms", rng=0, n_resamples=199)
    own = bootstrap_interval(sample, lambda s, axis: np.sqrt(np.mean(s**2, axis=axis)), rng=0, n_resamples=199)
    for found, expected in zip(own, named, strict=True):
        assert_allclose(found, expected)


def test_wrong_bootstrap_arguments_are_named():
    assert_refused(bootstrap_interval, {"samples": [1.0, 2.0], "n_resamples": 99}, {
        "samples": [[1.0], (1.0, 2.0)],
        "level": [95, 0.0, 1.0],
        "n_resamples": [1],
        "method": ["bca"],
        "statistic": ["mode"],
    })  # fmt: skip
    with pytest.raises(ValueError, match=r"samples\[1\]: expected shape \(2,\)"):
        bootstrap_interval(([1.0, 2.0], [1.0]), "ratio")
    with pytest.raises(ValueError, match="a tuple of two"):
        bootstrap_interval([1.0, 2.0], "ratio")
