"""The package as a whole: cheap to import, its names where they are said to be, and those that are gone."""

import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import robust_filterpy
from robust_filterpy import _lazy, noise, testing

ROOT = Path(__file__).parents[2]


def test_import_loads_nothing_heavy():
    code = "import robust_filterpy, sys; print(sorted({m.split('.')[0] for m in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    for heavy in ("control", "matplotlib", "statsmodels", "joblib", "pandas", "dask"):
        assert f"'{heavy}'" not in loaded


@pytest.mark.parametrize("room", ["", ".filters"])
def test_every_name_of_the_list_is_the_one_that_type_checkers_see(room):
    """The stub is the list: each line of it names a thing where it is, and nothing else is public."""
    module = importlib.import_module(f"robust_filterpy{room}")
    text = Path(module.__file__).with_suffix(".pyi").read_text()
    found = re.findall(r"from ([\w.]+) import \(?\s*(\w+) as (\w+)", text)
    assert len(found) == text.count("import")
    assert all(name == again for _, name, again in found)
    assert sorted(name for _, name, _ in found) == sorted(module.__all__)
    for home, name, _ in found:
        assert getattr(module, name) is getattr(importlib.import_module(home), name)


def test_the_root_has_20_names_at_most():
    """Those that most programs want, and the version."""
    assert len(dir(robust_filterpy)) <= 20, dir(robust_filterpy)


def test_the_packages_list_no_more_names():
    """All public names, the drop-ins for filterpy left out."""
    found = pkgutil.walk_packages(robust_filterpy.__path__, "robust_filterpy.")
    packages = [info.name for info in found if info.ispkg and not info.name.endswith((".kalman", ".common"))]
    names = {name for room in packages for name in getattr(importlib.import_module(room), "__all__", ())}
    names |= set(robust_filterpy.__all__) - {"__version__"}
    print(len(names), *sorted(names))
    assert 50 < len(names) <= 100, sorted(names)


def test_every_name_of_a_room_is_found_where_the_root_says_it_is():
    rooms = [path.parent.name for path in Path(robust_filterpy.__file__).parent.glob("[a-z]*/__init__.py")]
    assert len(rooms) > 15
    for room in set(rooms) - {"kalman", "common", "kernel", "testing"}:
        elsewhere = {*robust_filterpy.__all__, *_lazy._MOVED}
        for name in set(importlib.import_module(f"robust_filterpy.{room}").__all__) - elsewhere:
            with pytest.raises(AttributeError, match=rf"no `{name}`; it is in .*robust_filterpy\.{room}\b"):
                getattr(robust_filterpy, name)


def test_a_room_needs_no_import_of_its_own():
    code = "import robust_filterpy; print(robust_filterpy.edge.export_c.__name__)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "export_c\n"


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


def test_no_two_test_modules_share_a_name():
    # pytest imports a module by its name alone, and leaves the second of two out.
    names = sorted(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert len(names) == len(set(names)), [name for name in names if names.count(name) > 1]


# A name that was public says what has taken its place.


@pytest.mark.parametrize("module, name, mend", [
    (robust_filterpy, "tune", "estimate_noise"), (noise, "tune", "estimate_noise"),
    (robust_filterpy, "batch", "filter_series"), (robust_filterpy, "FilterBank", "filter_series"),
    (testing, "check_tracker", "assert_tracks"), (testing, "assert_unit_equivariant", "check_filter"),
])  # fmt: skip
def test_a_name_that_is_gone_says_what_does_the_same(module, name, mend):
    sentence = rf"^{module.__name__} has no `{name}`; .*{mend}"
    with pytest.raises(AttributeError, match=sentence):
        getattr(module, name)
    with pytest.raises(ImportError, match=sentence):
        exec(f"from {module.__name__} import {name}", {})


def test_a_name_that_never_was_is_refused_in_python_s_own_words():
    # One that moved from a package was never the root's.
    assert not hasattr(robust_filterpy, "Coefficients")
    for room in ("smoothing", "noise"):
        with pytest.raises(AttributeError, match="has no attribute 'filter_searies'"):
            importlib.import_module(f"robust_filterpy.{room}").filter_searies  # noqa: B018


def test_a_name_that_has_moved_is_found_where_it_was_and_says_where_it_is():
    assert len(_lazy._MOVED) > 30
    for name, home in _lazy._MOVED.items():
        thing, parts = getattr(importlib.import_module(home), name), home.split(".")
        # The front pages around its new home, but for those that are of a package alone.
        fronts = [".".join(parts[:n]) for n in range(2, len(parts))] or ["robust_filterpy"]
        for front in set(fronts) - {"robust_filterpy.identification.models"}:
            page = importlib.import_module(front)
            with pytest.warns(DeprecationWarning, match=f"{name} has moved: from {home} import {name}$"):
                assert getattr(page, name) is thing
            assert name not in page.__all__


def test_the_names_of_experiments_are_those_of_testing_for_one_release():
    experiments = importlib.import_module("robust_filterpy.experiments")
    for name in ("bootstrap_interval", "fit_percent", "monte_carlo", "rerun"):
        with pytest.warns(DeprecationWarning, match=f"from robust_filterpy.testing import {name}$"):
            assert getattr(experiments, name) is getattr(testing, name)
    with pytest.raises(AttributeError, match="has no attribute 'metrics'"):
        experiments.metrics  # noqa: B018
