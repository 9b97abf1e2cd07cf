"""A device's clock that is wrong once, or is set: it costs a few rows, never the device, and is said."""


import numpy as np
import pandas as pd
import pytest
from recordings import same, silence
from support import of_matrices

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.fleet import FilterModel, filter_table, step

DAY = 1.7e9
BACK = "the clock was set"


def model(dt=1.0, **more):
    kf = of_matrices(RobustKalmanFilter, 1.0, [[1.0]], 0.01)
    return FilterModel(kf, time="t", measurements=["z"], dt=dt, **more)


def streamed(times, a_model, sizes=1):
    """Return the errors and estimates of rows that come so many at a time."""
    state, errors, x = None, [], []
    for k in range(0, len(times), sizes):
        state, output = step(a_model, state, [[t, 1.0] for t in times[k : k + sizes]])
        errors.extend(output["error"])
        x.extend(output["x0"])
    return errors, np.array(x), state


@pytest.mark.parametrize("place", [0, 1, 250, 499])
@pytest.mark.parametrize("wrong", [0.0, 3e9])
def test_one_wrong_stamp_in_a_table_costs_its_row_alone(place, wrong):
    t = DAY + np.arange(500.0)
    t[place] = wrong
    # Another device stands before it.
    table = pd.DataFrame({"device": np.repeat(["b", "a"], 500), "t": np.append(DAY + np.arange(500.0), t), "z": 1.0})
    found = filter_table(model(), table)
    good = np.isfinite(found["x0"].to_numpy())
    assert not good[500 + place] and good.sum() == 999 and found["error"].notna().sum() == 1


@pytest.mark.parametrize("dt, costs", [(1.0, 5), (None, 50)])
@pytest.mark.parametrize(
    "first, then", [([DAY], 0.0), ([0.0], DAY), ([DAY, 3e9], DAY + 2.0), (DAY + np.arange(40.0), 10.0)]
)
def test_a_clock_that_was_set_is_followed(first, then, dt, costs):
    times = [*first, *(then + np.arange(100.0))]
    errors, x, _ = streamed(times, model(dt, late="drop" if dt is None else None))
    lost = len(times) - np.isfinite(x).sum() if dt else len(times) - len(x)
    forward = dt is None and then > max(first)
    assert lost <= (1 if len(first) == 2 else 0) + (0 if forward else costs - 1)
    stood = [error for error in errors if error and BACK in error]
    assert len(stood) == (0 if forward or (dt and len(first) == 2) else 1)


@pytest.mark.parametrize("sizes", [2, 3, 7, 200])
@pytest.mark.parametrize("dt", [1.0, None])
def test_a_cut_into_batches_changes_nothing(sizes, dt):
    rng = np.random.default_rng(sizes)
    times = np.concatenate([DAY + np.arange(30.0), np.arange(60.0), DAY + 100.0 + np.arange(70.0)])
    times[rng.integers(0, len(times), 5)] = 0.5
    whole, cut = streamed(times, model(dt), len(times)), streamed(times, model(dt), sizes)
    np.testing.assert_array_equal(whole[1], cut[1])
    same(whole[2], cut[2])


@pytest.mark.parametrize("dt", [1.0, None])
def test_late_rows_are_no_other_clock(dt):
    """A burst of forty that were kept back, samples that are shuffled, and duplicates."""
    rng = np.random.default_rng(1)
    burst = np.concatenate([DAY + np.arange(50.0), [DAY + 100.0], DAY + 50.0 + np.arange(40.0)])
    shuffled = DAY + rng.permutation(400.0 * np.ones(400)).cumsum()
    for times in (burst, rng.permutation(shuffled), np.full(300, DAY), DAY + 1e-3 * np.arange(300.0)):
        errors, _, _ = streamed(times, model(dt), 50)
        assert not any(error and BACK in error for error in errors)


def test_a_device_whose_clock_is_wrong_is_named_among_others():
    t = DAY + np.arange(50.0)
    table = pd.concat([pd.DataFrame({"device": name, "t": t, "z": 1.0}) for name in "abcde"], ignore_index=True)
    table.loc[table.device == "c", "t"] = DAY
    with pytest.warns(
        UserWarning, match=r"49 of 250 rows have an error, most of those of 1 device\(s\): 'c' \(49 of 50\)"
    ):
        filter_table(model(), table)
    table.loc[table.device == "c", "t"] = t
    with silence():
        assert filter_table(model(), table)["error"].isna().all()
