"""The code of the page on adapters runs as it stands, where its library is installed."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "adapters.md"


@pytest.mark.parametrize("library", ["sktime", "darts", "river"])
def test_the_code_of_the_page_runs(library):
    pytest.importorskip(library)
    (block,) = (b for b in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S) if f"from {library}" in b)
    exec(compile(block, str(PAGE), "exec"), {})
