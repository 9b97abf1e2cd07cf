"""After a blackout or a jump: the reading or the state may be wrong, and both are carried until that shows."""

import json

import numpy as np
import pytest
from fusion import worlds
from fusion.worlds import GPS, POLICIES, WHEEL, fed, table

from robust_filterpy.fusion import Fusion, Reacquisition, Sensor, constant_velocity
from robust_filterpy.influence import Linear

GONE, BACK, OFF = 20.0, 60.0, np.array([120.0, -80.0])


def recording(case, seed=0, end=130.0, wrong=40.0):
    """Fixes end for 40 s; then they are off for a while, or odometry was, or is: readings and places."""
    rng, motion, x = np.random.default_rng(seed), constant_velocity(2, 0.02), np.array([0.0, 4.0, 0.0, 3.0])
    F, Q, _ = motion.matrices(0.5)
    readings, places, root = [], {}, np.linalg.cholesky(Q)
    for k in range(int(2 * end)):
        t, x = 0.5 * k, F @ x + root @ rng.normal(size=4)
        # Odometry slips by and by, so that nobody sees it begin, nor end.
        slip = np.interp(t, [GONE, 40.0, BACK], [0.0, 0.05, 0.0 if case == "slipped" else 0.05])
        slip *= case in ("slipped", "slipping")
        readings.append(("wheel", t, x[[1, 3]] + 0.1 * rng.normal(size=2) - slip * OFF))
        if k % 2 == 0 and not GONE < t < BACK:
            amid = BACK <= t < BACK + wrong
            place = x[[0, 2]] + (OFF if case == "cluster" and amid else 0.0)
            if case == "standing" and amid:
                place = 2.0 * OFF + (240.0, 180.0)
            if case == "outliers" and rng.random() < 0.1:
                place = place + 40.0 * rng.normal(size=2)
            readings.append(("gps", t, place + 2.0 * rng.normal(size=2)))
        places[t] = x[[0, 2]].copy()
    return readings, places


def made(policy="learnt", reacquire=True, **prior):
    sensors = {"gps": Sensor(GPS, R=4.0), "wheel": Sensor(WHEEL, R=0.01)}
    options = {"reacquire": Reacquisition(**prior)} if reacquire else {}
    return Fusion(constant_velocity(2, 0.02), sensors, 3.0, P0=100.0 * np.eye(4), **POLICIES[policy], **options)


def followed(fusion, readings):
    """What is said after each fix."""
    return worlds.followed(fusion, readings, lambda k, name: name == "gps")


def apart(one, places):
    return np.hypot(*(one[1].x[[0, 2]] - places[one[0]]))


@pytest.mark.parametrize("policy", POLICIES)
def test_a_cluster_of_false_fixes_is_undecided_until_the_fixes_jump_back(policy):
    readings, places = recording("cluster")
    found = followed(made(policy), readings)
    amid = [one for one in found if BACK + 3.0 <= one[0] < BACK + 40.0]
    assert all(one[1].undecided and one[2] == {"gps": "undecided"} for one in amid)
    for t, now, _ in amid:
        # P covers where it is, whichever of the two is served, and little more than both.
        e = now.x[[0, 2]] - places[t]
        assert now.P[0, 0] + now.P[2, 2] < 0.5 * OFF @ OFF
        assert e @ np.linalg.solve(now.P[np.ix_([0, 2], [0, 2])], e) < 9.0
    for one in found:
        if one[0] < BACK or one[0] > BACK + 41.0:
            assert apart(one, places) < 10.0 and not one[1].undecided and one[2] == {}


def test_fixes_that_were_right_are_believed_when_the_prior_says_so():
    readings, places = recording("slipped", end=240.0)
    found = followed(made(), readings)
    taken = next(one[0] for one in found if one[2] == {"motion": "jumped"}) - BACK
    # After length * log(100) seconds, more or less: not before, not much later.
    assert 90.0 < taken < 140.0
    assert all(apart(one, places) < 10.0 for one in found if one[0] > BACK + taken)
    sooner = followed(made(length=5.0), readings)
    assert next(one[0] for one in sooner if one[2] == {"motion": "jumped"}) - BACK < 0.3 * taken
    assert "motion: jumped since 60.0" in fed(made(), [one for one in readings if one[1] <= 190.0]).report()


@pytest.mark.parametrize(("case", "said"), [
    ("slipping", {"wheel": "false", "motion": "jumped"}), ("standing", {"gps": "false"}),
])  # fmt: skip
def test_a_sensor_that_slips_and_one_that_stands_still_are_left_out_within_seconds(case, said):
    readings, places = recording(case)
    after = [one for one in followed(made(), readings) if one[0] >= BACK + 12.0]
    assert all(apart(one, places) < 10.0 for one in after)
    assert all(one[2] == said for one in after if one[0] < BACK + 40.0)
    assert after[-1][2] == (said if case == "slipping" else {})


def test_a_decision_is_undone_when_the_fixes_jump_back():
    readings, places = recording("cluster", wrong=150.0, end=230.0)
    found = followed(made(), readings)
    assert any(one[2] == {"motion": "jumped"} for one in found if one[0] < BACK + 150.0)
    assert all(apart(one, places) < 10.0 and one[2] == {} for one in found if one[0] > BACK + 152.0)


def test_outliers_that_come_alone_change_no_bit():
    readings, _ = recording("outliers", seed=2)
    kept = [one for one in readings if not GONE <= one[1] <= BACK + 1.0]
    with_it, without = made(), made(reacquire=False)
    for one in kept:
        with_it.observe(*one)
        without.observe(*one)
        assert not with_it.estimate().undecided
    assert with_it.estimate().x.tobytes() == without.estimate().x.tobytes()


def test_a_doubt_that_began_before_what_is_kept_is_in_a_state():
    readings, _ = recording("slipping", end=370.0)
    fusion, other = made(), made()
    fed(fusion, readings[:-60])
    state = fusion.state()
    other.restore(json.loads(json.dumps({name: np.asarray(value).tolist() for name, value in state.items()})))
    for one in readings[-60:]:
        fusion.observe(*one)
        other.observe(*one)
    assert fusion.estimate().x.tobytes() == other.estimate().x.tobytes()
    with pytest.raises(ValueError, match="reacquire"):
        made(reacquire=False).restore(state)
    with pytest.raises(ValueError, match="moments"):
        made().restore(made(reacquire=False).state())
    moments = state["moments"]
    for damaged in (moments[:, :-1], np.full_like(moments, np.nan), -5.0 - moments):
        with pytest.raises(ValueError, match=r"state: "):
            made().restore({**state, "moments": damaged})


def test_a_recording_says_what_was_in_doubt():
    readings, places = recording("cluster")
    found = made().run(table(readings), value=["v0", "v1"])
    said = [(t, name, v.fault) for t, name, v in found.verdicts if v.fault != "silent" and t >= BACK + 1.0]
    assert said == [(BACK + 2.0, "gps", "undecided"), (BACK + 40.0, "gps", "healthy")]
    assert np.hypot(*(found.x[-1, [0, 2]] - list(places.values())[-1])) < 10.0
    with pytest.raises(ValueError, match="smoothed"):
        made().run(table(readings), value=["v0", "v1"], smoothed=True)


def test_one_sensor_alone_and_sensors_by_function_are_served_too():
    rng, fusions = np.random.default_rng(3), []
    by_function = Sensor(h=lambda x: [x[0]], jacobian=lambda x: [[1.0, 0.0]], R=1.0)
    for sensor in (Sensor([1.0, 0.0], R=1.0), by_function):
        fusion = Fusion(constant_velocity(1, 0.01), {"gps": sensor}, 1.0, influence=Linear(), P0=100.0 * np.eye(2),
                        reacquire=Reacquisition(length=10.0))  # fmt: skip
        fusions.append(fusion)
    for k in range(200):
        z = 0.5 * k + rng.normal() + (100.0 if 100 <= k < 120 else 0.0)
        for fusion in fusions:
            fusion.observe("gps", float(k), z)
    assert abs(fusions[0].estimate().x[0] - 99.5) < 3.0
    np.testing.assert_allclose(fusions[0].estimate().x, fusions[1].estimate().x, rtol=1e-9)


def test_what_is_no_prior_is_refused():
    for wrong in ({"length": 0.0}, {"length": np.inf}, {"jump": 0.0}, {"jump": 1.0}, {"jump": np.nan}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            Reacquisition(**wrong)
    with pytest.raises(TypeError, match="reacquire"):
        Fusion(constant_velocity(1, 1.0), {"gps": Sensor([1.0, 0.0])}, 1.0, reacquire=True)
