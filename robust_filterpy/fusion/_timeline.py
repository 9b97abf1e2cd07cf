"""What was read when, and what follows from it, judged anew after a late reading; all of it as plain arrays, and back.

Each stamp has one entry, with what all sensors read then. What follows from an entry is kept with it until
something earlier arrives; then it is dirty, and judged anew when somebody asks. So the order of arrival plays no part,
to the last bit. Entries older than the window take nothing more; some of them are kept as history.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from itertools import compress, islice, pairwise
from typing import Any

import numpy as np

from robust_filterpy import _state
from robust_filterpy._checks import Array
from robust_filterpy.fusion._stepping import Moment, Setup, arrays, begun, of_arrays
from robust_filterpy.fusion._table import Clock
from robust_filterpy.fusion.reacquisition import Doubt, doubted
from robust_filterpy.fusion.verdicts import Look, watched

#: Entries that are kept, however long the window is: one late reading makes all after it be judged anew, and to look
#: back at sensors costs the more, the more there are.
MOST, MOST_WATCHED = 50_000, 5000


class Entry:
    """What was read at one stamp."""

    __slots__ = ("control", "key", "moment", "spoke", "z")

    def __init__(self, key: float | int, size: int) -> None:
        """Start with nothing read."""
        self.key, self.z, self.control = key, np.full(size, np.nan), None
        #: Names of the sensors that have said something, if only NaN.
        self.spoke: set[str] = set()
        self.moment: Moment | None = None


class Timeline:
    """Keep entries in the order of their stamps, and judge them when asked."""

    def __init__(self, setup: Setup, base: Moment, window: float, history: int) -> None:
        """Start empty."""
        self.setup, self.base, self.window, self.history = setup, base, window, history
        self.most = MOST_WATCHED if setup.watches or setup.reacquire is not None else MOST
        self.entries: list[Entry] = []
        self.keys: list[Any] = []
        #: Key of the moment that `base` is of; None before the first stamp, when no time has passed yet.
        self.base_key: float | int | None = None
        #: Entries before this one have their moments.
        self.clean = 0
        self.judging = False
        #: Whether nothing follows the entry that is judged: a look back then waits for no more stamps.
        self.ends = False
        #: A look back that is under way (`verdicts.Look`), or was the last.
        self.look: Look | None = None
        #: When each sensor has spoken last, and when by the entries that are no longer kept.
        self.latest: dict[str, float | int] = {}
        self.earlier: dict[str, float | int] = {}
        #: How many readings of each sensor could not be used, of entries that are no longer kept.
        self.unusable: dict[str, int] = {}
        #: First reading of each sensor that could not be used: its stamp's key, and why.
        self.reasons: dict[str, tuple[float | int, str]] = {}

    @property
    def horizon(self) -> float | int | None:
        """Key before which nothing is taken any more; None while everything is."""
        if not self.keys:
            return self.base_key
        closed = Clock.moved(self.keys[-1], -self.window)
        return closed if self.base_key is None else max(closed, self.base_key)

    @property
    def begun(self) -> float | int | None:
        """Key of the first moment that is kept; None if there is none."""
        return self.base_key if self.base_key is not None or not self.keys else self.keys[0]

    def at(self, key: float | int) -> Entry:
        """Return the entry of a stamp, a new one if there is none; from it on everything is dirty."""
        self.require_rest()
        i = bisect_left(self.keys, key)
        self.clean = min(self.clean, i)
        if self.look is not None and key <= self.look.key:
            self.look = None
        if i == len(self.keys) or self.keys[i] != key:
            self.entries.insert(i, Entry(key, self.setup.layout.size))
            self.keys.insert(i, key)
        return self.entries[i]

    def hear(self, entry: Entry, sensor: str) -> None:
        """Note that a sensor has spoken, if only NaN."""
        self.latest[sensor] = max(self.latest.get(sensor, entry.key), entry.key)
        entry.spoke.add(sensor)

    def require_rest(self) -> None:
        """Raise while an entry is judged: a function of a sensor or of the motion has called its own fusion."""
        if self.judging:
            raise RuntimeError("fusion: expected no call of it from a function of its own sensors or motion")
        # Ctrl-C may come between the two insertions of `at`.
        if len(self.keys) != len(self.entries):
            self.keys = [entry.key for entry in self.entries]

    def find(self, key: float | int) -> Entry | None:
        """Return the entry of a stamp, if there is one."""
        self.require_rest()
        i = bisect_left(self.keys, key)
        return self.entries[i] if i < len(self.keys) and self.keys[i] == key else None

    def until(self, key: float | int | None = None) -> tuple[Moment, float | int | None, int]:
        """Return what there is after all entries up to a stamp, the last of their keys, and their number."""
        self.require_rest()
        last = len(self.keys) if key is None else bisect_right(self.keys, key)
        self.judging = True
        try:
            while self.clean < last:
                self._judge(self.clean)
                self.clean += 1
        finally:
            self.judging = False
        if not last:
            return self.base, self.base_key, 0
        return self.entries[last - 1].moment, self.keys[last - 1], last  # type: ignore[return-value]

    def _judge(self, i: int) -> None:
        """Judge an entry by those before it."""
        entry = self.entries[i]
        before, key = self.stands(i)
        seconds = Clock.between(key, entry.key)
        moment = doubted(self.setup, before, seconds, entry.key, entry.z, entry.control)
        entry.moment = moment if moment.watch is None else watched(self, i, moment)
        for name, why in moment.failed:
            self.reasons.setdefault(name, (entry.key, why))

    def stands(self, i: int) -> tuple[Moment, float | int | None]:
        """Return what there is before an entry, and of when it is."""
        if not i:
            return self.base, self.base_key
        # An entry before this one has been judged.
        return self.entries[i - 1].moment, self.keys[i - 1]  # type: ignore[return-value]

    def forget(self) -> bool:
        """Let go of entries that are neither in the window nor wanted as history, or too many; return if too many."""
        if self.horizon is None:
            return False
        closed = bisect_left(self.keys, self.horizon)
        crowded = len(self.keys) - self.most > closed
        # A few hundred at a time: to shorten a list costs as much as it has left.
        least = max(64, self.history // 4)
        beyond = len(self.keys) - self.most if crowded else closed - self.history
        if beyond < least:
            return False
        closed = max(closed, beyond)
        # All that is final is judged while its past is there.
        self.until(self.keys[closed - 1])
        base, key, _ = self.until(self.keys[beyond - 1])
        earlier = self.last_words(beyond)
        unusable = self.failures(self.entries[:beyond])
        # No call from here on, so that Ctrl-C cannot fall between what belongs together.
        self.base, self.base_key, self.earlier, self.unusable = base, key, earlier, unusable
        del self.entries[:beyond], self.keys[:beyond]
        self.clean -= beyond
        return crowded

    def failures(self, entries: list[Entry]) -> dict[str, int]:
        """Return how many readings of each sensor could not be used, in these entries and those no longer kept."""
        counts = dict(self.unusable)
        for entry in entries:
            for name, _ in entry.moment.failed if entry.moment is not None else ():
                counts[name] = counts.get(name, 0) + 1
        return counts

    def last_words(self, entries: int) -> dict[str, float | int]:
        """Return when each sensor has spoken last, in the first entries; who never has is left out."""
        if entries == len(self.entries):
            return dict(self.latest)
        words: dict[str, float | int] = {}
        for i in range(entries - 1, -1, -1):
            words = {**dict.fromkeys(self.entries[i].spoke, self.keys[i]), **words}
            if len(words) == len(self.latest):
                return words
        return {**self.earlier, **words}

    def intervals(self, entries: int) -> dict[str, float]:
        """Return the median seconds between two readings of each sensor, in the first entries; of two at least."""
        part = self.entries[:entries]
        keys = {name: [one.key for one in part if name in one.spoke] for name in self.setup.layout.names}
        apart = {name: [Clock.between(a, b) for a, b in pairwise(at)] for name, at in keys.items()}
        return {name: float(np.median(seconds)) for name, seconds in apart.items() if len(seconds) > 1}

    def readings(self) -> Array:
        """Return what was read at every entry that is kept, (entries, M)."""
        return np.array([entry.z for entry in self.entries]).reshape(len(self.entries), self.setup.layout.size)


_KINDS = ("", "numbers", "instants")
_NANO = 1_000_000_000
# Arrays with a row for each stamp, or of a length of their own.
_LISTS = ("base", "keys", "z", "controls", "controlled", "spoke", "moments")
# As `arrays` gives them.
_ARRAYS = ("means", "covariances", "belief", "memory", "x", "P", "sizes", "u", "trial")


def state_of(timeline: Timeline, clock: Clock, counts: Any, outcomes: tuple[str, ...]) -> dict[str, Array]:
    """Return everything as arrays."""
    base, names = timeline.base.state, timeline.setup.layout.names
    p = timeline.setup.motion.dim_u
    controls = [np.full(p, np.nan) if e.control is None else e.control for e in timeline.entries]
    further: dict[str, Any] = {}
    if timeline.setup.watches or timeline.setup.reacquire is not None:
        # All of those that are watched, since a verdict looks back further than is kept.
        entries = timeline.entries[: timeline.clean] if timeline.setup.watches else []
        moments = [timeline.base, *(entry.moment for entry in entries)]
        pattern = _tree(timeline.setup)
        further["moments"] = np.array([_row(_tree(timeline.setup, moment), pattern) for moment in moments if moment])
    return _state.labelled("Fusion", {
        **dict(zip(_ARRAYS, arrays(timeline.setup.policy, base), strict=True)),
        "kind": _KINDS.index(clock.kind), "base": _split([] if timeline.base_key is None else [timeline.base_key]),
        "keys": _split(timeline.keys), "z": timeline.readings(),
        "controls": np.array(controls).reshape(len(controls), p),
        "controlled": [e.control is not None for e in timeline.entries],
        "spoke": np.array([[n in e.spoke for n in names] for e in timeline.entries]).reshape(-1, len(names)),
        "earlier_known": [n in timeline.earlier for n in names],
        "earlier": _split([timeline.earlier.get(n, 0) for n in names]),
        "counts": [[counts[n][o] + (o == "refused") * timeline.unusable.get(n, 0) for o in outcomes] for n in names],
        **further,
    })  # fmt: skip


def restored(like: Timeline, given: Any, outcomes: tuple[str, ...]) -> tuple[Timeline, Clock, Any]:
    """Return what a state says, for a fusion made like this one, or raise."""
    _state.require_kind(given, "Fusion")
    policy, names = like.setup.policy, like.setup.layout.names
    # What a fusion gives that is made like this one and has read nothing says which arrays there are, and their shapes.
    empty = Timeline(like.setup, begun(like.setup, like.base.state.x, like.base.state.P), like.window, like.history)
    pattern = state_of(empty, Clock(), {name: dict.fromkeys(outcomes, 0) for name in names}, outcomes)
    needed: dict[str, _state.Shape] = {
        name: (None, *part.shape[1:]) if name in _LISTS else part.shape
        for name, part in pattern.items() if name != _state.LABEL
    }  # fmt: skip
    if "moments" in given and "moments" not in needed:
        raise _state.StateError("state: expected one of a fusion without watch=True and reacquire, got one with them")
    got = _state.checked(given, "Fusion", needed, {}, ("z", "controls", "sizes", "moments"))
    entries, stamps = len(got["keys"]), np.vstack([got["keys"], got["base"], got["earlier"]])
    for good, expected in (
        (1 <= len(got.get("moments", [0])) <= entries + 1, f"at most {entries + 1} moments and one"),
        (all(len(got[name]) == entries for name in ("z", "controls", "controlled", "spoke")) and len(got["base"]) < 2,
         "as many z, controls and spoke as keys, and at most one base"),
        (got["kind"] in range(3), f"kind 0, 1 or 2, got {got['kind']}"),
        (not (got["sizes"] <= 0.0).any() and (got["counts"] >= 0.0).all(), "sizes > 0 and counts >= 0, got less"),
    ):  # fmt: skip
        if not good:
            raise _state.StateError(f"state: expected {expected}")
    if np.isnan(got["controls"][got["controlled"] != 0.0]).any():
        raise _state.StateError("state: expected a control of every entry that is controlled, got NaN")
    if got["kind"] == 2 and (np.abs(stamps) > (2**63 - 1) // _NANO).any():
        raise _state.StateError("state: expected stamps that nanoseconds hold, got larger ones")
    clock = Clock(_KINDS[int(got["kind"])])
    keys, start = _joined(got["keys"], clock.kind), _joined(got["base"], clock.kind)
    if any(later <= earlier for earlier, later in pairwise(keys)) or (start and keys and keys[0] < start[0]):
        raise _state.StateError("state: expected keys that ascend, after base")
    try:
        stood = of_arrays(policy, [got[name] for name in _ARRAYS])
    except ValueError as error:
        raise _state.StateError(str(error)) from None
    line = Timeline(like.setup, Moment(stood), like.window, like.history)
    line.base_key = start[0] if start else None
    for i, key in enumerate(keys):
        entry = line.at(key)
        entry.z[:] = got["z"][i]
        for name in compress(names, got["spoke"][i]):
            line.hear(entry, name)
        entry.control = got["controls"][i] if got["controlled"][i] else None
    if "moments" in got:
        tree = _tree(like.setup)
        line.base, *moments = (_moment_of(row, tree, like.setup, clock.kind) for row in got["moments"])
        line.clean = len(moments)
        for entry, moment in zip(line.entries, moments, strict=False):
            entry.moment = moment
    earlier = zip(names, got["earlier_known"], _joined(got["earlier"], clock.kind), strict=True)
    line.earlier = {name: key for name, there, key in earlier if there}
    line.latest = {**line.earlier, **line.latest}
    counts = {
        name: {o: int(c) for o, c in zip(outcomes, row, strict=True)}
        for name, row in zip(names, got["counts"], strict=True)
    }
    return line, clock, counts


def _tree(setup: Setup, moment: Moment | None = None) -> tuple[Any, ...]:
    """Return what a moment is made of as a tree of tuples, a moment like those of a setup if none is given."""
    if moment is None:
        moment = begun(setup, np.zeros(setup.layout.n), np.eye(setup.layout.n))
    S, D = len(setup.layout.names), setup.layout.n + setup.layout.size
    no_doubt = Doubt(0, None, 0, -1, False, np.zeros((S + 3, D)), np.zeros((S + 3, D, D)), np.zeros(S + 3), np.zeros(S))
    doubt, failed = moment.doubt, {name for name, _ in moment.failed}
    flags = *(name in failed for name in setup.layout.names), moment.far, moment.anew, doubt is not None
    return arrays(setup.policy, moment.state), moment.watch or (), flags, (doubt or no_doubt) if setup.reacquire else ()


def _row(tree: Any, pattern: Any) -> Array:
    """Return a tree like a pattern as one vector; what is at infinity, which no state holds, is the largest number."""
    parts: list[Any] = []
    for leaf, like in zip(_leaves(tree), _leaves(pattern), strict=True):
        # None where there may be a key.
        parts.append([leaf is not None, *_split([leaf or 0])[0]] if like is None else np.ravel(leaf))
    return np.nan_to_num(np.concatenate(parts), nan=np.nan)


def _leaves(tree: Any) -> list[Any]:
    """Return the parts of a tree of tuples that are none."""
    return [leaf for part in tree for leaf in _leaves(part)] if isinstance(tree, tuple) else [tree]


def _moment_of(row: Array, pattern: tuple[Any, ...], setup: Setup, kind: str) -> Moment:
    """Return the moment of a vector, or raise."""
    unbounded = np.abs(row) == np.finfo(float).max
    if (np.isnan(row) & ~np.isnan(_row(pattern, pattern))).any():
        raise _state.StateError("state: expected finite numbers in moments, got NaN")
    numbers, names = iter(np.where(unbounded, np.copysign(np.inf, row), row).tolist()), setup.layout.names

    def filled(like: Any) -> Any:
        """Return a part of the tree with the next numbers."""
        if isinstance(like, tuple):
            parts = [filled(one) for one in like]
            return like._make(parts) if hasattr(like, "_make") else tuple(parts)
        if isinstance(like, np.ndarray):
            return np.array(list(islice(numbers, like.size))).reshape(like.shape)
        if like is not None:
            return type(like)(next(numbers))
        there, *pair = islice(numbers, 3)
        return _joined(np.array([pair]), kind)[0] if there else None

    state, watch, (*failed, far, anew, doubtful), doubt = filled(pattern)
    if doubtful and not (0 <= doubt.sensor < len(names) and -1 <= doubt.served < len(names) + 3):
        raise _state.StateError(f"state: expected a doubt of one of {len(names)} sensors, got moments with another")
    why = tuple((name, "as it was when the state was kept") for name, bad in zip(names, failed, strict=True) if bad)
    state = of_arrays(setup.policy, state)
    return Moment(state, watch or None, why, doubt if doubtful else None, far, anew)


def _split(keys: Any) -> Array:
    """Return keys as pairs of floats: seconds and nanoseconds of an instant, the number and 0 of a number."""
    pairs = [divmod(int(k), _NANO) if isinstance(k, (int, np.integer)) else (k, 0) for k in keys]
    return np.array(pairs, dtype=float).reshape(len(pairs), 2)


def _joined(pairs: Array, kind: str) -> list[Any]:
    """Return keys again."""
    if kind == "instants":
        return [int(s) * _NANO + int(ns) for s, ns in pairs.tolist()]
    return [s for s, _ in pairs.tolist()]
