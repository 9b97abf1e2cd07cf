"""Whatever a front page exports explains itself, by a numpydoc docstring whose parameters are the signature's."""

import dataclasses
import importlib
import inspect
import pkgutil

from numpydoc.docscrape import ClassDoc, FunctionDoc

import robust_filterpy


def modules():
    """Public modules, and whether each is a front page: that of a room, or of the package."""
    yield robust_filterpy, True
    for info in pkgutil.walk_packages(robust_filterpy.__path__, "robust_filterpy."):
        if not any(part.startswith("_") for part in info.name.split(".")):
            try:
                yield importlib.import_module(info.name), info.ispkg
            except ModuleNotFoundError as error:
                # An adapter to a library that is not here; where it is, its names are read too.
                if not info.name.startswith("robust_filterpy.adapters.") or "robust_filterpy" in str(error.name):
                    raise


def listed(front):
    """What front pages list, or what only other modules do: classes, their own public methods, and functions."""
    exported = {front: {} for front in (True, False)}
    for module, is_front in modules():
        # What a module does not list is for the modules of its own room.
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            ours = getattr(thing, "__module__", None) or ""
            if (inspect.isclass(thing) or inspect.isfunction(thing)) and ours.startswith("robust_filterpy"):
                exported[is_front][id(thing)] = thing
    for thing in exported[front].values():
        if front or id(thing) not in exported[True]:
            yield thing
            for name, method in vars(thing).items() if inspect.isclass(thing) else ():
                method = getattr(method, "__func__", method)
                if inspect.isfunction(method) and method.__module__ == thing.__module__ and not name.startswith("_"):
                    yield method


def is_result(thing):
    """NamedTuples and exceptions document fields, not a call."""
    return inspect.isclass(thing) and (issubclass(thing, (tuple, Exception)) or getattr(thing, "_is_protocol", False))


def parameters(thing):
    try:
        # **kwargs is what filterpy or scipy defines and we only pass on.
        return set(inspect.signature(thing).parameters) - {"self", "cls", "_", "kwargs"}
    except (TypeError, ValueError):
        return set()


def wrong_line(thing):
    """What is wrong with the first line, if anything is."""
    text = inspect.getdoc(thing)
    if not text:
        return "no docstring"
    first = text.splitlines()[0]
    return None if first.endswith((".", ":")) else f"first line is no sentence: {first!r}"


def wrong_sections(thing):
    """What is wrong below the first line."""
    if is_result(thing):
        return
    doc = ClassDoc(thing) if inspect.isclass(thing) else FunctionDoc(thing)
    fields = doc["Attributes"] if dataclasses.is_dataclass(thing) else []
    rows = doc["Parameters"] + doc["Other Parameters"] + fields
    documented = {name.strip().lstrip("*") for row in rows for name in row.name.split(",")}
    expected = parameters(thing)
    if documented or len(expected) > 1 or inspect.isclass(thing):  # of rho(e) and psi(e) the sentence says it
        if not (documented >= expected if fields else documented == expected):
            yield f"documented {documented}, signature {expected}"
    for row in doc["Parameters"]:
        if not row.type and "," not in row.name:
            yield f"{row.name}: no type"
        array = "array_like" in row.type or ("ndarray" in row.type and "mapping" not in row.type)
        if array and "shape" not in row.type:
            yield f"{row.name}: an array without its shape"


def named(thing, wrong):
    return f"{thing.__module__}.{thing.__qualname__}: {wrong}"


def test_what_a_front_page_exports_has_a_complete_docstring():
    things = list(listed(front=True))
    wrong = [named(thing, wrong_line(thing)) for thing in things if wrong_line(thing)]
    wrong += [named(thing, one) for thing in things for one in wrong_sections(thing)]
    assert len(things) > 180 and not wrong, "\n".join(wrong)


def test_what_another_module_lists_has_a_first_line():
    wrong = [named(thing, wrong_line(thing)) for thing in listed(front=False) if wrong_line(thing)]
    assert not wrong, "\n".join(wrong)


def test_modules_say_what_they_are_for():
    silent = [module.__name__ for module, _ in modules() if len((module.__doc__ or "").strip().split("\n")[0]) <= 20]
    assert not silent, silent
