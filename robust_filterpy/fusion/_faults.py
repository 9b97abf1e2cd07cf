"""The recent past, judged anew under every fault of every sensor from every onset: which of them explains it best.

Side by side run filters of the state and of one number more, b::

    biased, drifting   z = h x + f b + v,   f = 1, or seconds since the onset; b unknown from the onset on
    stuck              z = b + v,           v as noisy as ever, or ten times less
    noisier            v 2, 3, 5 or 9 times as large from the onset on
    spikes             three of ten readings are outliers of one size, that of a class of noise, from the onset on
    model is wrong     Q 10, 100 or 1000 times as large from the onset on
    healthy            none of this

If nothing but a Q that is 10 or 100 times smaller explains the stretch better, all of them have that: a state that is
calmer than Q allows is nobody's fault, though a sensor that is noisily stuck looks like it. Without
this a bias of four deviations of one of three sensors of an object at rest, Q trusted, is called "stuck".

Noise and its outliers are those learned before the stretch that is judged. What a hypothesis is worth is the density of
all readings of the stretch under it, the size of b integrated out, times how often such a thing happens. No reading is
farther than the widest class reaches (`correction.learnt.REACH`), under any hypothesis: a wild one tells that there was
an outlier, not how wide the noise is. A reading of a sensor whose noise carries over to the next counts for less than
one (`_watch.worth`).
"""

from __future__ import annotations

import math
from collections.abc import Generator
from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.hypotheses import corrected, moved
from robust_filterpy.correction.learnt import REACH
from robust_filterpy.fusion._watch import BIASED, DRIFTING, HEALTHY, MODEL, NOISIER, SPIKES, STUCK
from robust_filterpy.kernel import extension

__all__ = ["Found", "Stretch", "judged"]

# Chance of a fault of one kind at a reading, shared among its sizes; of a manoeuvre that Q does not know at a stamp.
_FAULT, _MANOEUVRE = 1e-5, 1e-4
# Standard deviation of b in the sensor's own; of a drift: of what it has come to at the end.
_SIZE = 4.0
_NOISIER, _WORSE, _SPIKES = (2.0, 3.0, 5.0, 9.0), (10.0, 100.0, 1000.0), 0.3
# By how much Q may be smaller all along, and how likely that is over how likely it is as given.
_CALMER = ((1.0, 1.0), (0.1, 0.125), (0.01, 0.125))
_STILL = 0.01
# Stamps after which hypotheses go that are so far behind the healthy one, or so far below the best and not ahead of the
# healthy one by more than this; logarithms of odds.
_EVERY, _BEHIND, _HOPELESS, _AHEAD = 8, 10.0, 25.0, 2.0
# A stamp advances so many numbers of covariances, and each call counts for some more; a look back is shared among so
# many stamps at most; to begin it takes this part of what one stamp does.
_AT_ONCE, _CALL, _STAMPS, _BEGINS = 2e5, 5e3, 100, 0.5
# Onsets: of the last so many readings each, before them ever fewer; none of the very first readings.
_FINE, _FIRST = 16, 5


class Stretch(NamedTuple):
    """What is judged anew: K moments."""

    #: State before the first, (n,).
    x: Array
    #: (n, n)
    P: Array
    #: To each moment, (K, n, n).
    F: Array
    Q: Array
    drift: Array
    #: Since the first moment, (K,).
    seconds: Array
    #: (K, M), NaN where missing.
    z: Array
    #: (K, M, n)
    H: Array
    #: Variance of ordinary noise, (M,).
    r: Array
    #: Of the classes of noise, (C,).
    scales: Array
    #: (M, C)
    shares: Array
    #: How much of an independent reading one of a component is, (M,).
    worth: Array


class Found(NamedTuple):
    """What explains a stretch."""

    #: -1 for the model, and if nothing is wrong.
    component: int
    #: Place in `_watch.FAULTS`, or MODEL.
    fault: int
    probability: float
    #: The most probable moment.
    onset: int
    #: b at the end, or the factor, or the share.
    size: float


class _Bank(NamedTuple):
    """Hypotheses, each an entry of every array."""

    component: Array
    fault: Array
    onset: Array
    #: Of the variance of the noise, of all readings or of the outliers, or of Q.
    factor: Array
    #: Logarithm.
    prior: Array


def judged(stretch: Stretch, left_out: np.ndarray, suspects: np.ndarray) -> Generator[float, None, list[Found]]:
    """Return what may explain a stretch, each fault of each suspected component once, the most probable first.

    After each part of the work it yields how much of what is to be done at once that is.
    """
    bank = _hypotheses(stretch, suspects)
    yield _BEGINS
    calm = np.flatnonzero(bank.fault == HEALTHY)
    healthy = _Bank(*(part[calm] for part in bank))
    logs, _ = yield from _run(stretch, healthy, left_out, len(stretch.z))
    as_calm = healthy.factor[np.argmax(logs + healthy.prior)]
    logs, b = yield from _run(stretch._replace(Q=stretch.Q * as_calm), bank, left_out, _EVERY)
    logs[calm[1:]] = -np.inf
    logs = logs + bank.prior
    p = np.exp(logs - logs.max())
    p /= p.sum()
    causes = []
    for c, fault in sorted({(int(c), int(f)) for c, f in zip(bank.component, bank.fault, strict=True)}):
        group = np.flatnonzero((bank.component == c) & (bank.fault == fault))
        best = int(group[np.argmax(p[group])])
        size = float(b[best] if fault in (BIASED, DRIFTING) else math.sqrt(bank.factor[best]))
        causes.append(Found(c, fault, float(p[group].sum()), int(bank.onset[best]), size))
    return sorted(causes, key=lambda one: -one.probability)


def _hypotheses(stretch: Stretch, suspects: np.ndarray) -> _Bank:
    """Return healthy, a smaller Q, the model, and every fault of every suspected component from every onset."""
    of = [(-1, np.flatnonzero((~np.isnan(stretch.z)).any(axis=1)), _MANOEUVRE, {MODEL: _WORSE})]
    for c in np.flatnonzero(suspects).tolist():
        kinds = {BIASED: (1.0,), DRIFTING: (1.0,), STUCK: (1.0, _STILL), SPIKES: tuple(stretch.scales[1:])}
        kinds[NOISIER] = tuple(f * f for f in _NOISIER)
        of.append((c, np.flatnonzero(~np.isnan(stretch.z[:, c])), _FAULT, kinds))
    parts = [np.array([(-1, HEALTHY, 0, w, p) for w, p in _CALMER])]
    for c, moments, chance, kinds in of:
        onsets = np.array(_onsets(moments)).reshape(-1, 2)
        for fault, factors in kinds.items():
            (k, width), factor = np.repeat(onsets, len(factors), axis=0).T, np.tile(factors, len(onsets))
            parts.append(np.column_stack([np.full((len(k), 2), (c, fault)), k, factor, chance * width / len(factors)]))
    rows = np.concatenate(parts)
    rows = rows[np.argsort(rows[:, 2], kind="stable")]
    return _Bank(*rows.T)._replace(prior=np.log(rows[:, 4]))


def _onsets(moments: np.ndarray) -> list[tuple[int, int]]:
    """Return moments at which something may have begun, and how many each stands for; not the very first ones."""
    onsets, left = [], len(moments)
    while left > _FIRST:
        # An onset that is off by a small share of all since then costs little.
        width = min(1 + (len(moments) - left) // _FINE, left - _FIRST)
        left -= width
        onsets.append((int(moments[left + width // 2]), width))
    return onsets[::-1]


def _run(
    stretch: Stretch, bank: _Bank, left_out: np.ndarray, every: int
) -> Generator[float, None, tuple[Array, Array]]:
    """Return the log-density of all readings under each hypothesis, in the order of onsets, and b at the end."""
    (n,), K, N = stretch.x.shape, len(stretch.z), len(bank.fault)
    logs, b, numbers = np.full(N, -np.inf), np.zeros(N), _numbers(stretch, bank)
    at_once = max(_AT_ONCE, N * K * (n + 1) ** 2 / _STAMPS)
    able = stretch._replace(z=np.where(left_out, np.nan, stretch.z))
    shared = tuple(np.array(part, dtype=float) for part in able[2:])
    # Before its onset a hypothesis is the healthy one, which comes first.
    who, x, P, sums = np.arange(1), np.append(stretch.x, 0.0)[None], np.zeros((1, n + 1, n + 1)), np.zeros(1)
    P[0, :n, :n] = stretch.P
    ends = np.searchsorted(bank.onset, np.arange(every, K + every, every)).tolist()
    for first, begun, end in zip(range(0, K, every), [1, *ends], ends, strict=False):
        new = np.arange(begun, end)
        stays = np.flatnonzero(_hopeful(sums, bank, who))
        copies = np.append(stays, np.zeros(len(new), dtype=int))
        who, x, P, sums = np.append(who[stays], new), x[copies], P[copies], sums[copies]
        _advance(numbers[who], (x, P, sums), shared, (first, min(first + every, K)))
        yield (P.size * every + _CALL) / at_once
    logs[who], b[who] = sums, x[:, n]
    return logs, b / np.sqrt(stretch.r[np.maximum(bank.component.astype(int), 0)])


def _numbers(stretch: Stretch, bank: _Bank) -> Array:
    """Return what sets each hypothesis apart from its onset on, of its component, and its classes' shares, (N, 8 + C).

    Component, onset, factor of Q, whether it sees the state, b's part in what it reads, and how that grows with time,
    factor of the variance of noise, variance of b to begin with.
    """
    owner, fault, factor = np.maximum(bank.component.astype(int), 0), bank.fault, bank.factor
    drifts, stuck = fault == DRIFTING, fault == STUCK
    constant = stuck | (fault == BIASED)
    # A drift is as large as a bias would be when it has come to the end.
    length = stretch.seconds[-1] - stretch.seconds[bank.onset.astype(int)]
    spread = _SIZE**2 * stretch.r[owner] / np.where(drifts & (length > 0.0), length, 1.0) ** 2
    usual = stretch.shares[owner]
    more = np.maximum(_SPIKES, np.minimum(2.0 * (1.0 - usual[:, :1]), 0.9))
    spikes = (1.0 - more) * usual + more * (stretch.scales == factor[:, None])
    return np.column_stack([
        bank.component, bank.onset, np.where(bank.component < 0, factor, 1.0), ~stuck, constant, drifts,
        np.where(stuck | (fault == NOISIER), factor, 1.0), np.where(constant | drifts, spread, 0.0),
        np.where((fault == SPIKES)[:, None], spikes, usual),
    ])  # fmt: skip


def _advance(numbers: Array, rows: tuple[Array, ...], shared: tuple[Array, ...], stamps: tuple[int, int]) -> None:
    """Take x, P and the sums of log-densities of hypotheses through some stamps, in place; shared: of a `Stretch`."""
    if (kernel := extension()) is not None:
        kernel.advance_hypotheses((numbers, *rows), shared, *stamps)
        return
    (x, P, sums), (F, Q, drift, seconds, z, H, r, scales, shares, worth) = rows, shared
    component, onset, slack, sees, offset, grows, noise, spread = numbers[:, :8].T
    since, n = seconds[onset.astype(int)], H.shape[2]
    for k in range(*stamps):
        on, begins = onset <= k, onset == k
        moved(x, P, F[k], np.where(on, slack, 1.0)[:, None, None] * Q[k], drift[k])
        P[begins, n, n] = spread[begins]
        # It got stuck where it was: what the sensor should read there, give or take.
        at = (H[k, component[begins].astype(int)] * x[begins, :n]).sum(axis=1)
        x[begins, n] = np.where(sees[begins] == 0.0, at, 0.0)
        for c in np.flatnonzero(~np.isnan(z[k])):
            mine, h = on & (component == c), np.zeros(x.shape)
            h[:, :n] = np.where(mine, sees, 1.0)[:, None] * H[k, c]
            h[mine, n] = (offset + grows * (seconds[k] - since))[mine]
            variances = scales[:, None] * r[c] * np.where(mine, noise, 1.0)
            logs = np.log(np.where(mine, numbers[:, 8:].T, shares[c][:, None]))
            sums += worth[c] * corrected(x, P, z[k, c], h, variances, logs, REACH if r[c] > 0.0 else math.inf)


def _hopeful(sums: Array, bank: _Bank, who: np.ndarray) -> np.ndarray:
    """Return which hypotheses go on: one of the same kind that begins now, as the healthy one stands, does better."""
    better, worth = sums - sums[0], sums + bank.prior[who]
    lost = (better < -_BEHIND) | ((worth < worth.max() - _HOPELESS) & (better < _AHEAD))
    return np.asarray(~lost | (bank.fault[who] == HEALTHY))
