"""The cells of a tutorial, run one after the other, print what the page shows."""

import re
from pathlib import Path

import matplotlib
import numpy as np
import pytest

TUTORIALS = sorted((Path(__file__).parents[2] / "docs" / "tutorial").glob("*.md"))
NUMBER = re.compile(r"-?\d+\.?\d*(?:e[-+]?\d+)?")
matplotlib.use("Agg")


def same(shown, printed):
    """Tell whether two texts are the same but for a last digit or 5 % in a number."""
    old, new = NUMBER.findall(shown), NUMBER.findall(printed)
    digits = [10.0 ** -len(number.partition(".")[2]) for number in old]
    words = [" ".join(NUMBER.sub("", text).split()) for text in (shown, printed)]
    close = len(old) == len(new) and np.all(
        np.abs(np.subtract(np.array(new, float), np.array(old, float)))
        <= np.array(digits) + 0.05 * np.abs(np.array(old, float))
    )
    return words[0] == words[1] and close


@pytest.mark.filterwarnings("ignore:FigureCanvasAgg", "ignore:identify")
@pytest.mark.filterwarnings("ignore::robust_filterpy.RobustFilterWarning")
@pytest.mark.parametrize("path", TUTORIALS, ids=lambda path: path.stem)
def test_cells_print_what_the_page_shows(path, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    cells = re.findall(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", path.read_text(encoding="utf-8"), flags=re.S)
    assert len(cells) == 10
    names = {"__name__": "page"}
    for source, shown in cells:
        exec(compile(source, path.name, "exec"), names)
        printed = capsys.readouterr().out
        assert same(shown, printed), f"{source}\nprints\n{printed}"


def test_another_word_or_number_is_seen():
    assert same("1 of 300, 2.81 m\n", "1 of 300,  2.82 m")
    assert not same("1 of 300", "1 of 330") and not same("R is wrong", "R is right") and not same("a 1", "a")
