"""Verdicts: what is the matter with a sensor, since when, how surely, and what helps.

A cheap test of every reading raises an alarm (`_watch`), and then the last stamps are judged anew under every fault of
every sensor (`_faults`). What is all but certain is a verdict; what is more likely than not "departs", and is looked at
again. A sensor whose lie is no noise (biased, drifting, stuck) is left out of x, from the onset on, until its readings
are again as they were.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy.fusion import _faults, _watch
from robust_filterpy.fusion._faults import Found, Stretch
from robust_filterpy.fusion._stepping import Moment, covariance
from robust_filterpy.fusion._table import Clock, written
from robust_filterpy.fusion._watch import BIASED, DEPARTS, DRIFTING, FAULTS, HEALTHY, MODEL, SLOW, Watch
from robust_filterpy.fusion.reacquisition import doubted
from robust_filterpy.fusion.sensors import Layout

__all__ = ["LONGEST", "Verdict", "described", "of_all", "watched", "words"]

#: Stamps that are judged anew after an alarm, and at most while a sensor departs.
STRETCH, LONGEST = 300, 600
# A verdict is wrong once in twenty times at most; and what is said before that.
_SURE, _LIKELY = 0.95, 0.5
# A sensor is healthy, and looked at again soon, if something is the matter with more than this probability.
_DOUBTED = 0.05
# Readings until a sensor in doubt, one that departs, or one that has a verdict, is looked at again.
_SOON, _AGAIN, _LATER = 2, 5, 20
# Faults that a stretch which is too short confuses: biased, drifting.
_SLOW = (BIASED, DRIFTING)

_REMEDIES = {
    "healthy": "",
    "departs": "wait: what it is will be said when more readings have come",
    "biased": "left out of the state; calibrate it, or add its offset to the state",
    "drifting": "left out of the state; check its reference and temperature, or add its offset to the state",
    "stuck": "left out of the state; check power, cable and driver",
    "noisier": "its learned noise has grown with it; check mounting, cable and interference",
    "spikes": "its outliers are learned and bounded; check for reflections and lost bits",
    "silent": "check power and cable",
    "model is wrong": "a manoeuvre that q does not allow; raise q",
    "undecided": "its readings or the state is wrong: later readings decide, until then P covers both",
    "false": "left out of the state until its readings fit again",
    "jumped": "the state was wrong and is right again; check what carried it in between",
}


class Verdict(NamedTuple):
    """What is the matter with a sensor, or with the model of the motion."""

    fault: str
    """"healthy", "departs", "biased", "drifting", "stuck", "noisier", "spikes", "silent" or "model is wrong"; with
    ``reacquire`` "undecided", "false" or "jumped"."""
    since: Any
    """Stamp of the onset, or of its last word if it is silent; None if it is healthy, or has never spoken."""
    probability: float
    """That it is this, given that a fault comes once in 10^5 readings and a manoeuvre once in 10^4 stamps; with
    ``reacquire`` given its prior."""
    size: float
    """Of the fault, in standard deviations (biased), per second (drifting), or as a factor (noisier); else NaN."""
    remedy: str
    """What helps, in words."""

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


def described(fault: str, since: Any = None, probability: float = 1.0, size: float = float("nan")) -> Verdict:
    """Return a verdict with its remedy."""
    return Verdict(fault, since, probability, size, _REMEDIES[fault])


def silent(since: Any, refused: int) -> Verdict:
    """Return the verdict about a sensor that has said nothing for too long."""
    verdict = described("silent", since)
    if not refused:
        return verdict
    clocks = "check the clocks, of the sensor with the newest stamp too"
    return verdict._replace(remedy=f"{refused} of its readings were refused: {clocks}")


def watched(line: Any, i: int, moment: Moment) -> Moment:
    """Return the moment of an entry with what its readings say about the sensors."""
    owner, before = line.setup.layout.party, moment.watch
    # As at nearly every stamp; lists of a few numbers are faster than arrays.
    if before.calm and min(before.odds.tolist()) >= 1.0 - _DOUBTED:
        return moment
    if moment.doubt is not None and moment.doubt.served >= 0 and not moment.doubt.sure:
        # First it is decided whether a sensor or the state was wrong.
        return moment
    well = _watch.recovered(before, owner)
    watch = _watch.begun_anew(_set_free(before, well, owner), well, owner) if well.any() else before
    alarm = _watch.alarmed(watch, owner)
    alarm[:-1] &= watch.fault == HEALTHY
    followed = ((watch.fault > HEALTHY) | (watch.odds < 1.0 - _DOUBTED)) & (watch.due <= 0.0)
    if alarm.any() or followed.any():
        seen = alarm | np.append(followed, False)
        watch = _after_a_look(line, i, _watch.cleared(watch, seen, owner), alarm, followed)
    if watch is before:
        return moment
    left = watch.out
    since = np.array([a != b for a, b in zip(watch.since, before.since, strict=True)])
    if (left & (since | ~before.out)).any():
        watch = _watch.begun_anew(watch, left, owner)._replace(mended=line.keys[i])
        as_if = _mended(line, i, watch)
        return moment._replace(watch=watch, state=as_if.state, doubt=as_if.doubt)
    return moment._replace(watch=watch)


def _set_free(watch: Watch, sensors: np.ndarray, owner: np.ndarray) -> Watch:
    """Return that nothing is the matter with some sensors."""
    recent = np.where(sensors[owner][:, None], 0.0, watch.recent)
    since = tuple(None if free else at for free, at in zip(sensors, watch.since, strict=True))
    fault, odds = np.where(sensors, 0.0, watch.fault), np.where(sensors, 1.0, watch.odds)
    return watch._replace(fault=fault, odds=odds, since=since, recent=recent)


def _after_a_look(line: Any, i: int, watch: Watch, alarm: np.ndarray, followed: np.ndarray) -> Watch:
    """Return the verdicts once the last stamps have been judged anew."""
    party, departs = line.setup.layout.party, watch.fault == DEPARTS
    # Who has a verdict stays where he is, and says nothing, when another is in doubt, or if he had it before the
    # stretch begins. How fast one drifts is seen the better the longer.
    faulty = watch.fault > DEPARTS
    alone = faulty.sum() < 2 and not (alarm.any() or departs.any() or (followed & ~faulty).any())
    gone = np.array([
        one and not (alone and at >= _early(line, i, LONGEST if fault in _SLOW else STRETCH))
        for one, fault, at in zip(faulty, watch.fault, watch.since, strict=True)
    ])  # fmt: skip
    watch = watch._replace(due=np.where(followed, np.where(gone, np.inf, float(_LATER)), watch.due))
    if not (alarm.any() or (followed & ~gone).any()):
        return watch
    # A drift whose beginning is no longer seen looks like a bias: before one is named both are looked at from long ago.
    began = min((bisect_left(line.keys, at) for at in compress(watch.since, departs)), default=i + 1)
    for first in (min(i + 1, began + STRETCH // 2) - STRETCH, i + 1 - LONGEST)[: 1 if departs.any() else 2]:
        first = max(first, i + 1 - LONGEST, 0)
        # It begins with a state that took nothing of those.
        if any(at < line.keys[first] for at in compress(watch.since, gone & watch.out)):
            first = max(first, bisect_right(line.keys, watch.mended))
        # A stretch has one state, in which no doubt was decided.
        first = next((k + 1 for k in range(i - 1, first - 1, -1) if line.entries[k].moment.anew), first)
        if first >= i:
            return watch
        suspects = _watch.suspected(watch, (alarm[:-1] | followed | departs) & ~gone, party) & ~gone[party]
        causes = _faults.judged(_stretch(line, first, i, _watch.worths(watch)), gone[party], suspects)
        best = _by_sensor(causes, party)
        (who, fault), probability = max(best.items(), key=lambda one: one[1])
        doubts = [sum(p for (s, _), p in best.items() if s == one) for one in range(len(departs))]
        if who < 0 or doubts[who] <= _LIKELY or fault not in _SLOW:
            break
    # What is sure stays until the sensor has recovered; what was only likely does not.
    if who < 0:
        watch = _doubted(_set_free(watch, departs, party), doubts)
        if fault == MODEL and probability >= _SURE:
            onset = next(one.onset for one in causes if one.fault == fault)
            watch = watch._replace(model=probability, model_since=line.keys[first + onset])
        return watch
    if doubts[who] <= _LIKELY:
        return _doubted(watch, doubts)
    others = departs.copy()
    others[who] = False
    watch = _doubted(_set_free(watch, others, party), doubts)
    top = next(one for one in causes if one.component >= 0 and party[one.component] == who and one.fault == fault)
    sure = probability >= _SURE
    if watch.fault[who] > DEPARTS and not sure:
        return watch
    shown = (fault, probability) if sure else (DEPARTS, doubts[who])
    return _with(watch, who, *shown, top, line.keys[first + top.onset],
                 line.stands(first)[0].watch.statistics[:, SLOW], party)  # fmt: skip


def _early(line: Any, i: int, length: int) -> Any:
    """Return the key before which an onset is too near the beginning of a stretch."""
    first = max(i + 1 - length, 0)
    return line.keys[min(first + (first > 0) * STRETCH // 3, i)]


def _doubted(watch: Watch, doubts: list[float]) -> Watch:
    """Return how surely sensors are healthy, and that doubtful ones are looked at again soon."""
    doubt, healthy = np.array(doubts), watch.fault == HEALTHY
    odds = np.where(healthy, 1.0 - doubt, watch.odds)
    return watch._replace(odds=odds, due=np.where(healthy & (doubt > _DOUBTED), float(_SOON), watch.due))


def _with(
    watch: Watch, who: int, fault: int, probability: float, top: Found, since: Any, before: Array, owner: np.ndarray
) -> Watch:
    """Return that a sensor has a fault."""
    new, other = watch.fault[who] == HEALTHY, watch.fault[who] != fault
    mine = owner == who
    faults, odds, sizes, due = (a.copy() for a in (watch.fault, watch.odds, watch.size, watch.due))
    faults[who], odds[who], sizes[who] = fault, probability, top.size
    due[who] = _AGAIN if fault == DEPARTS else _LATER
    return watch._replace(
        fault=faults, odds=odds, size=sizes, due=due,
        since=(*watch.since[:who], since, *watch.since[who + 1 :]),
        # x, by which recovery is judged, took what it said until now.
        recent=np.where((mine & other)[:, None], 0.0, watch.recent),
        before=np.where(mine & new, before, watch.before),
    )  # fmt: skip


def _by_sensor(causes: list[Found], owner: np.ndarray) -> dict[tuple[int, int], float]:
    """Return the probability of each fault of each sensor; -1 is no sensor."""
    sums: dict[tuple[int, int], float] = {}
    for one in causes:
        key = (-1 if one.component < 0 else int(owner[one.component]), one.fault)
        sums[key] = sums.get(key, 0.0) + one.probability
    return sums


def _stretch(line: Any, first: int, last: int, worth: Array) -> Stretch:
    """Return the readings of some entries, with the model as it was about the states then."""
    setup, rows = line.setup, []
    before, key = line.stands(first)
    start = line.keys[first]
    for entry in line.entries[first : last + 1]:
        seconds = Clock.between(key, entry.key)
        moved = setup.motion.over(seconds, before.state.x, before.state.u)
        z = entry.z if before.doubt is None else np.where(setup.layout.owner == before.doubt.off, np.nan, entry.z)
        seen = setup.layout.seen_from(moved.F @ before.state.x + moved.drift, z)
        rows.append((*moved, Clock.between(start, entry.key), seen.z, seen.H))
        before, key = entry.moment or before, entry.key
    F, Q, drift, seconds_, z, H = (np.array(column) for column in zip(*rows, strict=True))
    state = line.stands(first)[0].state
    R = covariance(setup.layout, state.sizes).diagonal()
    scales, shares = setup.policy.shares(state.memory)
    z = np.where(np.isnan(state.sizes), np.nan, z)
    return Stretch(
        state.x, state.P, F, Q * setup.policy.slack(state.carried), drift, seconds_, z, H,
        line.stands(first)[0].watch.statistics[:, SLOW] * R, scales, shares, worth,
    )  # fmt: skip


def _mended(line: Any, i: int, watch: Watch) -> Moment:
    """Return the moment whose state never took what sensors have said since they lie."""
    owner, out = line.setup.layout.party, watch.out
    onsets = [at for at, left in zip(watch.since, out, strict=True) if left]
    first = next((k for k in range(i + 1) if line.keys[k] >= min(onsets)), i)
    first = max(first, i + 1 - LONGEST)
    moment, key = line.stands(first)
    for entry in line.entries[first : i + 1]:
        lies = np.array([left and at <= entry.key for at, left in zip(watch.since, out, strict=True)])
        seconds = Clock.between(key, entry.key)
        z = np.where(lies[owner], np.nan, entry.z)
        moment = doubted(line.setup, moment._replace(watch=None), seconds, entry.key, z, entry.control)
        key = entry.key
    return moment


def words(name: str, verdict: Verdict) -> str:
    """Return a verdict as a line."""
    if verdict.fault == "healthy":
        return f"{name} healthy"
    much = {
        "biased": f" by {verdict.size:.1f} standard deviations",
        "drifting": f" by {verdict.size:.2g} standard deviations a second",
        "noisier": f" {verdict.size:.0f} times",
    }.get(verdict.fault, "")
    # Nothing is as sure as 1.000.
    sure = "above 0.999" if verdict.probability >= 0.9995 else f"{verdict.probability:.3f}"
    odds = "" if verdict.fault == "silent" else f" (probability {sure})"
    since = "from the beginning" if verdict.since is None else f"since {written(verdict.since)}"
    return f"{name} {verdict.fault}{much} {since}{odds}: {verdict.remedy}"


def of_all(layout: Layout, moment: Moment) -> dict[str, Verdict]:
    """Return the verdict about each sensor, and about the "motion"."""
    verdicts = dict.fromkeys((*layout.names, "motion"), described("healthy"))
    watch = moment.watch
    if watch is not None:
        for s, (fault, since, party) in enumerate(zip(watch.fault, watch.since, layout.parties, strict=True)):
            kind, stamp = FAULTS[int(fault)], None if since is None else Clock.stamp(since)
            size = float(watch.size[s]) if kind in ("biased", "drifting", "noisier") else float("nan")
            verdict = described(kind, stamp, float(watch.odds[s]), size)
            verdicts.update({name: _shared(verdict, name, party) for name in party})
        if watch.model_since is not None:
            verdicts["motion"] = described("model is wrong", Clock.stamp(watch.model_since), watch.model)
    return {**verdicts, **_of_doubt(layout.names, moment.doubt)}


def _shared(verdict: Verdict, name: str, party: tuple[str, ...]) -> Verdict:
    """Return a verdict that says with whom a sensor is judged as one."""
    if verdict.fault == "healthy" or len(party) == 1:
        return verdict
    others = ", ".join(one for one in party if one != name)
    return verdict._replace(remedy=f"{verdict.remedy}; judged as one with {others}, of the same group")


def _of_doubt(names: tuple[str, ...], doubt: Any) -> dict[str, Verdict]:
    """Return what is said while readings and state are far apart, and after it as long as that may be undone."""
    if doubt is None or doubt.served < 0:
        return {}
    since, p = Clock.stamp(doubt.since), doubt.probability
    if not doubt.sure:
        return {names[doubt.sensor]: described("undecided", since, p)}
    verdicts = {names[doubt.off]: described("false", since, p)} if doubt.off >= 0 else {}
    return {**verdicts, "motion": described("jumped", since, p)} if doubt.moved else verdicts
