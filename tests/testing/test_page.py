"""The page of the site is what the code says."""

import sys
from pathlib import Path

from robust_filterpy import testing
from robust_filterpy.testing import contamination, models, plants

DOCS = Path(__file__).parents[2] / "docs"
sys.path.insert(0, str(DOCS))

from testing_page import page  # noqa: E402


def test_the_page_is_current():
    assert (DOCS / "testing.md").read_text() == page(), "python docs/testing_page.py > docs/testing.md"


def test_the_page_lists_everything():
    text = page()
    names = [check.name for check in testing.filter_checks(not_claimed=("robust",))]
    for name in (*names, *models.MODELS, *plants.PLANTS, *contamination.CONTAMINATIONS):
        assert name in text, name
    for name in testing.__all__:
        if name.startswith("assert_"):
            assert f"`{name}`" in text
