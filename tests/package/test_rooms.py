"""Imports between the rooms of the package point one way: read from the source, not from what happened to be loaded."""

import ast
import re
from pathlib import Path

import robust_filterpy

PACKAGE = Path(robust_filterpy.__file__).parent
#: From the bottom of the house to its top: a room imports from those before it, and from itself.
ROOMS = (
    "_version", "_warning", "_brief", "_checks", "_fill_values", "_stamps", "_arrays", "_filterpy",
    "_lazy", "_state", "_progress", "influence", "correction", "kernel", "filters", "smoothing",
    "fusion", "noise", "diagnostics", "identification", "edge", "plants", "testing", "experiments", "fleet", "adapters",
    "plotting", "kalman", "common", "__init__", "__main__",
)  # fmt: skip
FILES = {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in PACKAGE.rglob("*.py")}


def hidden_from_running(tree):
    """Nodes that only type checkers read."""
    branches = (node for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
    return {id(inner) for node in branches for child in node.body for inner in ast.walk(child)}


def imported(name, path):
    """Modules of the package that a module imports, wherever in it, below the package's name."""
    tree = ast.parse(path.read_text())
    hidden = hidden_from_running(tree)
    here = name.split(".")[: -1 or None]
    found = set()
    for node in ast.walk(tree):
        if id(node) in hidden:
            continue
        if isinstance(node, ast.Import):
            found |= {a.name.removeprefix("robust_filterpy.") for a in node.names if a.name.startswith("robust_fil")}
        if isinstance(node, ast.ImportFrom):
            if node.level:
                base = ".".join([*here[: len(here) - node.level + 1], *((node.module or "").split("."))]).strip(".")
            elif node.module == "robust_filterpy":
                base = ""
            elif (node.module or "").startswith("robust_filterpy."):
                base = node.module.removeprefix("robust_filterpy.")
            else:
                continue
            for alias in node.names:
                inner = f"{base}.{alias.name}".strip(".")
                found.add(inner if inner in FILES else f"{base}.__init__" if f"{base}.__init__" in FILES else base)
    return {module for module in found if module in FILES and module != name}


GRAPH = {name: imported(name, path) for name, path in FILES.items()}


def room(name):
    return name.split(".")[0]


def test_imports_point_to_rooms_below():
    assert "correction.options" in GRAPH["correction.definition"] and sum(map(len, GRAPH.values())) > 100
    above = [
        f"{name} imports {other}"
        for name in FILES
        for other in GRAPH[name]
        if ROOMS.index(room(other)) > ROOMS.index(room(name))
    ]
    assert not above, above


def test_no_import_circle():
    state = {}

    def visit(name, trail):
        state[name] = "open"
        for other in GRAPH[name]:
            # A package is loaded before its modules anyway; its own listing of them is no circle.
            if other.endswith("__init__") and room(other) == room(name):
                continue
            assert state.get(other) != "open", " -> ".join([*trail, name, other])
            if other not in state:
                visit(other, [*trail, name])
        state[name] = "closed"

    for name in GRAPH:
        if name not in state:
            visit(name, [])


def test_every_room_tells_what_is_in_which_file():
    for name, path in FILES.items():
        if name.endswith(".__init__"):
            text = ast.get_docstring(ast.parse(path.read_text())) or ""
            for module in path.parent.glob("[a-z]*.py"):
                assert f"`{module.stem}`" in text, f"{name} does not mention {module.stem}"


def test_no_private_module_of_another_room_is_imported():
    private = [
        f"{name} imports {other}"
        for name in FILES
        for other in GRAPH[name]
        if room(other) != room(name) and re.search(r"\._(?!_init__)\w+$", other)
    ]
    assert not private, private
