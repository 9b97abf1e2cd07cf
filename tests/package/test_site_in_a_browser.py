"""The site in a browser: nothing is wider than the window, and a word that people use finds its page first."""

import json
import re
from html import unescape
from urllib.parse import quote_plus

import pytest
from browsing import BROWSER, after_scripts, served

WIDTHS = (390, 1024, 1440)

# Each page in a frame of each width: what reaches beyond it, and is not inside something that scrolls by itself.
MEASURE = """<!doctype html><body><pre id="found"></pre><script>
function clipped(element) {
  for (let up = element.parentElement; up && up.tagName !== "ARTICLE"; up = up.parentElement) {
    if (getComputedStyle(up).overflowX !== "visible") return true;
  }
  return false;
}
// Words of a table that a reader does not see before the table is moved: a column that begins at the window's edge.
function hidden(cell, width) {
  const place = cell.getBoundingClientRect();
  const name = cell.textContent.trim().slice(0, 30);
  return place.width > 0 && place.left > width - 40 && /[a-z]{3}.* .*[a-z]{3}.* .*[a-z]{3}/.test(name);
}
function beyond(frame, width) {
  const elements = frame.contentDocument.querySelectorAll("article, article *");
  const reaches = (e) => e.getBoundingClientRect().right > width + 1 && e.offsetWidth > 0;
  const found = [...elements].filter((e) => reaches(e) && !clipped(e));
  found.push(...[...frame.contentDocument.querySelectorAll("article td")].filter((cell) => hidden(cell, width)));
  // On a telephone a line of code may be moved sideways; elsewhere its end is seen at once.
  const cut = (pre) => width > 768 && pre.scrollWidth > pre.clientWidth + 1;
  found.push(...[...frame.contentDocument.querySelectorAll("article pre")].filter(cut));
  return found.slice(0, 3).map((e) => `${e.tagName}.${e.className} ${Math.round(e.getBoundingClientRect().right)}`);
}
(async () => {
  const wide = [], loaded = [];
  for (const page of PAGES) for (const width of WIDTHS) {
    const frame = document.createElement("iframe");
    frame.style.cssText = `border: 0; width: ${width}px; height: 800px`;
    await new Promise((done) => { frame.onload = done; frame.src = page; document.body.append(frame); });
    const found = beyond(frame, width);
    loaded.push(frame.contentDocument.querySelectorAll("article").length);
    if (found.length) wide.push(`${page} at ${width}: ${found.join(", ")}`);
    frame.remove();
  }
  document.getElementById("found").textContent = JSON.stringify({ wide, loaded });
})();
</script>"""


pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="no browser")]


def test_no_page_is_wider_than_the_window(built_site):
    pages = [path.relative_to(built_site).as_posix() for path in sorted(built_site.rglob("*.html"))]
    pages = [page for page in pages if "<article" in (built_site / page).read_text(encoding="utf-8")]
    text = MEASURE.replace("PAGES", json.dumps(pages)).replace("WIDTHS", json.dumps(WIDTHS))
    with served(built_site, measure=text) as address:
        shown = after_scripts(f"{address}/measure")
    found = json.loads(unescape(re.search(r'<pre id="found">(.*?)</pre>', shown, flags=re.S).group(1)))
    # What is wider than the window, and how many articles each frame had.
    wide, loaded = found["wide"], found["loaded"]
    assert len(loaded) == len(pages) * len(WIDTHS) and all(loaded)
    assert not wide, "\n".join(wide)


SITUATIONS = {
    "json": "save_and_go_on", "save state": "save_and_go_on", "SORT": "box_tracker",
    "fill value": "gaps_and_fill_values", "unknown noise": "r_is_a_guess", "R is a guess": "r_is_a_guess",
    "two sensors disagree": "two_sensors_disagree", "paper": "report_in_a_paper",
}  # fmt: skip
FIRST = {words: f"situations/{page}.html" for words, page in SITUATIONS.items()} | {
    "microcontroller": "edge.html", "late": "fusion.html", "missing data": "broken_recordings.html",
    "C code": "edge.html", "csv": "identification.html", "unit test": "testing.html", "parquet": "fleet.html",
}  # fmt: skip


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
