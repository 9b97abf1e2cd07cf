"""From batch_filter's lists to the arrays of the compiled loops, or a decision that they are not for them."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy._arrays import noise_covariance, process_noise, state_of
from robust_filterpy._checks import Array, numbers
from robust_filterpy.compiled import dispatch


class Recording:
    """A recording ready for the compiled loops."""

    def __init__(self, choices: Any, zs: Array, model: Any, kept: dispatch.Kept, options: dict[str, Any]) -> None:
        """Keep the arrays; zs has shape (1, N, m)."""
        self.choices, self.zs, self.model, self.kept, self.options = choices, zs, model, kept, options
        seen = np.flatnonzero(~np.isnan(zs[0]).all(axis=1))
        self.last_seen = int(seen[-1]) if len(seen) else -1

    def advance(self, kf: Any, k: int) -> int:
        """Take steps from k on as far as the loops can and return the next, which is the filter's.

        The filter's own are the last step and the last with a measurement: what they leave in it stays.
        """
        last = self.last_seen if k <= self.last_seen else self.zs.shape[1] - 1
        if k >= last:
            return k
        x, P = state_of(kf)
        state, covariance = x.reshape(1, -1).copy(), P[None].copy()
        taken = int(
            dispatch.recurse(
                self.choices, self.zs[:, :last], self.model, state, covariance, self.kept, start=k, **self.options
            )[0]
        )
        if taken > k:
            # What else a step leaves in the filter, the filter's own next step sets anew.
            kf.x, kf.P = state[0].reshape(x.shape), covariance[0]
        return taken


def prepared(
    kf: Any, zs: Any, Fs: Any, Qs: Any, Hs: Any, Rs: Any, Bs: Any, us: Any, kept: dispatch.Kept, update_first: bool
) -> Recording | None:
    """Return the recording for the loops, None if the call is for the filter's own methods."""
    try:
        x, P = state_of(kf)
        n, steps = len(x), len(zs)
        H = _stack(kf.H, Hs, steps, None)
        if H.ndim != 3 or H.shape[2] != n or (Hs is None and H.shape[1] != kf.dim_z):
            return None
        m = H.shape[1]
        F = _stack(kf.F, Fs, steps, (n, n))
        Q = process_noise(kf.Q, None, n) * np.ones((1, n, n)) if Qs is None else _stack(None, Qs, steps, (n, n), True)
        R = noise_covariance(kf.R, None, m)[None] if Rs is None else _stack(None, Rs, steps, (m, m), True)
        if not (_symmetric(Q) and _symmetric(R) and _symmetric(P[None]) and _positive(R)):
            return None
        rows = measurements(zs, m)
        control = _control(kf.B, Bs, us, n, steps)
    except (TypeError, ValueError, AttributeError, np.linalg.LinAlgError):
        # Let the filter's own methods say what is wrong, and at which step.
        return None
    model = tuple(np.ascontiguousarray(a, dtype=float)[None] for a in (F, Q, H, R, control))
    options = {"alpha_sq": float(kf._alpha_sq), "update_first": update_first, "likely": False}
    return Recording(kf._choices, rows[None], model, kept, options)


def measurements(zs: Any, m: int) -> Array:
    """Return measurements as shape (N, m), None and masked rows as NaN, or raise."""
    steps = len(zs)
    if not isinstance(zs, np.ndarray):
        gap = [np.nan] * m
        zs = [gap if z is None else np.ma.filled(np.ma.asarray(z, dtype=float), np.nan).ravel() for z in zs] if any(
            z is None or isinstance(z, np.ma.MaskedArray) for z in zs
        ) else zs  # fmt: skip
    values = numbers("zs", zs)
    if values.size != steps * m or values.ndim > 3 or (values.ndim == 3 and 1 not in values.shape[1:]):
        raise ValueError(f"zs: expected shape {(steps, m)}, got {values.shape}")
    return np.ascontiguousarray(values.reshape(steps, m))


def _stack(default: Any, values: Any, steps: int, shape: tuple[int, int] | None, scalars: bool = False) -> Array:
    """Return one matrix, or one a step, as shape (1 or N, ., .), or raise; a scalar stands for itself times I."""
    if values is None:
        found = numbers("matrix", default)[None]
    else:
        found = numbers("matrices", values if isinstance(values, np.ndarray) else list(values)[:steps])[:steps]
        if scalars and found.ndim == 1:
            found = found[:, None, None] * np.eye(shape[0])  # type: ignore[index]
    if found.ndim != 3 or (shape is not None and found.shape[1:] != shape):
        raise ValueError("matrices: expected one shape for all steps")
    return found


def _symmetric(stack: Array) -> bool:
    """Return whether every matrix is symmetric to rounding, since the loops look at one half."""
    transposed = stack.transpose(0, 2, 1)
    return bool((np.abs(stack - transposed) <= 1e-13 * (np.abs(stack) + np.abs(transposed))).all())


def _positive(R: Array) -> bool:
    """Return whether every R is finite and positive definite."""
    if not np.isfinite(R).all():
        return False
    if R.shape[1] == 1:
        return bool((R > 0.0).all())
    np.linalg.cholesky(R)
    return True


def _control(B: Any, Bs: Any, us: Any, n: int, steps: int) -> Array:
    """Return B u as shape (1 or N, n)."""
    if us is None or (B is None and Bs is None):
        return np.zeros((1, n))
    if Bs is None and np.ndim(B) == 0 and B == 0:
        return np.zeros((1, n))
    matrices = _stack(B, Bs, steps, None)
    width = matrices.shape[2]
    if matrices.shape[1] != n:
        raise ValueError("B: expected a row for each state")
    u = measurements(us if isinstance(us, np.ndarray) else list(us)[:steps], width)[:steps]
    if not np.isfinite(u).all():
        raise ValueError("us: expected finite numbers")
    return np.einsum("kij,kj->ki", np.broadcast_to(matrices, (steps, n, width)), u)
