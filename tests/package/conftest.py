"""The site, built once for all that look at it."""

import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="session")
def built_site(tmp_path_factory):
    """Return the folder of the site's pages; a warning of Sphinx is a failure."""
    for needed in ("sphinx", "furo", "myst_parser", "numpydoc"):
        pytest.importorskip(needed)
    out = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-b", "html", "-W", "--keep-going", "-n", "-q", "-E"]
    built = subprocess.run([*command, "-d", out / "trees", DOCS, out / "html"], capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return out / "html"
