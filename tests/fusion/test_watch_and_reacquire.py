"""Sensors are watched and readings that come apart from the state are doubted, both by one fusion."""

import numpy as np
import pytest
from fusion.test_verdicts import made, recording
from fusion.worlds import followed

from robust_filterpy.fleet import pack, unpack
from robust_filterpy.fusion import Reacquisition


def doubting():
    return made(reacquire=Reacquisition())


def readings_of(seed, far=30.0):
    """b is off by five deviations from 30 s on, c by more from 40 to 45 s: readings and places."""
    readings, places = recording(seed, lambda t, x, v, last: x + v + 5.0)
    return [(n, t, z + far * (n == "c" and 40.0 < t < 45.0)) for n, t, z in readings], places


@pytest.fixture(scope="module")
def both():
    readings, places = readings_of(7)
    return readings, places, followed(doubting(), readings, lambda k, name: k % 4 == 0 or k == len(readings))


def test_one_is_biased_and_another_false_for_a_while(both):
    _, places, found = both
    assert all(said == {} for t, _, said in found if 10.0 < t < 30.0)
    assert {str(said) for t, _, said in found if 33.0 < t < 40.0} == {"{'b': 'biased'}"}
    amid = [said for t, _, said in found if 41.0 < t < 45.0]
    # With b left out there is one other: it takes readings until that shows.
    assert all(said["b"] == "biased" and said["c"] in ("undecided", "false") for said in amid)
    assert any(said["c"] == "false" for said in amid)
    assert [said for t, _, said in found if t > 46.0][-1] == {"b": "biased"}
    error = np.array([one.x[0] for _, one, _ in found]) - np.append(places[3:-1:4], places[-1])
    assert np.abs(error[[t > 33.0 for t, *_ in found]]).max() < 2.5


def test_any_order_of_arrival_and_a_state_on_the_way_give_the_same_bits(both):
    readings, _, found = both
    rng = np.random.default_rng(1)
    late = [t + (rng.uniform(0.0, 0.9) if rng.random() < 0.2 else 0.0) for _, t, _ in readings]
    mixed = doubting()
    for k, place in enumerate(np.argsort(late, kind="stable")):
        mixed.observe(*readings[place])
        if k % 500 == 499 or k == 1460:
            state, mixed = unpack(pack(mixed.state())), doubting()
            mixed.restore(state)
    assert mixed.estimate().x.tobytes() == found[-1][1].x.tobytes()
    assert {n: v.fault for n, v in mixed.verdicts().items() if v.fault != "healthy"} == found[-1][2]
    with pytest.raises(ValueError, match="moments"):
        made().restore({n: a for n, a in mixed.state().items() if n != "doubt"})
