"""A fusion steps on an engine as filters do: bytes in, bytes out, wherever the readings are cut."""

import numpy as np
import pytest
from fusion.worlds import plane, sensors, table

from robust_filterpy.fleet import pack, step, unpack
from robust_filterpy.fusion import Fusion, constant_velocity


def made(**options):
    return Fusion(constant_velocity(2, 0.5), sensors(), 1.0, P0=100.0 * np.eye(4), **options)


def stepped(model, state, rows):
    return model.step(state, rows, value=["v0", "v1"])


@pytest.mark.parametrize("watch", [False, True])
def test_batches_of_any_length_are_one_stream_to_the_last_bit(watch):
    readings, _ = plane(np.arange(120) * 0.1)
    readings[30], readings[36] = readings[36], readings[30]
    rows, model, fusion = table(readings), made(watch=watch), made(watch=watch)
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
    from robust_filterpy.fusion import Sensor

    model = Fusion(constant_velocity(1, 0.5), {"gps": Sensor([1.0, 0.0], R=1.0)}, 1.0)
    state, output = step(model, None, rows)
    assert [error is None for error in output["error"]] == [True, False, False, True]
    assert "a time, got nan" in output["error"][1] and "sonar" in output["error"][2]
    only = {name: [column[0], column[3]] for name, column in rows.items()}
    assert pack(step(model, None, only)[0]) == pack(state)
    with pytest.raises(ValueError, match="columns"):
        step(model, state, {"time": [1.0]})
