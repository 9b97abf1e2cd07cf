"""Recordings on a time axis: results come back on the same one, and an axis that does not fit is refused."""

import copy
import pickle

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from recordings import recording, silence, unchanged

from robust_filterpy import ARX, OutputError, ParameterTracker, identify
from robust_filterpy.identification import FIR, LinearRegression, TrackerBank, compare, select_structure, validate

pd = pytest.importorskip("pandas")

N = 600


def table(index=None):
    """A first-order plant with a gap and outliers."""
    y, u = recording(1, N, share=0.05, sigma=0.1, a=[1.0, -0.8], b=[0.0, 2.0])
    y[100:110] = np.nan
    dates = pd.date_range("2024-03-01", periods=N, freq="10s", name="when")
    return pd.DataFrame({"y": 5.0 + y, "u": u}, index=dates if index is None else index)


@pytest.fixture(scope="module")
def model():
    df = table()
    return identify(df.y, df.u, OutputError(1, 1))


def test_a_series_gives_the_model_of_its_numbers_and_its_period(model):
    df = table()
    plain = identify(df.y.to_numpy(), df.u.to_numpy(), OutputError(1, 1))
    assert_array_equal(model.theta, plain.theta)
    assert (model.dt, plain.dt) == (pytest.approx(10.0), None)
    assert model.transfer_function().dt == 10.0 and plain.transfer_function().dt is True
    assert model.transfer_function(dt=0.5).dt == 0.5


def test_signals_of_a_model_come_back_on_the_index(model):
    df = table()
    for call in (model.predict, model.residuals, model.free_run):
        found = call(df.y, df.u)
        assert found.index.equals(df.index)
        assert_array_equal(found.to_numpy(), call(df.y.to_numpy(), df.u.to_numpy()))


def test_simulation_fit_validation_and_comparison_take_a_table(model):
    df = table()
    assert model.simulate(df.u).index.equals(df.index)
    assert model.fit(df.y, df.u) == model.fit(df.y.to_numpy(), df.u.to_numpy())
    found, plain = (validate(model, *pair) for pair in ((df.y, df.u), (df.y.to_numpy(), df.u.to_numpy())))
    assert found.verdict == plain.verdict
    frame = found.to_frame()
    assert frame.index.name == "lag" and np.isnan(frame.autocorrelation[0])
    assert_array_equal(frame.autocorrelation[1:], plain.autocorrelation)
    ranked = compare({"one": model}, df.y, df.u)
    assert ranked.index.equals(df.index)
    assert ranked.to_frame().loc["one", "fit"] == ranked.rows[0].fit
    assert_array_equal(ranked.outputs["one"], model.free_run(df.y.to_numpy(), df.u.to_numpy()))


def test_selection_takes_a_table_and_gives_one():
    df = table()[:300]
    found = select_structure(df.y, df[["u"]], na=[1], nk=[1, 2])
    assert found.best.dt == pytest.approx(10.0)
    frame = found.to_frame()
    assert frame.index[0] == str(found.rows[0].structure) and frame.above_best.iloc[0] == 0.0
    assert list(frame.criterion) == [row.criterion for row in found.rows]


def test_a_run_comes_back_on_the_index_with_the_names_of_the_parameters():
    df = table()
    tracker = ParameterTracker(OutputError(1, 1), Q=1e-6)
    result = tracker.run(df.y, df.u)
    frame = result.to_frame()
    assert frame.index.equals(df.index)
    assert list(frame) == ["a1", "b1", "a1_std", "b1_std", "prediction", "residual", "weight", "guard"]
    assert_array_equal(frame[["a1", "b1"]].to_numpy(), result.theta)
    assert tracker.dt == 10.0 and tracker.transfer_function().dt == 10.0
    counted = ParameterTracker(OutputError(1, 1), Q=1e-6).run(df.y.to_numpy(), df.u.to_numpy()).to_frame()
    assert len(result) == 6 and counted.index.name == "sample" and list(counted.index[:2]) == [0, 1]
    for same in (pickle.loads(pickle.dumps(result)), copy.deepcopy(result)):
        assert same.names == ("a1", "b1") and same.index.equals(df.index)


def test_a_bank_comes_back_with_the_names_of_the_actuators():
    df = table()
    both = pd.DataFrame({"left": df.y, "right": 2.0 * df.y})
    bank = TrackerBank(2, ARX(1, 1), start=0, R=0.01)
    result = bank.run(both, df.u)
    frame = result.to_frame()
    assert frame.index.equals(df.index)
    assert_array_equal(frame["right"]["b1"].to_numpy(), result.theta[:, 1, 1])
    assert result.tracker(0).to_frame()["a1"].iloc[-1] == result.theta[-1, 0, 0]


CALLS = {
    "identify": lambda model, y, u: identify(y, u, OutputError(1, 1)),
    "validate": lambda model, y, u: validate(model, y, u),
    "compare": lambda model, y, u: compare({"one": model}, y, u),
    "select_structure": lambda model, y, u: select_structure(y, u),
    "predict": lambda model, y, u: model.predict(y, u),
    "residuals": lambda model, y, u: model.residuals(y, u),
    "fit": lambda model, y, u: model.fit(y, u),
    "run": lambda model, y, u: ParameterTracker(model).run(y, u),
    "bank": lambda model, y, u: TrackerBank(1, ARX(1, 1), start=0).run(y.to_frame(), u),
}
OF_ANY_RATE = ("identify", "select_structure", "bank")


@pytest.mark.parametrize("name", CALLS)
def test_an_axis_that_does_not_fit_is_refused(model, name):
    df = table()
    gone, quick = df.drop(df.index[77]), df.set_index(pd.date_range("2024-03-01", periods=N, freq="5s"))
    cases = [
        (df.y, df.u.shift(freq="1s"), r"u: expected the index of y, 2024-03-01 00:00:00 in sample 0, got .*00:00:01"),
        (df.y, df.u[1:], r"u: expected the index of y, 600 samples, got 599"),
        (gone.y, gone.u, r"y: .*steps of 10 s, got a step of 20 s from .*00:12:40 to .*00:13:00.*resample\(\"10s\"\)"),
        (df.y[::-1], df.u[::-1], r"y: .*got a step of -10 s.*sort_index"),
    ]
    if name not in OF_ANY_RATE:
        cases += [
            (df.y[::2], df.u[::2], r"expected a sample every 10 s.* got one every 20 s; identify one at"),
            (quick.y, quick.u, r"expected a sample every 10 s.* got one every 5 s; resample.*10s"),
        ]
    for y, u, match in cases:
        with pytest.raises(ValueError, match=match):
            CALLS[name](model, y, u)


@pytest.mark.parametrize(("index", "dt"), [
    (pd.RangeIndex(N), None),
    (np.arange(N) * 0.1, None),
    (pd.timedelta_range("0s", periods=N, freq="250ms"), 0.25),
    (pd.period_range("2024-01", periods=N, freq="M"), None),
    (pd.date_range("1950-01-01", periods=N, freq="MS"), None),
    (pd.date_range("2024-03-30", periods=N, freq="h", tz="Europe/Berlin"), 3600.0),
    (pd.DatetimeIndex(pd.Timestamp("2024-01-01") + pd.to_timedelta(np.round(np.arange(N) / 30, 3), "s")), 1 / 30),
    ([f"row {k}" for k in range(N)], None),
], ids=["count", "number", "durations", "periods", "months", "daylight saving", "30 Hz in ms", "words"])  # fmt: skip
def test_uniform_indexes_of_all_kinds_are_taken(index, dt):
    df = table(index)
    found = identify(df.y, df.u, FIR(2)).dt
    assert found == (None if dt is None else pytest.approx(dt, rel=1e-4))


DAY = pd.date_range("2026-01-10", periods=60, freq="6h")
LOCAL = pd.date_range("2024-03-30", periods=60, freq="h", tz="Europe/Berlin")
HOLE = pd.Index([*range(5), *range(6, 61)])


@pytest.mark.parametrize(("index", "said"), [
    # Dates that are text: with the order of day and month that pandas would get wrong.
    (DAY.strftime("%d.%m.%Y %H:%M"), r"pd\.to_datetime\(df\.index, dayfirst=True, utc=True\)$"),
    (DAY.strftime("%d/%m/%Y %H:%M"), r"pd\.to_datetime\(df\.index, utc=True\); with dayfirst=True where the day st.*"),
    (DAY.strftime("%Y-%m-%d %H:%M"), r"pd\.to_datetime\(df\.index, utc=True\)$"),
    (pd.Index([str(time) for time in LOCAL], dtype=object), r"y: expected times in the index.*00:00:00\+01:00.*to_dat"),
    (pd.Index([time.to_pydatetime() for time in LOCAL], dtype=object), "y: expected times in the index.*to_datetime"),
    (pd.Index([True, False] * 30), "expected times or numbers in the index, got bools"),
    (pd.Index(pd.array([True, False] * 30, dtype="boolean")), "expected times or numbers in the index, got bools"),
    (HOLE, r"steps of 1, got a step of 2 from 4 to 6.*reset_index"),
])  # fmt: skip
def test_an_index_that_is_no_time_is_refused_with_what_makes_it_one(index, said):
    y, u = pd.Series(np.arange(60.0), index), pd.Series(np.arange(60.0) % 7, index)
    with pytest.raises(ValueError, match=said):
        identify(y, u, FIR(1))
    if index is HOLE:
        # Regressors may come in any order.
        identify(y, u, LinearRegression(1))


def test_of_a_column_of_text_the_first_that_is_no_number_is_named_with_the_way_out():
    column = pd.Series(["1.5", "2", "ERR", "-"] * 20)
    with pytest.raises(TypeError, match=r"y: expected real numbers, got 'ERR' at index 2; pandas.to_numeric"):
        identify(column, np.ones(80), OutputError(1, 1))


def test_missing_values_of_nullable_columns_are_missing(model):
    df = table().convert_dtypes()
    assert df.y.isna().any()
    expected = model.predict(table().y, table().u)
    assert_array_equal(model.predict(df.y, df.u), expected)
    # One signal without an index goes by position.
    assert model.predict(table().y, table().u.to_numpy()).equals(expected)


@pytest.mark.parametrize("unit", ["ns", "us", "ms"])
def test_a_period_is_the_number_that_one_would_write(unit):
    for ms in (100, 300, 700):
        df = table(pd.date_range("2024-03-01", periods=N, freq=f"{ms}ms").as_unit(unit))
        tracker = ParameterTracker(ARX(1, 1), start=0, offset=True)
        tracker.run(df.y, df.u)
        assert tracker.dt == tracker.transfer_function().dt == ms / 1000
        assert f" {ms / 1000:g} s\n" in tracker.summary().to_text()
    tracker.dt = 0.1234567890123
    assert " 0.123457 s\n" in tracker.summary().to_text()


def split(first=300, second=300, index=None):
    """A tracker that has seen the first samples, and the table of the others."""
    df = table(index)
    tracker = ParameterTracker(ARX(1, 1), start=0, offset=True)
    tracker.run(df.y[:first], df.u[:first])
    return tracker, df[second:]


TIMES = {
    "dates": None,
    "durations": pd.timedelta_range("0s", periods=N, freq="250ms"),
    "daylight saving": pd.date_range("2024-03-30", periods=N, freq="h", tz="Europe/Berlin"),
    "months": pd.date_range("1950-01-01", periods=N, freq="MS"),
    "periods": pd.period_range("2024-01", periods=N, freq="M"),
}


@pytest.mark.parametrize("index", TIMES.values(), ids=TIMES)
def test_a_recording_that_goes_back_in_time_is_refused_and_one_that_goes_on_is_not(index):
    for second in (0, 200, 299):
        tracker, rest = split(300, second, index)
        with unchanged(tracker), pytest.raises(ValueError, match=r"^y: expected times that follow .*, got .*restore"):
            tracker.run(rest.y, rest.u)
    tracker, rest = split(300, 300, index)
    with silence():
        tracker.run(rest.y[:1], rest.u[:1])
        tracker.run(rest.y[1:], rest.u[1:])
    whole = ParameterTracker(ARX(1, 1), start=0, offset=True)
    whole.run(table().y.to_numpy(), table().u.to_numpy())
    assert_array_equal(tracker.theta, whole.theta)


@pytest.mark.parametrize("name", ["dates", "durations", "daylight saving"])
def test_a_gap_between_two_recordings_is_said_and_how_to_fill_it(name):
    tracker, rest = split(300, 342, TIMES[name])
    with pytest.warns(UserWarning, match=r"^y: 42 missing sample.s. between .*numpy.full\(42, numpy.nan\)"):
        tracker.run(rest.y, rest.u)
    # As the message says; samples without an index count.
    tracker, rest = split(300, 342, TIMES[name])
    u = table().u.to_numpy()[300:342]
    with silence():
        for k in range(2):
            tracker.update(np.nan, u[k])
        tracker.run(np.full(40, np.nan), u[2:])
        tracker.run(rest.y, rest.u)
    with pytest.raises(ValueError, match="follow"):
        tracker.run(rest.y, rest.u)


def test_time_is_forgotten_with_a_state_and_other_kinds_of_time_are_refused():
    tracker, _ = split()
    df = table()
    for other in (df.index.tz_localize("UTC"), TIMES["durations"]):
        there = df.set_index(other)
        with pytest.raises(ValueError, match=r"every 10 s|follow Timestamp"):
            tracker.run(there.y, there.u)
    tracker.restore(tracker.state())
    tracker.run(df.y, df.u)
    tracker.reset()
    tracker.run(df.y, df.u)
    # Counts and words are no times.
    tracker = ParameterTracker(ARX(1, 1), start=0, offset=True)
    for _ in range(2):
        tracker.run(df.y.reset_index(drop=True), df.u.reset_index(drop=True))
    # Regressors may come in any order.
    tracker = ParameterTracker(LinearRegression(1), start=0, offset=True)
    for _ in range(2):
        tracker.run(df.y, df[["u"]])


def test_a_refused_run_leaves_the_time_as_it_was():
    tracker, rest = split(300, 300)
    with pytest.raises(ValueError, match="finite"):
        tracker.run(rest.y, rest.u * np.inf)
    with pytest.raises(ValueError, match="finite"):
        tracker.update(1.0, np.inf)
    with silence():
        tracker.run(rest.y, rest.u)
