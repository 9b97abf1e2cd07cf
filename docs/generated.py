"""Pages made from the code: one for each room of the package."""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Iterable
from pathlib import Path

import robust_filterpy

ROOT = "robust_filterpy"
# Where a class takes over filterpy's or Python's methods, these are left out.
FOREIGN = (
    "KalmanFilter, ExtendedKalmanFilter, UnscentedKalmanFilter, CubatureKalmanFilter, EnsembleKalmanFilter, "
    "FixedLagSmoother, rv_continuous, rv_generic, tuple, dict, Mapping, Exception, object"
)
#: A class with so many methods has a page of its own.
MANY = 5


def write(docs: Path, pages: dict[str, str]) -> None:
    """Write pages, by file name, below docs, in place of those made before."""
    for old in (docs / "api").glob("*.rst"):
        if f"api/{old.name}" not in pages:
            old.unlink()
    for name, text in pages.items():
        path = docs / name
        path.parent.mkdir(parents=True, exist_ok=True)
        # An unchanged page need not be read again.
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def rooms() -> list[str]:
    """Return the modules that list public names: each room, its inner rooms, inputs, filterpy.kalman's drop-in."""
    found = [info.name for info in pkgutil.iter_modules(robust_filterpy.__path__, f"{ROOT}.")]
    found += [info.name for info in pkgutil.walk_packages(robust_filterpy.__path__, f"{ROOT}.") if info.ispkg]
    found += [f"{ROOT}.plants.excitation"]
    return sorted(name for name in set(found) if "._" not in name and own_page(name))


def own_page(module: str) -> bool:
    """Tell whether a module lists names that the room around it does not list."""
    names, around = (getattr(importlib.import_module(m), "__all__", ()) for m in (module, module.rpartition(".")[0]))
    return bool(names) and (module.count(".") == 1 or not set(names) <= set(around))


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
        first.append(f"   ~{module}.{name}")
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
    pages = {"api/index.rst": "\n".join(index)}
    shown: set[type] = set()
    for module, names in described.items():
        found = importlib.import_module(module)
        apart = [name for name in names if is_long(getattr(found, name))]
        pages[f"api/{module}.rst"] = module_page(module, names, apart, shown)
        for name in apart:
            lines = [heading(name), directive(module, name, getattr(found, name))]
            pages[f"api/{module}.{name}.rst"] = "\n".join(lines)
    return pages


def is_long(thing: object) -> bool:
    """Tell whether a class has so many methods that it needs a page of its own."""
    if not inspect.isclass(thing):
        return False
    own = {name for base in thing.__mro__ if base.__module__.startswith(ROOT) for name in vars(base)}
    return sum(callable(getattr(thing, name, None)) and not name.startswith("_") for name in own) >= MANY


def own_names(module: str) -> list[str]:
    """Return the public names of a module that are this package's."""
    found = importlib.import_module(module)
    names = sorted(name for name in found.__all__ if not is_elsewhere(module, getattr(found, name), name))
    if module not in (f"{ROOT}.kalman", f"{ROOT}.common"):
        return names
    # Classes are described in the room they come from, and filterpy's by filterpy.
    return [name for name in names if (getattr(getattr(found, name), "__module__", None) or "").startswith(module)]


def is_elsewhere(module: str, thing: object, name: str) -> bool:
    """Tell whether a name that a room passes on is described in the room that it comes from."""
    room = ".".join((getattr(thing, "__module__", None) or module).split(".")[:2])
    return room.startswith(ROOT) and not module.startswith(room) and home(thing, name) == room


def module_page(module: str, names: list[str], apart: list[str], shown: set[type]) -> str:
    """Return the page of a module: its docstring, a table, and in full every name that has no page of its own.

    What its names return is added to `shown`, of which each class stands on one page alone.
    """
    found = importlib.import_module(module)
    lines = [heading(module), f".. automodule:: {module}\n   :no-members:\n"]
    if names:
        lines += [heading("Names", "-"), f".. currentmodule:: {module}\n", ".. autosummary::\n"]
        # A constant has no first line of its own.
        lines += [*[f"   {name}" for name in names if callable(getattr(found, name))], ""]
        if apart:
            lines += [".. toctree::\n   :hidden:\n", *[f"   {module}.{name}" for name in apart], ""]
        if len(apart) < len(names):
            lines += [heading("In full", "-")]
        lines += [directive(module, name, getattr(found, name)) for name in names if name not in apart]
    back = [thing for thing in results(getattr(found, name) for name in names) if thing not in shown]
    shown.update(back)
    if back:
        lines += [heading("What these return", "-")]
        lines += [directive(thing.__module__, thing.__qualname__, thing) for thing in back]
    return "\n".join(lines) + "\n"


def results(things: Iterable[object]) -> list[type]:
    """Return the classes that a program gets from these without having to name them, by name."""
    named = (getattr(importlib.import_module(room), name) for room in rooms() for name in own_names(room))
    listed = {thing for thing in named if inspect.isclass(thing)}
    found: dict[str, type] = {}
    waiting = list(things)
    while waiting:
        thing = waiting.pop()
        for back in returned(thing, listed):
            if back not in listed and back.__qualname__ not in found:
                found[back.__qualname__] = back
                waiting.append(back)
    return [thing for _, thing in sorted(found.items())]


def returned(thing: object, listed: set[type]) -> list[type]:
    """Return the classes of this package that a function returns, or the methods and fields of a class."""
    if not inspect.isclass(thing):
        return mentioned(thing, [getattr(thing, "__annotations__", {}).get("return")])
    found: list[type] = []
    for base in thing.__mro__:
        if base.__module__.startswith(ROOT):
            public = [value for name, value in vars(base).items() if not name.startswith("_")]
            # A method that does not say what it returns is for other modules.
            told = [value for value in public if inspect.isfunction(value) and "Returns" in (value.__doc__ or "")]
            told += [getattr(value, "fget", None) or getattr(value, "func", None) for value in public]
            said = [getattr(method, "__annotations__", {}).get("return") for method in told]
            # The fields of what a program makes itself are its arguments.
            said += [] if thing in listed else list(vars(base).get("__annotations__", {}).values())
            found += mentioned(base, said)
    return found


def mentioned(thing: object, annotations: Iterable[object]) -> list[type]:
    """Return the public classes of this package that annotations name, where a function or class is defined."""
    scope = vars(importlib.import_module(getattr(thing, "__module__", ROOT)))
    named = [scope.get(word) for annotation in annotations for word in re.findall(r"\w+", str(annotation))]
    return [c for c in named if inspect.isclass(c) and c.__module__.startswith(ROOT) and "._" not in c.__module__]


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


def heading(text: str, line: str = "=") -> str:
    """Return a heading in reStructuredText."""
    return f"{text}\n{line * len(text)}\n"
