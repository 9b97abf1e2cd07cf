"""Parts of two studies: the paper's claims, which come out of one command, and the servo's loop on bad sensors."""

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from numpy.testing import assert_allclose

from robust_filterpy import Contaminated, RobustKalmanFilter
from robust_filterpy.plants import simulate_output_error
from robust_filterpy.plants.servo import simulate_servo

PAPER = Path(__file__).parents[2] / "examples" / "paper"


@pytest.fixture
def paper(monkeypatch):
    """Import a module of the folder."""
    monkeypatch.syspath_prepend(str(PAPER))
    return importlib.import_module


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


def test_bound_without_drift_and_prior_is_the_cramer_rao_bound(paper):
    identification = paper("identification")
    plant = replace(identification.WELL, contamination=0.0, P0=1e8, Q=0.0)
    g = np.repeat(np.random.default_rng(1).standard_normal((1, identification.STEPS, 4)), 2, axis=0)
    bound, cramer_rao = identification.bounds(g[..., :, None] * g[..., None, :], plant)
    assert bound[-1] ** 0.5 == pytest.approx(cramer_rao, rel=1e-4)


def test_outliers_move_the_piston_less_when_the_robust_filter_runs_the_loop(monkeypatch):
    monkeypatch.syspath_prepend(str(PAPER.parent))
    ServoObserver = importlib.import_module("servo.observer").ServoObserver
    n, dt, std = 1000, 0.01, np.array([5e-5, 500.0, 500.0])
    reference = 0.02 * np.where(np.random.default_rng(0).random(n // 20) < 0.5, -1.0, 1.0).repeat(20)

    def drive(noise, filter):
        return simulate_servo(reference, dt, noise=noise, observer=ServoObserver(filter(6, 3, 6), dt, std))

    deviations, travels = np.empty((2, 3, 2))
    for i, seed in enumerate((11, 12, 13)):
        rng = np.random.default_rng(seed)
        noise = np.column_stack([Contaminated(0.1, 40.0, s).rvs(size=n, random_state=rng) for s in std])
        without = drive(np.where(np.abs(noise) > 5 * std, noise / 40, noise), KalmanFilter)
        for j, filter in enumerate((KalmanFilter, RobustKalmanFilter)):
            recording = drive(noise, filter)
            deviations[i, j] = np.sqrt(np.mean((recording.position - without.position) ** 2))
            travels[i, j] = np.abs(np.diff(recording.valve)).sum() - np.abs(np.diff(without.valve)).sum()
    assert np.all(deviations[:, 1] < 0.7 * deviations[:, 0]) and np.all(travels[:, 1] < 0.4 * travels[:, 0])
