"""In any order of arrival within the window the same numbers, to the last bit."""

import numpy as np
import pytest
from fusion.worlds import POLICIES, fed, plane, sensors
from hypothesis import given, settings
from hypothesis import strategies as st

from robust_filterpy.fusion import Fusion, constant_velocity


def made(readings, window=100.0, **policy):
    return fed(Fusion(constant_velocity(2, 0.5), sensors(), window, **policy), readings)


def bits(estimate):
    return estimate.x.tobytes() + estimate.P.tobytes()


@pytest.mark.parametrize("policy", POLICIES)
@given(order=st.permutations(range(16)), asks=st.sets(st.integers(0, 15)))
@settings(max_examples=15, deadline=None)
def test_any_order_of_arrival_gives_the_same_bits(policy, order, asks):
    readings, _ = plane(np.arange(12) * 0.7, outliers=0.2)
    expected = made(readings, **POLICIES[policy])
    fusion = Fusion(constant_velocity(2, 0.5), sensors(), 100.0, **POLICIES[policy])
    for i, place in enumerate(order):
        fusion.observe(*readings[place])
        if i in asks:
            fusion.estimate()
    for t in (None, 3.0, 9.9):
        assert bits(fusion.estimate(t)) == bits(expected.estimate(t))
    assert fusion.estimate().ages == expected.estimate().ages


def test_late_within_the_window_while_the_window_moves_on():
    readings, _ = plane(np.arange(900) * 0.1)
    rng = np.random.default_rng(1)
    late = [t + (rng.uniform(0.0, 1.9) if rng.random() < 0.2 else 0.0) for _, t, _ in readings]
    arrived = [readings[i] for i in np.argsort(late, kind="stable")]
    fusion = made(arrived, 2.0)
    assert sum(counts["late"] for counts in fusion.counts.values()) > 100
    assert bits(fusion.estimate()) == bits(made(readings, 2.0).estimate())
    # Not everything was kept.
    assert len(fusion.state()["keys"]) < 700


def test_control_inputs_may_be_late_too():
    readings, _ = plane(np.arange(12) * 0.7)
    inputs = [(0.5, [1.0, 0.0]), (3.3, [0.0, -1.0]), (5.6, [0.5, 0.5])]
    first = fed(Fusion(constant_velocity(2, 0.5), sensors(), 100.0), readings)
    before = bits(first.estimate())
    for one in reversed(inputs):
        first.control(*one)
    other = Fusion(constant_velocity(2, 0.5), sensors(), 100.0)
    for one in inputs:
        other.control(*one)
    fed(other, readings)
    assert bits(first.estimate()) == bits(other.estimate()) != before


def test_what_is_asked_writes_nothing():
    readings, _ = plane(np.arange(12) * 0.7)
    quiet, asked = made([]), made([])
    for one in readings:
        quiet.observe(*one)
        asked.observe(*one)
        for t in (0.3, 1e4, one[1] + 0.01):
            if t >= readings[0][1]:
                asked.estimate(t)
    assert bits(quiet.estimate(9.0)) == bits(asked.estimate(9.0))
    found = asked.estimate()
    found.x[:] = found.P[:] = np.nan
    assert bits(quiet.estimate()) == bits(asked.estimate())


def test_the_same_again_is_a_duplicate_and_something_else_is_a_correction():
    fusion = made(plane(np.arange(4) * 0.5)[0])
    z, before = plane(np.arange(4) * 0.5)[0][0][2], bits(fusion.estimate())
    assert fusion.observe("wheel", 0.0, z) == "duplicate" and bits(fusion.estimate()) == before
    with pytest.raises(ValueError, match=r"one reading for each stamp.*replace=True"):
        fusion.observe("wheel", 0.0, z + 1.0)
    assert bits(fusion.estimate()) == before
    assert fusion.observe("wheel", 0.0, z + 1.0, replace=True) == "replaced"
    assert bits(fusion.estimate()) != before
    fusion.observe("wheel", 0.0, z, replace=True)
    assert bits(fusion.estimate()) == before
