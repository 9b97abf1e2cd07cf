"""The site builds without a warning, links and images in it lead somewhere; programs of pages and of README run."""

import json
import os
import re
import shutil
import subprocess
import sys
import textwrap
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import numpy as np
import pytest

import robust_filterpy
from robust_filterpy import RobustKalmanFilter, _warning, diagnose

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
# testing.md is made from the room it describes, programs of fleet.md follow one another, those of adapters.md need a
# library each: tests of their own.
README = (ROOT / "README.md").read_text(encoding="utf-8")
SNIPPETS = {
    f"{path.stem}-{i}": text
    for path in [*sorted([*DOCS.glob("*.md"), *DOCS.glob("situations/*.md")]), ROOT / "README.md"]
    if path.name not in ("testing.md", "fleet.md", "adapters.md")
    for i, text in enumerate(re.findall(r"```python\n(.*?)```", path.read_text(encoding="utf-8"), flags=re.S))
}
# What takes longest of them is run at night.
LONG = ("fusion-1", "fusion-2", "broken_recordings-1", "identification-3")
# A page that draws has one program, in one or several parts.
DRAWN = {
    str(path.relative_to(DOCS)): "\n".join(re.sub(r"(?m)^:.*\n", "", textwrap.dedent(part)) for part in parts)
    for path in sorted(DOCS.rglob("*.md"))
    if (parts := re.findall(r"\.\. plot::\n(.*?)```", path.read_text(encoding="utf-8"), flags=re.S))
}


class Page(HTMLParser):
    """What a page refers to, and what can be referred to in it."""

    def __init__(self, text):
        super().__init__()
        self.references, self.anchors = [], set()
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        found = dict(attributes)
        self.references += [found[key] for key in ("href", "src") if found.get(key)]
        self.anchors.add(found.get("id"))


@pytest.fixture(scope="module")
def site(built_site):
    return {path: Page(path.read_text(encoding="utf-8")) for path in built_site.rglob("*.html")}


@pytest.mark.slow
def test_no_internal_link_or_image_is_missing(site):
    missing = []
    for path, page in site.items():
        for reference in page.references:
            parts = urlsplit(reference)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            if not target.exists():
                missing.append(f"{path.name}: {reference}")
            elif parts.fragment and target in site and unquote(parts.fragment) not in site[target].anchors:
                missing.append(f"{path.name}: {reference} (anchor)")
    assert not missing


@pytest.mark.slow
def test_nothing_is_loaded_from_the_network(site):
    for path in site:
        text = path.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|link)[^>]*(?:src|href)=\"((?:https?:)?//[^\"]+)\"", text)
        assert not loaded, path.name


@pytest.mark.slow
def test_every_page_has_a_title_of_its_own(site):
    titles = [re.search(r"<title>([^<]*)", path.read_text(encoding="utf-8")) for path in site]
    named = [title.group(1) for title in titles if title]
    assert len(named) > 50 and sorted(named) == sorted(set(named))


@pytest.mark.slow
def test_every_public_name_is_described(site):
    anchors = set().union(*(page.anchors for page in site.values()))
    described = {anchor.rpartition(".")[2] for anchor in anchors if anchor and anchor.startswith("robust_filterpy.")}
    assert {name for name in robust_filterpy.__all__ if not name.startswith("__")} <= described


def test_what_a_name_returns_is_described_beside_it(monkeypatch):
    """Nobody imports these classes, but whoever is handed one reads its fields."""
    monkeypatch.syspath_prepend(str(DOCS))
    results = pytest.importorskip("generated").results
    names = {thing.__name__ for thing in results([robust_filterpy.estimate_noise, robust_filterpy.ParameterTracker])}
    assert {"NoiseEstimate", "NoiseIntervals", "Sample", "FrequencyResponse"} <= names
    assert "TrackingResult" in names and not names & {"ParameterTracker", "Model", "OutputError"}


@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_page_of_an_example_shows_its_figure_and_its_conclusion(path, site):
    (page,) = (page for page in site if page.parts[-2:] == ("examples", f"{path.stem}.html"))
    assert any("_images/" in reference for reference in site[page].references)
    assert "<strong>Conclusion</strong>" in page.read_text(encoding="utf-8")


def test_every_example_has_its_place_in_the_gallery(monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    story = pytest.importorskip("gallery").STORY
    placed = [stem for chapter in story.values() for stem in chapter]
    assert sorted(placed) == [path.stem for path in EXAMPLES]


@pytest.mark.parametrize("path", sorted(DOCS.rglob("*.md")), ids=lambda path: path.stem)
def test_no_page_is_written_in_tex(path):
    """The site loads no script that would set it: a formula would stand there as its source."""
    assert not re.findall(r"\$\$|\$\S[^$\n`]*\$|\\frac|\\mathrm", path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", [
    pytest.param(name, marks=[pytest.mark.nightly] if name in LONG or (k % 3 and "README" not in name) else [])
    for k, name in enumerate(SNIPPETS)
])  # fmt: skip
def test_program_runs(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    pytest.importorskip("matplotlib").use("Agg")
    exec(compile(SNIPPETS[name], name, "exec"), {"__name__": "page"})


@pytest.mark.parametrize("name", DRAWN)
def test_a_page_of_a_situation_draws_what_it_promises(name, tmp_path, monkeypatch):
    if "main.c" in DRAWN[name] and not shutil.which("cc"):
        pytest.skip("needs a C compiler")
    monkeypatch.chdir(tmp_path)
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("Agg")
    pyplot.close("all")
    exec(compile(DRAWN[name], name, "exec"), {"__name__": "page"})
    axes = pyplot.gca()
    assert axes.get_ylabel() or axes.get_legend()
    pyplot.close("all")


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("[01]*.py")), ids=lambda path: path.stem)
def test_notebooks_run_in_the_folder_of_the_examples(path, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(DOCS))
    cells = json.loads(pytest.importorskip("gallery").notebook(path))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    folder = tmp_path / "examples"
    shutil.copytree(path.parent, folder)
    environment = {**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)}
    run = subprocess.run([sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    assert "onclusion" in run.stdout


def test_messages_point_to_sections_that_the_page_has():
    text = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")
    assert text.startswith(f"# {_warning.PAGE}\n")
    for section in (_warning.FOLLOWS, _warning.STOPPED, _warning.SMALL):
        assert f"\n## {section}\n" in text
    said = str(diagnose(*_too_small()))
    assert _warning.pointer(_warning.SMALL) in said


def _too_small():
    """Return a filter whose R is a hundred times too small, and a recording."""
    kf = RobustKalmanFilter(1, 1)
    kf.F, kf.H, kf.Q, kf.R = np.eye(1), np.eye(1), 1e-4 * np.eye(1), 0.01 * np.eye(1)
    return kf, np.random.default_rng(10004).normal(size=400)


def test_the_first_program_of_readme_differs_from_filterpys_by_one_word():
    """Put filterpy's module back: it must still run, and the outlier must then hurt."""
    first = SNIPPETS["README-0"]
    original = first.replace("from robust_filterpy.kalman import", "from filterpy.kalman import")
    assert original != first and "robust" not in original
    ours, theirs = {}, {}
    exec(first, ours)
    exec(original, theirs)
    assert abs(theirs["kf"].x[0, 0] - 4.0) > 100 * abs(ours["kf"].x[0, 0] - 4.0)


def test_readme_can_be_read_in_a_minute_and_names_files_that_are_there():
    assert len(README.splitlines()) <= 120
    named = set(re.findall(r"(?:docs|examples|tests)/[\w/]+\.(?:py|png|csv|md)", README))
    assert named and not [name for name in named if not (ROOT / name).exists()]


def test_every_file_of_the_map_is_there():
    text, package = (DOCS / "map.md").read_text(encoding="utf-8"), Path(robust_filterpy.__file__).parent
    rows = [line.split("|")[2] for line in text.partition("## Which file")[2].splitlines() if line.count("|") == 3]
    found = 0
    for row in rows[2:]:
        folder = package
        for name in re.findall(r"`([\w/.]+(?:\.py|\.h)|\w+/\w+)`", row):
            # A name without a folder stands beside the one before it.
            path = package / name if "/" in name or (package / name).exists() else folder / name
            assert path.exists(), name
            folder, found = (path.parent if "/" in name else folder), found + 1
    assert found > 50


# The cells of a tutorial, run one after the other, print what the page shows.


TUTORIALS = sorted((DOCS / "tutorial").glob("*.md"))
NUMBER = re.compile(r"-?\d+\.?\d*(?:e[-+]?\d+)?")


def same(shown, printed):
    """Whether two texts are the same but for a last digit or 5 % in a number."""
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
    pytest.importorskip("matplotlib").use("Agg")
    monkeypatch.chdir(tmp_path)
    cells = re.findall(r"```python\n(.*?)```(?:\n\n```text\n(.*?)```)?", path.read_text(encoding="utf-8"), flags=re.S)
    assert len(cells) == 10
    names = {"__name__": "page"}
    for source, shown in cells:
        exec(compile(source, path.name, "exec"), names)
        printed = capsys.readouterr().out
        assert same(shown, printed), f"{source}\nprints\n{printed}"
