"""README's snippets run as they stand, and every command it names exists."""

import re
from pathlib import Path

import matplotlib
import pytest

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "README.md").read_text()
SNIPPETS = re.findall(r"```python\n(.*?)```", TEXT, flags=re.S)

matplotlib.use("Agg")


@pytest.mark.parametrize("source", SNIPPETS, ids=range(len(SNIPPETS)))
def test_snippet_runs(source, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(source, "README.md", "exec"), {"__name__": "readme"})


def test_there_are_snippets():
    assert SNIPPETS


def test_first_snippet_differs_from_filterpy_by_import_and_class_only():
    """Put filterpy's import and class back: it must still run, and the outlier must then hurt."""
    ours_imported, theirs_imported = (
        "from robust_filterpy import RobustKalmanFilter",
        "from filterpy.kalman import KalmanFilter",
    )
    original = SNIPPETS[0].replace(ours_imported, theirs_imported)
    original = original.replace("RobustKalmanFilter", "KalmanFilter")
    assert "robust" not in original.lower()
    # The last line prints the weights, which filterpy's filter does not have.
    ours, theirs = {}, {}
    exec(SNIPPETS[0], ours)
    exec(original.rsplit("print", 1)[0], theirs)
    assert abs(theirs["kf"].x[0, 0] - 4.0) > 100 * abs(ours["kf"].x[0, 0] - 4.0)


@pytest.mark.parametrize("name", sorted(set(re.findall(r"(?:examples|tests)/[\w/]+\.(?:py|png|csv)", TEXT))))
def test_named_files_exist(name):
    assert (ROOT / name).exists()
