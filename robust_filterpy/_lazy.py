"""Public names from one list: the stub next to a package's first page, which type checkers read too (PEP 562, SPEC 1).

Each line of the stub ``__init__.pyi`` is ``from package.module import name as name``; a line more is a name more. A
name that is not in the list is looked for on the first pages of its sister packages, and its error says where it is.
"""

from __future__ import annotations

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def attach(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package whose names are imported when asked for."""
    homes = _names(Path(file).with_suffix(".pyi"))

    def __getattr__(name: str) -> Any:
        """Import a name of another module, or a package, when it is first asked for."""
        if name in homes or (Path(file).parent / name / "__init__.py").exists():
            room = importlib.import_module(homes.get(name, f"{package}.{name}"))
            value = getattr(room, name) if name in homes else room
            # Found without this function from now on.
            setattr(sys.modules[package], name, value)
            return value
        rooms = [] if name.startswith("_") else _rooms(Path(file).parent, name)
        if not rooms:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        # An import statement asks first, and would put words of its own in the place of an AttributeError's.
        imported = sys._getframe(1).f_globals.get("__name__") == "importlib._bootstrap"
        error = ImportError if imported else AttributeError
        raise error(f"{package} has no `{name}`; it is in {' and in '.join(f'{package}.{room}' for room in rooms)}")

    return __getattr__, lambda: sorted(homes), sorted(homes)


def _names(page: Path) -> dict[str, str]:
    """Return the names that a first page imports from this package or filterpy, and the module of each."""
    lines = (node for node in ast.parse(page.read_text(encoding="utf-8")).body if isinstance(node, ast.ImportFrom))
    return {
        name.asname or name.name: str(node.module)
        for node in lines
        if "filterpy" in str(node.module)
        for name in node.names
    }


def _rooms(folder: Path, name: str) -> list[str]:
    """Return the packages in a folder whose first page has a name: its stub, where it has one."""
    pages = {page.parent.name: page for suffix in ("py", "pyi") for page in folder.glob(f"[a-z]*/__init__.{suffix}")}
    return sorted(room for room, page in pages.items() if name in _names(page))
