"""As a regressor of river a tracker does what it does by itself."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from robust_filterpy import ARX, ParameterTracker
from robust_filterpy.identification import FIR

pytest.importorskip("river")
from river import base, compose, evaluate, metrics

from robust_filterpy.adapters.river import RiverTracker


def recording():
    rng = np.random.default_rng(1)
    u, y = rng.normal(size=300), np.zeros(300)
    for k in range(1, 300):
        y[k] = 0.8 * y[k - 1] + 2.0 * u[k - 1] + 0.1 * rng.normal()
    return y, u


def test_river_measures_the_residuals_of_the_tracker():
    y, u = recording()
    stream = [({"valve": value, "other": "text"}, output) for value, output in zip(u, y, strict=True)]
    regressor = RiverTracker(ARX(1, 1), ["valve"], {"start": 0, "R": 0.01})
    assert isinstance(regressor, base.Regressor)
    found = evaluate.progressive_val_score(stream, regressor, metrics.MAE()).get()
    tracker = ParameterTracker(ARX(1, 1), start=0, R=0.01)
    assert_allclose(found, np.abs(tracker.run(y, u).residual).mean(), rtol=1e-9)
    assert_allclose(regressor.tracker.theta, tracker.theta, rtol=1e-9)


def test_a_clone_has_not_learnt():
    regressor = RiverTracker(ARX(1, 1), ["u"], {"start": 0, "R": 0.01, "forgetting": 0.98})
    regressor.learn_one({"u": 1.0}, 1.0)
    regressor.learn_one({"u": 1.0}, 1.0)
    clone = regressor.clone()
    assert clone.tracker.forgetting == pytest.approx(0.98)
    assert_array_equal(clone.tracker.theta, [0.0, 0.0])
    assert np.any(regressor.tracker.theta != 0.0)


def test_it_stands_in_a_pipeline():
    pipeline = compose.Select("u") | RiverTracker(FIR(1, nk=0), ["u"], {"start": 0, "R": 0.01})
    for value in np.linspace(-1.0, 1.0, 50):
        pipeline.learn_one({"u": value, "noise": 7.0}, 3.0 * value)
    assert pipeline.predict_one({"u": 2.0}) == pytest.approx(6.0, abs=0.05)


def test_features_that_are_missing_are_named_and_nothing_is_learnt():
    regressor = RiverTracker(FIR(1), ["u"], {"start": 0})
    before = regressor.tracker.state()
    with pytest.raises(KeyError, match="u"):
        regressor.learn_one({"v": 1.0}, 1.0)
    assert_array_equal(regressor.tracker.state()["P"], before["P"])
    with pytest.raises(ValueError, match=r"inputs: expected 1 name"):
        RiverTracker(FIR(1), ["u", "v"])
