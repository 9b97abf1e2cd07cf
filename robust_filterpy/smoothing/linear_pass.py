"""A recording as whitened arrays, and one pass of a linear smoother, with a weight for each measurement and step.

A whitened component z = h x + e of the measurement enters as a factor exp(-d e^2/2 - o e) of its residual e: d = 1,
o = 0 is an ordinary one, d = o = 0 a missing one, and any other precision d and offset o are what a robust smoother
makes of it. The process noise of step k is G w with w ~ N(0, q_k I), so that G may be singular and q_k large.

Forward a Kalman filter, backward the recursion of Bryson and Frazier for the score s and the information L of the
later measurements, which needs the inverse of no predicted covariance (A. E. Bryson and M. Frazier, Smoothing for
linear and nonlinear dynamic systems, 1963; P. de Jong, Journal of the American Statistical Association 84, 1989)::

    x_s = x + P s,   P_s = P - P L P,   e = z - H x_s,   V = H P_s H'
    s <- s + H'(d e + o),   L <- L + H'(d - d V d) H - H'd H P L - L P H'd H,   then s <- F's, L <- F'L F

Next to a diffuse P the last line loses the digits of P_s: there P - P L P is the difference of large numbers. So states
and covariances, once they are wanted, come from the information filter run backward, whose result corrects x and P as a
measurement would (D. C. Fraser and J. E. Potter, IEEE Transactions on Automatic Control 14, 1969), and e and V from
them. They are wanted, whoever asks, where a measurement tells far more than the prior did, as after a gap in front.

Every array has the axes (series, step) in front, of length 1 where one matrix serves all of them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks, kernel
from robust_filterpy._checks import Array
from robust_filterpy.filters.problem import finite, read
from robust_filterpy.kernel.series import plain

# From this d H P H' on V is no more than rounding, unless it is that of the smoothed states.
_SHARP = 1e6
# Nothing is distinguished that is so many standard deviations away, and what is squared there stays finite.
_FURTHEST = 1e30


class Model(NamedTuple):
    """A linear model, its measurements whitened: x_k = F x_(k-1) + c + G w, with prior mean and covariance of x_0."""

    #: Transition matrices, (series or 1, steps or 1, n, n).
    F: Array
    #: Roots of the process noise covariance, Q = G G', (.., .., n, r).
    G: Array
    #: Known part of the prediction, (.., .., n).
    c: Array
    #: Measurement matrices in units of the noise, (.., .., m, n).
    H: Array
    #: Measurements in units of the noise, (series, steps, m); a missing one is any number.
    z: Array
    #: Mean before the first prediction, (series or 1, n).
    x0: Array
    #: Its covariance, (series or 1, n, n).
    P0: Array


class Weighting(NamedTuple):
    """What the pass makes of the measurements and of the process noise."""

    #: d of each component, (series, steps, m), >= 0.
    precision: Array
    #: o of each component, (series, steps, m).
    offset: Array
    #: q of each step, (series, steps), >= 0: factor of Q.
    process_scale: Array


class Smooth(NamedTuple):
    """What a pass returns; what was not wanted has length 0 along its steps."""

    #: H x_s, (series, steps, m).
    fitted: Array
    #: H P_s H', (series, steps, m, m).
    spread: Array
    #: G's, (series, steps, r): the smoothed process noise is q G's, in units of G.
    score: Array
    #: G'L G, (series, steps, r, r): its covariance is q I - q^2 G'L G.
    information: Array
    #: Smoothed states, (series, steps, n).
    x: Array
    #: Their covariances, (series, steps, n, n).
    P: Array
    #: Smoothed state before the first prediction, (series, n), if states were wanted.
    x0: Array
    #: Its covariance, (series, n, n).
    P0: Array


def smoothing_pass(model: Model, weighting: Weighting, *, states: bool = False, process: bool = False) -> Smooth:
    """Smooth all series once: by the kernel (``kernel/smoother.h``), else by the definition."""
    out = _room(model, weighting, states, process)
    if _passed(model, weighting, out) > _SHARP and not states:
        return smoothing_pass(model, weighting, states=True, process=process)
    return out


def _passed(model: Model, weighting: Weighting, out: Smooth) -> float:
    """Write what a pass returns; return the most that a measurement added to the prior information, d H P H'."""
    extension = kernel.extension()
    if extension is None:
        return _by_definition(model, weighting, out)
    given = model._replace(x0=model.x0[:, None], P0=model.P0[:, None])
    weights = weighting._replace(process_scale=weighting.process_scale[..., None])
    rooms = (*out[:2], *(None if a.shape[1] == 0 else a for a in out[2:6]), *out[6:])
    return float(extension.smooth(tuple(map(plain, given)), tuple(map(plain, weights)), rooms))


def _room(model: Model, weighting: Weighting, states: bool, process: bool) -> Smooth:
    """Return empty arrays for what a pass returns."""
    series, steps, m = weighting.precision.shape
    n, r = model.G.shape[2:]
    shown, driven = (steps if wanted else 0 for wanted in (states, process))
    return Smooth(
        np.empty((series, steps, m)), np.empty((series, steps, m, m)),
        np.empty((series, driven, r)), np.empty((series, driven, r, r)),
        np.empty((series, shown, n)), np.empty((series, shown, n, n)), np.empty((series, n)), np.empty((series, n, n)),
    )  # fmt: skip


def _by_definition(model: Model, weighting: Weighting, out: Smooth) -> float:
    """Smooth all series, step by step, and return the most that a measurement added to the prior information."""
    d, o, q = weighting
    series, steps = q.shape
    n = model.F.shape[-1]
    means, covariances = np.empty((series, steps, n)), np.empty((series, steps, n, n))
    x = np.broadcast_to(model.x0, (series, n))
    P = np.broadcast_to(model.P0, (series, n, n))
    sharpest = 0.0
    for k in range(steps):
        F, G, c, H = _at(model, k)
        x = _times(F, x) + c
        P = F @ P @ _t(F) + q[:, k, None, None] * (G @ _t(G))
        for v in range(H.shape[-2]):
            h = H[..., v, :]
            sharpest = max(sharpest, float((d[:, k, v] * (h * _times(P, h)).sum(axis=-1)).max(initial=0.0)))
            x, P = _corrected(x, P, h, model.z[:, k, v], d[:, k, v], o[:, k, v])
        means[:, k], covariances[:, k] = x, P
    s, L = np.zeros((series, n)), np.zeros((series, n, n))
    later = np.zeros((series, n)), np.zeros((series, n, n))
    for k in range(steps - 1, -1, -1):
        F, G, c, H = _at(model, k)
        x, P = means[:, k], covariances[:, k]
        if out.x.shape[1]:
            out.x[:, k], out.P[:, k] = _combined(x, P, *later)
            later = _earlier(*later, F, q[:, k, None, None] * (G @ _t(G)), c, H, model.z[:, k], d[:, k], o[:, k])
        PH = P @ _t(H)
        B = L @ PH
        fitted = _times(H, x) + _times(_t(PH), s)
        V = H @ PH - _t(PH) @ B
        wanted = out.x.shape[1]
        out.fitted[:, k] = _times(H, out.x[:, k]) if wanted else fitted
        out.spread[:, k] = H @ out.P[:, k] @ _t(H) if wanted else V
        dH = d[:, k, :, None] * H
        s = s + _times(_t(H), d[:, k] * (model.z[:, k] - fitted) + o[:, k])
        L = L + _t(H) @ dH - _t(dH) @ V @ dH - _t(dH) @ _t(B) - B @ dH
        L = 0.5 * (L + _t(L))
        if out.score.shape[1]:
            out.score[:, k], out.information[:, k] = _times(_t(G), s), _t(G) @ L @ G
        s, L = _times(_t(F), s), _t(F) @ L @ F
    if out.x.shape[1]:
        x0, P0 = np.broadcast_to(model.x0, (series, n)), np.broadcast_to(model.P0, (series, n, n))
        out.x0[:], out.P0[:] = _combined(x0, P0, *later)
    return sharpest


def _corrected(x: Array, P: Array, h: Array, z: Array | float, d: Array, o: Array) -> tuple[Array, Array]:
    """Return mean and covariance after one component: with M = 1/(1 + d h'P h) the gain P h M d, in Joseph's form."""
    Ph = _times(P, h)
    gain = Ph / (1.0 + d * (h * Ph).sum(axis=-1))[:, None]
    x = x + gain * (d * (z - (h * x).sum(axis=-1)) + o)[:, None]
    C = np.eye(h.shape[-1]) - (gain * d[:, None])[..., None] * h[..., None, :]
    P = C @ P @ _t(C) + d[:, None, None] * gain[..., None] * gain[..., None, :]
    return x, 0.5 * (P + _t(P))


def _combined(x: Array, P: Array, y: Array, Y: Array) -> tuple[Array, Array]:
    """Return mean and covariance with the information exp(-x'Y x/2 + y'x) taken in, as n measurements: Y = L D L'."""
    Y, y = Y.copy(), y.copy()
    for j in range(Y.shape[-1]):
        pivot = np.maximum(Y[:, j, j], 0.0)
        row = np.divide(Y[:, j], pivot[:, None], out=np.zeros_like(y), where=pivot[:, None] > 0.0)
        potential = np.where(pivot > 0.0, y[:, j], 0.0)
        x, P = _corrected(x, P, row, 0.0, pivot, potential)
        Y = Y - pivot[:, None, None] * row[:, :, None] * row[:, None]
        y = y - row * potential[:, None]
    return x, P


def _earlier(
    y: Array, Y: Array, F: Array, Q: Array, c: Array, H: Array, z: Array, d: Array, o: Array
) -> tuple[Array, Array]:
    """Return the information about the state before a step from that about the state after it."""
    Y = Y + _t(H) @ (d[:, :, None] * H)
    y = y + _times(_t(H), d * z + o) - _times(Y, c)
    left = _t(F) @ np.linalg.inv(np.eye(Y.shape[-1]) + Y @ Q)
    Y = left @ Y @ F
    return _times(left, y), 0.5 * (Y + _t(Y))


def _at(model: Model, k: int) -> tuple[Array, Array, Array, Array]:
    """Return F, G, c, H of a step."""
    F, G, c, H = (a[:, k if a.shape[1] > 1 else 0] for a in (model.F, model.G, model.c, model.H))
    return F, G, c, H


def _t(a: Array) -> Array:
    """Return transposed matrices."""
    return a.swapaxes(-1, -2)


def _times(a: Array, v: Array) -> Array:
    """Return products of matrices and vectors."""
    return (a @ v[..., None])[..., 0]


class Recording(NamedTuple):
    """A smoothing problem."""

    model: Model
    #: Which components were measured, (series, steps, m).
    observed: Array
    #: Which columns of G are not zero, (series, steps, r).
    driven: Array


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
    unit = np.sqrt(np.maximum(np.diagonal(R, axis1=-2, axis2=-1), np.finfo(float).tiny))
    Z = R / unit[..., None] / unit[..., None, :]
    least = np.linalg.eigvalsh(Z)[..., 0]
    if (least <= m * np.finfo(float).eps).any():
        raise ValueError(
            f"R: expected noise of every sensor, got correlations with the least eigenvalue {least.min():.3g}; "
            "give it a little"
        )
    filled = np.where(observed, z, 0.0)
    if not (Z * (1.0 - np.eye(m))).any():
        return H / unit[..., None], np.clip(filled / unit, -_FURTHEST, _FURTHEST)
    # What is missing has a noise of its own, and no part in the others (`correction.result.correlation_whitening`).
    there: Any = np.True_ if observed.all() else observed[..., None] * observed[..., None, :]
    values, vectors = np.linalg.eigh(np.where(there, Z, np.eye(m)))
    T = there * ((vectors / np.sqrt(values)[..., None, :]) @ vectors.swapaxes(-1, -2)) / unit[..., None, :]
    return T @ H, np.clip((T @ filled[..., None])[..., 0], -_FURTHEST, _FURTHEST)
