"""What a stuck sensor says while a tracker runs counts as missing; sensors that repeat themselves are believed."""

import warnings

import numpy as np
import pytest
import support
from scipy.signal import lfilter

from robust_filterpy.filters import StuckSensorWarning
from robust_filterpy.identification import ARMAX, ARX, BoxJenkins, OutputError, ParameterTracker, TrackerBank, identify
from robust_filterpy.identification.recursive.watch import LostTrackerWarning

A, B, LENGTH = np.array([1.0, -1.5, 0.7]), np.array([0.0, 1.0, 0.5]), 900
STRUCTURES = [ARX(2, 2), OutputError(2, 2), ARMAX(2, 2, 1), BoxJenkins(2, 1, 1, 2)]


def recording(structure, seed=1, length=LENGTH, size=0.3):
    """A recording with 10 % outliers."""
    rng = np.random.default_rng([41, seed])
    u = rng.choice([-1.0, 1.0], length)
    noise = size * np.where(rng.random(length) < 0.1, 10.0, 1.0) * rng.normal(size=length)
    return lfilter(B, A, u) + (lfilter([1.0], A, noise) if structure.na else noise), u


def begun(structure, y, u, at=600):
    """A tracker as it is after so many samples, quickly."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        tracker = ParameterTracker(structure, start=200)
        tracker.run(y[:at], u[:at])
    return tracker


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("structure", support.by_night(STRUCTURES, ARX(2, 2), OutputError(2, 2)), ids=str)
@pytest.mark.parametrize("value", ["last", 0.0, 25.0])
def test_a_sensor_that_is_stuck_is_said_once_and_teaches_nothing(structure, value):
    y, u = recording(structure)
    y[600:800] = y[599] if value == "last" else value
    tracker = begun(structure, y, u)
    theta, noise = tracker.theta, tracker.R
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        result = tracker.run(y[600:], u[600:])
    assert [each.category for each in said] == [StuckSensorWarning]
    assert np.isnan(result.residual[10:200]).all() and np.isnan(result.weights[10:200]).all()
    assert not np.isnan(result.residual[200:]).any()
    # The first readings may be near the prediction, and count as any others.
    assert np.abs(result.theta[199] - theta).max() < 0.02 and 0.5 < tracker.R / noise < 2.0


def test_one_by_one_by_the_definition_and_in_a_bank_it_is_the_same(monkeypatch):
    structure = ARX(2, 2)
    y, u = recording(structure)
    y[600:700], y[750] = y[600], np.nan
    y[753:757] = y[753] + 30.0
    one = begun(structure, y, u)
    others = [begun(structure, y, u) for _ in range(2)]
    bank = TrackerBank(2, structure, start=200)
    with pytest.warns(StuckSensorWarning, match=r"actuators? 1.*stuck"):
        bank.run(np.column_stack((np.where(np.arange(LENGTH) < 600, y, np.nan), y)), u)
    with pytest.warns(StuckSensorWarning) as said:
        expected = one.run(y[600:], u[600:])
    assert len(said) == 1
    with pytest.warns(StuckSensorWarning) as said:
        residuals = [others[0].update(*sample).residual for sample in zip(y[600:], u[600:], strict=True)]
    assert len(said) == 1
    support.without_kernel(monkeypatch)
    with pytest.warns(StuckSensorWarning):
        others[1].run(y[600:], u[600:])
    np.testing.assert_allclose(residuals, expected.residual, rtol=1e-9, atol=1e-12)
    for theta in (others[0].theta, others[1].theta, bank.theta[1]):
        np.testing.assert_allclose(theta, one.theta, rtol=1e-9)
    assert np.isnan(residuals[1:100]).sum() > 90 and np.isnan(residuals[154:157]).all()


def test_interrupted_while_stuck_it_goes_on_to_the_last_bit():
    y, u = recording(OutputError(2, 2))
    y[600:700] = y[600]
    one, other = begun(OutputError(2, 2), y, u, 650), ParameterTracker(OutputError(2, 2), start=200)
    other.restore(one.state())
    # What has been said is not in a state, and is said again.
    with pytest.warns(StuckSensorWarning):
        found = other.run(y[650:], u[650:])
    for first, second in zip(one.run(y[650:], u[650:]), found, strict=True):
        np.testing.assert_array_equal(first, second)
    assert np.isnan(found.residual[:50]).all()
    damaged = {**one.state(), "readings": np.full(7, -1.0)}
    with pytest.raises(ValueError, match="readings"):
        other.restore(damaged)


def test_a_state_from_before_readings_were_noted_is_taken():
    y, u = recording(OutputError(2, 2))
    one = begun(OutputError(2, 2), y, u)
    old = {name: value for name, value in one.state().items() if name != "readings"}
    one.restore(old)
    assert not one.state()["readings"].any()


def believed():
    """Recordings of sensors that repeat themselves and are right."""
    y, u = recording(OutputError(2, 2), 2)
    rng, places = np.random.default_rng(3), np.arange(LENGTH)
    rests = u * (places // 150 % 2)
    at_rest = lfilter(B, A, rests)
    moving = np.abs(at_rest) > 1e-3
    return {
        "coarse": (np.round(y), u),
        "a tenth of its noise": (0.03 * np.round(y / 0.03), u),
        "counts": (rng.poisson(np.maximum(400.0 + 40.0 * y, 0.0)).astype(float), u),
        "each value three times": (y[places // 3 * 3], u),
        "without noise": (lfilter(B, A, u), u),
        "without noise, held": (at_rest, rests),
        "at rest": (np.where(moving, at_rest + 0.3 * rng.normal(size=LENGTH), 0.0), rests),
    }


@pytest.mark.parametrize("name", support.by_night(believed(), "coarse", "counts", "at rest"))
def test_sensors_that_repeat_themselves_are_believed(name):
    y, u = believed()[name]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LostTrackerWarning)
        warnings.simplefilter("error", StuckSensorWarning)
        result = ParameterTracker(OutputError(2, 2), start=200).run(y, u)
    assert np.isnan(result.residual).sum() <= 2


def test_a_sensor_stuck_in_the_first_samples_is_said_too():
    y, u = recording(OutputError(2, 2))
    y[:100] = 3.0
    with pytest.warns(StuckSensorWarning, match="of its first samples: y is 3"):
        ParameterTracker(OutputError(2, 2), start=200).run(y[:400], u[:400])


def test_as_in_the_paper_every_output_is_taken_as_it_is():
    y, u = recording(OutputError(2, 2))
    y[600:700] = y[600]
    tracker = ParameterTracker(OutputError(2, 2), start=0, theta=[-1.5, 0.7, 1.0, 0.5], P=0.01, R=0.09)
    assert not np.isnan(tracker.run(y, u).residual).any()


def test_after_a_long_gap_nothing_is_lost():
    y, u = recording(OutputError(2, 2), 4, length=2600)
    y[600:2400] = np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tracker = ParameterTracker(OutputError(2, 2), start=200)
        tracker.run(y, u)
    usual = tracker.state()["watch"][3]
    assert usual > 0.3


def test_wild_outputs_explain_no_other_wild_one():
    y, u = recording(ARX(2, 2), 5)
    model = identify(y[:400], u[:400], ARX(2, 2))
    wild = y.copy()
    # The first predicts 1.5e6 for the second: nearer than what the model predicts from outputs that are ordinary.
    size = 1e6 * np.random.default_rng(7).uniform(1.0, 2.0, 12)
    wild[420::40], wild[421::40] = size, 0.9 * size
    clean, spoilt = ParameterTracker(model), ParameterTracker(model)
    clean.run(y[400:], u[400:])
    spoilt.run(wild[400:], u[400:])
    assert np.abs(spoilt.theta - clean.theta).max() < 0.02


def test_a_sensor_that_gets_stuck_as_soon_as_there_is_a_model_is_seen():
    # That moves by a hundred times its noise, so that neighbours tell little of how fine its steps are.
    y, u = recording(OutputError(2, 2), 6, size=0.03)
    y[210:300] = y[210]
    with pytest.warns(StuckSensorWarning):
        result = ParameterTracker(OutputError(2, 2), start=200).run(y[:400], u[:400])
    assert np.isnan(result.residual[215:300]).all()
