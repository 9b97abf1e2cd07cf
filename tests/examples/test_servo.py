"""The parts of the servo study: what it draws, how it fits, and whose gain it compares with whose."""

import importlib
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

ROOT = Path(__file__).parents[2]
THETA = np.array([-0.9, 0.5, -0.1, 0.02, 0.4, 0.3, 0.1, 0.05])


@pytest.fixture
def servo(monkeypatch):
    """Import a module of the folder."""
    monkeypatch.syspath_prepend(str(ROOT / "examples"))
    return lambda name: importlib.import_module(f"servo.{name}")


def signals(models, n=800, outliers=0.0, seed=0):
    """An output-error recording with outliers, in the study's form."""
    rng = np.random.default_rng(seed)
    u = rng.choice([-1.0, 1.0], n)
    truth = lfilter([0.0, *THETA[4:]], [1.0, *THETA[:4]], u)
    noise = 0.05 * rng.standard_normal(n) + (rng.random(n) < outliers) * 3.0 * rng.standard_normal(n)
    return models.Signals(u, truth + noise, truth, np.zeros(n), THETA + 0.02)


@pytest.mark.nightly
def test_constant_model_is_found_through_outliers(servo):
    models = servo("models")
    data = signals(models, n=400, outliers=0.1)
    theta = models.best_constant(data)
    # The a's and b's of such a plant are known less well than what it does.
    found = lfilter([0.0, *theta[4:]], [1.0, *theta[:4]], data.u)
    assert np.std(found - data.truth) < 0.2 * 0.05
    assert models.fit(data, models.tracked(data, models.CONSTANT, 0.05**2)) > 97


def test_free_run_of_a_constant_path_is_the_filter(servo):
    models = servo("models")
    data = signals(models)
    assert models.free_run(np.tile(THETA, (data.u.size, 1)), data.u) == pytest.approx(data.truth)


def test_gain_and_its_deviation_are_those_of_theta(servo):
    models = servo("models")
    P = 1e-6 * np.diag(np.arange(1.0, 9.0))
    gain, std = models.gain_of(THETA, P)
    assert gain == pytest.approx(0.85 / 0.52)
    draws = np.random.default_rng(1).multivariate_normal(THETA, P, 20_000)
    drawn = [models.gain_of(theta, P)[0] for theta in draws]
    assert np.std(drawn) == pytest.approx(std, rel=5 / np.sqrt(2 * 20_000) + 0.01)


def test_looking_at_the_covariance_on_the_way_changes_nothing(servo):
    models = servo("models")
    data = signals(models, outliers=0.1)
    model = models.tracked(data, models.ROBUST, 0.05**2)
    whole = models._tracker(data, model.drift, models.Huber()).run(data.y, data.u)
    assert model.theta == pytest.approx(whole.theta, abs=1e-10)
    assert np.sqrt(model.covariance[-1].diagonal()) == pytest.approx(whole.std[-1])
    assert model.drift in models.DRIFTS


def test_sliding_gain_is_that_of_choked_venting(servo):
    experiment, models = servo("experiment"), servo("models")
    given = experiment.conditions(300, 0.1, np.random.default_rng(10_000))
    recording, p = experiment.drive(given, experiment.NONE), experiment.SERVO
    # What leaves the vented chamber is C_d W sqrt(R T) 0.6847 of its air per second, and the piston follows it.
    air = recording.beta[200] / recording.alpha[200] * p.valve_area * np.sqrt(p.gas_constant * p.temperature) * 0.6847
    assert models.sliding_gain(recording, 200) == pytest.approx(air * (1 / p.area_a + 1 / p.area_b) / 2, rel=5e-3)


def test_without_outliers_the_noise_of_every_loop_is_ordinary(servo):
    experiment = servo("experiment")
    given = experiment.conditions(2000, 0.2, np.random.default_rng(10_001))
    assert given.ordinary.std(axis=0) == pytest.approx(experiment.STD, rel=0.1)
    assert np.array_equal(given.ordinary[~given.is_outlier], given.noise[~given.is_outlier])
    assert given.noise[given.is_outlier[:, 0], 0].std() == pytest.approx(experiment.OUTLIERS[0], rel=0.2)


@pytest.mark.nightly
def test_benchmark_prints_fits_and_targets():
    study = ROOT / "tests/benchmarks/servo_study.py"
    arguments = ["--seeds", "2", "--steps", "300", "--first", "10000"]
    done = subprocess.run([sys.executable, str(study), *arguments], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    for words in ("two-sided", "outliers known", "constant", "valve to velocity", "intervals that do not overlap"):
        assert words in done.stdout
