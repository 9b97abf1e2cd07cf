"""The paper's figures and claims come out of one command, the same for a seed however many processes make them."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

PAPER = Path(__file__).parents[1] / "examples" / "paper"


def reproduce(out, *arguments):
    """Run the command in a process of its own."""
    return subprocess.run(
        [sys.executable, str(PAPER / "reproduce.py"), "--runs", "2", "--out", str(out), *map(str, arguments)],
        env={**os.environ, "MPLBACKEND": "Agg"},
        capture_output=True,
        text=True,
        timeout=300,
    )


def test_only_makes_the_figures_asked_for(tmp_path):
    done = reproduce(tmp_path, "--jobs", 1, "--only", 2, 7)
    assert done.returncode == 0, done.stderr
    assert {path.name for path in tmp_path.glob("*.png")} == {"fig02.png", "fig07.png"}


def test_report_does_not_depend_on_the_number_of_jobs(tmp_path):
    reports = []
    for jobs in (1, 2):
        done = reproduce(tmp_path / str(jobs), "--jobs", jobs, "--only", 4, 11)
        assert done.returncode == 0, done.stderr
        reports.append((tmp_path / str(jobs) / "report.md").read_text(encoding="utf-8"))
    assert reports[0] == reports[1]
    assert "does not hold" in reports[0]


@pytest.mark.parametrize("wrong", [("--only", 20), ("--only", 1)])
def test_unknown_figure_is_refused(tmp_path, wrong):
    assert reproduce(tmp_path, *wrong).returncode == 2


def test_bound_without_drift_and_prior_is_the_cramer_rao_bound(monkeypatch):
    monkeypatch.syspath_prepend(str(PAPER))
    from dataclasses import replace

    import identification

    plant = replace(identification.WELL, contamination=0.0, P0=1e8, Q=0.0)
    rng = np.random.default_rng(1)
    g = np.repeat(rng.standard_normal((1, identification.STEPS, 4)), 2, axis=0)
    bound, cramer_rao = identification.bounds(g[..., :, None] * g[..., None, :], plant)
    assert bound[-1] ** 0.5 == pytest.approx(cramer_rao, rel=1e-4)
