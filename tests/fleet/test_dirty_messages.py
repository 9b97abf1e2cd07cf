"""Whatever messages come, in whatever order, at every entry: nothing raises, and the clean devices do not notice."""

import datetime
import decimal
import json
import math

import numpy as np
import pytest
from hostile import OTHERS
from recordings import same, silence
from support import of_matrices
from test_engines import Store
from test_state import FILTERS

from robust_filterpy import ARX, RobustKalmanFilter
from robust_filterpy.fleet import FilterModel, TrackerModel, filter_table, step, unpack
from robust_filterpy.fleet.stream import StreamStep

pd = pytest.importorskip("pandas")

MODELS = {
    "filter": FilterModel(FILTERS["linear"](), time="t", measurements=["z"]),
    "grid": FilterModel(FILTERS["linear"](), time="t", measurements=["z"], dt=1.0),
    "refusing": FilterModel(FILTERS["two-sided"](), time="t", measurements=["z"], dt=1.0, late="refuse"),
    "tracker": TrackerModel(ARX(2, 1), {"start": 0}, time="t", measurements=["z"], inputs=["u"]),
}
CLEAN, DIRTY = ("c0", "c1", "c2"), ("d0", "d1", "d2")


class Odd:
    """An object that is like nothing else, and has no repr."""

    def __repr__(self):
        raise RuntimeError("no repr")


# An entry is one of these, or has one in it; a message is a choice of entries, or no mapping at all.
STRANGE = (
    *OTHERS, Odd(), decimal.Decimal("1.5"), decimal.Decimal("sNaN"), datetime.datetime(2026, 1, 1), np.inf, -np.inf,
    datetime.datetime(1, 1, 1, tzinfo=datetime.timezone(datetime.timedelta(hours=23))), datetime.date(2026, 1, 1),
    datetime.timedelta(seconds=1), np.datetime64("NaT"), np.datetime64("2026-01-01"), pd.NaT, pd.NA, np.ma.masked,
    -1e308, 5e-324, -0.0, "", "nan", "1e5", "\x00", "ü", "2026-01-01", "2026-01-01T00:00:00Z",
)  # fmt: skip
DEEP = (lambda it: [it], lambda it: (it, it), lambda it: {"z": it}, lambda it: np.array([it, 1.0], dtype=object))


def entry(rng):
    """Draw an entry."""
    thing = STRANGE[rng.integers(len(STRANGE))] if rng.random() < 0.7 else float(rng.normal())
    return DEEP[rng.integers(len(DEEP))](thing) if rng.random() < 0.2 else thing


def clean(rng, k):
    """Draw a sound message."""
    return {"t": float(k), "z": rng.normal() * (20.0 if rng.random() < 0.1 else 1.0), "u": rng.choice([-1.0, 1.0])}


def dirty(rng, k, like):
    """Draw a message of a device that sends anything."""
    kind = rng.random()
    if kind < 0.1:
        return entry(rng)
    message = clean(rng, k)
    if kind < 0.25:
        # Redelivered, late, or from another time.
        message["t"] = float(k + rng.choice([-1e9, -3, -1, -0.5, 0.0, 0.5, 3, 1e3, 1e12]))
        return message
    for name in list(message):
        if rng.random() < 0.4:
            message[name] = entry(rng)
        elif rng.random() < 0.1:
            del message[name]
    return message


def recording(rng, rounds):
    """Draw (device, message) in the order of arrival, and how many of them are dirty."""
    found = []
    for k in range(rounds):
        now = [(name, clean(rng, k)) for name in CLEAN]
        now += [(name, dirty(rng, k, now[0][1]) if rng.random() < 0.7 else clean(rng, k)) for name in DIRTY]
        found += [now[i] for i in rng.permutation(len(now))]
    return found


def through_streams(model, messages):
    """Return the answers of a stream by device, with its states in bytes."""
    stores, answers, taken = {}, {}, StreamStep(model)
    for key, message in messages:
        answers.setdefault(key, []).append(taken(message, stores.setdefault(key, Store())))
    return answers, {key: store.get("robust_filterpy") for key, store in stores.items()}


def table_of(messages):
    """Return messages as a table of objects; one that is no mapping is a row without anything."""
    mappings = [(key, message if isinstance(message, dict) else {}) for key, message in messages]
    columns = {name: np.full(len(mappings), None, dtype=object) for name in ("device", "t", "z", "u")}
    for row, (key, message) in enumerate(mappings):
        columns["device"][row] = key
        for name in ("t", "z", "u"):
            columns[name][row] = message.get(name)
    return pd.DataFrame(columns)


def columns_of(model, messages, key):
    """Return the names of the columns, and the clean numbers of a device by one step."""
    rows = [[message[name] for name in ("t", "z", *(model.inputs or ()))] for own, message in messages if own == key]
    return step(model, None, np.array(rows))


def equal(one, other):
    np.testing.assert_array_equal(np.asarray(one, dtype=float), np.asarray(other, dtype=float))


@pytest.mark.filterwarnings("ignore:time. gaps of a thousand")
@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize(
    "rounds", [pytest.param(40, id="some"), pytest.param(4800, id="ten thousand", marks=pytest.mark.slow)]
)
def test_whatever_comes_nothing_raises_and_clean_devices_do_not_notice(name, rounds):
    model, rng = MODELS[name], np.random.default_rng(29)
    messages = recording(rng, rounds)
    expected = {key: columns_of(model, messages, key) for key in CLEAN}
    answers, stored = through_streams(model, messages)
    for key, (state, output) in expected.items():
        for column in model.columns:
            equal([math.nan if one[column] is None else one[column] for one in answers[key]], output[column])
        assert all(one["error"] is None and one["dropped"] == 0 for one in answers[key])
        assert unpack(stored[key]).keys() == state.keys()
        for entry_name, value in state.items():
            equal(unpack(stored[key])[entry_name], value)
    for key in DIRTY:
        # Each answer says what was wrong, or is a number; states stay sound, whatever came.
        for one in answers[key]:
            assert one is None or one["error"] or one[model.columns[0]] is not None
            json.dumps({column: one[column] for column in (*model.columns, "error", "dropped")} if one else None)
        if stored[key] is not None:
            step(model, unpack(stored[key]), np.zeros((0, 3 if model.inputs else 2)))
    # The same as a table, in one batch and in many, and as batches of single devices.
    table = table_of(messages)
    whole_states, whole = step(model, None, table, key="device")
    states, parts = None, []
    for part in np.array_split(np.arange(len(table)), 7):
        states, found = step(model, states, table.iloc[part], key="device")
        parts.append(found)
    for found in (whole, pd.concat(parts), filter_table(model, table, sort=False)):
        for key, (_, output) in expected.items():
            mine = found[found["device"] == key]
            assert mine["error"].isna().all()
            for column in model.columns:
                equal(mine[column], output[column])
        other = found[found["device"].isin(DIRTY)]
        assert (other["error"].notna() | other[model.columns[0]].notna()).all()
    for key in set(whole_states) & set(states):
        for entry_name, value in whole_states[key].items():
            equal(states[key][entry_name], value)
    for key in DIRTY:
        rows = [
            [message.get(n) if isinstance(message, dict) else None for n in ("t", "z", *(model.inputs or ()))]
            for own, message in messages if own == key
        ]  # fmt: skip
        state, output = step(model, None, rows)
        mine = whole[whole["device"] == key]
        for column in model.columns:
            equal(output[column], mine[column])


def test_a_shuffled_table_a_column_of_text_and_a_path_are_said():
    table = pd.DataFrame({"device": "a", "t": np.arange(50.0)[::-1], "z": 1.0})
    with pytest.warns(UserWarning, match=r"49 of 50 rows .* late; sort=True puts"):
        filter_table(MODELS["filter"], table, sort=False)
    with pytest.warns(UserWarning, match="50 of 50 rows .* z: expected a finite number .* got '1.0'$"):
        filter_table(MODELS["filter"], table.assign(t=np.arange(50.0), z="1.0"))
    with pytest.raises(TypeError, match=r"table: expected .* got str; pandas.read_parquet"):
        filter_table(MODELS["filter"], "day.parquet")
    with pytest.raises(ValueError, match="measurements: expected 1 column"):
        FilterModel(FILTERS["linear"](), measurements=["z", "w"])


# A device's clock that is wrong once, or is set: it costs a few rows, never the device, and is said.


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
