"""Every example runs from a shell without a screen, draws a figure and comes to a conclusion; most of them at night."""

import importlib
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from PIL import Image

from robust_filterpy import Contaminated, RobustKalmanFilter
from robust_filterpy.plants.servo import simulate_servo

EXAMPLES = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted([*EXAMPLES.glob("*.py"), *EXAMPLES.glob("*/reproduce.py")])

# What makes a script small; every script besides takes --out.
SMALL = {
    "paper/reproduce.py": ["--runs", "2", "--jobs", "1", "--only", "2", "3", "5", "11"],
    "pneumatic_servo.py": ["--steps", "300", "--seeds", "2"],
    "state_estimation_study.py": ["--runs", "3", "--steps", "30", "--jobs", "1"],
    "first_screen.py": ["--seeds", "3"],
    "06_smoothing.py": ["--runs", "2"],
    "11_radar_glint.py": ["--runs", "3"],
    "15_a_fleet_on_dask.py": ["--devices", "1000"],
    "16_in_a_stream.py": ["--devices", "1000"],
    "21_physics_from_a_recording.py": ["--steps", "60"],
}
# One of a filter and one of a tracker run on every commit.
QUICK = ("01_drop_in.py", "07_tracking_parameters.py")


def name_of(script):
    return script.relative_to(EXAMPLES).as_posix()


def run(script, *arguments):
    """Run a script in a process of its own, its figures drawn on no screen."""
    environment = {**os.environ, "MPLBACKEND": "Agg", "PYTHONWARNINGS": "error::UserWarning:__main__"}
    return subprocess.run(
        [sys.executable, str(script), *map(str, arguments)], env=environment, capture_output=True, text=True,
        timeout=300,
    )  # fmt: skip


def test_every_example_imports_what_it_uses(monkeypatch):
    """And does nothing before it is asked to."""
    for script in SCRIPTS:
        with monkeypatch.context() as patch:
            patch.syspath_prepend(str(script.parent))
            spec = importlib.util.spec_from_file_location(f"example_{script.parent.name}_{script.stem}", script)
            module = importlib.util.module_from_spec(spec)
            patch.setitem(sys.modules, spec.name, module)
            spec.loader.exec_module(module)
        assert callable(module.main), name_of(script)


@pytest.mark.nightly
def test_the_picture_of_the_first_page_says_what_its_program_prints(tmp_path):
    """And so does the sentence below it."""
    run(EXAMPLES / "first_screen.py", "--out", tmp_path, "--seeds", 1)
    drawn, kept = (
        Image.open(folder / "first_screen.png").text["Description"] for folder in (tmp_path, EXAMPLES / "figures")
    )
    assert kept == drawn
    numbers = re.findall(r"[0-9.]+(?= m rms)", drawn)
    sentence = "prints the errors: {} m for filterpy's filter, {} m for the robust one"
    assert sentence.format(*numbers) in (EXAMPLES.parent / "docs" / "index.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "script",
    [pytest.param(s, marks=[] if name_of(s) in QUICK else [pytest.mark.nightly], id=name_of(s)) for s in SCRIPTS],
)
def test_example_draws_a_figure_and_concludes(script, tmp_path):
    done = run(script, "--out", tmp_path, *SMALL.get(name_of(script), []))
    assert done.returncode == 0, done.stderr
    figures = [path for path in tmp_path.rglob("*") if path.suffix in {".png", ".pdf", ".svg"}]
    assert figures, done.stdout
    assert all(path.stat().st_size > 5000 for path in figures)
    assert "conclusion" in done.stdout.lower()
    # A path that can be opened from anywhere.
    assert str(tmp_path.resolve()) in done.stdout


# What studies claim: the paper's claims, the servo's loop, the water flow, README's first figure.


PAPER = Path(__file__).parents[2] / "examples" / "paper"


@pytest.fixture
def example(monkeypatch):
    """Import an example by its name."""
    monkeypatch.syspath_prepend(str(PAPER.parent))
    return importlib.import_module


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


def test_outliers_move_the_piston_less_when_the_robust_filter_runs_the_loop(example):
    ServoObserver = example("servo.observer").ServoObserver
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


def test_robust_deviates_less_than_kalman_in_every_disturbance_of_the_water_flow(example, tmp_path):
    scores = example("water_flow").main(["--out", str(tmp_path)])
    kalman = scores["KalmanFilter"]
    for name in ("Robust, Huber", "Robust, Tukey"):
        for disturbance, at_most in {"stop 1": 0.25, "stop 2": 0.25, "stop 3": 0.25, "spike": 0.5}.items():
            assert scores[name].worst[disturbance] < at_most * kalman.worst[disturbance]
        assert scores[name].quiet < kalman.quiet


def test_first_figure_shows_a_typical_gain(example, tmp_path):
    first_screen = example("first_screen")
    errors = first_screen.main(["--out", str(tmp_path), "--seeds", "1"])
    shown = errors["KalmanFilter"] / errors["RobustKalmanFilter"]
    ratios = []
    for seed in range(1000, 1040):
        position, readings, _ = first_screen.simulate(seed)
        kalman, robust = (
            first_screen.rms(first_screen.track(cls, readings) - position) for cls in (KalmanFilter, RobustKalmanFilter)
        )
        ratios.append(kalman / robust)
    assert min(ratios) > 1
    assert 3 < shown < np.median(ratios) * 1.25
