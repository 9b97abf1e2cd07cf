"""A stranger who has read the map alone names the file for a question."""

import re
from pathlib import Path

import pytest

import robust_filterpy

PACKAGE = Path(robust_filterpy.__file__).parent
MAP = (Path(__file__).parents[2] / "docs/map.md").read_text(encoding="utf-8")
#: Ten questions: words by which a reader looks the answer up, the file, and what stands in it.
QUESTIONS = {
    "Where is a gap in y filled?": ("missing", "identification/estimation/missing.py", "class CompletedModel"),
    "What happens when a tracker is lost?": ("lost", "identification/recursive/watch.py", "LostTrackerWarning"),
    "Who believes that the state has jumped, under patience=?": ("jump", "filters/_insistence.py", "def jump_of"),
    "Where is the weight of a reading computed?": ("weighed", "correction/definition.py", "def correct"),
    "Why did this step not run in C?": ("kernel, or the definition", "filters/shell.py", "def _correct_by_kernel"),
    "Where does a reading go that arrives late?": ("late reading", "fusion/_timeline.py", "class Timeline"),
    "Who refuses an R that is no covariance?": ("matrices of a user", "_checks.py", "def covariance"),
    "Where are the orders of a model chosen?": ("orders", "identification/judging/select.py", "def select_structure"),
    "What is kept of a filter over a restart?": ("put away", "filters/states.py", "def restore"),
    "Where is it decided that a sensor drifts?": ("drifting", "fusion/_faults.py", "drift"),
}


@pytest.mark.parametrize("question", QUESTIONS)
def test_the_map_leads_to_the_file(question):
    words, file, holds = QUESTIONS[question]
    rows = [line for line in MAP.splitlines() if line.startswith("|") and words in line.split("|")[1]]
    named = [name for row in rows for name in re.findall(r"`([\w/.]+)`", row.split("|")[2])]
    assert len(rows) == 1 and file in named, f"{rows} name {named}"
    assert holds in (PACKAGE / file).read_text(encoding="utf-8")


def test_every_file_of_the_map_is_there():
    rows = [line.split("|")[2] for line in MAP.partition("## Which file")[2].splitlines() if line.count("|") == 3]
    found = 0
    for row in rows[2:]:
        folder = PACKAGE
        for name in re.findall(r"`([\w/.]+(?:\.py|\.h)|\w+/\w+)`", row):
            # A name without a folder stands beside the one before it.
            path = PACKAGE / name if "/" in name or (PACKAGE / name).exists() else folder / name
            assert path.exists(), name
            folder, found = (path.parent if "/" in name else folder), found + 1
    assert found > 50
