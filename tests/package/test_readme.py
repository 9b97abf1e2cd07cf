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


def test_first_snippet_differs_from_filterpy_by_one_word():
    """Put filterpy's module back: it must still run, and the outlier must then hurt."""
    original = SNIPPETS[0].replace("from robust_filterpy.kalman import", "from filterpy.kalman import")
    assert original != SNIPPETS[0] and "robust" not in original
    ours, theirs = {}, {}
    exec(SNIPPETS[0], ours)
    exec(original, theirs)
    assert abs(theirs["kf"].x[0, 0] - 4.0) > 100 * abs(ours["kf"].x[0, 0] - 4.0)


def test_it_can_be_read_in_a_minute():
    assert len(TEXT.splitlines()) <= 120


@pytest.mark.parametrize("name", sorted(set(re.findall(r"(?:docs|examples|tests)/[\w/]+\.(?:py|png|csv|md)", TEXT))))
def test_named_files_exist(name):
    assert (ROOT / name).exists()
