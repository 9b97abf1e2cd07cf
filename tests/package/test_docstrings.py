"""Every public object explains itself: a numpydoc docstring whose parameters are those of the signature."""

import dataclasses
import importlib
import inspect
import pkgutil

import pytest
from numpydoc.docscrape import ClassDoc, FunctionDoc

import robust_filterpy

# What filterpy or scipy defines and we only override.
INHERITED = {"kwargs"}


def public_modules():
    yield robust_filterpy
    for info in pkgutil.walk_packages(robust_filterpy.__path__, "robust_filterpy."):
        if not any(part.startswith("_") for part in info.name.split(".")):
            try:
                yield importlib.import_module(info.name)
            except ModuleNotFoundError as error:
                # An adapter to a library that is not here; where it is, its names are read too.
                if not info.name.startswith("robust_filterpy.adapters.") or "robust_filterpy" in str(error.name):
                    raise


def public_objects():
    seen = set()
    for module in public_modules():
        # What a module does not list is for the modules of its own room.
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            if not (inspect.isclass(thing) or inspect.isfunction(thing)) or id(thing) in seen:
                continue
            if not thing.__module__.startswith("robust_filterpy") or "._" in thing.__module__:
                continue
            seen.add(id(thing))
            yield pytest.param(thing, id=f"{thing.__module__}.{thing.__qualname__}")
            if inspect.isclass(thing):
                for method_name, method in vars(thing).items():
                    method = getattr(method, "__func__", method)
                    own = inspect.isfunction(method) and method.__module__ == thing.__module__
                    if own and not method_name.startswith("_"):
                        yield pytest.param(method, id=f"{thing.__module__}.{method.__qualname__}")


def parameters(thing):
    try:
        signature = inspect.signature(thing)
    except (TypeError, ValueError):
        return []
    return [name for name in signature.parameters if name not in {"self", "cls", "_"}]


def is_result(thing):
    """NamedTuples and exceptions document fields, not a call."""
    return inspect.isclass(thing) and (issubclass(thing, (tuple, Exception)) or getattr(thing, "_is_protocol", False))


@pytest.mark.parametrize("thing", list(public_objects()))
def test_docstring_is_complete(thing):
    text = inspect.getdoc(thing)
    assert text, "no docstring"
    first = text.splitlines()[0]
    assert first.endswith((".", ":")), f"first line is no sentence: {first!r}"
    if is_result(thing):
        return
    doc = ClassDoc(thing) if inspect.isclass(thing) else FunctionDoc(thing)
    fields = doc["Attributes"] if dataclasses.is_dataclass(thing) else []
    documented = [
        name.strip().lstrip("*")
        for parameter in doc["Parameters"] + doc["Other Parameters"] + fields
        for name in parameter.name.split(",")
    ]
    expected = [name for name in parameters(thing) if name not in INHERITED]
    if not documented and len(expected) <= 1 and not inspect.isclass(thing):
        return  # rho(e), psi(e): the sentence says it
    assert set(documented) >= set(expected) if fields else set(documented) == set(expected), (
        f"documented {documented}, signature {expected}"
    )
    for parameter in doc["Parameters"]:
        assert parameter.type or len(parameter.name.split(",")) > 1, f"{parameter.name}: no type"
        if "array_like" in parameter.type or ("ndarray" in parameter.type and "mapping" not in parameter.type):
            assert "shape" in parameter.type, f"{parameter.name}: an array without its shape"


@pytest.mark.parametrize("module", list(public_modules()), ids=lambda module: module.__name__)
def test_module_says_what_it_is_for(module):
    assert module.__doc__ and len(module.__doc__.strip().splitlines()[0]) > 20
