"""All that is warned of by a class has one base, and what is said once is said once of each thing."""

import gc
import warnings

import pytest
from recordings import silence

from robust_filterpy import RobustFilterWarning, _warning
from robust_filterpy.filters import CorrelatedInnovationsWarning, OutlierShareWarning, StuckSensorWarning
from robust_filterpy.fusion import FusionWarning
from robust_filterpy.identification import LostTrackerWarning

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
