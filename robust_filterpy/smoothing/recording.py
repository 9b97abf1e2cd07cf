"""From a filter and lists, as `batch_filter` takes them, to the arrays of a smoothing problem, checked."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.correction.whitening import standardize
from robust_filterpy.filters.problem import finite, read
from robust_filterpy.smoothing.linear_pass import Model

_FURTHEST = 1e30


class Recording(NamedTuple):
    """A smoothing problem."""

    model: Model
    observed: Array
    """Which components were measured, (series, steps, m)."""
    driven: Array
    """Which columns of G are not zero, (series, steps, r)."""


def linear_recording(kf: Any, zs: Any, *each: Any) -> Recording:
    """Return the problem of a linear filter and a recording; each: Fs, Qs, Hs, Rs, Bs, us."""
    recording = finite(read(kf, zs, *each))
    if getattr(kf, "alpha", 1.0) != 1.0:
        raise ValueError(f"alpha: expected 1, got {kf.alpha}; fading memory is no model to smooth by; raise Q")
    z, F, Q, H, R, c, x, P = (part[None] for part in recording[:8])
    return problem(F, Q, c, H, R, z, x, P)


def problem(F: Array, Q: Array, c: Array, H: Array, R: Array, z: Array, x0: Array, P0: Array) -> Recording:
    """Return the problem of arrays with axes (series, step) in front: measurements whitened, covariances as roots."""
    for name, value in (("F", F), ("H", H), ("B u", c), ("x", x0)):
        if not np.isfinite(value).all():
            raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
    _checks.covariance("P", P0, _checks.GATHERED, _checks.ROUNDING)
    G = noise_root(Q)
    observed = ~np.isnan(z)
    H, z = _whitened(H, R, z, observed)
    model = Model(F, G, c, H, z, x0, P0)
    driven = np.broadcast_to((G != 0.0).any(axis=-2), (*z.shape[:2], G.shape[-1]))
    return Recording(model, observed, driven)


def noise_root(Q: Array) -> Array:
    """Return G with G G' = Q for a stack of positive semidefinite matrices, without columns that are zero in all."""
    _checks.covariance("Q", Q, _checks.GATHERED, _checks.ROUNDING)
    values, vectors = np.linalg.eigh(0.5 * (Q + Q.swapaxes(-1, -2)))
    floor = Q.shape[-1] * np.finfo(float).eps * np.abs(values).max(axis=-1, keepdims=True)
    roots = np.sqrt(np.where(values > floor, values, 0.0))
    rank = max(int((roots > 0.0).any(axis=tuple(range(roots.ndim - 1))).sum()), 1)
    return np.ascontiguousarray((vectors * roots[..., None, :])[..., -rank:])


def _whitened(H: Array, R: Array, z: Array, observed: Array) -> tuple[Array, Array]:
    """Return H and z in units of the noise, T R T' = I, with zeros where nothing was observed."""
    m = R.shape[-1]
    _checks.covariance("R", R)
    least = np.linalg.eigvalsh(R)[..., 0] if m > 1 else R[..., 0, 0]
    if (least <= 0.0).any():
        raise ValueError(f"R: expected noise of every sensor, got least eigenvalue {least.min():.3g}; give it a little")
    # Nothing is distinguished that is so many standard deviations away, and what is squared there stays finite.
    filled = np.where(observed, z, 0.0)
    if not (R * (1.0 - np.eye(m))).any():
        root = 1.0 / np.sqrt(np.diagonal(R, axis1=-2, axis2=-1))
        return root[..., None] * H, np.clip(root * filled, -_FURTHEST, _FURTHEST)
    T = _scalings(R, observed)
    return T @ H, np.clip((T @ filled[..., None])[..., 0], -_FURTHEST, _FURTHEST)


def _scalings(R: Array, observed: Array) -> Array:
    """Return T of the observed block of R at each step, zero elsewhere; computed once for each block that occurs."""
    (series, steps), m = R.shape[:2] if observed.all() else observed.shape[:2], R.shape[-1]

    @cache
    def scaling(R_k: bytes, part: bytes) -> Array:
        there, T = np.frombuffer(part, dtype=bool), np.zeros((m, m))
        if there.any():
            pick = np.ix_(there, there)
            T[pick] = standardize(np.frombuffer(R_k).reshape(m, m)[pick], "innovation")[0]
        return T

    pairs = [(R[s % len(R), k % R.shape[1]], observed[s, k]) for s in range(series) for k in range(steps)]
    return np.array([scaling(R_k.tobytes(), part.tobytes()) for R_k, part in pairs]).reshape(series, steps, m, m)
