"""In any order of arrival within the window the same numbers, to the last bit."""

import copy

import numpy as np
import pytest
from fusion.worlds import POLICIES, fed, plane, sensors, table
from hypothesis import given, settings
from hypothesis import strategies as st
from interruption import interrupted

from robust_filterpy import Huber
from robust_filterpy.fleet import pack, step, unpack
from robust_filterpy.fusion import Fusion, Sensor, constant_velocity


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


# Ctrl-C anywhere: the reading was taken or it was not, and what comes afterwards is as if it never was.


def fused(**options):
    sensors = {"fast": Sensor([1.0, 0.0], 0.3), "slow": Sensor([1.0, 0.0], 0.3, delay=0.5)}
    return Fusion(constant_velocity(1, q=0.1), sensors, window=2.0, **options)


def readings(count):
    rng = np.random.default_rng(2)
    for k in range(count):
        z = 0.25 * k + rng.normal() + 50.0 * (k % 11 == 8)
        yield "slow" if k % 3 == 2 else "fast", 0.25 * k - 1.01 * (k % 5 == 4), z


def estimated(one):
    found = one.estimate()
    return np.concatenate([found.x, found.P.ravel()])


@pytest.mark.parametrize("options", [{}, {"influence": Huber()}], ids=["learned", "huber"])
@pytest.mark.parametrize("count, every", [(21, 1), (633, 11)], ids=["late", "let go"])
def test_a_fusion_that_was_interrupted_goes_on_as_if_it_had_not_been(options, count, every):
    *first, one, other = readings(count)
    ready = fused(**options)
    fed(ready, first)
    estimated(ready)
    done = copy.deepcopy(ready)
    fed(done, (one, other))
    expected, outcomes = estimated(done), set()
    for at in range(1, 30_000, every):
        broken = copy.deepcopy(ready)
        if not interrupted(lambda broken=broken: broken.observe(*one), at, calls=True):
            break
        outcomes.add(broken.observe(*one))
        broken.observe(*other)
        np.testing.assert_array_equal(estimated(broken), expected, err_msg=f"interrupted at {at}")
    assert at > 20 and len(outcomes) == 2 and "duplicate" in outcomes


# On an engine, as filters do: bytes in, bytes out, wherever the readings are cut.


def stepped(model, state, rows):
    return model.step(state, rows, value=["v0", "v1"])


@pytest.mark.parametrize("watch", [False, True])
def test_batches_of_any_length_are_one_stream_to_the_last_bit(watch):
    readings, _ = plane(np.arange(120) * 0.1)
    readings[30], readings[36] = readings[36], readings[30]
    rows, (model, fusion) = table(readings), (made((), 1.0, P0=100.0 * np.eye(4), watch=watch) for _ in range(2))
    outcomes = [fusion.observe(*one) for one in readings]
    state, said = None, []
    for first, last in ((0, 1), (1, 33), (33, 34), (34, 160)):
        part = {name: column[first:last] for name, column in rows.items()}
        state, output = stepped(model, None if state is None else unpack(pack(state)), part)
        said += output["outcome"].tolist()
    assert said == outcomes and "late" in said
    assert output["x.p"][-1] == fusion.estimate().x[0]
    with pytest.raises(ValueError, match="reading first"):
        model.estimate()


def test_a_bad_row_costs_itself_alone():
    rows = {"time": [0.0, np.nan, 2.0, 3.0], "sensor": ["gps", "gps", "sonar", "gps"], "value": [1.0, 1.0, 1.0, 2.0]}
    model = Fusion(constant_velocity(1, 0.5), {"gps": Sensor([1.0, 0.0], R=1.0)}, 1.0)
    state, output = step(model, None, rows)
    assert [error is None for error in output["error"]] == [True, False, False, True]
    assert "a time, got nan" in output["error"][1] and "sonar" in output["error"][2]
    only = {name: [column[0], column[3]] for name, column in rows.items()}
    assert pack(step(model, None, only)[0]) == pack(state)
    with pytest.raises(ValueError, match="columns"):
        step(model, state, {"time": [1.0]})
