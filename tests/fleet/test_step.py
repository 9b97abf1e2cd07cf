"""One pure step: the filter's and tracker's own numbers, however the samples are cut, and nothing is written into."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_state import FILTERS, F, extended, observe, recording, signals

from robust_filterpy import (
    ARMA,
    ARX,
    FIR,
    OutputError,
    ParameterTracker,
    RobustKalmanFilter,
    TwoSidedKalmanFilter,
    robust,
)
from robust_filterpy.fleet import FilterModel, TrackerModel, filter_table, pack, step, step_table, unpack

pd = pytest.importorskip("pandas")


def jacobian(x):
    return np.array([[1.0, 0.0]])


def unscented():
    """A sigma-point filter whose functions a worker can import."""
    return FILTERS["unscented"]()


MODELS = {
    "linear": lambda: FilterModel(FILTERS["linear"]()),
    "two-sided": lambda: FilterModel(FILTERS["two-sided"]()),
    "adaptive": lambda: FilterModel(FILTERS["adaptive"]()),
    "recovering": lambda: FilterModel(FILTERS["recovering"]()),
    "unscented": lambda: FilterModel(unscented()),
    "ensemble": lambda: FilterModel(FILTERS["ensemble"]()),
    "extended": lambda: FilterModel(extended(), update={"HJacobian": jacobian, "Hx": observe}),
    "ARX": lambda: TrackerModel(ARX(2, 1), {"start": 0}),
    "starting": lambda: TrackerModel(ARX(2, 1), {"start": 60}),
    "ARMA": lambda: TrackerModel(ARMA(2, 1), {"start": 0}),
    "output error": lambda: TrackerModel(OutputError(2, 1), {"start": 0, "forgetting": 0.99}),
}


def batch_for(model):
    if isinstance(model, TrackerModel):
        return np.column_stack(signals())[:, : sum(model.widths)]
    z = np.array([np.nan if z is None else z for z in recording()])
    # An outlier that the kernel leaves to the definition.
    z[15] = 1e200
    return z[:, None]


def same(one, other):
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], err_msg=name)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("cuts", [[1], [15, 16], [10, 11, 12, 35]])
def test_however_the_samples_are_cut_the_numbers_are_the_same(name, cuts):
    model = MODELS[name]()
    batch = batch_for(model)
    whole_state, whole = step(model, None, batch)
    state, parts = None, []
    for part in np.split(batch, cuts):
        # Bytes in between, and a model that has travelled.
        state = None if state is None else unpack(pack(state))
        state, output = step(pickle.loads(pickle.dumps(model)), state, part)
        parts.append(output)
    same({k: np.concatenate([part[k] for part in parts]) for k in whole}, whole)
    same(state, whole_state)
    assert list(whole) == list(model.columns)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.integers(0, 40), max_size=6).map(sorted))
def test_any_cuts_of_a_filter(cuts):
    model = MODELS["linear"]()
    batch = batch_for(model)
    state, parts = None, []
    for part in np.split(batch, cuts):
        state, output = step(model, state, part)
        parts.append(output["x0"])
    np.testing.assert_array_equal(np.concatenate(parts), step(model, None, batch)[1]["x0"])


@pytest.mark.parametrize("name", MODELS)
def test_nothing_is_written_into(name):
    model = MODELS[name]()
    batch = batch_for(model)
    batch.flags.writeable = False
    state, _ = step(model, None, batch[:20])
    frozen = copy.deepcopy(state)
    for value in frozen.values():
        value.flags.writeable = False
    first = step(model, frozen, batch[20:])
    again = step(model, frozen, batch[20:])
    same(first[0], again[0])
    same(first[1], again[1])
    same(frozen, state)
    with pytest.raises(AttributeError):
        model.late = "drop"


def test_a_linear_filter_gives_its_own_numbers():
    kf, model = FILTERS["linear"](), MODELS["linear"]()
    batch = batch_for(model)
    state, output = step(model, None, batch)
    for k, z in enumerate(batch):
        kf.predict()
        kf.update(z)
        np.testing.assert_allclose([output["x0"][k], output["x1"][k]], kf.x, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose([output["std0"][k], output["std1"][k]], np.sqrt(kf.P.diagonal()), rtol=1e-9)
        np.testing.assert_allclose(output["weight0"][k], kf.weights[0], rtol=1e-9)
    # And the filter goes on from the state of the fleet.
    other = FILTERS["linear"]()
    other.restore(state)
    np.testing.assert_allclose(other.P, kf.P, rtol=1e-9)


def test_a_filter_with_inputs_gives_its_own_numbers():
    def make():
        kf = RobustKalmanFilter(2, 1, dim_u=2)
        kf.F, kf.H, kf.Q, kf.B = F, np.array([[1.0, 0.0]]), 0.01 * np.eye(2), np.array([[0.5, 0.1], [0.0, 1.0]])
        return kf

    rng, kf = np.random.default_rng(1), make()
    batch = rng.normal(size=(30, 3))
    state, _ = step(FilterModel(make(), inputs=["u", "v"]), None, batch)
    for row in batch:
        kf.predict(u=row[1:])
        kf.update(row[0])
    np.testing.assert_allclose(state["x"], kf.x, rtol=1e-9)
    assert state["x"].shape == (2, 1)


def test_a_tracker_gives_its_own_numbers():
    y, u = signals()
    model = TrackerModel(ARX(2, 1), {"start": 60})
    _, output = step(model, None, np.column_stack((y, u)))
    expected = ParameterTracker(ARX(2, 1), start=60).run(y, u)
    np.testing.assert_allclose(
        np.column_stack([output[name] for name in ("a1", "a2", "b1")]), expected.theta, rtol=1e-6
    )
    np.testing.assert_allclose(output["prediction"], expected.prediction, rtol=1e-6, atol=1e-9)


# Forms of a batch.


def test_array_frame_and_arrow_table_are_the_same_batch():
    pa = pytest.importorskip("pyarrow")
    y, u = signals()
    t = np.arange(len(y)) * 0.5
    model = TrackerModel(ARX(2, 1), {"start": 0}, time="t", measurements=["y"], inputs=["u"])
    state, expected = step(model, None, np.column_stack((t, y, u)))
    frame = pd.DataFrame({"u": u, "other": "text", "y": y, "t": t}, index=np.arange(100, 100 + len(y)))
    frames_state, table = step(model, None, frame)
    assert table.index.equals(frame.index) and list(table) == ["t", *model.columns]
    arrows_state, arrow = step(model, None, pa.Table.from_pandas(frame))
    for one in (frames_state, arrows_state):
        same(one, state)
    for name in model.columns:
        np.testing.assert_array_equal(table[name], expected[name])
        np.testing.assert_array_equal(arrow.column(name).to_numpy(), expected[name])
    batch_state, found = step(model, None, pa.RecordBatch.from_pandas(frame))
    same(batch_state, state)
    assert type(found) is pa.RecordBatch


def test_dates_are_times():
    z = np.arange(5.0)
    model = FilterModel(FILTERS["linear"](), time="t", measurements=["z"], dt=60.0)
    minutes = pd.date_range("2026-01-01", periods=6, freq="min", tz="UTC").delete(3)
    state, output = step(model, None, pd.DataFrame({"t": minutes, "z": z}))
    expected = step(FilterModel(FILTERS["linear"]()), None, np.array([0.0, 1.0, 2.0, np.nan, 3.0, 4.0])[:, None])[1]
    np.testing.assert_array_equal(output["x0"], expected["x0"][[0, 1, 2, 4, 5]])
    assert state["time"] == minutes[-1].timestamp()


# Times.


def timed(**options):
    return FilterModel(FILTERS["linear"](), time="t", **options)


def test_a_gap_is_missing_samples_wherever_the_batch_is_cut():
    t, z = np.array([0.0, 1.0, 2.1, 6.0, 7.0]), np.arange(5.0)
    full = np.full(8, np.nan)
    full[[0, 1, 2, 6, 7]] = z
    expected = step(MODELS["linear"](), None, full[:, None])[1]["x0"][[0, 1, 2, 6, 7]]
    batch = np.column_stack((t, z))
    for cut in range(6):
        state, first = step(timed(dt=1.0), None, batch[:cut])
        _, second = step(timed(dt=1.0), state, batch[cut:])
        np.testing.assert_array_equal(np.concatenate((first["x0"], second["x0"])), expected)


def test_in_a_gap_an_input_stays():
    y, u = signals(30)
    t = np.delete(np.arange(30.0), [10, 11])
    held, gone = u.copy(), y.copy()
    held[10:12], gone[10:12] = u[9], np.nan
    options = {"start": 0}
    expected = step(TrackerModel(ARX(2, 1), options), None, np.column_stack((gone, held)))[1]["b1"]
    batch = np.column_stack((t, np.delete(y, [10, 11]), np.delete(u, [10, 11])))
    model = TrackerModel(ARX(2, 1), options, time="t", dt=1.0)
    state, first = step(model, None, batch[:10])
    _, second = step(model, state, batch[10:])
    np.testing.assert_array_equal(np.concatenate((first["b1"], second["b1"])), np.delete(expected, [10, 11]))


def test_late_samples_and_duplicates_are_refused_or_dropped():
    batch = np.column_stack(([1.0, 2.0, 2.0, 1.5, 3.0], [0.1, 0.2, 9.0, 9.0, 0.3]))
    with pytest.raises(ValueError, match="at 2, got 2 in row 2, which is a duplicate"):
        step(timed(), None, batch)
    with pytest.raises(ValueError, match=r"got 1.5 in row 2, which is late"):
        step(timed(), None, np.delete(batch, 2, axis=0))
    # As many dropped as are missing.
    both = np.column_stack(([1.0, 1.0, 3.0], [0.1, 9.0, 0.3]))
    same(step(timed(late="drop", dt=1.0), None, both)[1], step(timed(dt=1.0), None, both[[0, 2]])[1])
    for dt in (None, 1.0):
        state, output = step(timed(late="drop", dt=dt), None, batch)
        same(output, step(timed(late="drop"), None, batch[[0, 1, 4]])[1])
        with pytest.raises(ValueError, match="at 3, got 3 in row 0"):
            step(timed(), state, batch[4:])
        again, output = step(timed(late="drop"), state, batch)
        same(again, state)
        assert len(output["x0"]) == 0
    frame = pd.DataFrame(batch, columns=["t", "z"])
    _, output = step(timed(late="drop", measurements=["z"]), None, frame)
    assert output.index.tolist() == [0, 1, 4]


def test_times_off_the_grid_and_long_silences_are_refused():
    with pytest.raises(ValueError, match=r"got 1.5 of it before row 1"):
        step(timed(dt=2.0), None, [[0.0, 1.0], [3.0, 1.0]])
    with pytest.raises(ValueError, match="at most 100000 steps"):
        step(timed(dt=1.0), None, [[0.0, 1.0], [1e6, 1.0]])
    with pytest.raises(ValueError, match="none in row 1"):
        step(timed(), None, [[0.0, 1.0], [np.nan, 1.0]])


# What is refused.


@pytest.mark.parametrize(
    ("batch", "message"),
    [
        (np.zeros((3, 2)), "expected shape"),
        (np.zeros((2, 2, 1)), "expected shape"),
        ([["a"]], "real numbers"),
        ([[np.inf]], "infinity in row 0"),
        (pd.DataFrame({"z": [1.0], "y": [2.0]}), "measurements: expected 1 column"),
        (pd.DataFrame({"z": ["a"]}), "z: expected real numbers"),
    ],
)
def test_a_batch_that_does_not_fit_is_named(batch, message):
    with pytest.raises((ValueError, TypeError), match=message):
        step(MODELS["linear"](), None, batch)


def test_a_state_of_another_model_is_refused_by_name():
    state, _ = step(MODELS["two-sided"](), None, [[1.0]])
    with pytest.raises(ValueError, match="expected one of a RobustKalmanFilter, got one of a TwoSidedKalmanFilter"):
        step(MODELS["linear"](), state, [[1.0]])
    with pytest.raises(ValueError, match="ARX"):
        step(MODELS["ARX"](), state, [[1.0, 1.0]])
    with pytest.raises(ValueError, match="P"):
        step(MODELS["linear"](), {"x": np.zeros(2)}, [[1.0]])


def test_a_model_that_does_not_fit_together_is_refused():
    from filterpy.kalman import KalmanFilter

    kf = RobustKalmanFilter(2, 1)
    kf.R = -np.eye(1)
    with pytest.raises(ValueError, match="R"):
        FilterModel(kf)
    with pytest.raises(TypeError, match=r"robust_filterpy\.robust"):
        FilterModel(KalmanFilter(2, 1))
    FilterModel(robust(KalmanFilter(2, 1)))
    with pytest.raises(TypeError, match="HJacobian"):
        FilterModel(extended())
    with pytest.raises(ValueError, match="time"):
        FilterModel(FILTERS["linear"](), dt=1.0)
    with pytest.raises(TypeError, match=r"use \['z'\]"):
        FilterModel(FILTERS["linear"](), measurements="z")
    with pytest.raises(TypeError, match="class of a filter"):
        TrackerModel(ARX(1, 1), {"filter": TwoSidedKalmanFilter(2, 1)})
    with pytest.raises(TypeError, match="model: expected"):
        step(kf, None, [[1.0]])


# Tables of many keys.


def fleet(keys=40, seed=2):
    """Keys with different numbers of samples, shuffled among each other, each in order."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 12, keys)
    device = rng.permutation(np.repeat(np.arange(keys), lengths))
    table = pd.DataFrame({"device": [f"d{i}" for i in device], "z": rng.normal(size=len(device))})
    table.loc[rng.random(len(table)) < 0.1, "z"] = 40.0
    table["u"] = rng.choice([-1.0, 1.0], len(table))
    table["t"] = table.groupby("device").cumcount().astype(float)
    return table


@pytest.mark.parametrize(
    "model",
    [
        FilterModel(FILTERS["linear"](), measurements=["z"]),
        FilterModel(FILTERS["two-sided"](), measurements=["z"]),
        TrackerModel(FIR(2), {"start": 0}, measurements=["z"], inputs=["u"]),
    ],
    ids=["linear", "two-sided", "FIR"],
)
def test_a_table_is_a_step_for_each_key(model):
    table = fleet()
    found = filter_table(table, model, time="t")
    assert found.index.equals(table.index) and found["error"].isna().all()
    assert list(found) == ["device", "t", *model.columns, "error"]
    for _, part in table.groupby("device"):
        _, expected = step(model.reading(time="t"), None, part)
        pd.testing.assert_frame_equal(found.loc[part.index, list(model.columns)], expected[list(model.columns)])
    half = len(table) // 2
    states, first = step_table(model, None, table[:half], time="t")
    before = copy.deepcopy(states)
    again, second = step_table(model, states, table[half:], time="t")
    pd.testing.assert_frame_equal(pd.concat([first, second]), found)
    for name in before:
        same(before[name], states[name])
    assert set(again) == set(table["device"])


def test_a_key_that_is_refused_loses_nobody_else():
    model = FilterModel(FILTERS["linear"](), measurements=["z"], dt=1.0, time="t")
    table = fleet().astype({"z": object})
    row = {name: table.index[table["device"] == name][-1] for name in ("d1", "d2", "d3", "d4")}
    table.loc[row["d1"], "z"] = "text"
    table.loc[row["d2"], "z"] = np.inf
    table.loc[row["d3"], "t"] += 0.5
    table.loc[row["d4"], "t"] = np.nan
    table.loc[len(table)] = [None, 1.0, 1.0, 0.0]
    states, found = step_table(model, {"d5": {"x": np.zeros(7)}}, table)
    bad = table["device"].isin(["d1", "d2", "d3", "d4", "d5"]) | table["device"].isna()
    assert found.loc[bad, "error"].notna().all() and found.loc[bad, "x0"].isna().all()
    assert found.loc[~bad, "error"].isna().all() and found.loc[~bad, "x0"].notna().all()
    for name in ("d1", "d2", "d3", "d4", "d5"):
        assert (found.loc[table["device"] == name, "error"].str.startswith(f"device {name!r}: ")).all()
        assert name not in states or name == "d5"
    good = fleet()
    good = good[good["device"].isin(set(states) - {"d5"})]
    pd.testing.assert_frame_equal(
        filter_table(good, model), found.loc[good.index].astype(filter_table(good, model).dtypes)
    )


def test_a_table_that_was_shuffled_can_be_sorted():
    model = FilterModel(FILTERS["linear"](), measurements=["z"], time="t")
    table = fleet()
    shuffled = table.sample(frac=1.0, random_state=1)
    found = filter_table(shuffled, model, sort=True)
    pd.testing.assert_frame_equal(found.sort_index(), filter_table(table, model))


def test_an_empty_table_and_missing_columns():
    model = FilterModel(FILTERS["linear"](), measurements=["z"], time="t")
    assert filter_table(fleet()[:0], model).shape == (0, 8)
    with pytest.raises(ValueError, match=r"\['device'\]"):
        filter_table(fleet().drop(columns="device"), model)
    with pytest.raises(ValueError, match="measurements"):
        filter_table(fleet(), model, measurements=["z", "u"])
    with pytest.raises(TypeError, match="model"):
        filter_table(fleet(), None)
