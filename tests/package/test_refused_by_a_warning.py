"""Where a warning is an error, the call that gives it has not happened: filters, trackers, banks and fusions."""

import gc
import pickle
import warnings

import numpy as np
import pytest
from recordings import silence, unheard
from support import of_every_kind

from robust_filterpy import (
    RobustFilterWarning,
    _warning,
    fusion,
)
from robust_filterpy.filters import CorrelatedInnovationsWarning, OutlierShareWarning, StuckSensorWarning
from robust_filterpy.fusion import FusionWarning
from robust_filterpy.identification import ARX, LostTrackerWarning, OutputError, ParameterTracker, TrackerBank


def plant(rng, n=300):
    u, y = np.sign(rng.normal(size=n)), np.zeros(n)
    for k in range(1, n):
        y[k] = 0.8 * y[k - 1] + u[k - 1]
    return u, y + 0.05 * rng.normal(size=n)


def recordings(*kinds):
    """A plant that becomes another, a sensor that stands, fill values."""
    rng = np.random.default_rng(4)
    for kind in kinds:
        u, y = plant(rng)
        if kind == "changes":
            y[200:] *= -2.0
        elif kind == "stands":
            y[150:260] = 7.25
        else:
            y[[120, 121, 122, 180, 181]] = -9999.0
        yield u, y


def watched(call, things, said):
    """Make a call twice: as it is, and where a warning is an error, there again if it was refused."""
    _warning._said.clear()
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        call(things[0])
    _warning._said.clear()
    with silence(UserWarning):
        if not any(issubclass(one.category, UserWarning) for one in given):
            call(things[1])
            return
        before = pickle.dumps(things[1].state())
        with pytest.raises(UserWarning) as word:
            call(things[1])
        said.add(word.type.__name__)
        assert pickle.dumps(things[1].state()) == before
        warnings.simplefilter("ignore")
        call(things[1])


FILTERS = of_every_kind([[1.0, 1.0], [0.0, 1.0]], np.eye(1, 2), 0.01, P=10.0, x=np.zeros(2), patience=5)
FILTERS.pop("ensemble")


def readings(rng, steps=100):
    stuck, fill, wild = rng.normal(size=(3, steps))
    stuck[60:80], fill[60:63], slope = 50.0, -9999.0, 0.5 * np.arange(float(steps)) ** 1.5
    return stuck, fill, 100.0 * wild, slope


@pytest.mark.parametrize("name", FILTERS)
def test_a_reading_that_a_warning_refuses_has_not_happened(name):
    said = set()
    # What is clipped is judged after 198 of them.
    for zs in readings(np.random.default_rng(3), 200 if name == "innovation" else 100):
        things = [FILTERS[name]() for _ in "ab"]
        for z in zs[:, None]:
            for call in (lambda kf: kf.predict(), lambda kf, z=z: kf.update(z)):
                watched(call, things, said)
        assert pickle.dumps(things[0].state()) == pickle.dumps(things[1].state())
    assert said or name == "unscented"


LOST, STUCK = "LostTrackerWarning", "StuckSensorWarning"


@pytest.mark.parametrize("width, structure, by, kinds, expected", [
    (None, ARX(1, 1), "sample", ("changes", "stands"), {LOST, STUCK}),
    (2, OutputError(1, 1), "sample", ("changes", "stands"), {LOST, STUCK}),
    (None, ARX(1, 1), "run", ("stands", "fills"), {STUCK, "UserWarning"}),
    (2, ARX(1, 1), "run", ("stands", "fills"), {STUCK}),
], ids=["tracker", "bank", "run of a tracker", "run of a bank"])  # fmt: skip
def test_samples_that_a_warning_refuses_have_not_happened(width, structure, by, kinds, expected):
    said = set()
    for u, y in recordings(*kinds):
        things = [TrackerBank(2, structure, start=50) if width else ParameterTracker(structure, start=50) for _ in "ab"]
        y, u = (np.stack([x] * width, axis=1) if width else x for x in (y, u))
        for part in np.split(np.arange(len(y)), len(y) if by == "sample" else 6):
            if by == "sample":
                watched(lambda one, k=part[0], y=y, u=u: one.update(y[k], u[k]), things, said)
            else:
                watched(lambda one, part=part, y=y, u=u: one.run(y[part], u[part]), things, said)
        assert pickle.dumps(things[0].state()) == pickle.dumps(things[1].state())
    assert expected <= said


def fails(x):
    if x[0] > 8.0:
        raise ValueError("beyond the sensor's range")
    return x[:1]


def fused(fault):
    """A fusion in which somebody is never together with its group, one's function fails, or the motion does."""
    sensors = {
        "a": fusion.Sensor([1.0, 0.0], 0.3, group="party"),
        "b": fusion.Sensor([1.0, 0.0], 0.5, group="party"),
        "c": fusion.Sensor(h=fails, jacobian=lambda x: np.array([[1.0, 0.0]]), R=0.5),
    }
    motion = fusion.constant_velocity(1, q=0.1)
    if fault == "motion":

        def goes(x, dt):
            if x[0] > 5.0:
                raise ValueError("off the map")
            return np.array([x[0] + x[1] * dt, x[1]])

        motion = fusion.from_function(goes, lambda x, dt: np.array([[1.0, dt], [0.0, 1.0]]), 0.1 * np.eye(2), 2)
    return fusion.Fusion(motion, sensors, window=2.0)


def heard(one):
    """What a fusion holds; made again, a reading that was taken before its warning is a duplicate."""
    return pickle.dumps(one.state()), {name: {**had, "duplicate": 0} for name, had in one.counts.items()}


@pytest.mark.parametrize("fault", ["sensors", "motion"])
def test_a_fusion_whose_warnings_are_errors_takes_the_same_readings(fault):
    said, rng = 0, np.random.default_rng(8)
    plain, strict = fused(fault), fused(fault)
    for k in range(120):
        late = 5.0 if k % 30 == 29 else 0.0
        reading = "abc"[k % 3], 0.1 * k - late, 0.1 * k + 0.3 * rng.normal()
        calls = [lambda one, reading=reading: one.observe(*reading)]
        calls += [lambda one: one.estimate()] * (k % 10 == 9)
        for call in calls:
            with unheard():
                expected = outcome(call, plain)
                warnings.simplefilter("error", UserWarning)
                try:
                    assert outcome(call, strict) == expected
                except fusion.FusionWarning:
                    said += 1
                    warnings.simplefilter("ignore")
                    assert outcome(call, strict) in (expected, "duplicate")
    assert heard(plain) == heard(strict)
    assert said


def outcome(call, one):
    """What a call returns, or in which words it fails."""
    try:
        found = call(one)
    except (ValueError, RuntimeError) as error:
        return str(error)
    return found if isinstance(found, str) else pickle.dumps((found.x, found.P))


# All that is warned of by a class has one base, and what is said once is said once of each thing.


KINDS = [OutlierShareWarning, CorrelatedInnovationsWarning, StuckSensorWarning, FusionWarning, LostTrackerWarning]


class Filter:
    """Something that hash() refuses."""

    __hash__ = None


@pytest.fixture(autouse=True)
def anew(monkeypatch):
    monkeypatch.setattr(_warning, "_said", set())


@pytest.mark.parametrize("kind", KINDS)
def test_one_rule_switches_all_kinds_off(kind):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", RobustFilterWarning)
        _warning.warn("something", kind)
    with pytest.warns(kind):
        _warning.warn("something", kind)


@pytest.mark.parametrize("of", ["RobustKalmanFilter", ("RobustKalmanFilter", 2, 1), Filter()])
def test_it_is_said_once_of_each_thing_unless_the_call_was_refused(of):
    with silence():
        for _ in range(2):
            with pytest.raises(StuckSensorWarning):
                _warning.warn("something", StuckSensorWarning, of=of)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for kind in (StuckSensorWarning, StuckSensorWarning, OutlierShareWarning):
            _warning.warn("something", kind, of=of)
    assert [one.category for one in caught] == [StuckSensorWarning, OutlierShareWarning]


def test_an_object_that_is_gone_leaves_nothing_behind():
    one = Filter()
    with pytest.warns(StuckSensorWarning):
        _warning.warn("something", StuckSensorWarning, of=one)
    assert _warning.was_said(StuckSensorWarning, one) and len(_warning._said) == 1
    del one
    gc.collect()
    assert not _warning._said
