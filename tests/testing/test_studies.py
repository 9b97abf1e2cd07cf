"""What the studies claim: each a fact about the filters that would fail if they were worse."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from robust_filterpy import RobustKalmanFilter

EXAMPLES = Path(__file__).parents[2] / "examples"


def load(name):
    """Import an example by its file."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    # dataclasses look their module up by name.
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


# -- the water flow


@pytest.fixture(scope="module")
def water():
    return load("water_flow")


@pytest.fixture(scope="module")
def scores(water, tmp_path_factory):
    return water.main(["--out", str(tmp_path_factory.mktemp("water"))])


STOPS = ("stop 1", "stop 2", "stop 3")


@pytest.mark.parametrize("name", ["Robust, Huber", "Robust, Tukey"])
def test_robust_deviates_less_than_kalman_in_every_disturbance(scores, name):
    kalman, robust = scores["KalmanFilter"].worst, scores[name].worst
    for disturbance in STOPS:
        assert robust[disturbance] < 0.25 * kalman[disturbance]
    assert robust["spike"] < 0.5 * kalman["spike"]
    assert scores[name].quiet < scores["KalmanFilter"].quiet


# -- README's first figure


def test_first_figure_shows_a_typical_gain(tmp_path, capsys):
    first_screen = load("first_screen")
    errors = first_screen.main(["--out", str(tmp_path), "--seeds", "1"])
    shown = errors["KalmanFilter"] / errors["RobustKalmanFilter"]
    ratios = []
    for seed in range(1000, 1040):
        position, readings, _ = first_screen.simulate(seed)
        kalman, robust = (
            first_screen.rms(first_screen.track(cls, readings) - position) for cls in (KalmanFilter, RobustKalmanFilter)
        )
        ratios.append(kalman / robust)
    assert min(ratios) > 1
    assert 3 < shown < np.median(ratios) * 1.25
