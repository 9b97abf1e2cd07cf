"""When what numba compiles serves: by the state of the machine, with a word where somebody waits, never an error."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import robust_filterpy
from robust_filterpy.compiled import dispatch, stamp
from robust_filterpy.smoothing import linear_pass

PACKAGE = Path(robust_filterpy.__file__).parent
FILTER = (
    "import sys, numpy as np; from robust_filterpy import RobustKalmanFilter\n"
    "kf = RobustKalmanFilter(2, 1); kf.H[:] = 1.0\n"
    "def step():\n"
    "    kf.predict(); kf.update(1.0); return float(kf.x.sum())\n"
)


def python(code, **environment):
    """Run code in a process of its own; return what it printed and what it said."""
    done = subprocess.run(
        [sys.executable, "-W", "always", "-c", code], capture_output=True, text=True, env={**os.environ, **environment}
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split(), done.stderr


def test_with_a_cold_cache_nothing_waits_for_a_compilation(tmp_path):
    code = FILTER + "step(); kf.batch_filter(np.ones(3000)); print('numba' in sys.modules)"
    found, said = python(code, NUMBA_CACHE_DIR=str(tmp_path))
    assert found == ["False"] and not said


def test_it_can_be_switched_off():
    code = FILTER + "step(); kf.batch_filter(np.ones(3000)); print('numba' in sys.modules)"
    assert python(code, ROBUST_FILTERPY_KERNEL="off")[0] == ["False"]


def test_a_call_that_takes_longer_than_the_compilation_is_for_the_compiled_form(monkeypatch):
    pytest.importorskip("numba")
    monkeypatch.setattr(dispatch, "_cached", frozenset)
    assert linear_pass.serving(4, 2, 1000) is None
    assert linear_pass.serving(4, 2, 10**7) == (4, 2)
    assert linear_pass.serving(5, 2, 10**7) == (0, 0)


def test_the_fastest_form_in_the_cache_serves(monkeypatch):
    pytest.importorskip("numba")
    known = {linear_pass.kernel_name((0, 0))}
    monkeypatch.setattr(dispatch, "_cached", lambda: frozenset(known))
    assert linear_pass.serving(4, 2, 1) == (0, 0)
    known.add(linear_pass.kernel_name((4, 2)))
    assert linear_pass.serving(4, 2, 1) == (4, 2)


BROKEN = "raise ImportError('numba needs another numpy')"


def with_a_numba_that(tmp_path, source, version="0.60.0"):
    """Return where a broken numba comes before the installed one."""
    (tmp_path / "numba").mkdir()
    (tmp_path / "numba" / "__init__.py").write_text(source)
    information = tmp_path / f"numba-{version}.dist-info"
    information.mkdir()
    (information / "METADATA").write_text(f"Metadata-Version: 2.1\nName: numba\nVersion: {version}\n")
    return os.pathsep.join([str(tmp_path), str(PACKAGE.parent)])


@pytest.mark.parametrize(
    ("source", "version", "reason"),
    [(BROKEN, "0.60.0", "needs another numpy"), ("", "0.50.1", "0.50.1 is too old"), ("", "0.60.0", "numba")],
)
def test_a_numba_that_cannot_be_used_means_the_definition_and_one_warning(tmp_path, source, version, reason):
    path = with_a_numba_that(tmp_path, source, version)
    code = (
        "from robust_filterpy.compiled import dispatch\n"
        "dispatch._cached = lambda: frozenset(['a pass'])\n"
        "print(dispatch.ready('a pass', 0.0)); print(dispatch.ready('a pass', 0.0))"
    )
    found, said = python(code, PYTHONPATH=path)
    assert found == ["False", "False"] and said.count("RuntimeWarning") == 1 and reason in said


def test_without_a_folder_to_write_to_the_definition_serves(monkeypatch, tmp_path):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert stamp.cache_folder() is None and stamp.cached() == frozenset()
    stamp.remember("anything")
    monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError("no home")))
    assert stamp.cache_folder() is None


def test_what_is_remembered_is_cached(monkeypatch, tmp_path):
    pytest.importorskip("numba")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "new"))
    assert stamp.cached() == frozenset()
    stamp.remember("a kernel", "another one")
    stamp.remember("a third")
    assert stamp.cached() == {"a kernel", "another one", "a third"}


@pytest.mark.parametrize(
    "name",
    [
        "smoothing/_compiled_pass.py",
        "compiled/dispatch.py",
    ],
)
def test_the_cache_sees_an_edit_of_any_source(monkeypatch, tmp_path, name):
    copy = Path(shutil.copytree(PACKAGE, tmp_path / "package", ignore=shutil.ignore_patterns("__pycache__")))
    before = stamp.sources()
    monkeypatch.setattr(stamp, "_PACKAGE", copy)
    assert stamp.sources() == before
    with open(copy / name, "a") as source:
        source.write("# edited")
    assert stamp.sources() != before


@pytest.mark.slow
def test_a_compilation_is_announced_and_comes_again_only_after_an_edit(tmp_path):
    pytest.importorskip("numba")
    package = Path(shutil.copytree(PACKAGE, tmp_path / "robust_filterpy"))
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from robust_filterpy.smoothing import linear_pass\n"
        "linear_pass.compile_kernel((0, 0))"
    )
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    told = [python(code, **environment)[1].count("compiling the kernel") for _ in range(2)]
    with open(package / "smoothing" / "_compiled_pass.py", "a") as source:
        source.write("# edited")
    told.append(python(code, **environment)[1].count("compiling the kernel"))
    assert told == [1, 0, 1]


@pytest.mark.slow
def test_the_command_compiles_every_kernel_once(tmp_path):
    pytest.importorskip("numba")
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "robust_filterpy", "compile"]
    first, second = (
        subprocess.run(command, capture_output=True, text=True, env=environment, check=True).stdout for _ in range(2)
    )
    assert linear_pass.kernel_name((0, 0)) in first and "in the cache" not in first
    assert second.count("in the cache") == first.count(" s\n")


def test_the_command_alone_says_what_is_installed_what_serves_and_where_the_documentation_is():
    command = [sys.executable, "-m", "robust_filterpy"]
    for switch, serves in (("on", None), ("off", "definition in numpy")):
        environment = {**os.environ, "ROBUST_FILTERPY_KERNEL": switch}
        said = subprocess.run(command, capture_output=True, text=True, env=environment, check=True).stdout
        for word in (robust_filterpy.__version__, "numpy", "filterpy", "documentation", serves or "kernel"):
            assert word in said
