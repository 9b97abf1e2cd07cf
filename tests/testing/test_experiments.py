"""Monte-Carlo studies."""

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
from recordings import assert_refused

from robust_filterpy.testing import bootstrap_interval, fit_percent, monte_carlo, rerun


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
        # The second as a library does that calls sys.exit.
        raise ValueError(f"drew {value:.3f}") if value > -1.0 else SystemExit(f"drew {value:.3f}")
    return value


def thread_variables(rng):
    return [os.environ.get(name) for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")]


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


def test_another_joblib_backend_gives_the_same_result():
    with joblib.parallel_config(backend="threading", n_jobs=2):
        study = monte_carlo(functools.partial(draw_sized, 4), 50, seed=1)
    assert_array_equal(study.stacked(), monte_carlo(functools.partial(draw_sized, 4), 50, seed=1).stacked())
    with joblib.parallel_config(backend="multiprocessing", n_jobs=2), pytest.raises(ValueError, match="generator"):
        monte_carlo(draw, 2)


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
        kind = ValueError if values[failure.index] > -1.0 else SystemExit
        assert failure.error == f"{kind.__name__}: drew {values[failure.index]:.3f}"
        assert "fail_on_negative" in failure.traceback
        assert default_rng(failure.seed).normal() == values[failure.index]
        with pytest.raises(kind, match="drew"):
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
    done[:] = range(7)
    # Before the first run it comes through.
    with pytest.raises(KeyboardInterrupt):
        monte_carlo(trial, 3)


SCRIPT = """
    import time, warnings
    from robust_filterpy.testing import monte_carlo

    def trial(rng):
        time.sleep(0.05)
        return rng.normal()

    if __name__ == "__main__":
        warnings.simplefilter("ignore")
        monte_carlo(trial, 2, n_jobs=2)
        print("ready", flush=True)
        study = monte_carlo(trial, 2000, seed=4, n_jobs=2)
        print(len(study), study.stopped, float(study.stacked().sum()), flush=True)
"""


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_ctrl_c_returns_what_the_workers_have_done(tmp_path):
    script = tmp_path / "study.py"
    script.write_text(textwrap.dedent(SCRIPT))
    # A shell's background jobs ignore Ctrl-C, and their children would too.
    default = lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)  # noqa: E731
    process = subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=default
    )
    assert process.stdout.readline() == "ready\n"
    time.sleep(1.5)
    os.killpg(process.pid, signal.SIGINT)
    output, _ = process.communicate(timeout=30)
    count, stopped, total = output.split()
    assert process.returncode == 0 and stopped == "KeyboardInterrupt"
    assert 2 <= int(count) < 200
    expected = [default_rng(child).normal() for child in SeedSequence(4).spawn(int(count))]
    assert_allclose(float(total), np.sum(expected), rtol=1e-12)


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
        values = {value for found in monte_carlo(thread_variables, 4, n_jobs=n_jobs).results for value in found}
        assert values == {str(max(joblib.cpu_count() // n_jobs, 1))}


def test_progress_is_shown_on_demand(capsys):
    monte_carlo(draw, 4, progress=True)
    assert capsys.readouterr().err.startswith("monte_carlo: 0 s, 1 of 4 runs\n")
    for progress in (None, False):
        monte_carlo(draw, 4, progress=progress)
        assert capsys.readouterr().err == ""


def test_wrong_arguments_are_named():
    assert_refused(monte_carlo, {"trial": draw, "runs": 2}, {
        "trial": [3],
        "runs": [0, -2, 2.0, True, [], [1, 1]],
        "seed": [-1, "x"],
        "n_jobs": [0, 1.5],
    })  # fmt: skip
    assert_refused(rerun, {"trial": draw, "seed": 0, "index": 0}, {"seed": [None], "index": [-1]})


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
    with pytest.raises(ValueError, match=r"result\['x'\]: expected equal shapes in all runs, run 0 has"):
        shapes.stacked()
    structures = monte_carlo(lambda rng: {f"{rng.integers(9)}": 1.0}, 8)
    with pytest.raises(ValueError, match="equal structures in all runs, run 0 has dict with"):
        structures.stacked()
    with pytest.warns(RuntimeWarning):
        none = monte_carlo(lambda rng: 1 / 0, 2)
    with pytest.raises(ValueError, match="none; run 0: ZeroDivisionError"):
        none.stacked()


# The metrics drawn from studies.


def test_fit_percent_is_the_root_of_the_coefficient_of_determination():
    rng = default_rng(2)
    y = rng.normal(size=50)
    model = y + 0.3 * rng.normal(size=50)
    determination = 1 - np.sum((y - model) ** 2) / np.sum((y - y.mean()) ** 2)
    assert_allclose(fit_percent(y, model), 100 * (1 - np.sqrt(1 - determination)))
    assert fit_percent(y, y) == 100
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


def test_a_step_common_to_all_runs_gives_a_point_and_a_statistic_has_a_name_or_is_a_function():
    sample = np.stack([np.full(20, 3.0), np.arange(20.0)], axis=1)
    named = bootstrap_interval(sample, "rms", rng=0, n_resamples=199)
    own = bootstrap_interval(
        sample, lambda s, axis: np.sqrt(np.mean(s**2, axis=axis)), rng=default_rng(0), n_resamples=199
    )
    assert named.low[0] == named.high[0] == 3.0 and named.low[1] < named.high[1]
    assert_array_equal(named, own)


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
