"""A name that was public says what has taken its place."""

import importlib

import pytest

import robust_filterpy
from robust_filterpy import _lazy, noise, testing


@pytest.mark.parametrize("module, name, mend", [
    (robust_filterpy, "tune", "estimate_noise"), (noise, "tune", "estimate_noise"),
    (robust_filterpy, "batch", "filter_series"), (robust_filterpy, "FilterBank", "filter_series"),
    (testing, "check_tracker", "assert_tracks"), (testing, "assert_unit_equivariant", "check_filter"),
])  # fmt: skip
def test_a_name_that_is_gone_says_what_does_the_same(module, name, mend):
    sentence = rf"^{module.__name__} has no `{name}`; .*{mend}"
    with pytest.raises(AttributeError, match=sentence):
        getattr(module, name)
    with pytest.raises(ImportError, match=sentence):
        exec(f"from {module.__name__} import {name}", {})


def test_a_name_that_never_was_is_refused_in_python_s_own_words():
    # One that moved from a package was never the root's.
    assert not hasattr(robust_filterpy, "Coefficients")
    for room in ("smoothing", "noise"):
        with pytest.raises(AttributeError, match="has no attribute 'filter_searies'"):
            importlib.import_module(f"robust_filterpy.{room}").filter_searies  # noqa: B018


def test_a_name_that_has_moved_is_found_where_it_was_and_says_where_it_is():
    assert len(_lazy._MOVED) > 30
    for name, home in _lazy._MOVED.items():
        thing, parts = getattr(importlib.import_module(home), name), home.split(".")
        # The front pages around its new home, but for those that are of a package alone.
        fronts = [".".join(parts[:n]) for n in range(2, len(parts))] or ["robust_filterpy"]
        for front in set(fronts) - {"robust_filterpy.identification.models"}:
            page = importlib.import_module(front)
            with pytest.warns(DeprecationWarning, match=f"{name} has moved: from {home} import {name}$"):
                assert getattr(page, name) is thing
            assert name not in page.__all__


def test_the_names_of_experiments_are_those_of_testing_for_one_release():
    experiments = importlib.import_module("robust_filterpy.experiments")
    for name in ("bootstrap_interval", "fit_percent", "monte_carlo", "rerun"):
        with pytest.warns(DeprecationWarning, match=f"from robust_filterpy.testing import {name}$"):
            assert getattr(experiments, name) is getattr(testing, name)
    with pytest.raises(AttributeError, match="has no attribute 'metrics'"):
        experiments.metrics  # noqa: B018
