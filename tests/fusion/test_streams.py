"""Streams that break an assumption: what comes is right, refused or said, never silently wrong."""

import numpy as np
import pytest
from fusion.worlds import line

from robust_filterpy.fusion import Fusion, FusionWarning, Sensor, constant_velocity


def made(**options):
    return line("ab", 2.0, **options)


def untouched(fusion):
    return not fusion.state()["keys"].size and not any(sum(had.values()) for had in fusion.counts.values())


@pytest.mark.parametrize("unit, per_second", [("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
def test_integers_since_1970_are_refused_with_the_cure(unit, per_second):
    fusion, stamps = made(), 1_700_000_000 * per_second + np.arange(5) * per_second
    with pytest.raises(ValueError, match=rf'expected seconds, .* use np.datetime64\(int\(t\), "{unit}"\)'):
        fusion.observe("a", int(stamps[0]), 1.0)
    assert untouched(fusion)
    table = {"time": stamps, "sensor": ["a"] * 5, "value": np.arange(5.0)}
    with pytest.raises(ValueError, match=rf'column.astype\("datetime64\[{unit}\]"\)'):
        fusion.run(table)
    # The cure that is named is one.
    found = fusion.run({**table, "time": stamps.astype(f"datetime64[{unit}]")})
    assert found.x[-1, 1] == pytest.approx(1.0, abs=0.2)
    assert fusion.observe("a", np.datetime64(int(stamps[0]), unit), 1.0) == "taken"


def test_stamps_of_single_precision_are_refused_where_they_tell_no_moments_apart():
    fusion = made()
    with pytest.raises(ValueError, match=r"double precision, got 1.7e\+09 of float32, which is known to 128 s only"):
        fusion.observe("a", np.float32(1.7e9), 1.0)
    with pytest.raises(ValueError, match="double precision"):
        fusion.run({"time": np.float32([1.7e9, 1.8e9]), "sensor": ["a", "a"], "value": [0.0, 1.0]})
    assert untouched(fusion)
    assert fusion.observe("a", np.float32(12.5), 1.0) == "taken"


def test_who_has_never_spoken_is_silent_after_the_window():
    fusion = made(watch=True)
    for k in range(30):
        fusion.observe("a", 0.1 * k, 0.0)
        assert fusion.verdicts()["b"].fault == ("silent" if 0.1 * k > 2.0 else "healthy")
    assert fusion.verdicts()["b"].since is None
    assert "b silent from the beginning: check power and cable" in fusion.report()


def test_a_clock_that_jumps_back_and_a_burst_past_the_window_are_refused_counted_and_said():
    fusion = made()
    for k in range(100):
        fusion.observe("a", 0.1 * k, 0.0)
    with pytest.warns(FusionWarning, match=r"'a': a reading of 3.0 was dropped: it is 4.9 s older than the window"):
        assert fusion.observe("a", 3.0, 0.0) == "refused"
    with pytest.warns(FusionWarning, match="'b': a reading"):
        outcomes = [fusion.observe("b", 0.1 * k + 0.05, 0.0) for k in range(100)]
    assert outcomes == ["refused"] * 79 + ["late"] * 20 + ["taken"]
    assert fusion.counts["b"]["refused"] == 79 and fusion.counts["a"]["refused"] == 1


def test_a_change_of_unit_leaves_the_sensor_out_from_then_on():
    rng, fusion = np.random.default_rng(0), line("abc", 2.0, watch=True)
    for k in range(300):
        for name in "abc":
            z = 2.0 * 0.1 * k + rng.normal()
            fusion.observe(name, 0.1 * k, 0.3048 * z if name == "b" and k >= 200 else z)
    found = fusion.verdicts()
    assert [found[name].fault for name in "ac"] == ["healthy"] * 2
    assert found["b"].since == pytest.approx(20.0, abs=0.5) and "left out of the state" in found["b"].remedy
    assert abs(fusion.estimate().x[0] - 59.8) < 1.0


@pytest.mark.parametrize("watch", [False, True])
def test_a_window_holds_a_bounded_number_of_stamps_and_what_is_dropped_is_said(watch, monkeypatch):
    for name in ("MOST", "MOST_WATCHED"):
        monkeypatch.setattr(f"robust_filterpy.fusion._timeline.{name}", 100)
    rng = np.random.default_rng(4)
    late = Fusion(constant_velocity(1), {"a": Sensor([1.0, 0.0], R=1.0)}, 1e9, watch=watch)
    taken = []
    with pytest.warns(FusionWarning, match="window: at most 100 stamps are kept") as said:
        for t in (1000.0, *rng.permutation(1000).astype(float)):
            if late.observe("a", t, np.sin(t)) != "refused":
                taken.append(t)
            assert len(late._timeline.keys) <= 100 + 225
    assert sum("at most" in str(one.message) for one in said) == 1
    ordered = Fusion(constant_velocity(1), {"a": Sensor([1.0, 0.0], R=1.0)}, 1e9, watch=watch)
    for t in sorted(taken):
        ordered.observe("a", t, np.sin(t))
    assert sum(late.counts["a"].values()) == 1001 and 100 < len(taken) < 1001
    np.testing.assert_array_equal(late.estimate().x, ordered.estimate().x)
    np.testing.assert_array_equal(late.estimate().P, ordered.estimate().P)


@pytest.mark.parametrize("call", [lambda f: f.observe("a", 0.5, 1.0), lambda f: f.observe("a", 9.0, 1.0),
                                  lambda f: f.estimate(), lambda f: f.restore(f.state())])  # fmt: skip
def test_a_function_of_a_sensor_does_not_call_its_own_fusion(call):
    def h(x):
        call(fusion)
        return x[:1]

    sensors = {"a": Sensor([1.0, 0.0], R=1.0), "b": Sensor(h=h, jacobian=lambda x: np.array([[1.0, 0.0]]), R=1.0)}
    fusion = Fusion(constant_velocity(1), sensors, 50.0)
    fusion.observe("a", 0.0, 1.0)
    fusion.observe("b", 1.0, 1.0)
    fusion.observe("a", 2.0, 3.0)
    with pytest.warns(FusionWarning, match="RuntimeError: .* no call of it from a function of its own"):
        found = fusion.estimate()
    assert found.time == 2.0 and fusion.counts["b"]["refused"] == 1 and fusion.counts["a"]["taken"] == 2
    assert fusion.observe("a", 3.0, 4.0) == "taken"
