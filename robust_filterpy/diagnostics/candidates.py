"""Repaired copies of a model, judged by how likely each makes the recording: the engine of `diagnose`.

All candidates go through the recording side by side, as one batch of small matrices, by the robust filter with
Huber's psi and realized information. The state has one more part for each sensor, an error of that sensor: 0 unless
a candidate gives it a memory (correlated noise) or lets it jump (level shift).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

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
        """Return both repairs, told as the second."""
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
        _correct(
            x,
            P,
            H[:, seen],
            R[:, seen][:, :, seen],
            z[k, seen],
            shaped["missing"][:, seen],
            parts["tail"][:, None],
            total,
        )
    return Scores(np.where(np.isfinite(total), total, -np.inf), path)


def _correct(x: Array, P: Array, H: Array, R: Array, z: Array, missing: Array, tail: Array, total: Array) -> None:
    """Correct x and P in place by z and add its log density to total."""
    PH = P @ H.transpose(0, 2, 1)
    S = H @ PH + R
    if missing.any():
        # A sensor that is not to be used has a noise without bound.
        S = S + missing[:, :, None] * np.eye(len(z)) * 1e12 * np.einsum("cii->ci", S)[:, :, None]
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
