"""What a fusion says of the state, against filterpy's loop and against the truth."""

import math
from datetime import datetime, timedelta

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from fusion.worlds import GPS, POLICIES, WHEEL, fed, plane, sensors, table
from numpy.testing import assert_allclose
from recordings import silence

from robust_filterpy import Contaminated
from robust_filterpy.correction import Scales
from robust_filterpy.fusion import Fusion, FusionWarning, Reacquisition, Sensor, angle, constant_velocity, from_function
from robust_filterpy.influence import Linear


@pytest.mark.parametrize("options", [
    {"influence": Linear()}, {"noise": Contaminated(0.0), "process": Scales((1.0,), jump=0.0)},
])  # fmt: skip
def test_given_everything_and_in_order_it_is_the_loop_of_filterpy(options):
    readings, _ = plane(np.cumsum(np.random.default_rng(0).uniform(0.01, 1.0, 200)))
    motion, kf, before = constant_velocity(2, 0.5), KalmanFilter(4, 2), readings[0][1]
    fusion = fed(Fusion(motion, sensors(), 5.0, x0=np.zeros(4), P0=100.0 * np.eye(4), **options), readings)
    kf.x, kf.P = np.zeros(4), 100.0 * np.eye(4)
    for who, t, z in readings:
        if t > before:
            kf.predict(**dict(zip("FQ", motion.matrices(t - before), strict=False)))
        H, R = (GPS, 4.0) if who == "gps" else (WHEEL, 0.01)
        kf.update(z, R=R * np.eye(2), H=np.array(H))
        before = t
    found = fusion.estimate()
    np.testing.assert_allclose(found.x, kf.x, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(found.P, kf.P, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("kind", ["dict", "pandas", "pyarrow"])
def test_a_table_in_any_order_is_the_same_as_reading_by_reading(policy, kind):
    readings, _ = plane(np.cumsum(np.random.default_rng(0).uniform(0.01, 1.0, 60)), outliers=0.1)
    fusion = Fusion(constant_velocity(2, 0.5), sensors(), 1e3, **POLICIES[policy])
    columns = {name: np.array(column)[::-1] for name, column in table(readings).items()}
    if kind != "dict":
        module = pytest.importorskip(kind)
        columns = module.DataFrame(columns) if kind == "pandas" else module.table(columns)
    found = fusion.run(columns, value=["v0", "v1"])
    fed(fusion, readings)
    for i in (0, 10, -1):
        np.testing.assert_allclose(found.x[i], fusion.estimate(found.times[i]).x, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(found.P[i], fusion.estimate(found.times[i]).P, rtol=1e-6, atol=1e-6)
    assert list(found.columns())[:3] == ["time", "x.p", "x.p_std"]


def test_noise_is_learnt_for_each_sensor_whatever_was_given():
    readings, _ = plane(np.arange(3000) * 0.1)
    fusion = fed(Fusion(constant_velocity(2, 0.5), {"gps": Sensor(GPS), "wheel": Sensor(WHEEL, R=1.0)}, 1.0), readings)
    found = fusion.noise()
    np.testing.assert_allclose(found["gps"].deviation, 2.0, rtol=0.35)
    np.testing.assert_allclose(found["wheel"].deviation, 0.1, rtol=0.6)
    assert (found["gps"].contamination < 0.1).all()


def test_a_sensor_without_R_does_not_depend_on_units():
    readings, _ = plane(np.arange(90) * 0.3)
    scaled = {}
    for unit in (1.0, 1e-4, 1e5):
        wheel = {"gps": Sensor(GPS, R=4.0), "wheel": Sensor(unit * np.array(WHEEL))}
        fusion = Fusion(constant_velocity(2, 0.5), wheel, 1.0, P0=100.0 * np.eye(4))
        given = [(who, t, unit * z if who == "wheel" else z) for who, t, z in readings]
        scaled[unit] = fed(fusion, given).estimate().x
    np.testing.assert_allclose(scaled[1e-4], scaled[1.0], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(scaled[1e5], scaled[1.0], rtol=1e-5, atol=1e-6)


def test_a_missing_component_leaves_the_others():
    fusion = Fusion(constant_velocity(2, 0.5), sensors(), 1.0, P0=1e4 * np.eye(4))
    fusion.observe("gps", 0.0, [3.0, np.nan])
    found = fusion.estimate()
    assert abs(found.x[0] - 3.0) < 0.2 and found.x[2] == 0.0 and round(found.P[2, 2]) == 1e4
    fusion.observe("gps", 1.0, None)
    assert fusion.estimate().ages == {"gps": 0.0, "wheel": math.inf}


def test_how_long_a_sensor_is_silent_is_the_same_after_a_state_a_late_reading_and_for_the_past():
    fusion, other = (Fusion(constant_velocity(1), {n: Sensor([1.0, 0.0], R=1.0) for n in "abc"}, 5.0) for _ in range(2))
    for t in range(1500):
        fusion.observe("b" if t == 3 else "a", float(t), 0.0)
    other.restore(fusion.state())
    for one in (fusion, other):
        assert one.estimate().ages == {"a": 0.0, "b": 1496.0, "c": math.inf}
        one.observe("b", 1497.5, 0.0)
        one.observe("b", 1495.5, 0.0)
        assert one.estimate().ages == {"a": 0.0, "b": 1.5, "c": math.inf}
        assert one.estimate(1496.0).ages == {"a": 0.0, "b": 0.5, "c": math.inf}
        assert one.estimate(1495.0).ages == {"a": 0.0, "b": 1492.0, "c": math.inf}


@pytest.mark.parametrize(("t", "error", "says"), [
    (datetime(2026, 1, 1), ValueError, "time zone.*timezone.utc"),
    (timedelta(seconds=1), TypeError, "duration.*total_seconds"),
    ("2026-01-01", TypeError, "'2026-01-01', which is text; pandas.to_datetime"),
    (math.nan, ValueError, "a time, got nan"),
    (np.datetime64("NaT"), ValueError, "NaT"),
    (np.datetime64("2026-01-01"), TypeError, "number of seconds, as the stamps before"),
])  # fmt: skip
def test_what_is_no_stamp_is_refused_with_the_cure(t, error, says):
    fusion = Fusion(constant_velocity(2, 0.5), sensors(), 5.0)
    fusion.observe("gps", 0.0, [0.0, 0.0])
    with pytest.raises(error, match=says):
        fusion.observe("gps", t, [0.0, 0.0])
    assert fusion.counts["gps"]["taken"] == 1


def test_a_compass_that_goes_round_and_a_motion_that_is_a_function():
    """A heading that turns once in 6 s, seen by a compass with an angle and by the place it leads to."""

    def f(x, dt):
        return np.array([x[0] + dt * math.cos(x[2]), x[1] + dt * math.sin(x[2]), x[2] + dt * x[3], x[3]])

    def jacobian(x, dt):
        F = np.eye(4)
        F[0, 2], F[1, 2], F[2, 3] = -dt * math.sin(x[2]), dt * math.cos(x[2]), dt
        return F

    def wrapped(x):
        return np.array([(x[2] + math.pi) % (2 * math.pi) - math.pi])

    compass = Sensor(h=wrapped, jacobian=lambda x: np.array([[0.0, 0.0, 1.0, 0.0]]), residual=angle, R=0.01)
    place = Sensor(np.eye(4)[:2], R=0.04)
    motion = from_function(f, jacobian, np.diag([1e-4, 1e-4, 1e-4, 1e-3]), 4)
    fusion = Fusion(motion, {"compass": compass, "place": place}, 1.0, x0=[0, 0, 0, 1.0], P0=np.eye(4))
    rng, x, rows = np.random.default_rng(0), np.array([0.0, 0.0, 0.0, 1.0]), []
    for k in range(300):
        for _ in range(10):
            x = f(x, 0.01)
        t = 0.1 * (k + 1)
        rows += [("compass", t, wrapped(x + 0.1 * rng.normal())[0]), ("place", t, x[:2] + 0.2 * rng.normal(size=2))]
    found = fed(fusion, rows).estimate()
    assert np.abs(found.x - x)[[0, 1]].max() < 0.5 and abs(found.x[2] - x[2]) < 0.2
    columns = table([(who, t, z * np.ones(2)) for who, t, z in rows])
    np.testing.assert_allclose(fusion.run(columns, value=["v0", "v1"]).x[-1], found.x, rtol=1e-9)
    with pytest.raises(ValueError, match="smoothed: expected a linear"):
        fusion.run(columns, value=["v0", "v1"], smoothed=True)


def test_far_from_the_given_start():
    """Coordinates of a map are millions of metres; no start is given."""
    readings, truth = plane(np.arange(60) * 0.3)
    far = [(who, t, z + 5e6 if who == "gps" else z) for who, t, z in readings]
    fusion = fed(Fusion(constant_velocity(2, 0.5), sensors(), 1.0), far)
    assert np.abs(fusion.estimate().x - truth[-1] - [5e6, 0, 5e6, 0]).max() < 5.0


@pytest.mark.parametrize(("change", "says"), [
    ({"time": [math.nan, math.nan]}, "a time, got nan in row 0, and none in any other"),
    ({"sensor": ["gps", "sonar"]}, "sonar"),
    ({"v0": [0.0, math.inf]}, "row 1"),
    ({"time": [1.0, 1.0]}, "two that differ"),
    *(({"v0": bad}, "columns of one length") for bad in ([0.0, 1.0, 2.0], b"12", "12", {1: 2}, {1}, 3.0)),
])  # fmt: skip
def test_a_row_that_cannot_be_is_named(change, says):
    columns = {"time": [0.0, 1.0], "sensor": ["gps", "gps"], "v0": [0.0, 1.0], "v1": [0.0, 1.0]} | change
    with pytest.raises(ValueError, match=says):
        Fusion(constant_velocity(2, 0.5), sensors(), 1.0).run(columns, value=["v0", "v1"])


@pytest.mark.parametrize(("make", "says"), [
    (lambda: Sensor(), "H or h"),
    (lambda: Sensor(h=lambda x: x), "jacobian"),
    (lambda: Sensor([1.0, 0.0], R=-1.0), "R"),
    (lambda: Sensor([1.0, 0.0], delay=-1.0), "delay"),
    (lambda: Fusion(constant_velocity(1), {"a": Sensor([1.0])}, 1.0), "'a'.*2 columns"),
    (lambda: Fusion(constant_velocity(1), {}, 1.0), "dict"),
    (lambda: Fusion(constant_velocity(1), {"a": Sensor([1.0, 0.0])}, -1.0), "window"),
    (lambda: Fusion(constant_velocity(1), {"a": Sensor([1.0, 0.0])}, 1.0, influence=Linear()), "R"),
    (lambda: Fusion(constant_velocity(1), {"a": Sensor([1.0, 0.0])}, 1.0).observe("b", 0.0, 0.0), "'a'.*'b'"),
    (lambda: Fusion(constant_velocity(1), {"a": Sensor([1.0, 0.0])}, 1.0).observe("a", 0.0, [0.0, 1.0]), "1 number"),
    (lambda: Fusion(constant_velocity(1), {"a": Sensor([1.0, 0.0])}, 1.0).estimate(), "reading first"),
    (lambda: fused({"gps": Sensor([1.0, 0.0], R=1.0, group="rx")}), "another sensor of the group 'rx'"),
    (lambda: fused({"gps": Sensor([1.0, 0.0], R=1.0, group="")}), "group: expected the name"),
    (lambda: fused({"gps": Sensor([1.0, 0.0], R=1.0, group=3)}), "group: expected the name"),
    (lambda: fused(pair()).run(together(0, 20)[0], smoothed=True), "without group"),
    (lambda: fused(pair(None)).run({"time": [0.0, 1.0], "gps": [0.1, 0.2], "doppler": [0.3, 0.4]}),
     r"table: expected the columns \['sensor', 'value'\], .* table\.melt"),
])  # fmt: skip
def test_what_does_not_fit_is_refused_by_name(make, says):
    with pytest.raises((ValueError, TypeError), match=says):
        make()


def square_root(limit):
    """A sensor whose h has no answer left of a place."""

    def h(x):
        if x[0] < limit:
            raise ArithmeticError("left of the wall")
        return [np.sqrt(x[0] - limit)]

    return Sensor(h=h, jacobian=lambda x: [[0.5 / np.sqrt(x[0] - limit), 0.0]], R=0.01)


@pytest.mark.parametrize("watch", [False, True])
def test_a_reading_whose_h_raises_is_refused_with_the_reason_and_the_rest_goes_on(watch):
    def made():
        sensors = {"root": square_root(0.0), "place": Sensor([1.0, 0.0], R=1.0)}
        return Fusion(constant_velocity(1, 0.1), sensors, 0.5, x0=[50.0, -1.0], P0=np.eye(2), watch=watch)

    fusion, without, rng = made(), made(), np.random.default_rng(0)
    rows = [("place", 0.1 * k, 50.0 - 0.1 * k + rng.normal()) for k in range(1200)]
    with pytest.warns(FusionWarning, match=r"'root'.*refused.*left of the wall.*counts") as said:
        for k, row in enumerate(rows):
            for one in (fusion, without):
                one.observe(*row)
            # As it runs out of window and history, what raises is behind what is kept.
            if row[1] > 60.0 and k % 2:
                assert fusion.observe("root", row[1], 1.0) == "taken"
    counts = fusion.counts["root"]
    assert len([w for w in said if "'root'" in str(w.message)]) == 1
    assert counts["refused"] == counts["taken"] == 300 and fusion.counts["place"]["refused"] == 0
    assert fusion.estimate().x.tobytes() == without.estimate().x.tobytes()
    with pytest.warns(RuntimeWarning, match=r"1 reading\(s\) left out.*'root'"):
        assert np.isfinite(fusion.run(table([*rows, ("root", 100.0, 1.0)])).x).all()


def test_a_late_reading_may_bring_back_one_whose_h_raised():
    sensors = {"root": square_root(0.0), "place": Sensor([1.0, 0.0], R=1.0)}
    rows = [("root", 1.0, 3.0), ("place", 0.5, 9.0), ("place", 0.7, 9.0)]
    found = []
    for order in ((0, 1, 2), (1, 0, 2), (2, 1, 0)):
        fusion = Fusion(constant_velocity(1, 0.1), sensors, 5.0, x0=[-3.0, 0.0], t0=0.0, P0=100.0 * np.eye(2))
        for i in order:
            fusion.observe(*rows[i])
            if i == order[0] == 0:
                with pytest.warns(FusionWarning, match="left of the wall"):
                    fusion.estimate()
        found.append(fusion.estimate().x.tobytes())
        assert fusion.counts["root"]["refused"] == 0
    assert len(set(found)) == 1


def test_a_motion_that_raises_says_so_once_and_takes_readings_all_the_same():
    def f(x, dt):
        if x[0] > 5.0:
            raise ArithmeticError("beyond the map")
        return np.array([x[0] + dt])

    fusion = Fusion(from_function(f, lambda x, dt: np.eye(1), np.eye(1), 1), {"a": Sensor([1.0], R=1.0)}, 0.5)
    with pytest.warns(FusionWarning, match="motion.*beyond the map") as said:
        for k in range(1000):
            fusion.observe("a", 0.1 * k, 0.1 * k)
    assert len(said) == 1
    with pytest.raises(ArithmeticError):
        fusion.estimate()
    assert fusion.estimate(3.0).x[0] < 4.0


@pytest.mark.parametrize("bad", [None, np.nan, [], {}, np.array(1.0), np.zeros((2, 2)), object()], ids=range(7))
def test_what_names_no_column_no_state_and_no_choice_is_refused_in_words(bad):
    readings = table([("wheel", 1.0, [1.0, 2.0]), ("wheel", 2.0, [1.0, 2.0])])
    fusion = Fusion(constant_velocity(2, 0.5), sensors(), 5.0)
    columns = {"time": "time", "sensor": "sensor", "value": ["v0", "v1"]}
    for name in columns:
        with pytest.raises(TypeError, match=r"^time, sensor, value: expected names of columns"):
            fusion.run(readings, **{**columns, name: bad})
    with pytest.raises(ValueError, match=r"^sensor: expected one of \['gps', 'wheel'\], got"):
        fusion.observe(bad, 0.0, [1.0, 2.0])
    with pytest.raises((TypeError, ValueError), match=r"^state: expected"):
        fusion.restore(bad)
    with pytest.raises(TypeError, match=r"^watch: expected True or False"):
        Fusion(constant_velocity(2, 0.5), sensors(), 5.0, watch=bad)


# Sensors that share a cause: one outlier, one verdict, each with a noise of its own.


def pair(group="receiver", **more):
    return {"gps": Sensor([1.0, 0.0], R=4.0, group=group), "doppler": Sensor([0.0, 1.0], R=0.09, group=group), **more}


def together(seed, length=400):
    """A point on a line; one cause makes both readings of a stamp ten times as noisy, one time in ten."""
    rng, x, readings, truth = np.random.default_rng(seed), np.array([0.0, 1.0]), [], []
    F, Q, _ = constant_velocity(1, 0.1).matrices(0.5)
    for k in range(length):
        x = F @ x + np.linalg.cholesky(Q) @ rng.normal(size=2)
        wide = 10.0 if rng.random() < 0.1 else 1.0
        readings.append(("gps", 0.5 * k, x[0] + 2.0 * wide * rng.normal()))
        readings.append(("doppler", 0.5 * k, x[1] + 0.3 * wide * rng.normal()))
        truth.append(x)
    return dict(zip(("sensor", "time", "value"), zip(*readings, strict=True), strict=True)), np.array(truth)


def fused(sensors, **more):
    return Fusion(constant_velocity(1, 0.1), sensors, 5.0, P0=100.0 * np.eye(2), **more)


@pytest.mark.filterwarnings("ignore:smooth. Q and R do not fit")
def test_a_recording_is_smoothed_by_the_influence_of_the_fusion():
    table, _ = together(0, 60)
    motion = constant_velocity(1, 0.1)
    found = Fusion(motion, pair(None), 5.0, P0=100.0 * np.eye(2), influence=Linear()).run(table, smoothed=True)
    kf = KalmanFilter(2, 2)
    kf.P, kf.H, kf.R = 100.0 * np.eye(2), np.eye(2), np.diag([4.0, 0.09])
    kf.F, kf.Q, _ = motion.matrices(0.5)
    # The first stamp is the start's.
    Fs, Qs = [np.eye(2)] + [kf.F] * 59, [np.zeros((2, 2))] + [kf.Q] * 59
    zs = np.reshape(table["value"], (-1, 2, 1))
    means, covariances, _, _ = kf.batch_filter(list(zs), Fs=Fs, Qs=Qs)
    x, P, _, _ = kf.rts_smoother(means, covariances, Fs=Fs, Qs=Qs)
    assert_allclose(found.x, x[..., 0], atol=1e-6)
    assert_allclose(found.P, P, atol=1e-6)


def test_a_recording_in_degrees_is_smoothed_from_the_default_start_as_from_one_that_fits():
    """By default the start is 1e18 times less certain than this sensor, more than numbers tell apart."""
    rng, t = np.random.default_rng(5), 0.5 * np.arange(60)
    table = {"time": t, "sensor": ["gps"] * 60, "value": 48.1 + 0.01 * np.sin(t / 3.0) + 1e-5 * rng.normal(size=60)}
    motion, sensors = constant_velocity(1, 1e-6), {"gps": Sensor([1.0, 0.0], R=1e-10)}
    start = {"x0": [48.1, 0.0], "P0": 1e-2 * np.eye(2)}
    default, fits = (
        Fusion(motion, sensors, 5.0, influence=Linear(), **more).run(table, smoothed=True) for more in ({}, start)
    )
    assert_allclose(default.P, fits.P, rtol=1e-4, atol=1e-12)
    assert (np.abs(default.x - fits.x) < 1e-3 * np.sqrt(np.einsum("kii->ki", fits.P))).all()


@pytest.mark.parametrize("way", ["learnt", "given", "huber"])
def test_a_far_position_costs_the_speed_of_the_same_stamp_its_weight(way):
    table, _ = together(0, 101)
    values = np.array(table["value"])
    values[200] += 100.0
    table, policy = {**table, "value": values}, POLICIES[way]
    weights = [fused(pair(group), **policy).run(table).weights[100] for group in (None, "rx")]
    assert weights[0][0] < 0.2 and weights[1][0] < 0.2
    assert weights[1][1] < 0.3
    assert weights[0][1] < 0.3 if way == "learnt" else weights[0][1] > 0.3


def test_each_sensor_of_a_group_has_a_noise_of_its_own_size():
    table, _ = together(1, 800)
    values = np.array(table["value"])
    rng = np.random.default_rng(0)
    values[::2] += np.sqrt(3.0) * 2.0 * rng.normal(size=800)
    noise = fed(fused(pair()), zip(table["sensor"], table["time"], values, strict=True)).noise()
    assert 3.0 < noise["gps"].deviation[0] < 6.0
    assert 0.2 < noise["doppler"].deviation[0] < 0.45


@pytest.mark.parametrize("way", ["learnt", "given", "huber"])
def test_a_recording_with_a_group_is_its_steps_and_a_state_goes_on(way):
    table, _ = together(4, 80)
    whole, stepwise = fused(pair(), **POLICIES[way]).run(table), fused(pair(), **POLICIES[way])
    rows = list(zip(table["sensor"], table["time"], table["value"], strict=True))
    fed(stepwise, rows[:100])
    other = fused(pair(), **POLICIES[way])
    other.restore(stepwise.state())
    fed(other, rows[100:])
    assert_allclose(other.estimate().x, whole.x[-1], rtol=1e-9)


def test_a_name_that_nobody_shares_joins_the_components_of_one_sensor():
    rng = np.random.default_rng(0)
    found = []
    for group in (None, "antenna"):
        fusion = Fusion(constant_velocity(2, 0.1), {"gps": Sensor(np.eye(4)[[0, 2]], R=1.0, group=group)}, 1.0)
        z = rng.normal(size=(60, 2)) * 0.5
        z[59] = 60.0, 2.0
        table = {"time": np.arange(60.0), "sensor": ["gps"] * 60, "east": z[:, 0], "north": z[:, 1]}
        found.append(fusion.run(table, value=["east", "north"]).weights[59])
    assert found[0][1] > 0.5 > 0.1 > found[1][1]


@pytest.mark.nightly
def test_a_verdict_is_of_the_whole_group_and_says_with_whom():
    rng = np.random.default_rng(0)
    others = {name: Sensor([1.0, 0.0], R=1.0) for name in ("left", "right")}
    fusion = Fusion(constant_velocity(1, 0.1), pair(**others), 1.0, P0=100.0 * np.eye(2), watch=True)
    for k in range(320):
        t = 0.1 * k
        for name, sensor in fusion._setup.layout.sensors.items():
            z = float(sensor.H[0] @ [2.0 * t, 2.0]) + np.sqrt(sensor.R[0, 0]) * rng.normal()
            fusion.observe(name, t, z + (12.0 if name == "gps" and t > 25.0 else 0.0))
    found = fusion.verdicts()
    assert found["gps"].fault == found["doppler"].fault == "biased"
    assert found["left"].fault == found["right"].fault == "healthy"
    assert "judged as one with doppler" in found["gps"].remedy
    again = Fusion(constant_velocity(1, 0.1), pair(**others), 1.0, P0=100.0 * np.eye(2), watch=True)
    again.restore(fusion.state())
    assert again.report() == fusion.report()


def test_in_doubt_the_speed_of_a_receiver_whose_position_is_false_is_believed():
    rng = np.random.default_rng(1)
    fusion = Fusion(
        constant_velocity(1, 0.02), pair(wheel=Sensor([0.0, 1.0], R=0.01)), 2.0, P0=100.0 * np.eye(2),
        reacquire=Reacquisition(length=200.0, jump=0.01),
    )  # fmt: skip
    for t in range(120):
        fusion.observe("wheel", t, 5.0 + 0.1 * rng.normal())
        fusion.observe("doppler", t, 5.0 + 0.3 * rng.normal())
        fusion.observe("gps", t, 5.0 * t + 2.0 * rng.normal() + (500.0 if t > 90 else 0.0))
    found = fusion.verdicts()
    assert found["gps"].fault in ("false", "undecided")
    assert found["doppler"].fault == found["wheel"].fault == "healthy"
    assert abs(fusion.estimate().x[0] - 5.0 * 119) < 20.0


def test_sensors_of_a_group_that_never_share_a_stamp_are_warned_of():
    table, _ = together(0, 80)
    shifted = {**table, "time": np.array(table["time"]) + 1e-3 * (np.arange(160) % 2)}
    with pytest.warns(FusionWarning, match="expected readings with the same stamp"):
        fused(pair()).run(shifted)
    with pytest.warns(FusionWarning, match="expected readings with the same stamp"):
        fed(fused(pair()), zip(*(shifted[key] for key in ("sensor", "time", "value")), strict=True))
    with silence():
        fused(pair()).run(table)
