"""How many wrong lines do the tests see? Lines drawn at random over the rooms are spoilt, one at a time, in a copy.

    python tests/benchmarks/mutations.py [--count 100] [--seed 0] [--limit 40] [--rest 90] [--room filters]

A line counts as seen if a test fails within the limit, in seconds of processor time. The tests that come near the line
by the names that they mention go first, 40 at most; then all others of its room, within a limit of their own. A line
that survives is one that no test of its room sees, or one whose change changes nothing; `strict=` of zip is left
out, which refuses what right code never passes. The C of the kernel is drawn by
`kernel_mutations.py`.
"""

from __future__ import annotations

import argparse
import ast
import importlib.util
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest

SEEN = 0.9
# Tests that are run for a line, at most.
MOST = 40
ROOT = Path(__file__).parents[2]
# It compares tuned numbers of all rooms with the pages.
NUMBERS = "tests/correction/test_numbers.py"
# No line of these computes: names, stubs, what is printed.
LEFT_OUT = ("__init__", "__main__", "_version", "_lazy")

SWAPPED: dict[type, type] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult,
    ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip


def spoilt(node: ast.AST) -> ast.AST | None:
    """Return a wrong expression in place of a right one, or None if there is nothing to spoil."""
    if isinstance(node, ast.Compare) and type(node.ops[0]) in SWAPPED:
        return ast.Compare(node.left, [SWAPPED[type(node.ops[0])](), *node.ops[1:]], node.comparators)
    if isinstance(node, ast.BinOp) and type(node.op) in SWAPPED:
        return ast.BinOp(node.left, SWAPPED[type(node.op)](), node.right)
    if isinstance(node, ast.BoolOp):
        return ast.BoolOp(SWAPPED[type(node.op)](), node.values)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Not, ast.USub)):
        return node.operand
    if isinstance(node, ast.IfExp):
        return ast.IfExp(node.test, node.orelse, node.body)
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        return ast.Constant(not node.value)
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        return ast.Constant(node.value + 1)
    return None


def expressions(node: ast.AST, names: tuple[str, ...] = ()) -> Iterator[tuple[ast.AST, tuple[str, ...]]]:
    """Yield what computes, with the names that it is part of; no annotations, no words of errors, no strict= of zip."""
    if isinstance(node, (ast.Raise, ast.JoinedStr, ast.AnnAssign, ast.Import, ast.ImportFrom)):
        if not isinstance(node, ast.AnnAssign) or node.value is None:
            return
        node = node.value
    if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
        names = (*names, node.name)
        for part in (*node.body, *(node.args.defaults if isinstance(node, ast.FunctionDef) else ())):
            yield from expressions(part, names)
        return
    if spoilt(node) is not None:
        yield node, names
    for part in ast.iter_child_nodes(node):
        # `strict=` of zip says what has one length: with right code around it nothing else depends on it.
        if not (isinstance(part, ast.keyword) and part.arg == "strict"):
            yield from expressions(part, names)


def drawn(count: int, seed: int, room: str) -> Iterator[tuple[Path, ast.AST, tuple[str, ...]]]:
    """Yield expressions on lines drawn with equal chances, no line twice."""
    lines = []
    for path in sorted((ROOT / "robust_filterpy" / room).rglob("*.py")):
        if path.stem not in LEFT_OUT:
            found: dict[int, list[tuple[ast.AST, tuple[str, ...]]]] = {}
            for node, names in expressions(ast.parse(path.read_text())):
                if node.lineno == node.end_lineno:  # type: ignore[attr-defined]
                    found.setdefault(node.lineno, []).append((node, names))  # type: ignore[attr-defined]
            lines += [(path.relative_to(ROOT), here) for here in found.values()]
    rng = random.Random(seed)
    for path, here in rng.sample(lines, min(count, len(lines))):
        node, names = rng.choice(here)
        yield path, node, names


def changed(source: str, node: ast.AST) -> str:
    """Return the source with one expression spoilt."""
    lines = source.split("\n")
    row, begin, end = node.lineno - 1, node.col_offset, node.end_col_offset  # type: ignore[attr-defined]
    line = lines[row].encode()
    lines[row] = (line[:begin] + f"({ast.unparse(spoilt(node))})".encode() + line[end:]).decode()  # type: ignore[arg-type]
    return "\n".join(lines)


def used(node: ast.AST) -> set[str]:
    """Return the names that something mentions, without the underscores in front of them."""
    found = {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}
    found |= {part.attr for part in ast.walk(node) if isinstance(part, ast.Attribute)}
    return {name.lstrip("_") for name in found}


def definitions(path: Path) -> Iterator[tuple[str, set[str]]]:
    """Yield what a file defines, with the names that each mentions."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield node.name.lstrip("_"), used(node)
        elif isinstance(node, (ast.Assign, ast.AnnAssign)) and isinstance(getattr(node, "value", None), ast.AST):
            for target in node.targets if isinstance(node, ast.Assign) else [node.target]:
                for name in used(target):
                    yield name, used(node.value)  # type: ignore[arg-type]


def rooms_of(path: Path) -> tuple[str, ...]:
    """Return the folders of the tests of a file's room; those of the kernel hold the correction too."""
    # Of files that all rooms use some test of filters or of a fleet is the nearest.
    own = (path.parts[1],) if len(path.parts) > 2 else ("package", "fleet", "filters")
    return tuple(f"tests/{room}/" for room in (*own, "kernel") if room != "kernel" or "correction" in own)


class Chooser:
    """Which tests go first for a line: those that come near it by names, rare names counting for more."""

    def __init__(self) -> None:
        """Read what mentions what, in the package and in the tests."""
        self.mentioned_by: dict[str, set[str]] = {}
        for path in (ROOT / "robust_filterpy").rglob("*.py"):
            for name, names in definitions(path):
                for one in names - {name}:
                    self.mentioned_by.setdefault(one, set()).add(name)
        self.tests: dict[str, set[str]] = {}
        for path in sorted((ROOT / "tests").glob("*/test_*.py")):
            needed = re.findall(r'^(?:\w+ = )?pytest\.importorskip\("(\w+)"\)', path.read_text(), flags=re.M)
            if any(importlib.util.find_spec(name) is None for name in needed):
                continue
            own = dict(definitions(path))
            for name in [name for name in own if name.startswith("test_")]:
                mentions = set(own[name])
                for _ in range(3):
                    mentions |= {more for one in mentions & own.keys() for more in own[one]}
                self.tests[f"{path.relative_to(ROOT)}::{name}"] = mentions
        self.common = Counter(name for mentions in self.tests.values() for name in mentions)

    def ranked(self, path: Path, names: tuple[str, ...]) -> list[str]:
        """Return tests, the nearest in front: names that lead to the line by up to four others, and its room."""
        near = {name.lstrip("_"): 1.0 for name in names} or {path.stem.lstrip("_"): 1.0}
        edge = set(near)
        for depth in range(1, 5):
            edge = {one for name in edge for one in self.mentioned_by.get(name, ())} - near.keys()
            near.update(dict.fromkeys(edge, 0.5**depth))
        marks = {
            test: sum(near[name] / self.common[name] for name in mentions & near.keys())
            * (3.0 if test.startswith(rooms_of(path)) else 1.0)
            / len(mentions) ** 0.5
            for test, mentions in self.tests.items()
        }
        return sorted((test for test, mark in marks.items() if mark > 0.0), key=lambda test: -marks[test])[:MOST]


def seen(copy: Path, tests: Iterable[str], limit: float, without: Iterable[str] = (), **environment: str) -> str:
    """Run tests until one fails and return its name, or how it was that none did, in brackets."""
    options = ("-x", "--tb=no", "-rfE", "-p", "no:cacheprovider", "-p", "no:randomly", "--timeout=0")
    left_out = [f"--deselect={test}" for test in without]
    command = [sys.executable, "-W", "ignore", "-m", "pytest", *options, *left_out, *tests]
    own = {"PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}
    environment = {**os.environ, **own, **environment}
    seconds = max(int(limit), 1)
    try:
        done = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=20.0 * limit, check=False,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1)),
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return "(none within the limit)"
    if -done.returncode in (signal.SIGXCPU, signal.SIGKILL):
        return "(none within the limit)"
    # A line that breaks the import leaves no tests in a file.
    imported = not re.search("while loading conftest|found no collectors", done.stderr)
    if done.returncode == pytest.ExitCode.USAGE_ERROR and imported:
        raise SystemExit(f"pytest was not asked for tests that there are: {done.stderr[-1000:]}")
    if done.returncode == pytest.ExitCode.NO_TESTS_COLLECTED:
        return "(none by day)"
    said = re.findall(r"^(?:FAILED|ERROR) (\S+)", done.stdout, flags=re.M)
    return said[0] if said else "(all pass)" if done.returncode == 0 else f"a process that ends with {done.returncode}"


def seen_by_what_passes(
    spoilt: Callable[[set[str]], str], right: Callable[[str], str], passing: set[str], failing: set[str]
) -> str:
    """Return what sees a wrong line; tests that see one in the right source too are left out from then on."""
    while True:
        by = spoilt(failing)
        test = by.partition("[")[0]
        if "::" not in by or test in passing:
            return by
        if right(test) == "(all pass)":
            passing.add(test)
            return by
        failing.add(test)


def main() -> None:
    """Spoil lines one at a time and print which were seen, and the share in each room."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--limit", type=float, default=40.0)
    parser.add_argument("--rest", type=float, default=90.0)
    parser.add_argument("--room", default="")
    args = parser.parse_args()
    chooser = Chooser()
    total, killed = Counter[str](), Counter[str]()
    passing: set[str] = set()
    failing: set[str] = set()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder)
        for name in ("robust_filterpy", "tests", "examples", "docs"):
            shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__", "_build"))
        for name in ("pyproject.toml", "setup.cfg", "setup.py", "README.md"):
            shutil.copy(ROOT / name, copy)
        for path, node, names in drawn(args.count, args.seed, args.room):
            source = (ROOT / path).read_text()
            tests, spoilt_source = chooser.ranked(path, names), changed(source, node)

            def spoilt_run(without: set[str], path=path, tests=tests, text=spoilt_source, source=source) -> str:
                (copy / path).write_text(text)
                by = seen(copy, tests, args.limit, without)
                for room in (*rooms_of(path), NUMBERS) if args.rest > 0.0 else ():
                    by = seen(copy, [room], args.rest, {*without, *tests}) if by.startswith("(") else by
                (copy / path).write_text(source)
                return by

            by = seen_by_what_passes(spoilt_run, lambda test: seen(copy, [test], args.limit), passing, failing)
            room = path.parts[1] if len(path.parts) > 2 else "(root)"
            total[room] += 1
            survived = by.startswith("(")
            killed[room] += not survived
            change = f"{ast.unparse(node)}  ->  {ast.unparse(spoilt(node))}"  # type: ignore[arg-type]
            where = f"{path}:{node.lineno}"  # type: ignore[attr-defined]
            print(f"{'SURVIVED' if survived else 'seen    '} {where}  {change}  {by}", flush=True)
    for room, number in sorted(total.items()):
        print(f"{room:16} {killed[room]:3d} of {number:3d}")
    share = sum(killed.values()) / sum(total.values())
    print(f"seen: {share:.2f} (target {SEEN}) {'met' if share >= SEEN else 'MISSED'}")


if __name__ == "__main__":
    main()
