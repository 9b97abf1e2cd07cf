"""Pages made from the code: one for each room of the package, one for each example."""

import ast
import importlib
import inspect
import pkgutil
from pathlib import Path

import jupytext

import robust_filterpy

ROOT = "robust_filterpy"
# Where a class takes over filterpy's or Python's methods, these are left out.
FOREIGN = (
    "KalmanFilter, ExtendedKalmanFilter, UnscentedKalmanFilter, CubatureKalmanFilter, EnsembleKalmanFilter, "
    "FixedLagSmoother, rv_continuous, tuple, dict, Exception, object"
)


def write(docs: Path) -> None:
    """Write api/ and examples/ below docs."""
    pages = {**api_pages(), **example_pages(docs.parent / "examples")}
    for name, text in pages.items():
        path = docs / name
        path.parent.mkdir(parents=True, exist_ok=True)
        # An unchanged page need not be read again.
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def rooms() -> list[str]:
    """Return the modules that list public names: each room, and the drop-in for filterpy.kalman."""
    found = [info.name for info in pkgutil.iter_modules(robust_filterpy.__path__, f"{ROOT}.")]
    return sorted(name for name in found if "._" not in name and getattr(importlib.import_module(name), "__all__", ()))


def home(thing: object, name: str) -> str:
    """Return the module in whose page a name of the root package is described."""
    module = getattr(thing, "__module__", ROOT)
    room = ".".join(module.split(".")[:2])
    return room if name in getattr(importlib.import_module(room), "__all__", ()) else module


def api_pages() -> dict[str, str]:
    """Return the reference, by file name."""
    described: dict[str, list[str]] = {room: own_names(room) for room in rooms()}
    first = []
    for name in robust_filterpy.__all__:
        if name.startswith("__"):
            continue
        module = home(getattr(robust_filterpy, name), name)
        if name not in described.setdefault(module, []):
            described[module].append(name)
        first.append(f"   {module}.{name}")
    index = [
        heading("Reference"),
        "Every public name, by room. Names that `robust_filterpy` itself exports come first.\n",
        ".. toctree::\n   :maxdepth: 1\n",
        *[f"   {module}" for module in sorted(described)],
        "",
        heading(f"In {ROOT}", "-"),
        ".. autosummary::\n",
        *first,
        "",
    ]
    pages = {f"api/{module}.rst": module_page(module, names) for module, names in described.items()}
    return {"api/index.rst": "\n".join(index), **pages}


def own_names(module: str) -> list[str]:
    """Return the public names of a module that are this package's."""
    found = importlib.import_module(module)
    names = sorted(found.__all__)
    if module != f"{ROOT}.kalman":
        return names
    # Classes are described in the room they come from.
    return []


def module_page(module: str, names: list[str]) -> str:
    """Return the page of a module: its docstring, a table, and every name in full."""
    found = importlib.import_module(module)
    lines = [heading(module), f".. automodule:: {module}\n   :no-members:\n"]
    if names:
        lines += [heading("Names", "-"), f".. currentmodule:: {module}\n", ".. autosummary::\n"]
        # A constant has no first line of its own.
        lines += [*[f"   {name}" for name in names if callable(getattr(found, name))], "", heading("In full", "-")]
        lines += [directive(module, name, getattr(found, name)) for name in names]
    return "\n".join(lines) + "\n"


def directive(module: str, name: str, thing: object) -> str:
    """Return what makes autodoc describe a name."""
    path = f"{module}.{name}"
    if not callable(thing):
        values = (
            ", ".join(map(str, thing)) if isinstance(thing, (dict, tuple, frozenset)) else " ".join(repr(thing).split())
        )
        return f".. py:data:: {path}\n\n   ``{values}``\n"
    if not inspect.isclass(thing):
        return f".. autofunction:: {path}\n"
    return f".. autoclass:: {path}\n   :members:\n   :inherited-members: {FOREIGN}\n"


def example_pages(folder: Path) -> dict[str, str]:
    """Return a page for each example and their list, by file name."""
    pages, entries = {}, []
    for path in sorted(folder.glob("*.py")):
        question, _, rest = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").partition("\n\n")
        source = f"../../examples/{path.name}"
        pages[f"examples/{path.stem}.rst"] = "\n".join(
            [
                heading(path.stem.replace("_", " ")),
                question + "\n",
                rest + "\n",
                f"Run ``python examples/{path.name}``, or take the file, :download:`{path.name} <{source}>`, or the "
                f"notebook, :download:`{path.stem}.ipynb <notebooks/{path.stem}.ipynb>`.\n",
                f".. literalinclude:: {source}\n   :language: python\n",
            ]
        )
        pages[f"examples/notebooks/{path.stem}.ipynb"] = notebook(path)
        entries.append((path.stem, " ".join(question.split())))
    index = [
        heading("Examples"),
        "Each states a question, draws one figure and prints one conclusion. The figures are written to\n"
        "``examples/output``.\n",
        *[f"* :doc:`{stem}`: {question}" for stem, question in entries],
        "\n.. toctree::\n   :hidden:\n",
        *[f"   {stem}" for stem, _ in entries],
        "",
    ]
    return {"examples/index.rst": "\n".join(index), **pages}


def notebook(path: Path) -> str:
    """Return an example as a notebook: a cell for each part that `# %%` begins; it runs in the folder of the examples.

    An example reads its options from the command line, which a notebook has none of.
    """
    found = jupytext.reads(path.read_text(encoding="utf-8"), fmt="py:percent")
    for number, cell in enumerate(found.cells):
        # nbformat draws these at random, and the page would differ from build to build.
        cell["id"] = f"cell-{number}"
        cell.source = cell.source.replace('if __name__ == "__main__":\n    main()', "main([])")
        # A notebook does not know its file.
        cell.source = cell.source.replace("Path(__file__)", f'Path("{path.name}")')
    return str(jupytext.writes(found, fmt="ipynb"))


def heading(text: str, line: str = "=") -> str:
    """Return a heading in reStructuredText."""
    return f"{text}\n{line * len(text)}\n"
