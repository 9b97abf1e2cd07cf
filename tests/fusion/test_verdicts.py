"""What is said of a sensor that fails, and what becomes of the state meanwhile."""

import copy

import numpy as np
import pytest
from fusion.worlds import fed, followed, line, table
from support import by_night

from robust_filterpy.fleet import pack, unpack
from robust_filterpy.fusion import FusionWarning, Reacquisition, _faults, constant_velocity
from robust_filterpy.fusion.verdicts import described, words

RATES = {"a": 10.0, "b": 5.0, "c": 20.0}


def recording(seed, spoil, length=50.0):
    """Three sensors of one place, sigma 1; spoil(t, place, noise, last) is what b says from 30 s on."""
    rng, motion = np.random.default_rng(seed), constant_velocity(1, 0.5)
    stamps = sorted(
        (float(t), n) for n, f in RATES.items() for t in (np.arange(int(length * f)) + rng.uniform(0.2, 0.8)) / f
    )
    x, before, last, found, places = np.array([0.0, 1.0]), 0.0, 0.0, [], []
    for t, name in stamps:
        F, Q, _ = motion.matrices(t - before)
        x, before = rng.multivariate_normal(F @ x, Q), t
        v = rng.normal()
        z = spoil(t, x[0], v, last) if name == "b" and t > 30.0 else x[0] + v
        last = z if name == "b" else last
        found.append((name, t, z))
        places.append(x[0])
    return found, np.array(places)


def made(watch=True, **more):
    return line(RATES, q=0.5, watch=watch, **more)


def thrown(t):
    """What comes with every third reading, up or down for a second each."""
    return (12.0 if int(5 * t) % 3 == 0 else 0.0) * (1 if int(t) % 2 else -1)


#: What b says from 30 s on, the size of that fault, and the words for it.
FAULTS = {
    "biased": (lambda t, x, v, last: x + v + 5.0, 5.0, " by {:.1f} standard deviations since"),
    "stuck": (lambda t, x, v, last: last, np.nan, " since"),
    "noisier": (lambda t, x, v, last: x + 6.0 * v, 6.0, " {:.0f} times since"),
    "drifting": (lambda t, x, v, last: x + v + 0.2 * (t - 30.0), 0.2, " by {:.2g} standard deviations a second since"),
    "spikes": (lambda t, x, v, last: x + v + thrown(t), np.nan, " since"),
}


@pytest.fixture(scope="module", params=by_night(FAULTS, "biased", "drifting"))
def failing(request):
    """A fusion that has taken a recording in which b fails."""
    drifts = request.param == "drifting"
    readings, places = recording(23 if drifts else 3, FAULTS[request.param][0], 60.0 if drifts else 50.0)
    return request.param, fed(made(), readings), readings, places


def test_the_right_sensor_is_named_with_the_right_fault_its_onset_and_its_size(failing):
    fault, fusion, *_ = failing
    found, (_, size, words) = fusion.verdicts(), FAULTS[fault]
    assert {name: v.fault for name, v in found.items() if name in RATES} == {"a": "healthy", "b": fault, "c": "healthy"}
    # A drift takes its time to show, and says since when it has been seen.
    assert abs(found["b"].since - 30.0) < (8.0 if fault == "drifting" else 1.5)
    assert found["b"].probability > 0.95 and found["b"].remedy
    assert found["b"].size == pytest.approx(size, rel=0.3 if fault == "drifting" else 0.2, nan_ok=True)
    assert fusion.report().splitlines()[1].startswith(f"b {fault}{words.format(found['b'].size)}")
    assert all(np.isnan(verdict.size) for name, verdict in found.items() if name != "b")


@pytest.mark.parametrize("gap", [2.0, pytest.param(8.0, marks=pytest.mark.nightly)])
def test_two_sensors_that_fail_one_after_the_other_are_named_one_after_the_other(gap):
    fusion, said = made(), []
    for name, t, z in recording(5200, FAULTS["biased"][0], 42.0)[0]:
        fusion.observe(name, t, z - 5.0 if name == "c" and t > 30.0 + gap else z)
        found = fusion.verdicts()
        now = [(one, found[one].fault) for one in RATES if found[one].fault not in ("healthy", "departs")]
        said += [now] if now not in said else []
    assert said == [[], [("b", "biased")], [("b", "biased"), ("c", "biased")]]
    since = [fusion.verdicts()[name].since for name in "bc"]
    assert since == pytest.approx([30.0, 30.0 + gap], abs=0.5)


def test_a_sensor_that_lies_is_left_out_of_the_state(failing):
    fault, fusion, readings, _ = failing
    if fault not in ("biased", "stuck"):
        pytest.skip("its noise is learnt instead")
    alone = made(watch=False)
    for one in readings:
        if one[0] != "b" or one[1] <= fusion.verdicts()["b"].since - 1e-9:
            alone.observe(*one)
    # As if it had said nothing since the onset.
    np.testing.assert_allclose(fusion.estimate().x, alone.estimate().x, rtol=0.05, atol=0.1)


def test_a_healthy_recording_has_no_verdicts():
    fusion = fed(made(), recording(5, lambda t, x, v, last: x + v)[0])
    assert {v.fault for v in fusion.verdicts().values()} == {"healthy"}
    assert fusion.report().splitlines() == ["a healthy", "b healthy", "c healthy"]


def said(readings):
    """Return who was said to have which fault, in the order in which it was said."""
    verdicts = made().run(table(readings)).verdicts
    return [(name, verdict.fault) for _, name, verdict in verdicts if verdict.fault != "silent"]


@pytest.mark.parametrize("seed, length", [
    (21, 50.0), *(pytest.param(seed, 100.0, marks=pytest.mark.nightly) for seed in (21, 22, 30)),
])  # fmt: skip
def test_noise_that_carries_over_from_reading_to_reading_accuses_nobody(seed, length):
    readings, places = recording(seed, lambda t, x, v, last: x + v, length)
    carried, coloured = dict.fromkeys(RATES, 0.0), []
    for (name, t, z), x in zip(readings, places, strict=True):
        carried[name] = 0.6 * carried[name] + 0.8 * (z - x)
        coloured.append((name, t, x + carried[name]))
    # Who departs is only looked at more closely, which a third of such recordings bring about, and is healthy soon.
    faults = said(coloured)
    assert {fault for _, fault in faults} <= {"departs", "healthy"}
    assert all(fault == "healthy" for fault in dict(faults).values())


@pytest.mark.parametrize("seed", [25, pytest.param(26, marks=pytest.mark.nightly)])
def test_spikes_of_ten_standard_deviations_are_no_noise_that_has_grown(seed):
    turns = np.random.default_rng(seed)

    def spoil(t, x, v, last):
        return x + v + (turns.choice([-10.0, 10.0]) if turns.random() < 0.3 else 0.0)

    faults = [fault for name, fault in said(recording(seed, spoil)[0]) if name == "b" and fault != "departs"]
    assert faults[:1] == ["spikes"]


@pytest.mark.nightly
def test_a_sensor_that_has_recovered_is_let_in_again():
    readings, _ = recording(3, lambda t, x, v, last: x + v + (6.0 if t < 40.0 else 0.0), 60.0)
    fusion = made()
    seen = []
    for k, one in enumerate(readings):
        fusion.observe(*one)
        if k % 35 == 34:
            seen.append(fusion.verdicts()["b"].fault)
    assert "biased" in seen and seen[-1] == "healthy"


@pytest.mark.parametrize("times, fault", [(2, "healthy"), (3, "silent"), (800, "silent")])
def test_a_silent_sensor_is_named_if_it_has_spoken_often_enough_to_have_a_usual_interval(times, fault):
    readings = recording(5, lambda t, x, v, last: x + v)[0]
    last = [t for name, t, _ in readings if name == "c"][times - 1]
    fusion = fed(made(), [one for one in readings if one[0] != "c" or one[1] <= last])
    verdict = fusion.verdicts()["c"]
    assert verdict.fault == fault and ("c silent since" in fusion.report()) == (fault == "silent")
    assert fault == "healthy" or last - 0.1 < verdict.since < last + 0.1


def test_a_stamp_from_the_future_sends_nobody_to_the_cables():
    fusion = made()
    readings = recording(5, lambda t, x, v, last: x + v)[0]
    fed(fusion, readings[: len(readings) // 2])
    fusion.observe("a", 86400.0, 0.0)  # a clock that is a day ahead: all that comes is late from now on
    with pytest.warns(FusionWarning, match="by the newest reading, 'a' at 86400"):
        fed(fusion, readings[len(readings) // 2 :])
    assert "of its readings were refused: check the clocks" in fusion.report() and "cable" not in fusion.report()


def later(fusion, readings):
    fed(fusion, readings)
    return str(fusion.verdicts()), fusion.estimate().P.tobytes(), fusion.counts


# Before the fault, amid it, and long after, when nobody looks any more; each with something that came early.
@pytest.mark.parametrize("cut", [1060, *(pytest.param(cut, marks=pytest.mark.nightly) for cut in (100, 1700))])
@pytest.mark.parametrize("epoch", [pytest.param(None, marks=pytest.mark.nightly), np.datetime64("2026-01-01", "ns")])
def test_a_copy_and_a_state_go_on_to_the_last_bit_verdicts_included(epoch, cut):
    readings, _ = recording(3, FAULTS["biased"][0])
    if epoch is not None:
        readings = [(n, epoch + np.timedelta64(round(1e9 * t), "ns"), z) for n, t, z in readings]
    fusion, other = made(), made()
    fed(fusion, readings[:cut])
    fusion.observe(readings[cut + 8][0], *readings[cut + 8][1:])
    other.restore(unpack(pack(fusion.state())))
    copied = copy.deepcopy(fusion)
    rest = readings[cut : cut + 300]
    assert later(other, rest) == later(fusion, rest) == later(copied, rest)


@pytest.mark.parametrize("back", [10, 1])
def test_a_look_back_that_is_under_way_goes_on_after_a_copy_a_state_and_a_late_reading(monkeypatch, back):
    readings, fusion, work = recording(3, FAULTS["biased"][0])[0], made(), []
    advance = _faults._advance

    def counted(numbers, rows, shared, stamps):
        work.append(rows[1].size * (stamps[1] - stamps[0]))
        advance(numbers, rows, shared, stamps)

    monkeypatch.setattr(_faults, "_advance", counted)
    under_way, most = [], 0
    for k, one in enumerate(readings):
        work.clear()
        fusion.observe(*one)
        moment, most = fusion._until()[0], max(most, sum(work))
        under_way += [k + 1] if moment.watch.asked is not None else []
    # Each stamp does a share, and a part more at most.
    assert most < 1.5 * _faults._AT_ONCE and len(under_way) > 5
    for cut in [k for k in under_way if k - 1 in under_way and readings[k][1] > 30.0][:2]:
        # One that came late: before the look was asked for, or while it is under way.
        fusion, other, late = made(), made(), made()
        assert fed(fusion, readings[:cut])._until()[0].watch.asked is not None
        other.restore(unpack(pack(fusion.state())))
        fed(late, [one for k, one in enumerate(readings[:cut]) if k != cut - back])
        late.estimate()
        late.observe(*readings[cut - back])
        copied = copy.deepcopy(fusion)
        for one in readings[cut : cut + 20]:
            said = later(fusion, [one])
            assert later(other, [one]) == later(copied, [one]) == said and later(late, [one])[:2] == said[:2]


def test_a_state_is_not_taken_by_a_fusion_that_watches_otherwise():
    fusion = made()
    fusion.observe("a", 0.0, 1.0)
    with pytest.raises(ValueError, match="watch=True"):
        made(watch=False).restore(fusion.state())
    with pytest.raises(ValueError, match="moments"):
        made().restore(made(watch=False).state())
    with pytest.raises(ValueError, match="moments"):
        made().restore({**fusion.state(), "moments": np.full_like(fusion.state()["moments"], np.nan)})
    with pytest.raises(ValueError, match="watch=True"):
        made(watch=False).verdicts()


def test_a_recording_has_the_states_and_the_verdicts_of_its_readings(failing):
    fault, fusion, readings, places = failing
    found = made().run(table(readings))
    assert found.x[-1].tobytes() == fusion.estimate().x.tobytes()
    last = {name: verdict for _, name, verdict in found.verdicts}
    # Nothing else is said first, be a drift ever so slow.
    first = [
        v.fault for _, name, v in found.verdicts if name == "b" and v.fault not in ("departs", "healthy", "silent")
    ]
    assert first[:1] == [fault]
    assert last["b"].fault == fault and last["b"].since == fusion.verdicts()["b"].since
    assert all(t >= v.since for t, _, v in found.verdicts if v.since is not None)
    if fault == "biased":
        smooth = made().run(table(readings), smoothed=True).x[:, 0] - places
        assert np.abs(smooth[1100:]).mean() < 0.3


def test_a_recording_says_who_was_silent_and_when_he_spoke_again():
    rng = np.random.default_rng(0)
    rows = [(n, 0.1 * k, rng.normal()) for k in range(400) for n in "abc" if n != "b" or not 200 <= k < 300]
    said = [(round(t, 3), v.fault) for t, name, v in made().run(table(rows)).verdicts if name == "b"]
    assert [fault for _, fault in said] == ["silent", "healthy"]
    assert said[0][0] == pytest.approx(20.5, abs=0.15) and said[1][0] == 30.0


@pytest.mark.parametrize(("probability", "said"), [(0.9994, "0.999"), (0.9996, "above 0.999"), (1.0, "above 0.999")])
def test_nothing_is_said_to_be_as_sure_as_one(probability, said):
    since = np.datetime64("2024-05-01T10:00:59.450", "ns")
    assert words("left", described("biased", since, probability, 5.0)).startswith(
        f"left biased by 5.0 standard deviations since 2024-05-01T10:00:59.45 (probability {said}): "
    )


# Sensors are watched and readings that come apart from the state are doubted, both by one fusion.


def doubting():
    return made(reacquire=Reacquisition())


def readings_of(seed, far=30.0):
    """b is off by five deviations from 30 s on, c by more from 40 to 45 s: readings and places."""
    readings, places = recording(seed, lambda t, x, v, last: x + v + 5.0)
    return [(n, t, z + far * (n == "c" and 40.0 < t < 45.0)) for n, t, z in readings], places


@pytest.fixture(scope="module")
def both():
    readings, places = readings_of(7)
    return readings, places, followed(doubting(), readings, lambda k, name: k % 4 == 0 or k == len(readings))


def test_one_is_biased_and_another_false_for_a_while(both):
    _, places, found = both
    assert all(said == {} for t, _, said in found if 10.0 < t < 30.0)
    assert {str(said) for t, _, said in found if 33.0 < t < 40.0} == {"{'b': 'biased'}"}
    amid = [said for t, _, said in found if 41.0 < t < 45.0]
    # With b left out there is one other: it takes readings until that shows.
    assert all(said["b"] == "biased" and said["c"] in ("undecided", "false") for said in amid)
    assert any(said["c"] == "false" for said in amid)
    assert [said for t, _, said in found if t > 46.0][-1] == {"b": "biased"}
    error = np.array([one.x[0] for _, one, _ in found]) - np.append(places[3:-1:4], places[-1])
    assert np.abs(error[[t > 33.0 for t, *_ in found]]).max() < 2.5


def test_any_order_of_arrival_and_a_state_on_the_way_give_the_same_bits(both):
    readings, _, found = both
    rng = np.random.default_rng(1)
    late = [t + (rng.uniform(0.0, 0.9) if rng.random() < 0.2 else 0.0) for _, t, _ in readings]
    mixed = doubting()
    for k, place in enumerate(np.argsort(late, kind="stable")):
        mixed.observe(*readings[place])
        if k % 500 == 499 or k == 1460:
            state, mixed = unpack(pack(mixed.state())), doubting()
            mixed.restore(state)
    assert mixed.estimate().x.tobytes() == found[-1][1].x.tobytes()
    assert {n: v.fault for n, v in mixed.verdicts().items() if v.fault != "healthy"} == found[-1][2]
    with pytest.raises(ValueError, match="moments"):
        made().restore(mixed.state())
