"""Which repair of a model explains a recording best: candidates of each cause, judged side by side, and the search.

All candidates go through the recording side by side, as one batch of small matrices, by the robust filter with
Huber's psi and realized information. The state has one more part for each sensor, an error of that sensor: 0 unless
a candidate gives it a memory (correlated noise) or lets it jump (level shift).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.diagnostics.recording import LinearModel

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
    missing: Array | float = 0.0  # (m,), sensors not to be used
    jump_at: int = -1
    jump: Array | float = 0.0  # (n + m,), variances of what jumps there

    def then(self, other: Repair) -> Repair:
        """Return both repairs, described as the second."""
        rows = np.where(np.isnan(np.asarray(other.rows)), self.rows, other.rows)
        keep = self if other.jump_at < 0 else other
        return replace(
            other,
            Q=self.Q * other.Q,
            R=self.R * np.asarray(other.R),
            gain=self.gain * np.asarray(other.gain),
            rows=rows,
            memory=other.memory or self.memory,
            coupling=self.coupling + np.asarray(other.coupling),
            tail=other.tail if other.cause == "more outliers" else self.tail,
            jump_at=keep.jump_at,
            jump=keep.jump,
        )


@dataclass(frozen=True)
class Scores:
    """Hold what each of C candidates made of the recording."""

    log_likelihood: Array  # (C,)
    x: Array  # (C, N, n), predicted states


def scores(model: LinearModel, z: Array, repairs: list[Repair]) -> Scores:
    """Return the robust log-likelihood of z (N, m) under each repaired model."""
    N, m, n = model.H.shape
    C = len(repairs)
    parts = {f.name: np.array([getattr(r, f.name) for r in repairs]) for f in fields(Repair) if f.type == "float"}
    shaped = {
        name: np.array([np.broadcast_to(getattr(r, name), shape) for r in repairs])
        for name, shape in (("R", (m,)), ("gain", (m,)), ("rows", (m, n)), ("coupling", (m, m)), ("missing", (m,)))
    }
    jumps = np.array([np.broadcast_to(r.jump, (n + m,)) for r in repairs])
    at = np.array([r.jump_at for r in repairs])
    memory = parts["memory"][:, None, None]
    spread = shaped["R"][:, :, None] * shaped["R"][:, None, :]
    own, replaced = ~np.isnan(shaped["rows"]), np.nan_to_num(shaped["rows"])
    sensors, states = slice(n, None), slice(0, n)

    x, P = np.zeros((C, n + m)), np.zeros((C, n + m, n + m))
    x[:, states], P[:, states, states] = model.x, model.P
    H = np.zeros((C, m, n + m))
    H[:, :, sensors] = np.eye(m)
    # What lasts: a correlated error decays, a shifted level stays.
    decay = np.where(at[:, None] >= 0, 1.0, parts["memory"][:, None])
    total, path = np.zeros(C), np.zeros((C, N, n))
    for k in range(N):
        stage(f"models tried at once: {C}, at sample {k} of {N}")
        deviations = np.sqrt(np.diag(model.R[k]))
        R = spread * (model.R[k] + shaped["coupling"] * np.outer(deviations, deviations))
        if k:
            F = model.F[k]
            x[:, states] = x[:, states] @ F.T + model.offset[k]
            x[:, sensors] *= decay
            P[:, states, states] = model.fading[k] * (F @ P[:, states, states] @ F.T)
            P[:, states, states] += parts["Q"][:, None, None] * model.Q[k]
            cross = F @ P[:, states, sensors] * decay[:, None, :]
            P[:, states, sensors], P[:, sensors, states] = cross, cross.transpose(0, 2, 1)
            P[:, sensors, sensors] *= decay[:, :, None] * decay[:, None, :]
            P[:, sensors, sensors] += (1.0 - memory**2) * (memory != 0.0) * R
        else:
            P[:, sensors, sensors] = (memory != 0.0) * R
        hit = at == k
        if hit.any():
            P[hit] += jumps[hit][:, :, None] * np.eye(n + m)
        path[:, k] = x[:, states]
        seen = ~np.isnan(z[k])
        if not seen.any():
            continue
        H[:, :, states] = np.where(own, replaced, shaped["gain"][:, :, None] * model.H[k])
        R = np.where(memory != 0.0, 1e-6 * R, R)
        missing, tail = shaped["missing"][:, seen], parts["tail"][:, None]
        _correct(x, P, H[:, seen], R[:, seen][:, :, seen], z[k, seen], missing, tail, total)
    return Scores(np.where(np.isfinite(total), total, -np.inf), path)


@np.errstate(over="ignore", invalid="ignore")
def _correct(x: Array, P: Array, H: Array, R: Array, z: Array, missing: Array, tail: Array, total: Array) -> None:
    """Correct x and P in place by z and add its log density to total."""
    PH = P @ H.transpose(0, 2, 1)
    S = H @ PH + R
    if missing.any():
        # A sensor that is not to be used has a noise without bound.
        S = S + missing[:, :, None] * np.eye(len(z)) * 1e12 * np.einsum("cii->ci", S)[:, :, None]
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
    total += logdet + log_density(e, tail).sum(axis=1)
    G = PH @ T
    inside = (np.abs(e) <= _THRESHOLD).astype(float)
    x += np.einsum("cij,cj->ci", G, np.clip(e, -_THRESHOLD, _THRESHOLD))
    P -= (G * inside[:, None, :]) @ G.transpose(0, 2, 1)


def log_density(e: Array, share: Array) -> Array:
    """Return the log density of a standardized innovation that may be an outlier."""
    with np.errstate(over="ignore", under="ignore"):
        body = (1.0 - share) * np.exp(-0.5 * e * e) / np.sqrt(2.0 * np.pi)
        tail = share / (np.pi * _TAIL_SCALE * (1.0 + (e / _TAIL_SCALE) ** 2))
    return np.log(body + tail + 1e-300)


# Log-likelihood that the best of a hundred wrong candidates may gain on a recording without fault.
_GAIN = 12.0
# A factor of a variance below this is not reported.
_FACTOR = 2.0
_UNITS = (1e3, 1e-3, 1e2, 1e-2, 10.0, 0.1, 180 / np.pi, np.pi / 180, 3.6, 1 / 3.6, 0.3048, 1 / 0.3048, 1e6, 1e-6)
_AT_MOST = 3


def find(model: LinearModel, z: Array, clipped: Array, e: Array) -> list[tuple[Repair, float]]:
    """Return the causes, the weightiest first, each with the log-likelihood that its repair gains."""
    repairs: list[tuple[Repair, float]] = []
    so_far = Repair()
    base = float(scores(model, z, [so_far]).log_likelihood[0])
    while len(repairs) < _AT_MOST:
        # One good candidate hides behind another, so every round looks at all of them on the repaired model.
        stage(f"{len(repairs)} of at most {_AT_MOST} causes found")
        candidates = _candidates(model, z, clipped, e, so_far)
        best, likelihood = _search(model, z, candidates, so_far)
        gain = likelihood - base
        # After a large misfit is repaired, small ones may be left by the roughness of the repair.
        least = max(_GAIN, 0.1 * repairs[0][1]) if repairs else _GAIN
        if gain - best.cost < least or _is_slight(best):
            break
        repairs.append((best, gain))
        so_far, base = so_far.then(best), likelihood
    return repairs


def _is_slight(repair: Repair) -> bool:
    """Tell a factor too close to 1 to matter."""
    return repair.cause in ("R", "Q", "R and Q") and 1 / _FACTOR < repair.value < _FACTOR


def _search(model: LinearModel, z: Array, candidates: list[Repair], so_far: Repair) -> tuple[Repair, float]:
    """Return the best candidate after three rounds of closing in on factors, and its log-likelihood."""
    pool: dict[tuple[Any, ...], tuple[Repair, float]] = {}
    for width in (1.0, 10.0 ** (1 / 3), 10.0 ** (1 / 9), 10.0 ** (1 / 27)):
        if width != 1.0:
            candidates = [near for best, _ in _leaders(pool) for near in _near(best, width, len(z[0]))]
        if not candidates:
            break
        stage(f"{len(candidates)} repairs tried on {len(z)} samples")
        likelihoods = scores(model, z, [so_far.then(c) for c in candidates]).log_likelihood
        for candidate, likelihood in zip(candidates, likelihoods, strict=True):
            key = (candidate.cause, candidate.sensor)
            if key not in pool or likelihood - candidate.cost > pool[key][1] - pool[key][0].cost:
                pool[key] = (candidate, float(likelihood))
    return max(pool.values(), key=lambda pair: pair[1] - pair[0].cost)


def _leaders(pool: dict[tuple[Any, ...], tuple[Repair, float]]) -> list[tuple[Repair, float]]:
    """Return the five best, the only ones that closing in can make the best."""
    return sorted(pool.values(), key=lambda pair: pair[0].cost - pair[1])[:5]


def _near(repair: Repair, width: float, m: int) -> list[Repair]:
    """Return the candidate's neighbors, if it has a factor to be refined."""
    if repair.cause not in ("R", "Q", "R and Q"):
        return []
    return [_noise(repair.cause, repair.sensor, repair.value * factor, m) for factor in (width, 1 / width)]


def _noise(cause: str, sensor: int | None, factor: float, m: int) -> Repair:
    """Return a repair that multiplies a covariance."""
    unit = np.ones(m) if sensor is None else np.eye(m)[sensor]
    r = np.where(unit > 0, np.sqrt(factor), 1.0)
    if cause == "R":
        return Repair("R", sensor, factor, 1.0 if sensor is None else 1.5, R=r)
    if cause == "Q":
        return Repair("Q", None, factor, 1.0, Q=factor)
    return Repair("R and Q", None, factor, 4.0, Q=factor, R=r)


def _candidates(model: LinearModel, z: Array, clipped: Array, e: Array, so_far: Repair) -> list[Repair]:
    """Return every candidate of the first, coarse round."""
    m = model.H.shape[1]
    grid = [10.0**power for power in (-6, -5, -4, -3, -2, -1, -0.5, 0.5, 1, 2, 3, 4, 5, 6)]
    causes = ("R", "Q", "R and Q") if model.Q.any() else ("R",)
    result = [_noise(cause, None, factor, m) for cause in causes for factor in grid]
    if m > 1:
        result += [_noise("R", i, factor, m) for i in range(m) for factor in grid]
        for i in range(m):
            for unit in _UNITS:
                each = np.where(np.arange(m) == i, unit, 1.0)
                result.append(Repair("units", i, unit, 3.0, R=each, gain=each))
        for i in range(m):
            for j in range(i):
                for r in (-0.9, -0.7, -0.5, -0.3, 0.3, 0.5, 0.7, 0.9):
                    coupling = np.zeros((m, m))
                    coupling[i, j] = coupling[j, i] = r
                    result.append(Repair("coupled noise", i, r, 3.0, coupling=coupling))
    result += [Repair("correlated noise", None, a, 3.0, memory=a) for a in (-0.8, -0.5, 0.3, 0.5, 0.7, 0.8, 0.9, 0.96)]
    result += [Repair("more outliers", None, share, 2.0, tail=share) for share in (0.02, 0.2, 0.3, 0.4, 0.5)]
    return result + _rows(model, z, so_far) + _jumps(model, z, clipped, e) + _starts(model, z)


def _rows(model: LinearModel, z: Array, so_far: Repair) -> list[Repair]:
    """Return other rows of H: those that the remaining sensors suggest, and the states themselves."""
    m, n = model.H.shape[1:]
    result = []
    constant = bool(np.ptp(model.H, axis=0).max(initial=0.0) == 0.0)
    if not constant:
        return []
    for i in range(m):
        suggestions = [-model.H[0, i], *np.eye(n)]
        if m > 1:
            without = scores(model, z, [so_far.then(Repair(missing=np.eye(m)[i]))]).x[0]
            suggestions.append(_regressed(without, z[:, i]))
        for row in suggestions:
            if row is not None and not np.allclose(row, model.H[0, i]):
                rows = np.full((m, n), np.nan)
                rows[i] = row
                result.append(Repair("H", i, 1.0, 2.0 + 2.0 * n, rows=rows))
    return result


def _regressed(x: Array, z: Array) -> Array | None:
    """Return the row h that makes z = h x best, whatever the outliers say."""
    seen = ~np.isnan(z) & np.isfinite(x).all(axis=1)
    if seen.sum() < 5 * x.shape[1]:
        return None
    x, z = x[seen], z[seen]
    # Sums of squares have to be numbers.
    far = 1e50 * max(float(np.median(np.abs(z - np.median(z)))), 1e-300)
    z = np.clip(z, np.median(z) - far, np.median(z) + far)
    # The unit of a state must not decide how much it counts.
    size = np.maximum(np.abs(x).max(axis=0), 1e-300)
    start = np.linalg.lstsq(x / size, z, rcond=1e-9)[0]
    wide = max(float(np.median(np.abs(z - x / size @ start))), 1e-12 * float(np.abs(z).max(initial=1e-300)))
    fit = least_squares(lambda h: (x / size @ h - z) / wide, start, loss="soft_l1", max_nfev=50)
    return np.asarray(fit.x / size)


def _jumps(model: LinearModel, z: Array, clipped: Array, e: Array) -> list[Repair]:
    """Return jumps of the state and of each sensor where a run of clipped samples or a change of mean begins."""
    m, n = model.H.shape[1:]
    result = []
    for i in np.flatnonzero(~np.isnan(z).all(axis=0)).tolist():
        size = float(np.nanmax(np.abs(z[:, i] - np.nanmedian(z[:, i])), initial=1e-300))
        # Beyond this the square overflows.
        size = min(size, 1e150) ** 2
        for k in sorted({0, *_breaks(e[:, i])}):
            if k:
                row = model.H[k, i] ** 2
                weighty = row > 1e-12 * row.max(initial=1e-300)
                state = np.where(weighty, size / np.where(weighty, row, 1.0), 0.0)
                result.append(Repair("state jump", i, float(k), 5.0, jump_at=k, jump=np.r_[state, np.zeros(m)]))
            if m > 1:
                sensor = np.r_[np.zeros(n), size * np.eye(m)[i]]
                cause = "level shift" if k else "bias"
                result.append(Repair(cause, i, float(k), 5.0, jump_at=k, jump=sensor))
    return result


def _starts(model: LinearModel, z: Array) -> list[Repair]:
    """Return a first state that is as uncertain as the first innovations suggest."""
    m = model.H.shape[1]
    first = np.clip(np.nan_to_num(z[:5] - model.H[:5] @ model.x), -1e150, 1e150)
    size = np.median(np.abs(first), axis=0) ** 2
    row = model.H[0] ** 2
    weighty = row > 1e-12 * row.max(initial=1e-300)
    seen = np.where(weighty, size[:, None] / np.where(weighty, row, 1.0), 0.0).max(axis=0)
    jump = np.r_[seen + 100.0 * model.P.diagonal(), np.zeros(m)]
    return [Repair("wrong start", None, 0.0, 4.0, jump_at=0, jump=jump)]


def unseen(model: LinearModel, z: Array) -> tuple[str, ...]:
    """Return which noises, ten times too large or too small, a recording of this kind would not show."""
    # By trial: recordings are drawn from the repaired model, with the same gaps, and the repair is looked for in them.
    rng, unnoticed = np.random.default_rng(0), []
    for name in ("R", "Q") if model.Q.any() else ("R",):
        for word, factor in (("too large", 0.1), ("too small", 10.0)):
            repair = _noise(name, None, factor, model.H.shape[1])
            gains = []
            for _ in range(3):
                drawn = np.where(np.isnan(z), np.nan, _drawn(model, repair, rng))
                wrong, right = scores(model, drawn, [Repair(), repair]).log_likelihood
                gains.append(right - wrong - repair.cost)
            if np.median(gains) < _GAIN:
                unnoticed.append(f"{name} ten times {word}")
    return tuple(unnoticed)


def _drawn(model: LinearModel, repair: Repair, rng: np.random.Generator) -> Array:
    """Return a recording of the repaired model, shape of z."""
    x = rng.multivariate_normal(model.x, model.P, method="eigh")
    N, m, n = model.H.shape
    zs = np.empty((N, m))
    for k in range(N):
        if k:
            w = rng.multivariate_normal(np.zeros(n), repair.Q * model.Q[k], method="eigh")
            x = model.F[k] @ x + model.offset[k] + w
        noise = rng.multivariate_normal(np.zeros(m), model.R[k], method="eigh")
        zs[k] = model.H[k] @ x + repair.R * noise
    return zs


def _breaks(e: Array) -> list[int]:
    """Return where one sensor's heaviest run of large innovations starts, and where its mean changes most."""
    size = np.minimum(np.abs(np.nan_to_num(e)), 30.0)
    sign = np.where(size > 2.0, np.sign(e), 0.0)
    start, weight, best = 0, 0.0, (0.0, 0)
    for k, s in enumerate(sign):
        if not (s and k and s == sign[k - 1]):
            start, weight = k, 0.0
        elif s:
            # The first of a run does not count: alone it is an outlier.
            weight += float(size[k])
        if weight > best[0]:
            best = (weight, start)
    bounded = np.clip(np.nan_to_num(e), -3.0, 3.0)
    N = len(e)
    before = np.arange(1, N)
    change = np.abs(np.cumsum(bounded)[:-1] - before / N * bounded.sum()) / np.sqrt(before * (N - before) / N)
    breaks = [best[1]]
    if N > 20:
        breaks.append(int(change[5:-5].argmax()) + 6)
    return [k for around in breaks for k in (around - 1, around) if 0 < k < N]
