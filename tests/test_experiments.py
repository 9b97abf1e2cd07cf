"""Monte-Carlo studies and the metrics drawn from them."""

import dataclasses
import functools
import os
import signal
import subprocess
import sys
import textwrap
import time
from typing import NamedTuple

import joblib
import numpy as np
import pytest
from numpy.random import SeedSequence, default_rng
from numpy.testing import assert_allclose, assert_array_equal

from robust_filterpy.experiments import (
    bootstrap_interval,
    fit_percent,
    log_squared_error,
    mean_square_error,
    monte_carlo,
    ratio_to,
    rerun,
)


class Study(NamedTuple):
    path: np.ndarray
    end: float


def draw(rng):
    return rng.normal(size=3)


def draw_sized(size, rng):
    return rng.normal(size=size)


def fail_on_negative(rng):
    value = rng.normal()
    if value < 0:
        raise ValueError(f"drew {value:.3f}")
    return value


def thread_variables(rng):
    return {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}


def die_on_fifth(rng):
    if rng.bit_generator.seed_seq.spawn_key == (5,):
        time.sleep(0.5)
        os._exit(1)
    return rng.normal()


# --- running -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("n_jobs", [1, 2, -1])
def test_result_is_the_same_for_any_number_of_jobs(n_jobs):
    expected = [draw(default_rng(child)) for child in SeedSequence(3).spawn(20)]
    study = monte_carlo(draw, 20, seed=3, n_jobs=n_jobs)
    assert_array_equal(study.stacked(), expected)
    assert_array_equal(study.indices, np.arange(20))
    assert study.stopped is None and study.failures == [] and len(study) == study.runs == 20


@pytest.mark.parametrize("backend", ["threading", "multiprocessing"])
def test_any_joblib_backend_gives_the_same_result(backend):
    with joblib.parallel_config(backend=backend, n_jobs=2):
        study = monte_carlo(functools.partial(draw_sized, 4), 50, seed=1)
    assert_array_equal(study.stacked(), monte_carlo(functools.partial(draw_sized, 4), 50, seed=1).stacked())


@pytest.mark.slow
def test_dask_cluster_gives_the_same_result():
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster),
        joblib.parallel_config(backend="dask"),
    ):
        study = monte_carlo(lambda rng: (os.getpid(), draw(rng)), 40, seed=1)
    pids, values = study.stacked()
    assert os.getpid() not in pids
    assert_array_equal(values, monte_carlo(draw, 40, seed=1).stacked())


def test_a_study_can_be_extended():
    whole = monte_carlo(draw, 10, seed=5).stacked()
    assert_array_equal(monte_carlo(draw, range(6, 10), seed=5).stacked(), whole[6:])
    assert_array_equal(monte_carlo(draw, np.array([7, 2]), seed=5).stacked(), whole[[7, 2]])


def test_a_run_can_be_repeated_from_any_kind_of_seed():
    for seed in (0, [1, 2], SeedSequence(9, spawn_key=(4,)), None):
        study = monte_carlo(draw, 4, seed=seed)
        assert_array_equal(rerun(draw, study.seed, 3), study.results[3])
    assert np.any(monte_carlo(draw, 1, seed=None).results[0] != study.results[0])


def test_a_seed_sequence_is_left_unchanged_and_refused_once_it_has_children():
    seed = SeedSequence(2)
    assert_array_equal(monte_carlo(draw, 3, seed=seed).stacked(), monte_carlo(draw, 3, seed=seed).stacked())
    assert seed.n_children_spawned == 0
    seed.spawn(1)
    with pytest.raises(ValueError, match="has not spawned"):
        monte_carlo(draw, 3, seed=seed)


@pytest.mark.parametrize("n_jobs", [1, 2])
def test_failing_runs_are_kept_apart_with_their_seed(n_jobs):
    with pytest.warns(RuntimeWarning, match=r"of 12 runs failed.*rerun\(trial, result.seed"):
        study = monte_carlo(fail_on_negative, 12, seed=0, n_jobs=n_jobs)
    values = np.array([rng.normal() for rng in map(default_rng, SeedSequence(0).spawn(12))])
    assert_array_equal(study.indices, np.flatnonzero(values >= 0))
    assert_array_equal(study.stacked(), values[values >= 0])
    assert [failure.index for failure in study.failures] == list(np.flatnonzero(values < 0))
    for failure in study.failures:
        assert failure.error == f"ValueError: drew {values[failure.index]:.3f}"
        assert "fail_on_negative" in failure.traceback
        assert default_rng(failure.seed).normal() == values[failure.index]
        with pytest.raises(ValueError, match="drew"):
            rerun(fail_on_negative, 0, failure.index)


def test_keyboard_interrupt_returns_what_is_done():
    done = []

    def trial(rng):
        if len(done) == 7:
            raise KeyboardInterrupt
        done.append(rng.normal())
        return done[-1]

    with pytest.warns(RuntimeWarning, match="ended after 7 of 20 runs: KeyboardInterrupt"):
        study = monte_carlo(trial, 20)
    assert study.results == done and len(study) == 7 and study.runs == 20
    assert study.stopped == "KeyboardInterrupt"


def test_keyboard_interrupt_before_the_first_run_comes_through():
    def trial(rng):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        monte_carlo(trial, 3)


SCRIPT = """
    import sys, time, warnings
    from typing import NamedTuple
    from robust_filterpy.experiments import monte_carlo

    class Out(NamedTuple):
        value: float

    def trial(rng):
        time.sleep({pause})
        return Out(rng.normal())

    if __name__ == "__main__":
        warnings.simplefilter("ignore")
        monte_carlo(trial, 2, n_jobs=2)
        print("ready", flush=True)
        study = monte_carlo(trial, {runs}, seed=4, n_jobs=2)
        stack = study.stacked()
        assert type(stack) is Out and list(study.indices) == list(range(len(study)))
        print(len(study), study.stopped, float(stack.value.sum()), flush=True)
"""


def start_script(tmp_path, pause, runs):
    script = tmp_path / "study.py"
    script.write_text(textwrap.dedent(SCRIPT).format(pause=pause, runs=runs))
    # A shell's background jobs ignore Ctrl-C, and their children would too.
    return subprocess.Popen(
        [sys.executable, script],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
@pytest.mark.parametrize("send", [os.kill, os.killpg], ids=["parent alone", "whole group, as a terminal does"])
def test_ctrl_c_returns_what_the_workers_have_done(tmp_path, send):
    process = start_script(tmp_path, pause=0.05, runs=2000)
    assert process.stdout.readline() == "ready\n"
    time.sleep(1.5)
    send(process.pid, signal.SIGINT)
    output, _ = process.communicate(timeout=30)
    count, stopped, total = output.split()
    assert process.returncode == 0 and stopped == "KeyboardInterrupt"
    assert 2 <= int(count) < 200
    expected = [default_rng(child).normal() for child in SeedSequence(4).spawn(int(count))]
    assert_allclose(float(total), np.sum(expected), rtol=1e-12)


def test_trial_of_a_script_runs_in_worker_processes(tmp_path):
    process = start_script(tmp_path, pause=0, runs=30)
    output, _ = process.communicate(timeout=60)
    assert output.split()[1:3] == ["30", "None"]


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_dying_worker_does_not_cost_the_runs_before_it():
    with pytest.warns(RuntimeWarning, match="ended after . of 40 runs: .*Terminated"):
        study = monte_carlo(die_on_fifth, 40, n_jobs=2)
    assert_array_equal(study.indices, np.arange(len(study)))
    assert 0 < len(study) <= 5 and "Terminated" in study.stopped


def test_worker_processes_share_the_cores(monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    for n_jobs in (2, 3):
        for variables in monte_carlo(thread_variables, 4, n_jobs=n_jobs).results:
            for value in variables.values():
                assert int(value) == max(joblib.cpu_count() // n_jobs, 1)


def test_progress_bar_is_shown_on_demand(capsys):
    monte_carlo(draw, 4, progress=True)
    assert "4/4" in capsys.readouterr().err
    for progress in (None, False):
        monte_carlo(draw, 4, progress=progress)
        assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("arguments", "error", "match"),
    [
        ((3, 5), TypeError, "trial: expected a callable"),
        ((lambda: 1, 5), TypeError, r"trial: .* signature \(\)"),
        ((draw, 0), ValueError, "runs: expected at least one"),
        ((draw, -2), ValueError, "runs: expected at least one"),
        ((draw, 2.0), TypeError, "runs: expected an integer"),
        ((draw, True), TypeError, "runs: expected an integer"),
        ((draw, [1, 1]), ValueError, "runs: expected every run once"),
        ((draw, 2, -1), ValueError, "seed: expected integers"),
        ((draw, 2, "x"), TypeError, "seed: expected integers"),
        ((draw, 2, 0, 0), ValueError, "n_jobs: expected"),
        ((draw, 2, 0, 1.5), TypeError, "n_jobs: expected"),
    ],
)
def test_wrong_arguments_are_named(arguments, error, match):
    with pytest.raises(error, match=match):
        monte_carlo(*arguments)


def test_rerun_refuses_what_names_no_run():
    with pytest.raises(ValueError, match="seed: expected the study's seed"):
        rerun(draw, None, 0)
    with pytest.raises(ValueError, match="index: expected"):
        rerun(draw, 0, -1)


# --- stacking ------------------------------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Pair:
    a: np.ndarray
    b: float


def test_stacking_keeps_the_structure():
    def trial(rng):
        return {"study": Study(rng.normal(size=5), 2.0), "pair": Pair(rng.normal(size=(2, 3)), 1.0), "t": (1, [2, 3])}

    study = monte_carlo(trial, 4)
    stack = study.stacked()
    assert isinstance(stack["study"], Study)
    assert stack["study"].path.shape == (4, 5) and stack["study"].end.shape == (4,)
    assert stack["pair"]["a"].shape == (4, 2, 3) and stack["pair"]["b"].shape == (4,)
    assert isinstance(stack["t"], tuple) and stack["t"][0].dtype.kind == "i" and stack["t"][1].shape == (4, 2)
    for i in range(4):
        assert_array_equal(stack["study"].path[i], study.results[i]["study"].path)


def test_stacking_names_what_does_not_fit():
    shapes = monte_carlo(lambda rng: {"x": np.zeros(rng.integers(1, 9))}, 8)
    with pytest.raises(ValueError, match=r"result\['x'\]: expected equal shapes, run 0 has"):
        shapes.stacked()
    structures = monte_carlo(lambda rng: {f"{rng.integers(9)}": 1.0}, 8)
    with pytest.raises(ValueError, match="same structure in all runs, run 0 has dict with"):
        structures.stacked()
    with pytest.warns(RuntimeWarning):
        none = monte_carlo(lambda rng: 1 / 0, 2)
    with pytest.raises(ValueError, match="none; run 0: ZeroDivisionError"):
        none.stacked()


# --- metrics -------------------------------------------------------------------------------------------------


def test_mean_square_error_is_the_loop_over_runs_and_steps():
    rng = default_rng(0)
    x_hat, path = rng.normal(size=(6, 4, 3)), rng.normal(size=(4, 3))
    expected = [np.mean([np.linalg.norm(x_hat[r, k] - path[k]) ** 2 for r in range(6)]) for k in range(4)]
    assert_allclose(mean_square_error(x_hat, path), expected)
    assert_allclose(mean_square_error(x_hat[..., None], np.tile(path, (6, 1, 1))[..., None]), expected)
    assert_allclose(mean_square_error(x_hat[..., 0], path[:, 0]), np.mean((x_hat[..., 0] - path[:, 0]) ** 2, axis=0))


def test_mean_square_error_refuses_shapes_that_numpy_would_broadcast():
    with pytest.raises(ValueError, match=r"x: expected shape \(6, 4, 1\) or \(4, 1\)"):
        mean_square_error(np.zeros((6, 4, 1)), np.zeros(4))
    with pytest.raises(ValueError, match="for a single run"):
        mean_square_error(np.zeros(4), np.zeros(4))


def test_paper_section_4_log_squared_error_is_natural():
    theta_hat = np.array([[3.0, 4.0], [np.e, 0.0]])
    assert_allclose(log_squared_error(theta_hat, np.zeros(2)), [np.log(25), 2])
    assert_allclose(log_squared_error(theta_hat[None], theta_hat - 1), np.log(2) * np.ones((1, 2)))
    with pytest.raises(ValueError, match="theta: expected the last axes"):
        log_squared_error(np.zeros((2, 2)), np.zeros((2, 1)))


def test_ratio_to_divides_means_of_runs():
    reference, error = np.array([[1.0, 0.0], [3.0, 0.0]]), np.array([[6.0, 0.0], [4.0, 1.0]])
    assert_array_equal(ratio_to(reference, error), [2.5, np.inf])
    assert np.isnan(ratio_to([0.0], [0.0]))
    assert ratio_to(np.array([1.0, 2.0, 30.0]), {"a": [4.0, 2.0, 90.0]}, "median") == {"a": 2.0}
    with pytest.raises(ValueError, match="reference: expected shape"):
        ratio_to(reference, error[:1])
    with pytest.raises(ValueError, match="statistic: expected a callable or one of mean, median"):
        ratio_to(reference, error, "mode")


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
    assert paired.estimate == ratio_to(luck, error)
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
    plain = bootstrap_interval(sample, lambda s: np.sqrt(np.mean(s**2)), rng=0, n_resamples=199)
    for other in (own, plain):
        for found, expected in zip(other, named, strict=True):
            assert_allclose(found, expected)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (([1.0],), "at least 2 runs"),
        ((([1.0, 2.0], [1.0]), "ratio"), r"samples\[1\]: expected shape \(2,\)"),
        (([1.0, 2.0], "ratio"), "a tuple of two arrays"),
        (((1.0, 2.0),), r"samples\[0\]: expected shape"),
        (([1.0, 2.0], "mean", 95), "level: .* use 0.95"),
        (([1.0, 2.0], "mean", 0.95, 0, 1), "n_resamples: expected"),
        (([1.0, 2.0], "mean", 0.95, 0, 99, "bca"), "method: expected"),
        (([1.0, 2.0], "mode"), "statistic: expected"),
    ],
)
def test_wrong_bootstrap_arguments_are_named(arguments, match):
    with pytest.raises(ValueError, match=match):
        bootstrap_interval(*arguments)
