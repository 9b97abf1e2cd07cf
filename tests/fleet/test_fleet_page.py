"""What the page on fleets shows runs as it stands: each program after the two that make a model and samples."""

import ast
import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pandas")
PAGE = Path(__file__).parents[2] / "docs" / "fleet.md"
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
STATE, *FIRST = PROGRAMS[:3]
#: What takes long, or prints much: in CI beside the engines' own tests.
ENGINES = ("ray", "pyspark")


def packages(program):
    """What a program imports, by the names of the packages."""
    nodes = list(ast.walk(ast.parse(program)))
    found = {alias.name.split(".")[0] for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    return found | {node.module.split(".")[0] for node in nodes if isinstance(node, ast.ImportFrom)}


def titled(program):
    """A program as a parameter, named after its engine."""
    own = sorted(packages(program) - {"numpy", "pandas", "robust_filterpy"})
    marks = [pytest.mark.engines, pytest.mark.slow] if set(own) & set(ENGINES) else []
    return pytest.param(program, id=own[0] if own else program[:20].split("\n")[0], marks=marks)


@pytest.mark.parametrize("program", [titled(program) for program in (STATE, *PROGRAMS[3:])])
def test_program_runs(program, tmp_path, monkeypatch):
    missing = [name for name in packages(program) if importlib.util.find_spec(name) is None]
    if missing or ("pyspark" in program and shutil.which("java") is None):
        pytest.skip(f"not installed: {missing or 'Java'}")
    if "pyspark" in program:
        # Java has the folder in which Spark was first started in a process: one of its own, as a user's program has.
        script = tmp_path / "program.py"
        script.write_text("\n".join((*FIRST, program)), encoding="utf-8")
        path = os.pathsep.join((str(PAGE.parents[1]), os.environ.get("PYTHONPATH", "")))
        done = subprocess.run(
            [sys.executable, str(script)], cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True,
            text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return
    monkeypatch.chdir(tmp_path)
    space = {"__name__": "page"}
    for number, part in enumerate((*FIRST, program)):
        exec(compile(part, f"fleet-{number}", "exec"), space)
    found = space.get("found")
    if found is not None and hasattr(found, "columns"):
        names = list(getattr(found, "column_names", found.columns))
        assert {"device", "t", "x0", "error"} <= set(names) and len(found) > 0


def test_the_page_has_a_program_for_each_engine_that_installs_from_a_wheel():
    shown = set().union(*map(packages, PROGRAMS))
    assert shown >= {"pyarrow", "duckdb", "deltalake", "polars", "ray", "dask", "pyspark"}
