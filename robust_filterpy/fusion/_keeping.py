"""A fusion as plain arrays, and back: what there was before the oldest entry that is kept, and what was read since."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy import _state
from robust_filterpy._checks import Array
from robust_filterpy.fusion._policies import arrays, of_arrays
from robust_filterpy.fusion._stepping import Moment, Setup, begun
from robust_filterpy.fusion._table import Clock
from robust_filterpy.fusion._timeline import Timeline
from robust_filterpy.fusion._watch import Watch
from robust_filterpy.fusion.reacquisition import Doubt
from robust_filterpy.fusion.sensors import Layout

__all__ = ["restored", "state"]

_KINDS = ("", "numbers", "instants")
_NANO = 1_000_000_000
# As `arrays` gives them.
_ARRAYS = ("means", "covariances", "belief", "memory", "x", "P", "sizes", "u", "trial")
# Fields of a `Watch` that are stamps.
_STAMPS = ("since", "model_since", "mended")


def state(timeline: Timeline, clock: Clock, counts: Any, outcomes: tuple[str, ...]) -> dict[str, Array]:
    """Return everything as arrays."""
    base, names = timeline.base.state, timeline.setup.layout.names
    p = timeline.setup.motion.dim_u
    controls = [np.full(p, np.nan) if e.control is None else e.control for e in timeline.entries]
    watched = _watched(timeline) if timeline.setup.watches else {}
    doubted = {} if timeline.setup.reacquire is None else {"doubt": _of_doubt(timeline.base.doubt)}
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
        **watched, **doubted,
    })  # fmt: skip


def restored(like: Timeline, given: Any, outcomes: tuple[str, ...]) -> tuple[Timeline, Clock, Any]:
    """Return what a state says, for a fusion made like this one, or raise."""
    _state.require_kind(given, "Fusion")
    layout, base = like.setup.layout, like.base.state
    policy, M, p, names = like.setup.policy, layout.size, like.setup.motion.dim_u, layout.names
    needed: dict[str, _state.Shape] = {
        **{name: part.shape for name, part in zip(_ARRAYS, arrays(policy, base), strict=True)}, "kind": (),
        "base": (None, 2), "keys": (None, 2), "z": (None, M),
        "controls": (None, p), "controlled": (None,), "spoke": (None, len(names)), "earlier_known": (len(names),),
        "earlier": (len(names), 2), "counts": (len(names), len(outcomes)),
    }  # fmt: skip
    length = _flat(like.setup, like.base).size if like.setup.watches else 0
    if like.setup.watches:
        needed["moments"] = (None, length)
    elif "moments" in given:
        raise _state.StateError("state: expected one of a fusion that does not watch, got one of watch=True")
    if like.setup.reacquire is not None:
        needed["doubt"] = (None,)
    elif "doubt" in given:
        raise _state.StateError("state: expected one of a fusion without reacquire, got one with it")
    got = _state.checked(given, "Fusion", needed, {}, ("z", "controls", "sizes", "moments"))
    entries = len(got["keys"])
    if like.setup.watches and not 1 <= len(got["moments"]) <= entries + 1:
        raise _state.StateError(f"state: expected at most {entries + 1} moments and one, got {len(got['moments'])}")
    if any(len(got[name]) != entries for name in ("z", "controls", "controlled", "spoke")) or len(got["base"]) > 1:
        raise _state.StateError("state: expected as many z, controls and spoke as keys, and at most one base")
    if got["kind"] not in range(3):
        raise _state.StateError(f"state: expected kind 0, 1 or 2, got {got['kind']}")
    if (got["sizes"] <= 0.0).any() or (got["counts"] < 0.0).any():
        raise _state.StateError("state: expected sizes > 0 and counts >= 0, got less")
    if np.isnan(got["controls"][got["controlled"] != 0.0]).any():
        raise _state.StateError("state: expected a control of every entry that is controlled, got NaN")
    stamps = np.vstack([got["keys"], got["base"], got["earlier"]])
    if got["kind"] == 2 and (np.abs(stamps) > (2**63 - 1) // _NANO).any():
        raise _state.StateError("state: expected stamps that nanoseconds hold, got larger ones")
    clock = Clock(_KINDS[int(got["kind"])])
    keys, start = _joined(got["keys"], clock.kind), _joined(got["base"], clock.kind)
    if any(b <= a for a, b in zip(start[:1] + keys[:-1], keys, strict=False)) and (start[:1] + keys) != sorted(
        set(start[:1]) | set(keys)
    ):
        raise _state.StateError("state: expected keys that ascend, after base")
    try:
        stood = of_arrays(policy, [got[name] for name in _ARRAYS])
    except ValueError as error:
        raise _state.StateError(str(error)) from None
    doubt = _doubt_of(got.get("doubt", np.zeros(0)), like, clock.kind)
    line = Timeline(like.setup, Moment(stood, doubt=doubt), like.window, like.history)
    line.base_key = start[0] if start else None
    for i, key in enumerate(keys):
        entry = line.at(key)
        entry.z[:] = got["z"][i]
        entry.spoke = {name for name, spoke in zip(names, got["spoke"][i], strict=True) if spoke}
        entry.control = got["controls"][i] if got["controlled"][i] else None
    if like.setup.watches:
        first, *moments = [_unflat(row, like, clock.kind) for row in got["moments"]]
        line.base, line.clean = first, len(moments)
        for entry, moment in zip(line.entries, moments, strict=False):
            entry.moment = moment
    earlier = zip(names, got["earlier_known"], _joined(got["earlier"], clock.kind), strict=True)
    line.earlier = {name: key for name, there, key in earlier if there}
    counts = {
        name: {o: int(c) for o, c in zip(outcomes, row, strict=True)}
        for name, row in zip(names, got["counts"], strict=True)
    }
    return line, clock, counts


def _watched(timeline: Timeline) -> dict[str, Any]:
    """Return what a fusion that watches has besides: all moments, since a verdict looks back further than is kept."""
    moments = [timeline.base, *(entry.moment for entry in timeline.entries[: timeline.clean])]
    return {"moments": np.array([_flat(timeline.setup, moment) for moment in moments])}


def _flat(setup: Setup, moment: Any) -> Array:
    """Return a moment that is watched as one vector; what a function of a sensor said when it failed is not in it."""
    watch, names, failed = moment.watch, setup.layout.names, {name for name, _ in moment.failed}
    numbers = [value for name, value in zip(Watch._fields, watch, strict=True) if name not in _STAMPS]
    stamps = [[at is not None, *_split([at or 0])[0]] for at in (*watch.since, watch.model_since, watch.mended)]
    flags = [*(name in failed for name in names), moment.far, moment.anew]
    parts = [*arrays(setup.policy, moment.state), *numbers, stamps, flags]
    if setup.reacquire is not None:
        doubt = _of_doubt(moment.doubt)
        parts += [len(doubt) > 0, doubt if len(doubt) else np.zeros(_length_of_doubt(setup.layout))]
    # A look that is never due again is at infinity, which no state holds.
    return np.nan_to_num(np.concatenate([np.ravel(np.asarray(part, dtype=float)) for part in parts]), nan=np.nan)


def _unflat(row: Array, like: Timeline, kind: str) -> Moment:
    """Return the moment of a vector, shaped as those of the fusion that takes it over."""
    at, setup, base = 0, like.setup, begun(like.setup, like.base.state.x, like.base.state.P)
    policy, names = setup.policy, setup.layout.names

    def taken(pattern: Any) -> Any:
        nonlocal at
        shape = np.shape(pattern)
        part = row[at : at + int(np.prod(shape))].reshape(shape).copy()
        at += part.size
        return part if shape else float(part)

    state = [taken(part) for part in arrays(policy, base.state)]
    numbers = {name: taken(value) for name, value in zip(Watch._fields, base.watch, strict=True) if name not in _STAMPS}
    stamps, failed = taken(np.zeros((len(setup.layout.parties) + 2, 3))), taken(np.zeros(len(names)))
    far, anew = taken(np.zeros(2)).tolist()
    rest = row[at:]
    if not all(np.isfinite(part).all() for name, part in numbers.items() if name != "statistics") or not all(
        np.isfinite(part).all() for part in (*state[:6], stamps, rest)
    ):
        raise _state.StateError("state: expected finite numbers in moments, got NaN")
    numbers["due"][numbers["due"] == np.finfo(float).max] = np.inf
    since = [_joined(pair[1:][None], kind)[0] if pair[0] else None for pair in stamps]
    why = tuple((name, "as it was when the state was kept") for name, bad in zip(names, failed, strict=True) if bad)
    watch = Watch(**numbers, since=tuple(since[:-2]), model_since=since[-2], mended=since[-1])
    doubt = _doubt_of(rest[1:], like, kind) if len(rest) and rest[0] else None
    return Moment(of_arrays(policy, state), watch, why, doubt, int(far), bool(anew))


def _of_doubt(doubt: Doubt | None) -> Array:
    """Return what is in doubt as one vector, of length 0 if nothing is; no probability is the least number."""
    if doubt is None:
        return np.zeros(0)
    parts = [_split([part]) if name == "since" else part for name, part in doubt._asdict().items()]
    return np.nan_to_num(np.concatenate([np.ravel(np.asarray(part, dtype=float)) for part in parts]))


def _length_of_doubt(layout: Layout) -> int:
    """Return how many numbers say what is in doubt."""
    S, D = len(layout.names), layout.n + layout.size
    return 6 + (S + 3) * (D + D * D + 1) + S


def _doubt_of(row: Array, like: Timeline, kind: str) -> Doubt | None:
    """Return what is in doubt, or raise."""
    if not len(row):
        return None
    layout = like.setup.layout
    S, D = len(layout.names), layout.n + layout.size
    N = S + 3
    parts = np.split(row, np.cumsum([1, 2, 1, 1, 1, N * D, N * D * D, N]))
    if len(row) != _length_of_doubt(layout):
        raise _state.StateError("state: expected one of a fusion with as many sensors and states, and reacquire alike")
    sensor, since, agreed, served, sure, x, P, logs, quiet = parts
    if not (0 <= sensor[0] < S and -1 <= served[0] < N):
        raise _state.StateError(f"state: expected a doubt of one of {S} sensors, got {sensor[0]} and {served[0]}")
    return Doubt(
        int(sensor[0]), _joined(since[None], kind)[0], int(agreed[0]), int(served[0]), bool(sure[0]),
        x.reshape(N, D).copy(), P.reshape(N, D, D).copy(), np.where(logs < -1e300, -np.inf, logs), quiet.copy(),
    )  # fmt: skip


def _split(keys: Any) -> Array:
    """Return keys as pairs of floats: seconds and nanoseconds of an instant, the number and 0 of a number."""
    pairs = [divmod(int(k), _NANO) if isinstance(k, (int, np.integer)) else (k, 0) for k in keys]
    return np.array(pairs, dtype=float).reshape(len(pairs), 2)


def _joined(pairs: Array, kind: str) -> list[Any]:
    """Return keys again."""
    if kind == "instants":
        return [int(s) * _NANO + int(ns) for s, ns in pairs.tolist()]
    return [s for s, _ in pairs.tolist()]
