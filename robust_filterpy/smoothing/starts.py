"""Other places to start from, where a recording can be read in two ways, and which reading is the more probable.

A burst that lasts as long as what is before it can be followed, and the good samples around it left out: the search
that doubts single samples comes to rest there as well. What the search left out in a row, and where readings jump, cuts
the recording into stretches; each stretch is doubted as a whole, everything else believed, and the search begins anew.
Of what is found the most probable is kept: density of the measurements together with which of them are outliers.
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
# Times the typical change from reading to reading that is a jump; the weight of what a start doubts.
_JUMP, _DOUBTED = 8.0, 1e-3
_TYPICAL = 0.6745


def doubted_stretches(recording: Recording, outliers: np.ndarray) -> list[Array]:
    """Return weights to start from, each (steps, 1), for one series; none where outliers come one by one.

    outliers (steps,): which samples a search from the usual start has left out.
    """
    rows = _rows(outliers)
    if not len(rows):
        return []
    steps = len(outliers)
    jumps = _jumps(recording)
    inside = np.concatenate([jumps[(begin <= jumps) & (jumps <= end)] for begin, end in rows])
    stretches = set()
    for cuts in (inside, rows.ravel(), np.concatenate([inside, rows.ravel()])):
        cuts = np.unique(np.concatenate([[0, steps], cuts])).tolist()
        stretches |= {(a, b) for a, b in itertools.pairwise(cuts) if _ROW <= b - a <= steps // 2}
    starts = []
    for begin, end in sorted(stretches, key=lambda pair: pair[0] - pair[1])[:_STRETCHES]:
        start = np.ones((steps, 1))
        start[begin:end] = _DOUBTED
        starts.append(start)
    return starts


def log_probability(recording: Recording, outliers: Array, jumps: Array, noise: Array, process: Array) -> float:
    """Return log p(z, which are outliers) of one series, a constant apart.

    outliers (steps, m), jumps (steps,): which measurements, and which steps of the process, are large; noise (2, m)
    and process (2,): share of the large ones and their standard deviation over that of the others.
    """
    F, G, c, H, z, x0, P0 = recording.model
    if c.any():
        z = z - _moved_by(c, F, H, z.shape[1])
    there = recording.observed.astype(bool)
    scale = np.where(jumps, process[1] ** 2, 1.0)[None, :, None, None]
    R = np.where(outliers, noise[1] ** 2, 1.0)[..., None] * np.eye(z.shape[2])
    found = filter_series(
        np.where(there, z, np.nan), F, H, scale * (G @ G.swapaxes(-1, -2)), R[None], x0, P0,
        influence=Linear(), keep="last", covariance="none",
    )  # fmt: skip
    return float(found.log_likelihood[0]) + _labels(outliers, there[0], noise[0]) + _labels(jumps, True, process[0])


def _labels(large: Array, there: Array | bool, share: Array) -> float:
    """Return the log probability of these being large and the others not; 0 for a share that was not learnt."""
    each = np.where(large, np.log(share), np.log1p(-share))
    return float(np.where(there & np.isfinite(each), each, 0.0).sum())


def _rows(outliers: np.ndarray) -> np.ndarray:
    """Return where rows of outliers begin and end, (rows, 2); one good sample does not end a row."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], outliers.astype(int), [0]]))).reshape(-1, 2)
    if len(edges):
        apart = np.flatnonzero(edges[1:, 0] - edges[:-1, 1] > 1) + 1
        edges = np.stack([edges[np.append(0, apart), 0], edges[np.append(apart, len(edges)) - 1, 1]], axis=1)
    # Of independent outliers, steps share^length rows begin anywhere; a row may have gaps of one.
    steps, share = len(outliers), min(float(outliers.mean()), 0.5)
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
