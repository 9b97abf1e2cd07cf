"""The least robust loss of a model's residuals: Levenberg and Marquardt's steps, the noise re-estimated at each.

Each step is a weighted least-squares problem, by orthogonal transformation; a step that leaves the stable region or
raises the loss is shortened. scipy's `least_squares` needs the scale of the noise beforehand, and thus a whole
optimisation for each scale.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
from scipy.signal import fftconvolve

from robust_filterpy._checks import Array
from robust_filterpy.identification.estimation.colour import colour_of
from robust_filterpy.identification.estimation.limits import Limits
from robust_filterpy.identification.estimation.missing import CompletedModel
from robust_filterpy.identification.models.noise import Noise, Noises

__all__ = ["Optimum", "minimised", "sandwich"]

# A step that would change the residuals by less than this share of them ends the search.
_PRECISION: Final = 1e-9
_MOST_STEPS: Final = 100
_MOST_SHORTENINGS: Final = 12


_Noise: TypeAlias = Noise | Noises


class Optimum(NamedTuple):
    """Where the search ended.

    Attributes
    ----------
    p : ndarray, shape (n,)
        Free parameters.
    noise : Noise or Noises
        Noise of the residuals there.
    residual : ndarray, shape (N - first,)
        Residuals there.
    converged : bool
        Whether the steps became small, rather than many.
    """

    p: Array
    noise: Any
    residual: Array
    converged: bool


def minimised(
    model: Any,
    p: Array,
    noise: _Noise,
    rows: Array,
    clear: Array,
    most_steps: int = _MOST_STEPS,
    limits: Limits | None = None,
    precision: float = 0.0,
) -> Optimum:
    """Minimise the loss of the residuals from p on."""
    unknown = model if isinstance(model, CompletedModel) else None
    residual, damping = model.residuals(p), 1e-3
    for _ in range(most_steps):
        noise = noise.refitted(residual[clear])
        root = np.sqrt(noise.weights(residual[rows]) / noise.variance)
        jacobian, target = model.jacobian(p)[rows] * root[:, None], root * residual[rows]
        cost = noise.cost(residual[rows])
        if unknown is not None:
            further, derivatives = unknown.further(p)
            jacobian, target = np.concatenate((jacobian, derivatives)), np.concatenate((target, further))
            cost += unknown.half_log_det(p)
        if limits is not None:
            jacobian[:, limits.held(p, jacobian.T @ target)] = 0.0
        size = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
        size[size == 0.0] = 1.0
        triangle = np.asarray(np.linalg.qr(np.column_stack((jacobian / size, target)), mode="r"))
        if not np.isfinite(triangle).all():
            # A model far from stable has derivatives that overflow; the search from another start goes on.
            return Optimum(p, noise, residual, False)
        taken = None
        for _ in range(_MOST_SHORTENINGS):
            step, change = _step(triangle, damping)
            trial = p - step / size if limits is None else limits.inside(p - step / size)
            if model.is_stable(trial):
                new = model.residuals(trial)
                price = noise.cost(new[rows]) + (0.0 if unknown is None else unknown.half_log_det(trial))
                if np.isfinite(new).all() and price < cost:
                    taken = trial, new
                    break
            damping = max(4.0 * damping, 1e-6)
        if taken is None:
            return Optimum(p, noise, residual, True)
        p, residual = taken
        damping = max(damping / 10.0, 1e-12)
        if change <= max(_PRECISION * np.linalg.norm(target), precision):
            return Optimum(p, noise.refitted(residual[clear]), residual, True)
    return Optimum(p, noise.refitted(residual[clear]), residual, False)


def _step(triangle: Array, damping: float) -> tuple[Array, float]:
    """Return the step for a damping, with columns of unit size, and the change of the residuals that it brings."""
    n = triangle.shape[1] - 1
    R, z = triangle[:n, :n], triangle[:n, n]
    damped = np.vstack((R, np.sqrt(damping) * np.eye(n)))
    step = np.linalg.lstsq(damped, np.concatenate((z, np.zeros(n))), rcond=None)[0]
    return step, float(np.linalg.norm(R @ step))


def sandwich(jacobian: Array, residual: Array, noise: _Noise, shared: int) -> tuple[Array, float]:
    """Return the covariance of the free parameters at an optimum."""
    # ``(N/(N - n)) R (J'J)^-1 J' C J (J'J)^-1 / mean(psi')^2`` with C the covariance of psi: diag(psi^2) where psi is
    # white (Huber, Robust Statistics, 1981, section 7.6), otherwise that of the autoregression that it shows. This
    # holds whatever the distribution of the residuals is. Rounding counts as white and as no less than R in each
    # sample. With a noise for each output, J and psi are weighted by mean(psi')/R of it, and each psi has a colour;
    # directions that nothing depends on have no variance.
    psi, slope = noise.psi(residual), noise.slope(residual)
    weighted = jacobian * np.broadcast_to(np.sqrt(slope / noise.variance), residual.shape)[:, None]
    size = np.linalg.norm(weighted, axis=0)
    size[size == 0.0] = 1.0
    # Derivatives of theta by psi, (J'J)^-1 J', without forming J'J.
    left, values, right = np.linalg.svd(weighted / size, full_matrices=False)
    kept = values > 1e-10 * values[0]
    effect = (right[kept].T / values[kept]) @ left[:, kept].T / size[:, None] / np.sqrt(slope)
    parts = (noise,) if isinstance(noise, Noise) else noise.parts
    outputs = [slice(None)] if isinstance(noise, Noise) else [noise.which == j for j in range(len(parts))]
    # What rounding leaves follows the signal: at rest its colour and its zeros say nothing of errors elsewhere.
    for part, own in zip(parts, outputs, strict=True):
        if part.is_rounding:
            psi[own] = np.maximum(np.abs(psi[own]), 1.0)
    white = carried = effect * psi
    colours = [
        np.ones(1) if part.is_rounding else colour_of(psi[own]).response
        for part, own in zip(parts, outputs, strict=True)
    ]
    if any(h.size > 1 for h in colours):
        carried = np.hstack([
            white[:, own] if h.size == 1
            else fftconvolve(effect[:, own], h[None, ::-1], axes=1) * np.sqrt(np.mean(psi[own] ** 2))
            for own, h in zip(outputs, colours, strict=True)
        ])  # fmt: skip
    more = residual.size / (residual.size - int(kept.sum()))
    P, plain = more * (carried @ carried.T), more * (white @ white.T)
    before, after = plain.diagonal()[:shared], P.diagonal()[:shared]
    return P, float(np.sqrt(np.mean(np.divide(after, before, out=np.ones(before.size), where=before > 0.0))))
