"""The package as a whole: cheap to import, honest about its version, nothing heavy before it is used."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import robust_filterpy

ROOT = Path(__file__).parents[2]


def test_import_loads_nothing_heavy():
    code = "import robust_filterpy, sys; print(sorted({m.split('.')[0] for m in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    for heavy in ("control", "matplotlib", "numba", "statsmodels", "joblib", "pandas", "dask"):
        assert f"'{heavy}'" not in loaded


def test_every_advertised_name_exists():
    for name in robust_filterpy.__all__:
        assert getattr(robust_filterpy, name) is not None
    assert set(robust_filterpy.__all__) <= set(dir(robust_filterpy))


def test_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no_such_name"):
        robust_filterpy.no_such_name  # noqa: B018


def test_a_run_of_the_tests_says_that_it_compiles_first():
    command = [sys.executable, "-m", "pytest", "--collect-only", "-p", "no:cacheprovider", "tests/influence"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.stdout.startswith("compiling what is not in the cache")
    assert done.returncode == 0


def test_version_is_one():
    assert re.fullmatch(r"\d+\.\d+\.\d+", robust_filterpy.__version__)


def test_no_machine_path_in_the_sources():
    bad = re.compile(r"/(work|tmp|root|home)/\w")
    files = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True).stdout.split()
    for name in files or ["README.md"]:
        path = ROOT / name
        if path.exists() and path.suffix in {".py", ".md", ".cfg", ".toml"} and path.name != "test_package.py":
            found = bad.search(path.read_text())
            assert not found, f"{name}: {found.group()}"


def test_no_public_name_is_found_in_a_private_module_alone():
    # The reference describes it where it is found, and a reader imports it from there.
    for name in set(robust_filterpy.__all__) - {"__version__"}:
        module = getattr(robust_filterpy, name).__module__
        room = importlib.import_module(".".join(module.split(".")[:2]))
        assert name in room.__all__ or "._" not in module, name
