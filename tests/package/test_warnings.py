"""A warning points at the line of the user, and not at one of this package's."""

import ast
import warnings
from pathlib import Path

import numpy as np
import pytest

import robust_filterpy
from robust_filterpy import ARX, ParameterTracker, RobustKalmanFilter, identify

PACKAGE = Path(robust_filterpy.__file__).parent


def filled():
    y = np.random.default_rng(10_001).normal(size=400)
    y[::10] = 9999.0
    return y


def identified():
    return identify(filled(), np.random.default_rng(10_002).normal(size=400), ARX(1, 1))


def tracked():
    return ParameterTracker(ARX(1, 1)).run(filled(), np.random.default_rng(10_002).normal(size=400))


def with_q_of_filterpy():
    return ParameterTracker(ARX(1, 1), filter=RobustKalmanFilter(2, 1), start=0)


@pytest.mark.parametrize("call", [identified, tracked, with_q_of_filterpy])
def test_it_points_at_the_call(call):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    assert caught and {one.filename for one in caught} == {__file__}


def test_nobody_counts_frames():
    for path in PACKAGE.rglob("*.py"):
        if path.name not in ("_warning.py", "bench.py"):
            calls = (node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call))
            assert not any(keyword.arg == "stacklevel" for call in calls for keyword in call.keywords), path.name
