"""In any order of arrival within the window the same numbers, to the last bit."""

import numpy as np
import pytest
from fusion.worlds import POLICIES, fed, plane, sensors, table
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
            # What is asked writes nothing, nor what is written into an answer.
            for t in (None, 7.8, 1e4):
                found = fusion.estimate(t)
                found.x[:] = found.P[:] = np.nan
            fusion.forecast(1e4)
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


def test_a_table_takes_control_inputs_and_they_may_be_late_too():
    readings, _ = plane(np.arange(12) * 0.7)
    stamps, inputs = [0.5, 3.3, 5.6], [[1.0, 0.0], [0.0, -1.0], [0.5, 0.5]]
    late, prompt, run = (Fusion(constant_velocity(2, 0.5), sensors(), 100.0) for _ in range(3))
    before = bits(fed(late, readings).estimate())
    for one in zip(stamps[::-1], inputs[::-1], strict=True):
        late.control(*one)
    for one in zip(stamps, inputs, strict=True):
        prompt.control(*one)
    assert bits(late.estimate()) == bits(fed(prompt, readings).estimate()) != before
    found = run.run(table(readings), value=["v0", "v1"], controls=(stamps, inputs))
    np.testing.assert_allclose(found.x[-1], late.estimate().x, rtol=1e-6, atol=1e-7)


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
