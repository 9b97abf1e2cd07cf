"""Every example runs from a shell without a screen, draws a figure and comes to a conclusion; most of them at night."""

import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from PIL import Image

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
        [sys.executable, str(script), *map(str, arguments)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )


def test_small_settings_belong_to_a_script():
    assert {*SMALL, *QUICK} <= {name_of(s) for s in SCRIPTS}


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
