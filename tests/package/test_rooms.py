"""Imports between the rooms of the package point one way: read from the source, not from what happened to be loaded."""

import ast
import re
from importlib.util import resolve_name
from pathlib import Path

import robust_filterpy

PACKAGE = Path(robust_filterpy.__file__).parent
#: From the bottom of the house to its top: a room imports from those before it, and from itself.
ROOMS = (
    "_version", "_warning", "_brief", "_checks", "_fill_values", "_stamps", "_arrays", "_filterpy",
    "_lazy", "_state", "_progress", "influence", "correction", "kernel", "filters", "smoothing",
    "fusion", "noise", "diagnostics", "identification", "edge", "plants", "testing", "fleet", "adapters",
    "plotting", "kalman", "common", "__init__", "__main__",
)  # fmt: skip
FILES = {".".join(path.relative_to(PACKAGE).with_suffix("").parts): path for path in PACKAGE.rglob("*.py")}


def hidden_from_running(tree):
    """Nodes that only type checkers read."""
    branches = (node for node in ast.walk(tree) if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test))
    return {id(inner) for node in branches for child in node.body for inner in ast.walk(child)}


def imported(name, path):
    """Modules of the package that a module imports, wherever in it, below the package's name."""
    tree, package = ast.parse(path.read_text()), f"robust_filterpy.{name}".rpartition(".")[0]
    hidden, named = hidden_from_running(tree), []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import) and id(node) not in hidden:
            named += [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom) and id(node) not in hidden:
            home = resolve_name("." * node.level + (node.module or ""), package)
            named += [f"{home}.{alias.name}" for alias in node.names]
    # The module itself, or the one that a thing stands in.
    ours = [one.removeprefix("robust_filterpy.") for one in named if one.startswith("robust_filterpy.")]
    places = [(one, f"{one}.__init__", one.rpartition(".")[0], f"{one.rpartition('.')[0]}.__init__") for one in ours]
    return {next((place for place in some if place in FILES), name) for some in places} - {name}


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
