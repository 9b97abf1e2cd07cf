"""The map names files that are there."""

import re
from pathlib import Path

import robust_filterpy

PACKAGE = Path(robust_filterpy.__file__).parent
MAP = (Path(__file__).parents[2] / "docs/map.md").read_text(encoding="utf-8")


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
