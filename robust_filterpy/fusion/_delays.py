"""How late each sensor's stamps are, from a recording: the shift with which it agrees best with all the others.

The others give the track x(t), smoothed where they are linear. A reading z of stamp t with a delay d is one of
x(t - d); the d is looked for that makes the mean of abs(z - h(x(t - d)) - c) least, c the median, since an offset is
no delay. That is done for each sensor in turn, with the others shifted as found so far, until nobody moves.

Only differences can be seen: whoever is least late counts as on time.
"""

from __future__ import annotations

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.fusion._stepping import Moment, Setup
from robust_filterpy.fusion._table import Rows
from robust_filterpy.fusion.recording import fused

__all__ = ["found_delays"]

# Points of the grids, each around the best of the one before; rounds; readings that are compared.
_GRID, _FINER, _ROUNDS, _MOST = 41, 3, 6, 4000
# A delay is found if all that are less worse than this, in log-density, are in a tenth of what was searched.
_WORSE, _NARROW = 8.0, 0.1
_FEWEST = 20


def found_delays(setup: Setup, begin: Moment, rows: Rows, longest: float) -> tuple[dict[str, float], dict[str, str]]:
    """Return how much later than the least late each sensor's stamps are, and why a delay cannot be found."""
    layout = setup.layout
    seconds = (rows.keys - rows.keys[0]) / (1e9 if rows.keys.dtype == np.int64 else 1.0)
    own = {name: np.flatnonzero((~np.isnan(rows.zs[:, place])).any(axis=1)) for name, place in layout.places.items()}
    reasons = {name: f"it has {len(at)} readings, too few" for name, at in own.items() if len(at) < _FEWEST}
    able = [name for name in layout.names if name not in reasons]
    if len(able) < 2:
        reasons.update(dict.fromkeys(able, "there is no other sensor to compare it with"))
        return dict.fromkeys(layout.names, np.nan), reasons
    shifts, certain = dict.fromkeys(able, 0.0), dict.fromkeys(able, False)
    for _ in range(_ROUNDS):
        before = dict(shifts)
        for name in able:
            others = {one: own[one] for one in able if one != name}
            track = _track(setup, begin, rows, seconds, others, shifts)
            shifts[name], certain[name] = _shift(setup, track, (seconds[own[name]], rows.zs[own[name]], name), longest)
        if max(abs(shifts[name] - before[name]) for name in able) < 2e-3 * longest:
            break
    reasons.update({
        name: "a delay and none explain its readings about as well: what it measures has to change, and unevenly"
        for name in able if not certain[name]
    })  # fmt: skip
    least = min((shifts[name] for name in able if certain[name]), default=0.0)
    return {name: shifts[name] - least if certain.get(name) else np.nan for name in layout.names}, reasons


def _track(
    setup: Setup, begin: Moment, rows: Rows, seconds: Array, own: dict[str, np.ndarray], shifts: dict[str, float]
) -> tuple[Array, Array]:
    """Return times and states as some sensors tell them, each shifted."""
    places = setup.layout.places
    times = np.concatenate([seconds[at] - shifts[name] for name, at in own.items()])
    keys, where = np.unique(times, return_inverse=True)
    zs, first = np.full((len(keys), setup.layout.size), np.nan), 0
    for name, at in own.items():
        zs[where[first : first + len(at)], places[name]] = rows.zs[at, places[name]]
        first += len(at)
    inputs = rows.inputs[np.clip(np.searchsorted(seconds, keys, side="right") - 1, 0, None)]
    straight = setup.motion.is_linear and not setup.layout.curved
    return keys, fused(setup._replace(watches=False), begin, None, Rows(keys, zs, inputs, 0), straight).x


def _shift(
    setup: Setup, track: tuple[Array, Array], said: tuple[Array, Array, str], longest: float
) -> tuple[float, bool]:
    """Return the shift of one sensor that agrees best with a track, and whether it is certain."""
    (times, states), (stamps, zs, name) = track, said
    place = setup.layout.places[name]
    # The same readings for every shift, or shifts could not be compared.
    inside = np.flatnonzero((stamps >= times[0] + longest) & (stamps <= times[-1] - longest))
    if len(inside) < _FEWEST:
        return 0.0, False
    inside = inside[np.linspace(0, len(inside) - 1, min(len(inside), _MOST)).astype(int)]
    stamps, zs = stamps[inside], zs[inside]

    def cost(d: float) -> float:
        at = np.column_stack([np.interp(stamps - d, times, column) for column in states.T])
        apart = _apart(setup, at, zs, name)[:, place]
        apart = np.abs(apart - np.nanmedian(apart, axis=0))
        return float((np.isfinite(apart).sum(axis=0) * np.log(np.nanmean(apart, axis=0) + 1e-300)).sum())

    low, high, certain, best = -longest, longest, False, 0.0
    for finer in range(_FINER):
        grid = np.linspace(low, high, _GRID)
        costs = np.array([cost(d) for d in grid])
        best, step = float(grid[np.argmin(costs)]), grid[1] - grid[0]
        if not finer:
            near = grid[costs < costs.min() + _WORSE]
            certain = bool(near[-1] - near[0] <= 2.0 * longest * _NARROW and abs(best) < longest - 0.5 * step)
        low, high = best - step, best + step
    return best, certain


def _apart(setup: Setup, states: Array, zs: Array, name: str) -> Array:
    """Return how far readings are from what states say."""
    layout = setup.layout
    if layout.sensors[name].h is None:
        return np.asarray(zs - states @ layout.H.T)
    alone = np.full(zs.shape, np.nan)
    for k, (x, z) in enumerate(zip(states, zs, strict=True)):
        mine = np.full(layout.size, np.nan)
        mine[layout.places[name]] = z[layout.places[name]]
        seen = layout.seen_from(x, mine)
        alone[k] = seen.z - seen.H @ x
    return alone
