"""Stamps of every library and resolution: the instant that they name, or a refusal that costs that row alone."""

from datetime import datetime, timedelta, timezone

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robust_filterpy import RobustKalmanFilter, _stamps
from robust_filterpy.fleet import FilterModel, filter_table, step
from robust_filterpy.fusion import Fusion, FusionWarning, Sensor, constant_velocity

NANO = 10**9
#: Nanoseconds of a unit of numpy, and in which the day is no multiple of it.
UNITS = {"W": 7 * 86400 * NANO, "D": 86400 * NANO, "h": 3600 * NANO, "m": 60 * NANO, "s": NANO, "ms": 10**6, "us": 1000,
         "ns": 1}  # fmt: skip
#: Dates that stand for "none", or lie where nanoseconds end.
FAR = ["9999-12-31", "3000-01-01", "1600-01-01", "0001-01-01", "2262-04-12", "1677-09-20"]
EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
HELD = range(*((datetime(year, 1, 1, tzinfo=timezone.utc) - EPOCH).days * 86400 * NANO for year in (1678, 2262)))


def made():
    return Fusion(constant_velocity(1, q=0.1), {"gps": Sensor([1.0, 0.0], R=1.0)}, window=5.0)


def filter_model():
    kf = RobustKalmanFilter(1, 1)
    kf.H, kf.Q = np.eye(1), 0.01 * np.eye(1)
    return FilterModel(kf, time="t", measurements=["z"])


def keys(unit):
    least, most = -(2**63) + 1, 2**63 - 1
    around = HELD.stop // UNITS[unit]
    return st.one_of(st.integers(least, most), st.integers(-around - 500, min(around + 500, most)))


@settings(deadline=None, max_examples=200)
@given(st.data(), st.sampled_from(list(UNITS)))
def test_an_instant_of_numpy_is_what_integers_say_or_refused(data, unit):
    count = data.draw(keys(unit))
    stamp = np.datetime64(count, unit)
    exact = count * UNITS[unit]
    for found in (
        lambda: _stamps.read("t", stamp),
        lambda: int(column_of([stamp])),
        lambda: int(column_of([stamp], object)),
    ):
        if exact in HELD:
            assert found() == exact
        else:
            with pytest.raises(ValueError, match="which nanoseconds do not hold"):
                found()


def column_of(stamps, dtype=None):
    found, wrong = _stamps.column(np.array(stamps, dtype=dtype))
    for why in wrong.values():
        raise ValueError(why)
    return found[0]


@settings(deadline=None, max_examples=200)
@given(st.datetimes(timezones=st.timezones() | st.just(timezone.utc)))
def test_a_datetime_is_what_integers_say_or_refused(stamp):
    exact = (stamp - EPOCH) // timedelta(microseconds=1) * 1000
    if exact in HELD:
        assert _stamps.read("t", stamp) == exact == column_of([stamp], object)
    else:
        with pytest.raises(ValueError, match="which nanoseconds do not hold"):
            _stamps.read("t", stamp)


DAYS = [f"2024-01-{day:02d}" for day in range(1, 11)]


def tables(dates):
    """Yield tables of every library with a column of dates in every resolution and some zones, a value and a sensor."""
    rows = {"z": np.arange(float(len(dates))), "sensor": ["gps"] * len(dates), "device": ["a"] * len(dates)}
    pa, pl = pytest.importorskip("pyarrow"), pytest.importorskip("polars")
    for unit in ("D", "h", "m", "s", "ms", "us"):
        yield f"numpy {unit}", {"t": np.array(dates, "M8[D]").astype(f"M8[{unit}]"), **rows}
    for unit in ("s", "ms", "us"):
        column = pd.Series(np.array(dates, f"M8[{unit}]"))
        there = column.dt.tz_localize("UTC").dt.tz_convert("Europe/Berlin")
        arrow = column.astype(f"timestamp[{unit}][pyarrow]")
        for name, times in (("", column), (" in Berlin", there), (" of Arrow", arrow)):
            yield f"pandas {unit}{name}", pd.DataFrame({"t": times, **rows})
        zoned = pa.array(column.to_numpy()).cast(pa.timestamp(unit, "Asia/Tokyo"))
        yield f"pyarrow {unit} in Tokyo", pa.table({"t": zoned, **rows})
        for zone in (None, "UTC", "America/Lima") if unit != "s" else ():
            dated = pl.Series("t", dates).str.to_datetime("%Y-%m-%d", time_unit=unit).dt.replace_time_zone(zone)
            yield f"polars {unit} {zone}", pl.DataFrame({"t": dated, **rows})
    yield "polars dates", pl.DataFrame({"t": pl.Series(dates).str.to_date(), **rows})
    yield "datetime", pd.DataFrame({"t": [datetime.fromisoformat(d + "T00:00:00+00:00") for d in dates], **rows})


def as_pandas(table):
    return table.to_pandas() if hasattr(table, "to_pandas") else table


@pytest.mark.parametrize("far", ["9999-12-31", "1600-01-01"])
def test_a_date_that_is_none_costs_its_row_alone(far):
    dates = [*DAYS[:4], far, *DAYS[4:]]
    good = np.arange(len(dates)) != 4
    expected = None
    for name, table in tables(dates):
        with pytest.warns(
            FusionWarning, match="1 of 11 rows were left out, the first is row 4: .*[0-9-]+.*do not hold"
        ):
            found = made().run(table, time="t", value="z")
        expected = found.x if expected is None else expected
        assert len(found.times) == 10 and np.array_equal(found.x, expected), name
        assert np.isfinite(found.x).all() and (np.diff(found.times) == np.timedelta64(1, "D")).all(), name
        output = as_pandas(made().step(None, table, time="t", value="z")[1])
        assert (output["outcome"][good] == "taken").all(), name
        assert output["outcome"][4] is None and "which nanoseconds do not hold" in output["error"][4], name
        if not isinstance(table, dict):
            filtered = as_pandas(filter_table(filter_model(), table))
            assert (np.isfinite(filtered["x0"].to_numpy(float)) == good).all(), name
            assert "which nanoseconds do not hold" in filtered["error"][4], name


@pytest.mark.parametrize("far", FAR)
def test_a_date_that_is_none_costs_its_message_alone(far):
    state, outcomes = None, []
    for day in [DAYS[0], far, *DAYS[1:]]:
        stamp = datetime.fromisoformat(day + "T00:00:00+00:00")
        state, output = step(filter_model(), state, [[stamp, 1.0]])
        outcomes.append(output["error"][0])
    assert "which nanoseconds do not hold" in outcomes[1]
    assert not any(outcomes[2:])
    fusion = made()
    fusion.observe("gps", np.datetime64(DAYS[0]), 1.0)
    for stamp in (np.datetime64(far), pd.Timestamp(far), datetime.fromisoformat(far + "T00:00:00+00:00")):
        with pytest.raises(ValueError, match="which nanoseconds do not hold"):
            fusion.observe("gps", stamp, 1.0)
    assert fusion.observe("gps", np.datetime64(DAYS[1]), 1.0) == "taken"


def test_instants_that_are_centuries_apart_are():
    table = {"time": np.array(["1700-01-01", "1980-01-01", "2250-01-01"], "M8[D]"), "sensor": ["gps"] * 3,
             "value": [0.0] * 3}  # fmt: skip
    fusion, P = made(), []
    for t in table["time"]:
        fusion.observe("gps", t, 0.0)
        P.append(fusion.estimate().P)
    np.testing.assert_allclose(made().run(table).P, P, rtol=1e-9)
    assert (np.diag(P[-1]) > 0.0).all()


@pytest.mark.parametrize("unit", ["s", "ms", "us", "ns"])
def test_a_column_of_durations_is_no_column_of_times_of_a_fusion(unit):
    table = {"time": np.arange(3).astype(f"m8[{unit}]"), "sensor": ["gps"] * 3, "value": [0.0] * 3}
    with pytest.raises((TypeError, ValueError), match="a duration"):
        made().run(table)
    assert all("a duration" in why for why in made().step(None, table)[1]["error"])


@pytest.mark.parametrize("flag", [True, np.True_, np.bool_(False)])
def test_a_truth_is_no_stamp_and_no_number(flag):
    with pytest.raises(TypeError, match=r"expected a time, got (True|False)"):
        made().observe("gps", flag, 1.0)
    with pytest.raises((TypeError, ValueError), match="expected a time, got"):
        made().run({"time": np.array([flag, flag]), "sensor": ["gps"] * 2, "value": [0.0, 1.0]})
    with pytest.raises(TypeError, match="window: expected a number"):
        Fusion(constant_velocity(1), {"gps": Sensor([1.0, 0.0])}, window=flag)
