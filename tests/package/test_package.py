"""The package as a whole: cheap to import, its names where they are said to be, and those that are gone."""

import importlib
import pkgutil
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
        for name in {*importlib.import_module(f"robust_filterpy.{room}").__all__} - {*robust_filterpy.__all__}:
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


def test_a_name_that_never_was_is_refused_in_python_s_own_words():
    assert not hasattr(robust_filterpy, "Coefficients")
    for room in ("smoothing", "noise"):
        with pytest.raises(AttributeError, match="has no attribute 'filter_searies'"):
            importlib.import_module(f"robust_filterpy.{room}").filter_searies  # noqa: B018


# A type checker knows the public names, their arguments and their options, although most are imported late.


RIGHT = """
import numpy as np

import robust_filterpy as rf
from filterpy.common import Q_discrete_white_noise

from robust_filterpy import ARX, Huber, OutputError, ParameterTracker, RobustKalmanFilter, filter_series
from robust_filterpy.common import Saver, kinematic_kf
from robust_filterpy.kalman import IMMEstimator, KalmanFilter, MerweScaledSigmaPoints
from robust_filterpy.kalman.kalman_filter import KalmanFilter as SameFilter

kf = RobustKalmanFilter(dim_x=2, dim_z=1, influence=Huber(1.5), scaling="bounded", information="weight")
kf.predict()
kf.update(1.0)
weights = kf.weights.sum()
tracker = ParameterTracker(OutputError(2, 2), R=0.25, guard="reject", gradient="filtered")
result = tracker.run(np.zeros(10), np.zeros(10))
theta: float = float(result.theta[-1, 0])
interval = tracker.confidence_intervals(0.9).lower
series = filter_series(np.zeros((1, 2, 1)), np.eye(1), np.eye(1), np.eye(1), np.eye(1), np.zeros(1), np.eye(1))
series.x.sum()
kf.x = [0.0, 1.0]
kf.R = 5
kf.Q = Q_discrete_white_noise(2, dt=0.1, var=0.5)
kf.P *= 10.0
kf.F[0, 1] = 0.1
kf.B = None
position: float = float(kf.x[0, 0])
imm: IMMEstimator = IMMEstimator([kf, KalmanFilter(2, 1)], [0.5, 0.5], np.eye(2))
imm.update(1.0)
MerweScaledSigmaPoints(2, 0.1, 2.0, 1.0)
Saver(kinematic_kf(2, 1)).save()
rf.diagnose(tracker, np.zeros(10), us=np.zeros(10))
kf.scaling = "unit"
"""
WRONG = {
    "ParameterTracker(ARX(1, 1), Rr=0.25)": "Rr", "tracker.runn(np.zeros(10))": "runn",
    'RobustKalmanFilter(2, 1, scaling="foo")': "scaling", 'ParameterTracker(ARX(1, 1), guard="maybe")': "guard",
    "kf.updat(1.0)": "updat", "SameFilter(2, 1).RR": '"RR"', "kf.R = object()": "R|expression has type|[Ii]ncompatible",
    "kf.predict(v=1.0)": '"v"', "rf.no_such_name": "no_such_name", "series.y": '"y"',
    'kf.scaling = "foo"': "scaling|foo|expression has type",
}  # fmt: skip


def test_right_use_passes_and_wrong_use_fails(tmp_path):
    pytest.importorskip("mypy")
    program = tmp_path / "program.py"
    program.write_text(RIGHT + "\n".join(WRONG) + "\n")
    options = ["--strict", "--follow-imports=silent", "--cache-dir", str(tmp_path / "cache")]
    command = [sys.executable, "-m", "mypy", *options, str(program)]
    found = subprocess.run(command, capture_output=True, text=True).stdout
    errors = dict(re.findall(r"program\.py:(\d+): error: (.*)", found))
    first = RIGHT.count("\n") + 1
    for line, (statement, reason) in enumerate(WRONG.items(), first):
        assert re.search(reason, errors.pop(str(line), "")), f"{statement}: {found}"
    assert not errors, found
