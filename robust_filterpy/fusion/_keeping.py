"""A fusion as plain arrays, and back: what there was before the oldest entry that is kept, and what was read since."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy import _state
from robust_filterpy._checks import Array
from robust_filterpy.fusion._first_readings import TRIAL
from robust_filterpy.fusion._policies import State
from robust_filterpy.fusion._stepping import Moment
from robust_filterpy.fusion._timeline import Timeline
from robust_filterpy.fusion._times import Clock

__all__ = ["restored", "state"]

_KINDS = ("", "numbers", "instants")
_NANO = 1_000_000_000


def state(timeline: Timeline, clock: Clock, counts: Any, outcomes: tuple[str, ...]) -> dict[str, Array]:
    """Return everything as arrays.

    Parameters
    ----------
    timeline : Timeline
        Entries.
    clock : Clock
        What the stamps are.
    counts : mapping of str to mapping of str to int
        For each sensor and outcome.
    outcomes : tuple of str
        In the order in which they are stored.

    Returns
    -------
    dict of str to ndarray
    """
    base, names = timeline.base.state, timeline.setup.layout.names
    p = timeline.setup.motion.dim_u
    controls = [np.full(p, np.nan) if e.control is None else e.control for e in timeline.entries]
    return _state.labelled("Fusion", {
        "x": base.x, "P": base.P, "means": base.means, "covariances": base.covariances, "shares": base.probabilities,
        "memory": base.memory, "unseen": base.unseen, "sizes": base.sizes, "u": base.u, "trial": base.trial,
        "kind": _KINDS.index(clock.kind), "base": _split([] if timeline.base_key is None else [timeline.base_key]),
        "keys": _split(timeline.keys), "z": timeline.readings(),
        "controls": np.array(controls).reshape(len(controls), p),
        "controlled": [e.control is not None for e in timeline.entries],
        "spoke": np.array([[n in e.spoke for n in names] for e in timeline.entries]).reshape(-1, len(names)),
        "earlier_known": [n in timeline.earlier for n in names],
        "earlier": _split([timeline.earlier.get(n, 0) for n in names]),
        "counts": [[counts[n][o] + (o == "refused") * timeline.unusable.get(n, 0) for o in outcomes] for n in names],
    })  # fmt: skip


def restored(like: Timeline, found: Any, outcomes: tuple[str, ...]) -> tuple[Timeline, Clock, Any]:
    """Return what a state says, for a fusion made like this one, or raise.

    Parameters
    ----------
    like : Timeline
        Of the fusion that takes it over.
    found : mapping of str to ndarray
        From `state`.
    outcomes : tuple of str
        As stored.

    Returns
    -------
    timeline : Timeline
    clock : Clock
    counts : dict
    """
    layout, base = like.setup.layout, like.base.state
    q, (n, M), names = len(base.means), (layout.n, layout.size), layout.names
    p, width = like.setup.motion.dim_u, base.memory.shape[1]
    needed: dict[str, _state.Shape] = {
        "x": (n,), "P": (n, n), "means": (q, n), "covariances": (q, n, n), "shares": (q,), "memory": (M, width),
        "unseen": (), "sizes": (M,), "u": (p,), "trial": (M, TRIAL), "kind": (),
        "base": (None, 2), "keys": (None, 2), "z": (None, M),
        "controls": (None, p), "controlled": (None,), "spoke": (None, len(names)), "earlier_known": (len(names),),
        "earlier": (len(names), 2), "counts": (len(names), len(outcomes)),
    }  # fmt: skip
    got = _state.checked(found, "Fusion", needed, {}, ("z", "controls", "sizes"))
    entries = len(got["keys"])
    if any(len(got[name]) != entries for name in ("z", "controls", "controlled", "spoke")) or len(got["base"]) > 1:
        raise _state.StateError("state: expected as many z, controls and spoke as keys, and at most one base")
    if got["kind"] not in range(3):
        raise _state.StateError(f"state: expected kind 0, 1 or 2, got {got['kind']}")
    if not ((got["shares"] >= 0.0).all() and np.isclose(got["shares"].sum(), 1.0)):
        raise _state.StateError(f"state: expected shares >= 0 that sum to 1, got {got['shares']}")
    clock = Clock(_KINDS[int(got["kind"])])
    keys, start = _joined(got["keys"], clock.kind), _joined(got["base"], clock.kind)
    if any(b <= a for a, b in zip(start[:1] + keys[:-1], keys, strict=False)) and (start[:1] + keys) != sorted(
        set(start[:1]) | set(keys)
    ):
        raise _state.StateError("state: expected keys that ascend, after base")
    none = np.full(M, np.nan)
    stood = State(
        got["means"], got["covariances"], got["shares"], got["memory"], got["x"], got["P"], float(got["unseen"]),
        got["sizes"], got["u"], got["trial"],
    )  # fmt: skip
    line = Timeline(like.setup, Moment(stood, none, none), like.window, like.history)
    line.base_key = start[0] if start else None
    for i, key in enumerate(keys):
        entry = line.at(key)
        entry.z[:] = got["z"][i]
        entry.spoke = {name for name, spoke in zip(names, got["spoke"][i], strict=True) if spoke}
        entry.control = got["controls"][i] if got["controlled"][i] else None
    known = zip(names, got["earlier_known"], _joined(got["earlier"], clock.kind), strict=True)
    line.earlier = {name: key for name, there, key in known if there}
    counts = {
        name: {o: int(c) for o, c in zip(outcomes, row, strict=True)}
        for name, row in zip(names, got["counts"], strict=True)
    }
    return line, clock, counts


def _split(keys: Any) -> Array:
    """Return keys as pairs of floats: seconds and nanoseconds of an instant, the number and 0 of a number."""
    pairs = [divmod(int(k), _NANO) if isinstance(k, (int, np.integer)) else (k, 0) for k in keys]
    return np.array(pairs, dtype=float).reshape(len(pairs), 2)


def _joined(pairs: Array, kind: str) -> list[Any]:
    """Return keys again."""
    if kind == "instants":
        return [int(s) * _NANO + int(ns) for s, ns in pairs.tolist()]
    return [s for s, _ in pairs.tolist()]
