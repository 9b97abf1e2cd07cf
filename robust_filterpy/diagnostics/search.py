"""Which repair of a model explains a recording best: candidates of each cause, judged side by side, and the search.

All candidates go through the recording side by side, as one batch of small matrices, by the robust filter with
Huber's psi and realized information. The state has one more part for each sensor, an error of that sensor: 0 unless
a candidate gives it a memory (correlated noise) or lets it jump (level shift).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.correction.hypotheses import moved
from robust_filterpy.diagnostics.recording import LinearModel
from robust_filterpy.influence.regression import robust_regression

_THRESHOLD = 2.0
# Density of e that no outlier can dominate: normal, with a share from a Cauchy distribution five times as wide.
_TAIL_SHARE, _TAIL_SCALE = 0.1, 5.0


@dataclass(frozen=True)
class Repair:
    """Hold what one candidate changes; the default changes nothing."""

    cause: str = ""
    sensor: int | None = None
    value: float = 1.0
    cost: float = 0.0  # log-likelihood that the candidate must earn
    Q: float = 1.0  # factor of Q
    R: Array | float = 1.0  # (m,), factors of the standard deviations
    gain: Array | float = 1.0  # (m,), factors of the rows of H
    rows: Array | float = np.nan  # (m, n), rows instead of those of H
    memory: float = 0.0  # lag-one correlation of the noise
    coupling: Array | float = 0.0  # (m, m), added to the correlations of R
    tail: float = _TAIL_SHARE  # share of outliers
    jump_at: int = -1
    jump: Array | float = 0.0  # (n + m,), variances of what jumps there

    def then(self, other: Repair) -> Repair:
        """Return both repairs, described as the second."""
        jumps, outliers = self if other.jump_at < 0 else other, other if other.cause == "more outliers" else self
        return replace(
            other, Q=self.Q * other.Q, R=self.R * np.asarray(other.R), gain=self.gain * np.asarray(other.gain),
            rows=np.where(np.isnan(np.asarray(other.rows)), self.rows, other.rows),
            memory=other.memory or self.memory, coupling=self.coupling + np.asarray(other.coupling),
            tail=outliers.tail, jump_at=jumps.jump_at, jump=jumps.jump,
        )  # fmt: skip


def scores(model: LinearModel, z: Array, repairs: list[Repair]) -> tuple[Array, Array]:
    """Return the robust log-likelihood of z (N, m) under each of C repaired models, and predicted states (C, N, n)."""
    (N, m, n), C = model.H.shape, len(repairs)

    def column(name: str, *shape: int) -> Array:
        return np.array([np.broadcast_to(getattr(repair, name), shape) for repair in repairs])

    factors, gain, rows, at = column("R", m), column("gain", m), column("rows", m, n), column("jump_at")
    coupling, jumps, tail = column("coupling", m, m), column("jump", n + m), column("tail")[:, None]
    slack, memory = column("Q")[:, None, None], column("memory")[:, None, None]
    spread, lasts = factors[:, :, None] * factors[:, None, :], memory != 0.0
    own, replaced = ~np.isnan(rows), np.nan_to_num(rows)
    sensors, states = slice(n, None), slice(0, n)

    x, P = np.zeros((C, n + m)), np.zeros((C, n + m, n + m))
    x[:, states], P[:, states, states] = model.x, model.P
    H = np.zeros((C, m, n + m))
    H[:, :, sensors] = np.eye(m)
    # What lasts: a correlated error decays, a shifted level stays.
    decay = np.ones((C, n + m))
    decay[at < 0, n:] = memory[at < 0, 0]
    total, path = np.zeros(C), np.zeros((C, N, n))
    for k in range(N):
        stage(f"models tried at once: {C}, at sample {k} of {N}")
        deviations = np.sqrt(np.diag(model.R[k]))
        R = spread * (model.R[k] + coupling * np.outer(deviations, deviations))
        if k:
            moved(x, P, model.F[k], np.zeros((n, n)), model.offset[k])
            x *= decay
            P *= decay[:, :, None] * decay[:, None, :]
            P[:, states, states] *= model.fading[k]
            P[:, states, states] += slack * model.Q[k]
        P[:, sensors, sensors] += (1.0 - memory**2 if k else 1.0) * lasts * R
        hit = at == k
        P[hit] += jumps[hit][:, :, None] * np.eye(n + m)
        path[:, k] = x[:, states]
        seen = ~np.isnan(z[k])
        if seen.any():
            H[:, :, states] = np.where(own, replaced, gain[:, :, None] * model.H[k])
            R = np.where(lasts, 1e-6 * R, R)
            _correct(x, P, H[:, seen], R[:, seen][:, :, seen], z[k, seen], tail, total)
    return np.where(np.isfinite(total), total, -np.inf), path


@np.errstate(over="ignore", under="ignore", invalid="ignore")
def _correct(x: Array, P: Array, H: Array, R: Array, z: Array, tail: Array, total: Array) -> None:
    """Correct x and P in place by z and add its log density to total."""
    PH = P @ H.transpose(0, 2, 1)
    S = H @ PH + R
    lost = ~(np.abs(S) < 1e150 * max(float(np.abs(R).max()), 1.0)).all(axis=(1, 2)) & (len(z) > 1)
    if lost.any():
        # What grows beyond numbers whose square is a number explains nothing.
        total[lost], x[lost], P[lost], PH[lost], S[lost] = -np.inf, 0.0, 0.0, 0.0, np.eye(len(z))
    if len(z) == 1:
        T = 1.0 / np.sqrt(np.maximum(S, 1e-300))
        logdet = np.log(T[:, 0, 0])
    else:
        values, vectors = np.linalg.eigh(S)
        values = np.maximum(values, 1e-13 * values[:, -1:] + 1e-300)
        T = (vectors / np.sqrt(values)[:, None, :]) @ vectors.transpose(0, 2, 1)
        logdet = -0.5 * np.log(values).sum(axis=1)
    e = np.einsum("cij,cj->ci", T, z - np.einsum("cij,cj->ci", H, x))
    body = (1.0 - tail) * np.exp(-0.5 * e * e) / np.sqrt(2.0 * np.pi)
    total += logdet + np.log(body + tail / (np.pi * _TAIL_SCALE * (1.0 + (e / _TAIL_SCALE) ** 2)) + 1e-300).sum(axis=1)
    G = PH @ T
    inside = (np.abs(e) <= _THRESHOLD).astype(float)
    x += np.einsum("cij,cj->ci", G, np.clip(e, -_THRESHOLD, _THRESHOLD))
    P -= (G * inside[:, None, :]) @ G.transpose(0, 2, 1)


# Log-likelihood that the best of a hundred wrong candidates may gain on a recording without fault.
_GAIN = 12.0
# A factor of a variance below this is not reported.
_FACTOR = 2.0
_FACTORS = [10.0**power for power in (-6, -5, -4, -3, -2, -1, -0.5, 0.5, 1, 2, 3, 4, 5, 6)]
_UNITS = (1e3, 1e-3, 1e2, 1e-2, 10.0, 0.1, 180 / np.pi, np.pi / 180, 3.6, 1 / 3.6, 0.3048, 1 / 0.3048, 1e6, 1e-6)
_COUPLINGS = (-0.9, -0.7, -0.5, -0.3, 0.3, 0.5, 0.7, 0.9)
_MEMORIES, _SHARES = (-0.8, -0.5, 0.3, 0.5, 0.7, 0.8, 0.9, 0.96), (0.02, 0.2, 0.3, 0.4, 0.5)
_AT_MOST = 3


def find(model: LinearModel, z: Array, e: Array) -> list[tuple[Repair, float]]:
    """Return the causes, the weightiest first, each with the log-likelihood that its repair gains."""
    repairs: list[tuple[Repair, float]] = []
    so_far = Repair()
    base = float(scores(model, z, [so_far])[0][0])
    while len(repairs) < _AT_MOST:
        # One good candidate hides behind another, so every round looks at all of them on the repaired model.
        stage(f"{len(repairs)} of at most {_AT_MOST} causes found")
        best, likelihood = _search(model, z, _candidates(model, z, e, so_far), so_far)
        gain = likelihood - base
        # After a large misfit is repaired, small ones may be left by the roughness of the repair.
        least = max(_GAIN, 0.1 * repairs[0][1]) if repairs else _GAIN
        is_slight = best.cause in ("R", "Q", "R and Q") and 1 / _FACTOR < best.value < _FACTOR
        if gain - best.cost < least or is_slight:
            break
        repairs.append((best, gain))
        so_far, base = so_far.then(best), likelihood
    return repairs


def _search(model: LinearModel, z: Array, candidates: list[Repair], so_far: Repair) -> tuple[Repair, float]:
    """Return the best candidate after three rounds of closing in on factors, and its log-likelihood."""
    pool: dict[tuple[Any, ...], tuple[Repair, float]] = {}
    for width in (1.0, 10.0 ** (1 / 3), 10.0 ** (1 / 9), 10.0 ** (1 / 27)):
        if width != 1.0:
            # The five best, the only ones that closing in can make the best.
            leaders = sorted(pool.values(), key=lambda pair: pair[0].cost - pair[1])[:5]
            candidates = [
                _noise(best.cause, best.sensor, best.value * factor, len(z[0]))
                for best, _ in leaders for factor in (width, 1 / width) if best.cause in ("R", "Q", "R and Q")
            ]  # fmt: skip
        if not candidates:
            break
        stage(f"{len(candidates)} repairs tried on {len(z)} samples")
        likelihoods = scores(model, z, [so_far.then(c) for c in candidates])[0]
        for candidate, likelihood in zip(candidates, likelihoods, strict=True):
            key = (candidate.cause, candidate.sensor)
            if key not in pool or likelihood - candidate.cost > pool[key][1] - pool[key][0].cost:
                pool[key] = (candidate, float(likelihood))
    return max(pool.values(), key=lambda pair: pair[1] - pair[0].cost)


def _noise(cause: str, sensor: int | None, factor: float, m: int) -> Repair:
    """Return a repair that multiplies a covariance."""
    root = np.where(np.ones(m) if sensor is None else np.eye(m)[sensor], np.sqrt(factor), 1.0)
    cost = 4.0 if cause == "R and Q" else 1.0 if sensor is None else 1.5
    return Repair(cause, sensor, factor, cost, Q=factor if "Q" in cause else 1.0, R=root if "R" in cause else 1.0)


def _candidates(model: LinearModel, z: Array, e: Array, so_far: Repair) -> list[Repair]:
    """Return every candidate of the first, coarse round."""
    m = model.H.shape[1]
    unit, single = np.eye(m), [None] if m == 1 else [None, *range(m)]
    result = [_noise("R", i, factor, m) for i in single for factor in _FACTORS]
    if model.Q.any():
        result += [_noise(cause, None, factor, m) for cause in ("Q", "R and Q") for factor in _FACTORS]
    for i in range(m if m > 1 else 0):
        each = [(size, np.where(unit[i], size, 1.0)) for size in _UNITS]
        result += [Repair("units", i, size, 3.0, R=row, gain=row) for size, row in each]
        pairs = [(r, np.outer(unit[i], unit[j]) + np.outer(unit[j], unit[i])) for j in range(i) for r in _COUPLINGS]
        result += [Repair("coupled noise", i, r, 3.0, coupling=r * pair) for r, pair in pairs]
    result += [Repair("correlated noise", None, a, 3.0, memory=a) for a in _MEMORIES]
    result += [Repair("more outliers", None, share, 2.0, tail=share) for share in _SHARES]
    without = [np.where(np.arange(m) == i, np.nan, z) for i in range(m if m > 1 else 0)]
    others = [scores(model, rest, [so_far])[1][0] for rest in without]
    return result + _rows(model, z, others) + _jumps(model, z, e, others)


def _rows(model: LinearModel, z: Array, others: list[Array]) -> list[Repair]:
    """Return other rows of H: those that the states by the remaining sensors suggest, and the states themselves."""
    m, n = model.H.shape[1:]
    result: list[Repair] = []
    for i in range(m if np.ptp(model.H, axis=0).max(initial=0.0) == 0.0 else 0):
        suggestions = [-model.H[0, i], *np.eye(n)]
        if others:
            x = others[i]
            seen = ~np.isnan(z[:, i]) & np.isfinite(x).all(axis=1)
            # The unit of a state must not decide how much it counts.
            size = np.maximum(np.abs(x[seen]).max(axis=0, initial=0.0), 1e-300)
            if seen.sum() >= 5 * n:
                suggestions.append(robust_regression(x[seen] / size, z[seen, i]) / size)
        for row in suggestions:
            if not np.allclose(row, model.H[0, i]):
                rows = np.full((m, n), np.nan)
                rows[i] = row
                result.append(Repair("H", i, 1.0, 2.0 + 2.0 * n, rows=rows))
    return result


def _seen_by(row: Array, size: Array | float) -> Array:
    """Return variances of the states that show in a row of H with this variance."""
    row = row**2
    weighty = row > 1e-12 * row.max(initial=1e-300)
    return np.where(weighty, size / np.where(weighty, row, 1.0), 0.0)


def _jumps(model: LinearModel, z: Array, e: Array, others: list[Array]) -> list[Repair]:
    """Return jumps of the state and of each sensor where large innovations or a change of mean begin, a wrong start."""
    m, n = model.H.shape[1:]
    result = []
    for i in np.flatnonzero(~np.isnan(z).all(axis=0)).tolist():
        size = float(np.nanmax(np.abs(z[:, i] - np.nanmedian(z[:, i])), initial=1e-300))
        # Beyond this the square overflows.
        size = min(size, 1e150) ** 2
        # The filter follows a sensor that has shifted; those that do not see that do not, and show where it began.
        apart = z[:, i] - np.nan_to_num(np.einsum("kj,kj->k", model.H[:, i], others[i])) if others else e[:, i]
        begins = _heaviest_run(e[:, i]), _change(e[:, i]), _change(np.clip(apart, -1e150, 1e150))
        for k in sorted({0, *(at for begin in begins for at in (begin - 1, begin) if at > 0)}):
            if k:
                jump = np.r_[_seen_by(model.H[k, i], size), np.zeros(m)]
                result.append(Repair("state jump", i, float(k), 5.0, jump_at=k, jump=jump))
            if m > 1:
                jump = np.r_[np.zeros(n), size * np.eye(m)[i]]
                result.append(Repair("level shift" if k else "bias", i, float(k), 5.0, jump_at=k, jump=jump))
    # A first state that is as uncertain as the first innovations suggest.
    first = np.clip(np.nan_to_num(z[:5] - model.H[:5] @ model.x), -1e150, 1e150)
    seen = _seen_by(model.H[0], np.median(np.abs(first), axis=0)[:, None] ** 2).max(axis=0)
    jump = np.r_[seen + 100.0 * model.P.diagonal(), np.zeros(m)]
    return [*result, Repair("wrong start", None, 0.0, 4.0, jump_at=0, jump=jump)]


def _heaviest_run(e: Array) -> int:
    """Return where one sensor's heaviest run of large innovations of one sign starts."""
    size = np.minimum(np.abs(np.nan_to_num(e)), 30.0)
    sign = np.where(size > 2.0, np.sign(e), 0.0)
    starts = np.flatnonzero(np.diff(sign, prepend=np.nan))
    # The first of a run does not count: alone it is an outlier.
    weights = np.where(sign[starts] != 0.0, np.add.reduceat(size, starts) - size[starts], 0.0)
    return int(starts[weights.argmax()])


def _change(e: Array) -> int:
    """Return where the mean changes most, whatever the unit."""
    off, N = np.nan_to_num(e - np.nanmedian(e)), len(e)
    most, before = 3.0 * np.median(np.abs(off)), np.arange(1, N)
    bounded = np.clip(off, -most, most)
    change = np.abs(np.cumsum(bounded)[:-1] - before / N * bounded.sum()) / np.sqrt(before * (N - before) / N)
    return int(change[5:-5].argmax()) + 6 if N > 20 else 0
