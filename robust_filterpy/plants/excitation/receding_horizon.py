"""The search of section 3.2: each bit is the first of the m-tuple that brings the lag sums nearest to their target."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from robust_filterpy._checks import Array

# Tuples that are weighed at once: what they need stays in the processor's cache.
_BLOCK = 1 << 12


def search_bits(target: Array, length: int, horizon: int, rng: np.random.Generator | None) -> np.ndarray:
    """Return a signal of zeros and ones whose non-central autocovariance (54) is near target, lags 0 .. n."""
    n, m = target.size - 1, horizon
    blocks = _tuples(m, n)
    # m - 1 zeros in front stand for the samples that are still to come.
    signal = np.zeros(m - 1 + length + n, dtype=np.float32)
    rows = sliding_window_view(signal, n + 1)
    sums = np.zeros(n + 1)
    cost = np.empty(1 << m)
    tolerance = _tie(n + 1, m, length)
    for t in range(1, length + 1):
        here = m - 1 + length - t
        gap = sums - (t + m - 1) * target
        # Row j holds s_{t+j}, s_{t+j-1}, ..: the products of a one at t+j with the past, 0 with what is to come.
        past = rows[here - m + 1 : here + 1][::-1].copy()
        start = 0
        for tuples, own in blocks:
            change = tuples @ past
            change[:, : own.shape[1]] += own
            stop = start + len(tuples)
            # |gap + change|^2 - |gap|^2
            np.einsum("ij,ij->i", change, change + 2.0 * gap, out=cost[start:stop])
            start = stop
        best = cost <= cost.min() + tolerance
        index = int(best.argmax()) if rng is None else int(rng.choice(np.flatnonzero(best)))
        if index >> (m - 1):
            signal[here] = 1.0
            sums += rows[here]
    return signal[m - 1 : m - 1 + length][::-1]


def _tuples(m: int, n: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """List all of {0, 1}^m in lexicographic order, in blocks, each with the lag sums of its own products."""
    blocks = []
    for start in range(0, 1 << m, _BLOCK):
        index = np.arange(start, min(start + _BLOCK, 1 << m))
        # Small whole numbers: single precision holds them exactly and is twice as fast.
        bits = (index[:, None] >> np.arange(m - 1, -1, -1) & 1).astype(np.float32)
        own = [np.einsum("ij,ij->i", bits[:, k:], bits[:, : m - k]) for k in range(min(m, n + 1))]
        blocks.append((bits, np.column_stack(own)))
    return blocks


def _tie(n_lags: int, m: int, length: int) -> float:
    """Bound the rounding error of a cost, below which two continuations count as equally good."""
    return 8.0 * float(np.finfo(float).eps) * n_lags * m * (length + m)
