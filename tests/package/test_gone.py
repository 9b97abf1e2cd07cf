"""A name that was public says what has taken its place."""

import importlib

import pytest

import robust_filterpy
from robust_filterpy import batch, noise, testing


@pytest.mark.parametrize(
    "module, name, mend",
    [
        (robust_filterpy, "tune", "estimate_noise"),
        (noise, "tune", "estimate_noise"),
        (batch, "FilterBank", "filter_series"),
        (robust_filterpy, "FilterBank", "filter_series"),
        (testing, "check_tracker", "assert_tracks"),
    ],
)
def test_a_name_that_is_gone_says_what_does_the_same(module, name, mend):
    sentence = rf"^{module.__name__} has no `{name}`; .*{mend}"
    with pytest.raises(AttributeError, match=sentence):
        getattr(module, name)
    with pytest.raises(ImportError, match=sentence):
        exec(f"from {module.__name__} import {name}", {})


def test_a_name_that_never_was_is_refused_in_python_s_own_words():
    for room in ("batch", "noise"):
        with pytest.raises(AttributeError, match="has no attribute 'filter_searies'"):
            importlib.import_module(f"robust_filterpy.{room}").filter_searies  # noqa: B018
