"""Verdicts: what is the matter with a sensor, since when, how surely, and what helps.

A cheap test of every reading raises an alarm (`_watch`), and then the last stamps are judged anew under every fault of
every sensor (`_faults`). What is all but certain is a verdict; what is more likely than not "departs", and is looked at
again. A sensor whose lie is no noise (biased, drifting, stuck) is left out of x, from the onset on, until its readings
are again as they were.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Generator, Sequence
from functools import partial
from itertools import compress
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy.fusion import _faults, _watch
from robust_filterpy.fusion._faults import Found, Stretch
from robust_filterpy.fusion._stepping import Moment, covariance, through
from robust_filterpy.fusion._table import Clock, written
from robust_filterpy.fusion._watch import BIASED, DEPARTS, DRIFTING, FAULTS, HEALTHY, MODEL, SLOW, Watch
from robust_filterpy.fusion.reacquisition import doubted
from robust_filterpy.fusion.sensors import Layout

__all__ = ["LONGEST", "Verdict", "described", "of_all", "watched", "words"]

# What has become of the verdicts after a look back.
_Conclusion: TypeAlias = Callable[[Watch], Watch]
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

    #: "healthy", "departs", "biased", "drifting", "stuck", "noisier", "spikes", "silent" or "model is wrong"; with
    #: ``reacquire`` "undecided", "false" or "jumped".
    fault: str
    #: Stamp of the onset, or of its last word if it is silent; None if it is healthy, or has never spoken.
    since: Any
    #: That it is this, given that a fault comes once in 10^5 readings and a manoeuvre once in 10^4 stamps; with
    #: ``reacquire`` given its prior.
    probability: float
    #: Of the fault, in standard deviations (biased), per second (drifting), or as a factor (noisier); else NaN.
    size: float
    #: What helps, in words.
    remedy: str

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


class Look:
    """A look back of which each stamp does a share; neither copied nor stored, since it can be begun again."""

    def __init__(self, key: Any, shares: Generator[float, None, _Conclusion]) -> None:
        """Begin, asked for at a stamp."""
        self.key, self._shares, self._stamps = key, shares, 0
        self._says: _Conclusion | None = None

    def __reduce__(self) -> tuple[Any, tuple[()]]:
        """Leave nothing in its place."""
        return type(None), ()

    def by(self, stamps: float) -> _Conclusion | None:
        """Return what it says once so many stamps, if infinite all that it takes, have done their share, else None."""
        while self._stamps < stamps and self._says is None:
            self._stamps, done, last = self._stamps + 1, 0.0, 0.0
            try:
                # As much as the last part, the next one is no more.
                while done + last < 1.0:
                    last = next(self._shares)
                    done += last
            except StopIteration as end:
                self._says = end.value
        return self._says if self._stamps <= stamps else None


def watched(line: Any, i: int, moment: Moment) -> Moment:
    """Return the moment of an entry with what its readings say about the sensors."""
    owner, before, key = line.setup.layout.party, moment.watch, moment.watch.asked
    # As at nearly every stamp; lists of a few numbers are faster than arrays.
    if key is None and before.calm and min(before.odds.tolist()) >= 1.0 - _DOUBTED:
        return moment
    if moment.doubt is not None and moment.doubt.served >= 0 and not moment.doubt.sure:
        # First it is decided whether a sensor or the state was wrong.
        return moment
    watch = before
    if key is None:
        well = _watch.recovered(before, owner)
        watch = _watch.begun_anew(_set_free(before, well, owner), well, owner) if well.any() else before
        alarm, followed = _asking(watch, owner)
        key = line.keys[i] if alarm.any() or followed.any() else None
    if key is not None:
        at = bisect_left(line.keys, key)
        # One that Ctrl-C has interrupted is begun again.
        look, line.look = line.look, None
        if look is None or look.key != key:
            look = Look(key, _look(line, key, watch if at == i else line.entries[at].moment.watch))
        says = look.by(math.inf if line.ends else i - at + 1)
        line.look = look
        watch = watch._replace(asked=key) if says is None else says(watch)
    if watch is before:
        return moment
    left = watch.out
    since = np.array([a != b for a, b in zip(watch.since, before.since, strict=True)])
    if (left & (since | ~before.out)).any():
        watch = _watch.begun_anew(watch, left, owner)._replace(mended=line.keys[i])
        as_if = _mended(line, i, moment, watch)
        return moment._replace(watch=watch, state=as_if.state, doubt=as_if.doubt)
    return moment._replace(watch=watch)


def _set_free(watch: Watch, sensors: np.ndarray, owner: np.ndarray) -> Watch:
    """Return that nothing is the matter with some sensors."""
    recent = np.where(sensors[owner][:, None], 0.0, watch.recent)
    since = tuple(None if free else at for free, at in zip(sensors, watch.since, strict=True))
    fault, odds = np.where(sensors, 0.0, watch.fault), np.where(sensors, 1.0, watch.odds)
    return watch._replace(fault=fault, odds=odds, since=since, recent=recent)


def _asking(watch: Watch, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return for whom there is an alarm, the model last, (S + 1,), and who is to be looked at again, (S,)."""
    alarm = _watch.alarmed(watch, owner)
    alarm[:-1] &= watch.fault == HEALTHY
    return alarm, ((watch.fault > HEALTHY) | (watch.odds < 1.0 - _DOUBTED)) & (watch.due <= 0.0)


def _look(line: Any, key: Any, watch: Watch) -> Generator[float, None, _Conclusion]:
    """Judge the stamps up to one anew; yield after each part how much it is of what one stamp should do."""
    party, departs, i = line.setup.layout.party, watch.fault == DEPARTS, bisect_left(line.keys, key)
    alarm, followed = _asking(watch, party)
    # Who has a verdict stays where he is, and says nothing, when another is in doubt, or if he had it before the
    # stretch begins. How fast one drifts is seen the better the longer.
    faulty = watch.fault > DEPARTS
    alone = faulty.sum() < 2 and not (alarm.any() or departs.any() or (followed & ~faulty).any())
    gone = np.array([
        one and not (alone and at >= _early(line, i, LONGEST if fault in _SLOW else STRETCH))
        for one, fault, at in zip(faulty, watch.fault, watch.since, strict=True)
    ])  # fmt: skip
    says = partial(_after_a_look, party=party, alarm=alarm, followed=followed, gone=gone)
    if not (alarm.any() or (followed & ~gone).any()):
        return says
    # A drift whose beginning is no longer seen looks like a bias: before one is named both are looked at from long ago.
    began = min((bisect_left(line.keys, at) for at in compress(watch.since, departs)), default=i + 1) - i
    for back in (min(1, began + STRETCH // 2) - STRETCH, 1 - LONGEST)[: 1 if departs.any() else 2]:
        # Others may have been let go meanwhile.
        i = bisect_left(line.keys, key)
        first = max(i + back, i + 1 - LONGEST, 0)
        # It begins with a state that took nothing of those.
        if any(at < line.keys[first] for at in compress(watch.since, gone & watch.out)):
            first = max(first, bisect_right(line.keys, watch.mended))
        # A stretch has one state, in which no doubt was decided.
        first = next((k + 1 for k in range(i - 1, first - 1, -1) if line.entries[k].moment.anew), first)
        if first >= i:
            return partial(says, causes=())
        suspects = _watch.suspected(watch, (alarm[:-1] | followed | departs) & ~gone, party) & ~gone[party]
        keys, usual = line.keys[first : i + 1], line.stands(first)[0].watch.statistics[:, SLOW]
        causes = yield from _faults.judged(_stretch(line, first, i, _watch.worths(watch)), gone[party], suspects)
        says = partial(says, causes=causes, keys=keys, usual=usual)
        who, fault, probability, _ = _most_likely(causes, party)
        if who < 0 or probability < _SURE or fault not in _SLOW:
            break
    return says


def _after_a_look(
    watch: Watch, party: np.ndarray, alarm: np.ndarray, followed: np.ndarray, gone: np.ndarray,
    causes: Sequence[Found] = (), keys: Sequence[Any] = (), usual: Any = None,
) -> Watch:  # fmt: skip
    """Return the verdicts once stamps have been judged anew; usual: factors of the components' noise before them."""
    departs = watch.fault == DEPARTS
    watch = _watch.cleared(watch, alarm | np.append(followed, False), party)
    watch = watch._replace(asked=None, due=np.where(followed, np.where(gone, np.inf, float(_LATER)), watch.due))
    if not causes:
        return watch
    who, fault, probability, doubts = _most_likely(causes, party)
    # What is sure stays until the sensor has recovered; what was only likely does not.
    if who < 0:
        watch = _doubted(_set_free(watch, departs, party), doubts)
        if fault == MODEL and probability >= _SURE:
            onset = next(one.onset for one in causes if one.fault == fault)
            watch = watch._replace(model=probability, model_since=keys[onset])
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
    return _with(watch, who, *shown, top, keys[top.onset], usual, party)


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


def _most_likely(causes: Sequence[Found], owner: np.ndarray) -> tuple[int, int, float, list[float]]:
    """Return the most probable fault of a sensor, whose (-1: nobody's) and how surely, and what is doubted of each."""
    sums: dict[tuple[int, int], float] = {}
    for one in causes:
        key = (-1 if one.component < 0 else int(owner[one.component]), one.fault)
        sums[key] = sums.get(key, 0.0) + one.probability
    (who, fault), probability = max(sums.items(), key=lambda one: one[1])
    return who, fault, probability, [sum(p for (s, _), p in sums.items() if s == i) for i in range(max(owner) + 1)]


def _stretch(line: Any, first: int, last: int, worth: Array) -> Stretch:
    """Return the readings of some entries, with the model as it was about the states then."""
    setup, layout, (dts, zs, befores) = line.setup, line.setup.layout, _between(line, first, last)
    xs, us = (np.array([getattr(moment.state, name) for moment in befores]) for name in "xu")
    off = np.array([-1 if moment.doubt is None else moment.doubt.off for moment in befores])
    z, H = np.where(layout.owner == off[:, None], np.nan, zs), np.tile(layout.H, (len(zs), 1, 1))
    F, Q, drift = setup.motion.over_each(dts, xs, us)
    for k in range(len(z) if layout.curved else 0):
        z[k], H[k], _ = layout.seen_from(F[k] @ xs[k] + drift[k], z[k])
    state, watch = befores[0].state, befores[0].watch
    scales, shares = setup.policy.shares(state.memory)
    return Stretch(
        state.x, state.P, F, Q * setup.policy.slack(state.carried), drift, np.cumsum(dts) - dts[0],
        np.where(np.isnan(state.sizes), np.nan, z), H,
        watch.statistics[:, SLOW] * covariance(layout, state.sizes).diagonal(), scales, shares, worth,
    )  # fmt: skip


def _between(line: Any, first: int, last: int) -> tuple[Array, Array, list[Moment]]:
    """Return the seconds to each of some entries, what was read there, and the moments before."""
    stood, entries = [line.stands(k) for k in range(first, last + 1)], line.entries[first : last + 1]
    dts = [Clock.between(key, entry.key) for (_, key), entry in zip(stood, entries, strict=True)]
    return np.array(dts), np.array([entry.z for entry in entries]), [moment for moment, _ in stood]


def _mended(line: Any, i: int, now: Moment, watch: Watch) -> Moment:
    """Return the moment whose state never took what sensors have said since they lie."""
    setup, out = line.setup, watch.out[line.setup.layout.party]
    onsets = [at for at, left in zip(watch.since, watch.out, strict=True) if left]
    first = max(bisect_left(line.keys, min(onsets), 0, i), i + 1 - LONGEST)
    dts, zs, (moment, *later) = _between(line, first, i)
    entries, (K, n) = line.entries[first : i + 1], (len(zs), setup.layout.n)
    for c in np.flatnonzero(out):
        zs[[entry.key >= watch.since[setup.layout.party[c]] for entry in entries], c] = np.nan
    if setup.reacquire is None:
        us = np.array([before.state.u for before in (*later, now)])
        rows = np.empty((K, n)), np.empty((K, n, n)), np.empty(zs.shape)
        return through(setup, moment._replace(watch=None), dts, zs, us, rows)[0]
    for seconds, z, entry in zip(dts.tolist(), zs, entries, strict=True):
        moment = doubted(setup, moment._replace(watch=None), seconds, entry.key, z, entry.control)
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
