"""A recording tells how late a sensor's stamps are, or that it does not."""

import numpy as np
import pytest
from support import states

from robust_filterpy.fusion import Fusion, FusionWarning, Sensor, constant_velocity

LATE = {"a": 0.0, "b": 0.25, "c": 0.07}
MOTION = constant_velocity(1, 4.0)


def recording(seed, late=LATE, wild=True, outliers=0.05, length=60.0):
    """Three sensors of a place (10, 5, 20 Hz, sigma .3), each stamped so much too late."""
    rng = np.random.default_rng(seed)
    at = np.arange(0.0, length, 0.005)
    F, Q, _ = MOTION.matrices(0.005)
    steps = rng.multivariate_normal(np.zeros(2), Q, len(at)) * wild
    places, rows = states(F, steps, np.array([0.0, 1.0]))[:, 0], []
    for name, rate in {"a": 10.0, "b": 5.0, "c": 20.0}.items():
        for t in np.arange(1.0, length - 1.0, 1.0 / rate) + rng.uniform(0.0, 0.01):
            v = 0.3 * rng.normal() * (10.0 if rng.random() < outliers else 1.0)
            rows.append((t + late[name], name, np.interp(t, at, places) + v))
    time, sensor, value = zip(*rows, strict=True)
    return {"time": np.array(time), "sensor": list(sensor), "value": np.array(value)}


def made(**more):
    return Fusion(MOTION, {name: Sensor([1.0, 0.0], R=0.09, **more.get(name, {})) for name in LATE}, 1.0)


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_delays_are_found_and_then_there_are_none(seed):
    found = made().delays(recording(seed))
    for name, late in LATE.items():
        assert found[name] == pytest.approx(late, abs=0.02)
    again = made(**{name: {"delay": d} for name, d in found.items()}).delays(recording(seed))
    for name, d in found.items():
        assert again[name] == pytest.approx(d, abs=0.02)


@pytest.mark.nightly
@pytest.mark.parametrize("curved", [False, True])
def test_an_offset_is_no_delay_instants_are_as_good_and_a_sensor_may_be_a_function(curved):
    table, sensors = recording(4 if curved else 3), {name: Sensor([1.0, 0.0], R=0.09) for name in LATE}
    mine = np.array(table["sensor"]) == "b"
    if curved:
        sensors["b"] = Sensor(h=lambda x: [x[0] ** 3], jacobian=lambda x: [[3.0 * x[0] ** 2, 0.0]], R=0.09)
    table["value"] = np.where(mine, table["value"] ** 3 if curved else table["value"] + 5.0, table["value"])
    table["time"] = np.datetime64("2026-01-01", "ns") + (1e9 * table["time"]).astype("m8[ns]")
    found = Fusion(MOTION, sensors, 1.0).delays(table)
    for name, late in LATE.items():
        assert found[name] - found["a"] * curved == pytest.approx(late, abs=0.06 if curved else 0.02)


@pytest.mark.nightly
def test_what_a_recording_does_not_tell_is_said():
    with pytest.warns(FusionWarning, match="cannot be seen.*has to change"):
        assert np.isnan(list(made().delays(recording(0, wild=False)).values())).all()
    table = recording(0)
    alone = np.array(table["sensor"]) == "a"
    with pytest.warns(FusionWarning, match="too few"), pytest.warns(FusionWarning, match="no other sensor"):
        few = {name: np.array(column)[alone] for name, column in table.items()}
        assert np.isnan(list(made().delays(few).values())).all()
    with pytest.raises(ValueError, match="longest"):
        made().delays(table, longest=0.0)
    with pytest.raises(ValueError, match="row for each reading"):
        made().delays({"time": [], "sensor": [], "value": []})
