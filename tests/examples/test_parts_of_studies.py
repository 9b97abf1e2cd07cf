"""Parts of two studies: the paper's figures and claims, which come out of one command, and the servo's."""

import importlib
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from recordings import binary
from scipy.signal import lfilter

from robust_filterpy import Huber, RobustKalmanFilter
from robust_filterpy.plants import simulate_output_error

PAPER = Path(__file__).parents[2] / "examples" / "paper"


def reproduce(out, *arguments):
    """Run the command in a process of its own."""
    return subprocess.run(
        [sys.executable, str(PAPER / "reproduce.py"), "--runs", "2", "--out", str(out), *map(str, arguments)],
        env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.mark.nightly
def test_figures_that_are_asked_for_and_a_report_that_does_not_depend_on_the_number_of_jobs(tmp_path):
    reports = []
    for jobs in (1, 2):
        out = tmp_path / str(jobs)
        done = reproduce(out, "--jobs", jobs, "--only", 4, 11)
        assert done.returncode == 0, done.stderr
        assert {path.name for path in out.glob("*.png")} == {"fig04.png", "fig11.png"}
        reports.append((out / "report.md").read_text(encoding="utf-8"))
    assert reports[0] == reports[1]
    assert "does not hold" in reports[0]


@pytest.fixture
def paper(monkeypatch):
    """Import a module of the folder."""
    monkeypatch.syspath_prepend(str(PAPER))
    return importlib.import_module


def test_unknown_figure_is_refused(paper, tmp_path):
    for wrong in (("--only", "20"), ("--only", "0"), ("--runs", "1")):
        with pytest.raises(SystemExit) as refused:
            paper("reproduce").main([*wrong, "--out", str(tmp_path)])
        assert refused.value.code == 2


def test_filters_over_all_runs_are_the_loop_over_filterpy_and_refuse_the_same_runs(paper, form):
    paper("state_estimation")
    study = paper("state_estimation_study")
    rng = np.random.default_rng(3)
    z, is_outlier = rng.standard_normal((3, 60)), rng.random((3, 60)) < 0.2
    # Every sample of this run is clipped, and with the realized psi' P is never corrected: no reason to refuse it.
    z[1] = 1e6
    for P0, expected_refusals, realized_refusals in ((0.1, 0, 0), (10.0, 3, 2)):
        setting, refused = study.Setting("", P0=P0), {}
        for name in study.FILTERS:
            found, expected = (way(name, setting, z, is_outlier) for way in (study.filtered, study.looped))
            assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
            refused[name] = np.isnan(found).any(axis=(1, 2)).sum()
        assert (refused.pop("T=1,  expected"), refused.pop("T=1,  realized")) == (expected_refusals, realized_refusals)
        assert not any(refused.values())


@pytest.mark.parametrize("plant", ["SECTION4", "WELL"])
def test_trackers_of_a_recording_are_the_loop_over_filterpy(paper, form, plant, monkeypatch):
    identification = paper("identification")
    monkeypatch.setattr(identification, "STEPS", 300)
    found, expected = (
        identification.trial(np.random.default_rng(5), getattr(identification, plant), tracking=way)
        for way in (identification.tracked, identification.looped)
    )
    for one, other in zip(found, expected, strict=True):
        assert_allclose(one, other, rtol=1e-9, atol=1e-9)
    # T = 1 is refused from the well-conditioned plant's start, and nothing else is.
    refused = np.isnan(found.response_error)
    assert refused.sum() == (2 if plant == "WELL" else 0)


def test_equation_50_of_the_report_is_the_gain_of_the_filter(paper):
    """And (52) is (50) where (51) holds."""
    rate = paper("initial_rate")
    huber = Huber.from_contamination(0.1)
    kf = RobustKalmanFilter(4, 1, influence=huber, scaling="unit", information="realized")
    kf.x, kf.P, kf.F, kf.H, kf.Q, kf.R = np.zeros(4), 0.5 * np.eye(4), rate.F, rate.H, rate.W, 0.1 * np.eye(1)
    before, seen = None, set()
    for z in (0.3, 5.0, -0.2, 9.0, 9.0, 0.1):
        kf.predict()
        P = kf.P.copy()
        kf.update(z)
        if before is not None:
            P_before, nu = before
            large = bool(rate.is_large(nu, huber.threshold))
            K = rate.gain(P_before, float(huber.psi_deriv(nu)), rate.H, rate.F, rate.H, rate.W)
            assert_allclose(kf.K, K, rtol=1e-12)
            if large:
                assert_allclose(kf.K, rate.gain_after_large(P_before, rate.F, rate.H, rate.W), rtol=1e-12)
            seen.add(large)
        before = P, kf.y.item()
    assert seen == {True, False}


def test_a_start_that_is_far_off_keeps_the_gain_of_the_realized_psi_up(paper):
    rate = paper("initial_rate")
    near, far = (rate.starts(offset, 10, 10_000) for offset in (0, 10))
    assert far.large[:, :5].all() and near.large[:, :5].mean() < 0.5
    assert (far.K[0] > far.K[1])[:, 1:].all() and np.mean(near.K[0] < near.K[1]) > 0.5
    assert far.squared[0].mean() < 0.7 * far.squared[1].mean()


def test_verdicts_are_one_sided_and_join(paper):
    report, Interval = paper("report"), paper("robust_filterpy.testing.studies").Interval
    # Far better than asked for is no failure of "no worse".
    for low, high, verdict in ((0.4, 0.6, True), (1.2, 1.6, False), (1.0, 1.2, None)):
        assert report.judged(Interval((low + high) / 2, low, high, 0.1), high=1.1) is verdict
    for verdicts, joined in (([True, True], True), ([True, None], None), ([None, False], False)):
        assert report.together(verdicts) is joined


def test_the_report_in_the_repository_gives_every_claim_a_criterion_a_figure_and_its_failures_a_reason():
    lines = (PAPER / "figures" / "report.md").read_text(encoding="utf-8").splitlines()
    start = lines.index("## Claims") + 4
    claims = [line.strip("| ").replace("\\|", "/").split(" | ") for line in lines[start : lines.index("", start)]]
    assert len(claims) >= 20
    for figures, claim, criterion, measured, verdict in claims:
        assert figures and claim.endswith(".") and criterion and measured
        holds = verdict.startswith(("**holds**", "**undecided**"))
        assert holds or (verdict.startswith("**does not hold**: ") and verdict.endswith("."))
    # Every fact stands once.
    assert len({tuple(row[:3]) for row in claims}) == len(claims)
    for name in (line.split("](")[1][:-1] for line in lines if line.startswith("![")):
        assert (PAPER / "figures" / name).stat().st_size > 3000


def test_information_is_made_of_the_derivative_of_the_output(paper):
    identification = paper("identification")
    rng = np.random.default_rng(2)
    theta = [-1.5, 0.7, 1.0, 0.5] + np.cumsum(0.002 * rng.standard_normal((50, 4)), axis=0)
    u = rng.standard_normal(50)

    def output(step):
        return simulate_output_error(theta + step, u, na=2, nb=2).y_clean

    steps = 1e-6 * np.eye(4)
    g = np.transpose([(output(step) - output(-step)) / 2e-6 for step in steps])
    information = identification._information(theta, u, output(0.0), 2, 0.25)
    assert_allclose(information, g[:, :, None] * g[:, None, :] / 0.25, rtol=1e-6, atol=1e-6)


@pytest.mark.nightly
def test_comparison_with_a_loop_checks_the_numbers(paper, tmp_path):
    done = reproduce(tmp_path, "--compare-loop")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("numbers agree to") == 3
    speed = paper("speed")
    with pytest.raises(RuntimeError, match="numbers differ"):
        speed.compared("x", lambda way: way(), lambda: np.ones(3), lambda: np.ones(3) + 1e-6)


def test_bound_without_drift_and_prior_is_the_cramer_rao_bound(paper):
    identification = paper("identification")
    plant = replace(identification.WELL, contamination=0.0, P0=1e8, Q=0.0)
    g = np.repeat(np.random.default_rng(1).standard_normal((1, identification.STEPS, 4)), 2, axis=0)
    bound, cramer_rao = identification.bounds(g[..., :, None] * g[..., None, :], plant)
    assert bound[-1] ** 0.5 == pytest.approx(cramer_rao, rel=1e-4)


# The servo study: what it draws, how it fits, and whose gain it compares with whose.

THETA = np.array([-0.9, 0.5, -0.1, 0.02, 0.4, 0.3, 0.1, 0.05])


@pytest.fixture
def servo(monkeypatch):
    """Import a module of the folder."""
    monkeypatch.syspath_prepend(str(PAPER.parent))
    return lambda name: importlib.import_module(f"servo.{name}")


def signals(models, n=800, outliers=0.0, seed=0):
    """An output-error recording with outliers, in the study's form."""
    rng, u = binary(seed, n)
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


def test_sliding_gain_is_that_of_choked_venting(servo):
    experiment, models = servo("experiment"), servo("models")
    given = experiment.conditions(300, 0.1, np.random.default_rng(10_000))
    recording, p = experiment.drive(given, experiment.NONE), experiment.SERVO
    # What leaves the vented chamber is C_d W sqrt(R T) 0.6847 of its air per second, and the piston follows it.
    air = recording.beta[200] / recording.alpha[200] * p.valve_area * np.sqrt(p.gas_constant * p.temperature) * 0.6847
    assert models.sliding_gain(recording, 200) == pytest.approx(air * (1 / p.area_a + 1 / p.area_b) / 2, rel=5e-3)


@pytest.mark.nightly
def test_benchmark_prints_fits_and_targets():
    study = PAPER.parents[1] / "tests/benchmarks/servo_study.py"
    arguments = ["--seeds", "2", "--steps", "300", "--first", "10000"]
    done = subprocess.run([sys.executable, str(study), *arguments], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    for words in ("two-sided", "outliers known", "constant", "valve to velocity", "intervals that do not overlap"):
        assert words in done.stdout
