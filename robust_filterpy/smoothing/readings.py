"""Where a recording can be read in two ways: what else may be left out, and which reading is the more probable.

A burst that lasts as long as what is before it can be followed, and the good samples around it left out: the search
that doubts single samples comes to rest there as well. What the search left out in a row, and where readings jump, cuts
the recording into stretches; one after the other is taken for missing, and what is left is searched. Of what is found
the most probable is kept: density of the measurements together with which of them are outliers. Samples that are left
out in a row may share one offset, which a burst has and good samples taken for bad ones do not; but not what lasts for
long, or from or to an end of the recording, which the state itself may have done.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.batch.series import filter_series
from robust_filterpy.influence.functions import Linear
from robust_filterpy.smoothing.recording import Recording

# Outliers in a row, at least, and how many such rows chance may have made; how many stretches are doubted at most, the
# longest first.
_ROW, _CHANCE, _STRETCHES = 5, 0.01, 6
# Times the typical change from reading to reading that is a jump; times an outlier's size that an offset may have, and
# the share of a recording for which it may last.
_JUMP, _OFFSET, _LASTS = 8.0, 10.0, 0.25
_TYPICAL = 0.6745


def doubted_stretches(recording: Recording, outliers: np.ndarray) -> list[np.ndarray]:
    """Return what else may be left out of one series, each (steps,) of bool; nothing where outliers come one by one."""
    # outliers (steps,): which samples a search from the usual start has left out.
    if not len(_rows(outliers)):
        return []
    rows, steps = _rows(outliers, by_chance=True), len(outliers)
    jumps = _jumps(recording)
    inside = np.concatenate([jumps[(begin <= jumps) & (jumps <= end)] for begin, end in rows])
    stretches = set()
    for cuts in (inside, rows.ravel(), np.concatenate([inside, rows.ravel()])):
        cuts = np.unique(np.concatenate([[0, steps], cuts])).tolist()
        stretches |= {(a, b) for a, b in itertools.pairwise(cuts) if _ROW <= b - a <= steps // 2}
    longest = sorted(stretches, key=lambda pair: pair[0] - pair[1])[:_STRETCHES]
    places = np.arange(steps)
    return [(begin <= places) & (places < end) for begin, end in longest]


def log_probability(recording: Recording, outliers: Array, jumps: Array, noise: Array, process: Array) -> float:
    """Return log p(z, which are outliers) of one series, a constant apart."""
    # outliers (steps, m), jumps (steps,): which measurements, and which steps of the process, are large; noise (2, m)
    # and process (2,): share of the large ones and their standard deviation over that of the others.
    # Outliers in a row either have nothing to do with each other, or one offset and ordinary noise: whatever is more
    # probable, row by row.
    F, G, c, H, z, x0, P0 = recording.model
    if c.any():
        z = z - _moved_by(c, F, H, z.shape[1])
    there = recording.observed.astype(bool)
    scale = np.where(jumps, process[1] ** 2, 1.0)[None, :, None, None]
    z, Q = np.where(there, z, np.nan), scale * (G @ G.swapaxes(-1, -2))
    rows = [(i, begin, end) for i, large in enumerate(outliers.T) for begin, end in _bursts(large)]
    bursts: list[tuple[int, int, int]] = []
    best = -math.inf
    for more in ([], *([row] for row in rows)):
        tried = [*bursts, *more]
        alone = outliers & ~_inside(tried, outliers.shape)
        found = _density(z, F, H, Q, alone, noise, x0, P0, tried)
        # A burst is as likely as one outlier.
        found += _labels(alone, there[0] & ~_inside(tried, alone.shape), noise[0])
        found += sum(float(np.log(noise[0, i])) for i, *_ in tried)
        if found > best:
            best, bursts = found, tried
    return best + _labels(jumps, np.ones(len(jumps), dtype=bool), process[0])


def _bursts(large: np.ndarray) -> list[list[int]]:
    """Return the rows of outliers that may have one offset: where they begin and end."""
    steps = len(large)
    rows: list[list[int]] = _rows(large).tolist()
    return [[begin, end] for begin, end in rows if 0 < begin and end < steps and end - begin <= _LASTS * steps]


def _inside(rows: list[tuple[int, int, int]], shape: tuple[int, ...]) -> np.ndarray:
    """Return which samples of which components are in one of the rows."""
    found = np.zeros(shape, dtype=bool)
    for i, begin, end in rows:
        found[begin:end, i] = True
    return found


def _density(
    z: Array, F: Array, H: Array, Q: Array, outliers: Array, noise: Array, x0: Array, P0: Array,
    offsets: list[tuple[int, int, int]],
) -> float:  # fmt: skip
    """Return log p(z | which are outliers); offsets: component, begin and end of rows that have one each."""
    (steps, m), n, more = outliers.shape, F.shape[-1], len(offsets)
    H = np.concatenate([np.broadcast_to(H, (1, steps, m, n)), np.zeros((1, steps, m, more))], axis=-1)
    for k, (i, begin, end) in enumerate(offsets):
        H[0, begin:end, i, n + k] = _OFFSET * noise[1, i]
    F, Q, P0 = (np.pad(a, [(0, 0)] * (a.ndim - 2) + [(0, more)] * 2) for a in (F, Q, P0))
    for kept in (F, P0):
        kept[..., range(n, n + more), range(n, n + more)] = 1.0
    R = np.where(outliers, noise[1] ** 2, 1.0)[..., None] * np.eye(m)
    found = filter_series(
        z, F, H, Q, R[None], np.pad(x0, [(0, 0)] * (x0.ndim - 1) + [(0, more)]), P0,
        influence=Linear(), keep="last", covariance="none",
    )  # fmt: skip
    return float(found.log_likelihood[0])


def _labels(large: Array, there: Array, share: Array) -> float:
    """Return the log probability of these being large and the others not; 0 for a share that was not learnt."""
    each = np.where(large, np.log(share), np.log1p(-share))
    return float(np.where(there & np.isfinite(each), each, 0.0).sum())


def _rows(outliers: np.ndarray, by_chance: bool = False) -> np.ndarray:
    """Return where rows of outliers begin and end, (rows, 2); one good sample does not end a row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], outliers.astype(int), [0]]))).reshape(-1, 2)
    if len(edges):
        apart = np.flatnonzero(edges[1:, 0] - edges[:-1, 1] > 1) + 1
        edges = np.stack([edges[np.append(0, apart), 0], edges[np.append(apart, len(edges)) - 1, 1]], axis=1)
    # Of independent outliers, steps share^length rows begin anywhere; a row may have gaps of one.
    steps, share = len(outliers), 0.0 if by_chance else min(float(outliers.mean()), 0.5)
    share *= 2.0 - share
    length = max(_ROW, math.log(_CHANCE / steps) / math.log(share)) if share > 0.0 else _ROW
    return edges[edges[:, 1] - edges[:, 0] >= length]


def _jumps(recording: Recording) -> np.ndarray:
    """Return the samples whose readings are far from those before, in units of how far that is as a rule."""
    z = np.where(recording.observed[0], recording.model.z[0], np.nan)
    far = np.zeros(len(z), dtype=bool)
    for reading in z.T:
        there = np.flatnonzero(~np.isnan(reading))
        change = np.abs(np.diff(reading[there]))
        if len(change):
            far[there[1:][change > _JUMP * max(float(np.median(change)) / _TYPICAL, np.finfo(float).tiny)]] = True
    return np.flatnonzero(far)


def _moved_by(c: Array, F: Array, H: Array, steps: int) -> Array:
    """Return what inputs alone add to the measurements, (1, steps, m)."""
    x, added = np.zeros(F.shape[-1]), np.empty((1, steps, H.shape[-2]))
    F, c, H = (np.broadcast_to(a[0], (steps, *a.shape[2:])) for a in (F, c, H))
    for k in range(steps):
        x = F[k] @ x + c[k]
        added[0, k] = H[k] @ x
    return added
