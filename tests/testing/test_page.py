"""The page of the site is what the code says."""

from pathlib import Path

from robust_filterpy import testing
from robust_filterpy.testing.page import page

PAGE = Path(__file__).parents[2] / "docs" / "testing.md"


def test_the_page_is_current():
    assert PAGE.read_text() == page(), "python -m robust_filterpy.testing.page > docs/testing.md"


def test_the_page_lists_everything():
    text = page()
    names = [check.name for check in (*testing.filter_checks(not_claimed=("robust",)), *testing.tracker_checks())]
    for name in (*names, *testing.MODELS, *testing.PLANTS, *testing.CONTAMINATIONS):
        assert name in text, name
    for name in testing.__all__:
        if name.startswith("assert_"):
            assert f"`{name}`" in text
