"""Let property tests draw the same examples in every run, and put numpy's treatment of errors back."""

import itertools

import numpy as np
import pytest
import support
from hypothesis import settings

# A run that fails must fail again; `pytest --hypothesis-profile search` draws others, and finds new defects.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("search", derandomize=False)
settings.load_profile("repeatable")


def pytest_addoption(parser):
    """Add ``--every N``: of the tests that are chosen only the first of every N."""
    parser.addoption("--every", type=int, default=1, metavar="N", help="run the first of every N tests")


@pytest.fixture(autouse=True)
def numpy_errors_stay_as_they_were():
    """Put it back: after an interrupt within numpy.linalg every invalid number raises "Singular matrix"."""
    with np.errstate():
        yield


def served(which, monkeypatch):
    """Let the kernel serve, or the definition alone."""
    if which == "definition":
        support.without_kernel(monkeypatch)
    else:
        support.needs_kernel()
    return which


@pytest.fixture(params=["kernel", "definition"])
def form(request, monkeypatch):
    """The kernel where it serves, and the definition alone."""
    return served(request.param, monkeypatch)


@pytest.fixture(params=["kernel", pytest.param("definition", marks=pytest.mark.nightly)])
def path(request, monkeypatch):
    """As form, the definition by night: by day the tests of the kernel hold it to the kernel's numbers."""
    return served(request.param, monkeypatch)


@pytest.hookimpl(hookwrapper=True)
def pytest_collection_modifyitems(config, items):
    """Leave to the night what a product has beyond a table of pairs; of what marks then choose take every Nth."""
    pairs_only(items)
    yield
    every = config.getoption("--every")
    config.hook.pytest_deselected(items=[item for k, item in enumerate(items) if k % every])
    items[:] = items[::every]


def pairs_only(items):
    """Mark for the night what a product of arguments has beyond a table of pairs: see the mark `pairwise`."""
    products = {}
    for item in items:
        mark = item.get_closest_marker("pairwise")
        if mark and hasattr(item, "callspec") and not item.get_closest_marker("nightly"):
            product = products.setdefault(item.nodeid.partition("[")[0], {})
            values = sorted((name, id(value)) for name, value in item.callspec.params.items())
            product[item] = set(itertools.combinations(values, *mark.args or (2,)))
    for product in products.values():
        left = set().union(*product.values())
        while left:
            best = max(product, key=lambda item: len(left & product[item]))
            left -= product.pop(best)
        for item in product:
            item.add_marker(pytest.mark.nightly)
