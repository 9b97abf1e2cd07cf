"""One pure step: the filter's and tracker's own numbers, however the samples are cut, and nothing is written into."""

import copy
import itertools
import pickle
from dataclasses import replace
from datetime import datetime, timedelta, timezone

import numpy as np
import pytest
from recordings import same, silence, unheard
from scipy.signal import lfilter
from support import of_matrices, predict_and_update, two_sided
from test_state import FILTERS, F, H, linear, recording, signals

from robust_filterpy import (
    ARX,
    OutputError,
    ParameterTracker,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    kernel,
    robust,
)
from robust_filterpy._state import StateError
from robust_filterpy.fleet import FilterModel, TrackerModel, filter_table, pack, step, unpack
from robust_filterpy.fleet.states import _ragged
from robust_filterpy.identification import ARMA, FIR

pd = pytest.importorskip("pandas")


def jacobian(x):
    return H


def observe(x):
    return H @ x


#: Its functions are passed to each update.
extended = linear(RobustExtendedKalmanFilter)


MODELS = {
    **{name: lambda name=name: FilterModel(FILTERS[name]()) for name in (
        "linear", "two-sided", "adaptive", "adaptive, joint", "psi, joint", "recovering", "unscented", "ensemble",
    )},
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
    assert list(whole) == [*model.columns, "error"]


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


def driven():
    kf = of_matrices(RobustKalmanFilter, F, H, 0.01, x=np.zeros((2, 1)), dim_u=2)
    kf.B = np.array([[0.5, 0.1], [0.0, 1.0]])
    return kf


# Forms of a batch.


def test_array_frame_and_arrow_table_are_the_same_batch():
    pa = pytest.importorskip("pyarrow")
    y, u = signals()
    t = np.arange(len(y)) * 0.5
    model = TrackerModel(ARX(2, 1), {"start": 0}, time="t", measurements=["y"], inputs=["u"])
    state, expected = step(model, None, np.column_stack((t, y, u)))
    frame = pd.DataFrame({"u": u, "other": "text", "y": y, "t": t}, index=np.arange(100, 100 + len(y)))
    frames_state, table = step(model, None, frame)
    assert table.index.equals(frame.index) and list(table) == ["t", *model.columns, "error"]
    arrows_state, arrow = step(model, None, pa.Table.from_pandas(frame))
    for one in (frames_state, arrows_state):
        same(one, state)
    for name in model.columns:
        np.testing.assert_array_equal(table[name], expected[name])
        np.testing.assert_array_equal(arrow.column(name).to_numpy(), expected[name])
    batch_state, found = step(model, None, pa.RecordBatch.from_pandas(frame))
    same(batch_state, state)
    assert type(found) is pa.RecordBatch


# Times.


def timed(**options):
    return FilterModel(FILTERS["linear"](), time="t", **options)


@pytest.mark.parametrize("cut", [1, 9, 10, 11, 28])
def test_a_gap_is_missing_samples_wherever_the_batch_is_cut_and_an_input_stays(cut):
    y, u = signals(30)
    t = np.delete(np.arange(30.0), [10, 11])
    held, gone = u.copy(), y.copy()
    held[10:12], gone[10:12] = u[9], np.nan
    options = {"start": 0}
    expected = step(TrackerModel(ARX(2, 1), options), None, np.column_stack((gone, held)))[1]["b1"]
    batch = np.column_stack((t, np.delete(y, [10, 11]), np.delete(u, [10, 11])))
    model = TrackerModel(ARX(2, 1), options, time="t", dt=1.0)
    state, first = step(model, None, batch[:cut])
    _, second = step(model, state, batch[cut:])
    np.testing.assert_array_equal(np.concatenate((first["b1"], second["b1"])), np.delete(expected, [10, 11]))


def test_late_samples_and_duplicates_are_refused_or_dropped():
    batch = np.column_stack(([1.0, 2.0, 2.0, 1.5, 3.0], [0.1, 0.2, 9.0, 9.0, 0.3]))
    alone = step(timed(), None, batch[[0, 1, 4]])
    for dt in (None, 1.0):
        state, output = step(timed(late="drop", dt=dt), None, batch)
        same(output, alone[1])
        assert state["dropped"].tolist() == [2.0]
        state, output = step(timed(dt=dt), None, batch)
        same({name: value[[0, 1, 4]] for name, value in output.items()}, alone[1])
        assert np.isnan(output["x0"][2:4]).all()
        assert output["error"][2] == "time: expected a sample later than the one at 2, got 2, a duplicate"
        assert output["error"][3] == "time: expected a sample later than the one at 2, got 1.5, late"
        again, output = step(timed(dt=dt), state, batch)
        assert np.isnan(output["x0"]).all() and "dropped" not in again
        output = step(timed(dt=dt), again, [[4.0, 0.1], [5.0, 0.1]])[1]
        assert not any(output["error"])
        expected = step(timed(), None, np.vstack((batch[[0, 1, 4]], [[4.0, 0.1], [5.0, 0.1]])))[1]
        for name in ("x0", "std1", "weight0"):
            np.testing.assert_array_equal(output[name], expected[name][-2:])
    # As many dropped as are missing.
    both = np.column_stack(([1.0, 1.0, 3.0], [0.1, 9.0, 0.3]))
    same(step(timed(late="drop", dt=1.0), None, both)[1], step(timed(dt=1.0), None, both[[0, 2]])[1])
    frame = pd.DataFrame(batch, columns=["t", "z"])
    _, output = step(timed(late="drop", measurements=["z"]), None, frame)
    assert output.index.tolist() == [0, 1, 4]


def test_times_off_the_grid_and_long_silences_are_refused():
    _, output = step(timed(dt=2.0), None, [[0.0, 1.0], [3.0, 1.0], [4.0, 1.0]])
    assert "0.50 of it away" in output["error"][1] and output["error"][2] is None
    same({k: v[[0, 2]] for k, v in output.items()}, step(timed(dt=2.0), None, [[0.0, 1.0], [4.0, 1.0]])[1])
    _, output = step(timed(dt=1.0), None, [[0.0, 1.0], [1e6, 1.0], [1.0, 1.0]])
    assert "at most 100000 steps" in output["error"][1] and output["error"][2] is None
    assert step(timed(dt=1.0), None, [[0.0, 1.0], [1e5, 1.0]])[1]["error"].tolist() == [None, None]
    _, output = step(timed(), None, [[0.0, 1.0], [np.nan, 1.0]])
    assert "expected a time, got nan" in output["error"][1]


def test_a_grid_is_measured_from_its_beginning_and_follows_a_clock_that_drifts():
    n = 400
    rng = np.random.default_rng(3)

    def refused(t, dt=1.0):
        state, errors = None, []
        for part in np.split(np.column_stack((t, np.zeros(n))), [7, 8, 200]):
            state, output = step(timed(dt=dt), state, part)
            errors += output["error"].tolist()
        errors = [error if error is None or "away" in error else None for error in errors]
        whole, output = step(timed(dt=dt), None, np.column_stack((t, np.zeros(n))))
        assert output["error"].tolist() == errors
        same(state, whole)
        return sum(error is not None and "away" in error for error in errors), whole["grid"][1]

    # Within .2 of the grid, in whatever order, is on it; a clock that is off by half a percent is followed.
    assert refused(np.arange(n) + rng.choice([-0.2, 0.2], n)) == (0, n - 1)
    assert refused(1e9 + 1.005 * np.arange(n)) == (0, n - 1)
    assert refused(0.1005 * np.arange(n), 0.1) == (0, n - 1)
    # A period of 1.2 is not 1: each sample is taken where it was, or refused.
    for period in (1.2, 1.45, 2.5):
        lost, steps = refused(period * np.arange(n))
        assert abs(steps - period * (n - 1)) <= 3.0 and lost < 0.6 * n


def test_milliseconds_are_noticed():
    t = 1.7e12 + 1000.0 * np.arange(4)
    with pytest.warns(UserWarning, match="milliseconds"):
        step(timed(dt=1.0), None, np.column_stack((t, np.zeros(4))))
    with silence():
        step(timed(dt=1000.0), None, np.column_stack((t, np.zeros(4))))
        step(timed(dt=1.0), None, np.column_stack((1e-3 * t, np.zeros(4))))


def test_times_are_dates_with_a_time_zone_or_text_as_iso_has_it():
    zone = timezone(timedelta(hours=2))
    dates = [datetime(2026, 1, 1, 2, 0, k, tzinfo=zone) for k in range(3)]
    model = timed(dt=1.0, measurements=["z"])
    state, expected = step(model, None, [[date.timestamp(), 0.5] for date in dates])
    for times in (
        dates,
        [date.isoformat() for date in dates],
        ["2026-01-01T00:00:00Z", "2026-01-01T00:00:01Z", "2026-01-01T00:00:02Z"],
        np.array(["2026-01-01T00:00:00", "2026-01-01T00:00:01", "2026-01-01T00:00:02"], "M8[s]"),
        list(pd.to_datetime(dates, utc=True)),
    ):
        after, output = step(model, None, pd.DataFrame({"t": times, "z": 0.5}))
        same({name: output[name].to_numpy() for name in model.columns}, {n: expected[n] for n in model.columns})
        same(after, state)
    for naive in (datetime(2026, 1, 1), "2026-01-01T00:00:00"):
        assert "time zone" in step(model, None, [[naive, 0.5]])[1]["error"][0]
        assert "time zone" in step(model, None, pd.DataFrame({"t": [naive, 5], "z": 0.5}, dtype=object))[1]["error"][0]


# What is refused.


@pytest.mark.parametrize(("batch", "message"), [
    (np.zeros((3, 2)), "expected shape"),
    (np.zeros((2, 2, 1)), "expected shape"),
    (pd.DataFrame({"z": [1.0], "y": [2.0]}), "measurements: expected 1 column"),
])  # fmt: skip
def test_a_batch_that_does_not_fit_is_named(batch, message):
    with pytest.raises((ValueError, TypeError), match=message):
        step(MODELS["linear"](), None, batch)


def test_a_state_of_another_model_is_refused_by_name():
    state, _ = step(MODELS["two-sided"](), None, [[1.0]])
    with pytest.raises(ValueError, match="expected one of this model, got one of a model with other"):
        step(MODELS["linear"](), state, [[1.0]])
    with pytest.raises(ValueError, match="ARX"):
        step(MODELS["ARX"](), state, [[1.0, 1.0]])
    with pytest.raises(ValueError, match="P"):
        step(MODELS["linear"](), {"x": np.zeros(2)}, [[1.0]])


def test_a_state_of_other_matrices_is_refused_unless_asked_for():
    state, _ = step(MODELS["linear"](), None, [[1.0]])
    step(MODELS["linear"](), unpack(pack(state)), [[1.0]])
    for name, value in (("Q", 0.02 * np.eye(2)), ("F", np.eye(2)), ("R", 2.0 * np.eye(1))):
        kf = FILTERS["linear"]()
        setattr(kf, name, value)
        other = FilterModel(kf)
        with pytest.raises(ValueError, match="other matrices, choices or sampling period"):
            step(other, state, [[1.0]])
        adopted, _ = step(other, other.adopt(state), [[1.0]])
        kf.restore({name: state[name] for name in ("x", "P")})
        predict_and_update(kf, 1.0)
        np.testing.assert_allclose(adopted["x"], kf.x, rtol=1e-12)
        states, output = step(other, {"a": state}, pd.DataFrame({"device": ["a", "b"], "z": 1.0}), key="device")
        assert "other matrices" in output["error"][0] and states["a"]["x"] is not None
        np.testing.assert_array_equal(output["x0"][1:], step(other, None, [[1.0]])[1]["x0"])
    for one, other in ((MODELS["ARX"](), TrackerModel(ARX(2, 1), {"start": 0, "R": 2.0})),
                       (MODELS["linear"](), FilterModel(FILTERS["linear"](), time="t", dt=1.0))):  # fmt: skip
        assert one.fingerprint == pickle.loads(pickle.dumps(one)).fingerprint != other.fingerprint


DAMAGES = {
    **{name: {"P": P} for name, P in {
        "a number for P": np.array(3.0), "a vector for P": np.ones(2), "text in P": np.array([["a", "b"], ["c", "d"]]),
        "complex P": np.eye(2) + 1j, "a negative variance": np.diag([1e12, -1e3]),
        "an indefinite P": np.array([[1.0, 2.0], [2.0, 1.0]]), "an asymmetric P": np.array([[1.0, 0.5], [0.2, 1.0]]),
        "NaN in P": np.full((2, 2), np.nan),
    }.items()},
    "infinite x": {"x": np.array([0.0, np.inf])}, "a long x": {"x": np.zeros(3)}, "text for x": {"x": "ab"},
    "objects in x": {"x": np.array([None, {}], dtype=object)}, "text for the time": {"time": "now"},
    "two times": {"time": np.zeros(2)}, "no label": {"format": np.zeros(0)},
    "a label of another": {"format": np.r_[1.0, 65.0]},
}  # fmt: skip


@pytest.mark.parametrize("damage", DAMAGES)
@pytest.mark.parametrize("name", ["linear", "extended"])
def test_a_damaged_state_is_refused_on_every_path_by_one_error(damage, name):
    model = MODELS[name]()
    state, _ = step(model, None, [[1.0]])
    spoilt = {**state, **DAMAGES[damage]}
    with pytest.raises(StateError, match="state: "):
        step(model, spoilt, [[1.0]])
    if "time" not in damage:
        with pytest.raises(StateError, match="state: "):
            model.template().restore(spoilt)
    table = pd.DataFrame({"device": ["a", "b"], "z": 1.0})
    states, output = step(model, {"a": spoilt, "b": state}, table, key="device")
    assert output["error"][0].startswith("device 'a': state: ")
    # np.asarray: a state with an object in it compares as an array of them.
    assert all(np.asarray(states["a"][key] == spoilt[key], dtype=object).all() or value is not None
               for key, value in spoilt.items())  # fmt: skip
    np.testing.assert_array_equal(output["x0"][1:], step(model, state, [[1.0]])[1]["x0"])


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
        TrackerModel(ARX(1, 1), {"filter": two_sided(2, 1)})
    with pytest.raises(TypeError, match="model: expected"):
        step(kf, None, [[1.0]])


# Tables of many keys.


def fleet(keys=40, seed=2):
    """Keys with different numbers of samples, shuffled among each other, each in order."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 12, keys)
    device = rng.permutation(np.repeat(np.arange(keys), lengths))
    table = pd.DataFrame({"device": [f"d{i}" for i in device], "z": rng.normal(size=len(device))})
    # Not one number again and again, which would be a fill value.
    table.loc[rng.random(len(table)) < 0.1, "z"] += 40.0
    table["u"] = rng.choice([-1.0, 1.0], len(table))
    table["t"] = table.groupby("device").cumcount().astype(float)
    return table


@pytest.mark.parametrize("name", ["linear", "two-sided", "FIR"])
def test_a_table_is_a_step_for_each_key_and_its_states_go_on_from_arrow_too(name):
    own = {"measurements": ["z"], "time": "t"}
    model, table = TrackerModel(FIR(2), {"start": 0}, inputs=["u"], **own), fleet()
    model = model if name == "FIR" else FilterModel(FILTERS[name](), **own)
    found = filter_table(model, table)
    assert found.index.equals(table.index) and found["error"].isna().all()
    assert list(found) == ["device", "t", *model.columns, "error"]
    for _, part in table.groupby("device"):
        _, expected = step(model, None, part)
        pd.testing.assert_frame_equal(found.loc[part.index, list(model.columns)], expected[list(model.columns)])
    half = len(table) // 2
    states, first = step(model, None, table[:half], key="device")
    before = copy.deepcopy(states)
    for given in (states, states.to_arrow()):
        again, second = step(model, given, table[half:], key="device")
        pd.testing.assert_frame_equal(pd.concat([first, second]), found)
        assert set(again) == set(table["device"])
    for key in before:
        same(before[key], states[key])


def test_a_table_may_be_shuffled_and_have_rows_without_a_time():
    model = FilterModel(FILTERS["linear"](), measurements=["z"], time="t")
    table = fleet()
    shuffled = table.sample(frac=1.0, random_state=1)
    found = filter_table(model, shuffled)
    pd.testing.assert_frame_equal(found.sort_index(), filter_table(model, table))
    # Between 5 and 3 stands a row of no time: the order is looked at across it.
    gap = pd.DataFrame({"device": "a", "t": [5.0, np.nan, 3.0], "z": [0.1, 0.2, 0.3]})
    assert filter_table(model, gap)["error"].isna().tolist() == [True, False, True]


@pytest.mark.parametrize("zone", [None, "Europe/Berlin"])
def test_an_error_names_instants_as_instants(zone):
    model = FilterModel(FILTERS["linear"](), measurements=["z"], time="t")
    when = pd.to_datetime(["2024-03-01 10:00:00.0", "2024-03-01 09:59:59.5"]).tz_localize("UTC").tz_convert(zone)
    table = pd.DataFrame({"device": "a", "t": when, "z": [0.1, 0.2]})
    said = "later than the one at 2024-03-01T10:00:00Z, got 2024-03-01T09:59:59.500000Z, late"
    assert said in filter_table(model, table, sort=False)["error"][1]
    texts = table.assign(t=[f"{one}" if zone else f"{one}Z" for one in when])
    assert said in filter_table(model, texts, sort=False)["error"][1]


def test_states_of_devices_that_are_gone_can_be_left_out():
    """And what goes on from the others is the same; an instant tells the time as its seconds do."""
    described = timed(measurements=["z"])
    when = pd.to_datetime([0, 1, 2, 5], unit="s", utc=True)
    table = pd.DataFrame({"device": ["a", "b", "a", "c"], "t": when, "z": [0.1, 0.2, 0.3, 0.4]})
    states, _ = step(described, None, table, key="device")
    for since in (when[2], when[2].to_datetime64(), when[2].to_pydatetime(), 2.0):
        assert list(states.newer(since)) == ["a", "c"] and list(states) == ["a", "b", "c"]
    kept, later = states.newer(2.0), table.assign(t=when + pd.Timedelta(seconds=10))
    one, other = (step(described, before, later, key="device")[1].set_index("device") for before in (kept, states))
    pd.testing.assert_frame_equal(one.loc[["a", "c"]], other.loc[["a", "c"]], check_exact=True)
    assert not one.loc["b"].equals(other.loc["b"]) and list(states.newer(6.0)) == []
    # Of keys without times all stay.
    untimed = FilterModel(FILTERS["linear"](), measurements=["z"])
    assert len(step(untimed, None, table, key="device")[0].newer(1e9)) == 3
    for wrong in ("yesterday", when[2].tz_localize(None).to_pydatetime(), None):
        with pytest.raises(ValueError, match="time: expected a time"):
            states.newer(wrong)


def test_an_empty_table_and_missing_columns():
    model = FilterModel(FILTERS["linear"](), measurements=["z"], time="t")
    assert filter_table(model, fleet()[:0]).shape == (0, 8)
    with pytest.raises(ValueError, match=r"\['device'\]"):
        filter_table(model, fleet().drop(columns="device"))
    with pytest.raises(ValueError, match="measurements"):
        filter_table(replace(model, measurements=None), fleet())
    with pytest.raises(TypeError, match="model"):
        filter_table(None, fleet())


def test_states_of_a_fleet_print_on_a_line_and_a_missing_column_says_who_names_it():
    table = pd.DataFrame({"tank": [f"T{i}" for i in range(9)], "z": np.zeros(9)})
    states, _ = step(FilterModel(RobustKalmanFilter(1, 1)), None, table, key="tank")
    assert repr(states) == "States(9 keys: T0, T1, T2, ..)"
    with pytest.raises(ValueError, match=r"got .'tank', 'z'.; key= names that of the device"):
        step(FilterModel(RobustKalmanFilter(1, 1)), None, table, key="device")


def test_a_column_of_lists_is_read_row_by_row_whatever_their_lengths():
    pa = pytest.importorskip("pyarrow")
    lists = pa.array([[1.0, 2.0, 3.0, 4.0], [], [5.0, None], None], pa.list_(pa.float64()))
    rows = [[1.0, 2.0], [3.0, 4.0]], np.zeros((0, 2)), [[5.0, np.nan]], np.zeros((0, 2))
    same(_ragged(lists, [2]), rows)
    # Four numbers are two rows of two, but not as three and one.
    with pytest.raises(ValueError, match="reshape"):
        _ragged(pa.array([[1.0, 2.0, 3.0], [4.0]], pa.list_(pa.float64())), [2])


def test_a_key_whose_covariance_is_lost_in_rounding_stops_alone():
    # Exact sensors of a state at rest: P is rounding, and the step after an absurd reading is for the definition.
    rng = np.random.default_rng(0)
    F, H, R = [[1.0, 0.5], [0.0, 1.0]], [[1.0, 0.0], [1.0, 1e-9]], np.diag([1e-3, 0.0])
    kf = of_matrices(RobustKalmanFilter, F, H, 0.0, R, 1e-3, scaling="innovation")
    z = rng.normal(size=(60, 2))
    z[rng.random((60, 2)) < 0.05] = 1e290
    a, b = z.repeat(2, axis=0).T
    table = pd.DataFrame({"device": ["lost", "other"] * 60, "a": a, "b": b})
    table.loc[table.device == "other", ["a", "b"]] = np.nan
    _, output = step(FilterModel(kf, measurements=["a", "b"]), None, table, key="device")
    lost, other = (output[output.device == device] for device in ("lost", "other"))
    assert other.x0.notna().all() and other.error.isna().all()
    assert lost.x0.iloc[:5].notna().all() and lost.x0.iloc[-1:].isna().all()
    assert "state: P: expected a positive semidefinite matrix" in lost.error.iloc[-1]


@pytest.mark.parametrize("options", [{"start": 0}, {"start": 0, "regressor": "cleaned", "offset": True}, {"start": 80}])
def test_keys_of_trackers_go_together_and_are_the_trackers(options, monkeypatch):
    rng, keys = np.random.default_rng(8), list("abcde")
    u = rng.choice([-1.0, 1.0], (5, 150))
    y = lfilter([0.0, 1.0, 0.5], [1.0, -0.6], u, axis=1) + 0.1 * rng.normal(size=u.shape)
    y[0, 140:], y[rng.random(y.shape) < 0.05] = 1e12, np.nan
    model, states, calls = TrackerModel(ARX(1, 2), options, measurements=["y"], inputs=["u"]), None, []
    alone = ParameterTracker.advance
    monkeypatch.setattr(ParameterTracker, "advance", lambda *given: calls.append(0) or alone(*given))
    cuts = [0, 1, 40, 41, 42, 90, 91, 120, 150]
    with unheard():
        for first, stop in itertools.pairwise(cuts):
            part = {"key": np.repeat(keys, stop - first), "y": y[:, first:stop].ravel(), "u": u[:, first:stop].ravel()}
            states, found = step(model, states, pd.DataFrame(part), key="key")
        assert kernel.extension() is None or not calls
        for i, key in enumerate(keys):
            tracker = ParameterTracker(ARX(1, 2), **options)
            result = tracker.advance(y[i], u[i][:, None], None)
            np.testing.assert_array_equal(found[found.key == key].prediction, result[120:, -4])
            for name, value in tracker.state().items():
                if name in states[key] and name != "format":
                    np.testing.assert_array_equal(states[key][name], value, err_msg=name)


@pytest.mark.parametrize("name", ["kind", "P"])
def test_an_arrow_table_of_states_that_lacks_a_column_is_refused_by_its_name(name):
    pytest.importorskip("pyarrow")
    model, table = MODELS["linear"](), pd.DataFrame({"device": ["a", "b"], "z": [0.1, 0.2]})
    states = step(model, None, table, key="device")[0].to_arrow()
    step(model, states, table, key="device")
    with pytest.raises(StateError, match=rf"states: expected the columns \['{name}'\] of a RobustKalmanFilter"):
        step(model, states.drop([name]), table, key="device")


def test_a_flat_batch_is_a_column_and_inputs_may_be_absent():
    model, z = MODELS["linear"](), [0.1, -20.0, 0.3]
    for flat, column in zip(step(model, None, z), step(model, None, [[one] for one in z]), strict=True):
        same(flat, column)
    inputs = np.random.default_rng(1).normal(size=(3, 2))
    for u in (inputs, None):
        kf = driven()
        state, output = step(FilterModel(driven()), None, z if u is None else np.column_stack((z, u)))
        for k, one in enumerate(z):
            kf.predict(**({} if u is None else {"u": u[k]}))
            kf.update(one)
            expected = [*kf.x[:, 0], *np.sqrt(kf.P.diagonal()), kf.weights.item()]
            found = [output[name][k] for name in ("x0", "x1", "std0", "std1", "weight0")]
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(state["x"], kf.x, rtol=1e-9)
    same(step(FilterModel(driven()), None, pd.DataFrame({"z": z}))[0], state)
    for width in (2, 4):
        with pytest.raises(ValueError, match=r"expected shape \(samples, 1 or 3\), 1 measurement\(s\), 2 input\(s\)"):
            step(FilterModel(kf), None, np.zeros((3, width)))


def test_samples_for_which_a_sensors_function_has_no_answer_are_as_if_missing():
    kf = RobustExtendedKalmanFilter(1, 1)
    functions = {"HJacobian": lambda x: np.eye(1), "Hx": lambda x: np.where(x[:1] > 5.0, np.nan, x[:1])}
    output = step(FilterModel(kf, update=functions), None, np.arange(9.0)[:, None])[1]
    assert np.isfinite(output["x0"]).all() and np.isnan(output["weight0"][-1])
    assert "Hx: expected finite numbers" in output["error"][-1] and "as if it were missing" in output["error"][-1]
