"""A word that people use finds its page first."""

import re
from urllib.parse import quote_plus

import pytest
from browsing import BROWSER, after_scripts, served

pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="no browser")]

FIRST = {
    "json": "situations/save_and_go_on.html",
    "save state": "situations/save_and_go_on.html",
    "microcontroller": "edge.html",
    "SORT": "situations/box_tracker.html",
    "late": "fusion.html",
    "fill value": "situations/gaps_and_fill_values.html",
    "missing data": "broken_recordings.html",
    "unknown noise": "situations/r_is_a_guess.html",
    "C code": "edge.html",
    "R is a guess": "situations/r_is_a_guess.html",
    "two sensors disagree": "situations/two_sensors_disagree.html",
    "csv": "identification.html",
    "unit test": "testing.html",
    "parquet": "fleet.html",
    "paper": "situations/report_in_a_paper.html",
}


def found(address, words):
    """The pages that a search lists, best first."""
    shown = after_scripts(f"{address}/search.html?q={quote_plus(words)}", seconds=60)
    results = re.search(r'<ul[^>]*class="search".*</ul>', shown, flags=re.S)
    assert results, f"nothing is found for {words!r}"
    return [link.split("?")[0].split("#")[0] for link in re.findall(r'<li[^>]*><a href="([^"]*)"', results.group())]


@pytest.mark.parametrize("words", FIRST)
def test_a_word_finds_its_page_first(words, built_site):
    with served(built_site) as address:
        pages = found(address, words)
    assert pages[0] == FIRST[words], pages[:5]
