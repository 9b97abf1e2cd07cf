"""The least robust loss of a model's residuals: Levenberg and Marquardt's steps, the noise re-estimated at each.

Each step is a weighted least-squares problem, by orthogonal transformation; a step that leaves the stable region or
raises the loss is shortened. scipy's `least_squares` needs the scale of the noise beforehand, and thus a whole
optimisation for each scale.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.learnt_noise import Noise

__all__ = ["Optimum", "minimised", "sandwich"]

# A step that would change the residuals by less than this share of them ends the search.
_PRECISION: Final = 1e-9
_MOST_STEPS: Final = 100
_MOST_SHORTENINGS: Final = 12


class Optimum(NamedTuple):
    """Where the search ended.

    Attributes
    ----------
    p : ndarray, shape (n,)
        Free parameters.
    noise : Noise
        Noise of the residuals there.
    residual : ndarray, shape (N - first,)
        Residuals there.
    converged : bool
        Whether the steps became small, rather than many.
    """

    p: Array
    noise: Noise
    residual: Array
    converged: bool


def minimised(model: Any, p: Array, noise: Noise, rows: Array, clear: Array, most_steps: int = _MOST_STEPS) -> Optimum:
    """Minimise the loss of the residuals from p on.

    Parameters
    ----------
    model : PolynomialModel
        Gives ``residuals(p)``, ``jacobian(p)``, ``uncertainty(p)`` and ``is_stable(p)``.
    p : ndarray, shape (n,)
        Where to begin, stable.
    noise : Noise
        Noise to begin with.
    rows : ndarray of bool, shape (N - first,)
        Which residuals count.
    clear : ndarray of bool, shape (N - first,)
        Which of them show the noise.
    most_steps : int, default 100
        Ends the search.

    Returns
    -------
    Optimum
    """
    residual, damping = model.residuals(p), 1e-3
    for _ in range(most_steps):
        noise = noise.refitted(residual[clear])
        root, unit = np.sqrt(noise.weights(residual[rows])), np.sqrt(noise.R)
        further, derivatives = model.uncertainty(p)
        jacobian = np.concatenate((model.jacobian(p)[rows] * root[:, None], unit * derivatives))
        size = np.sqrt(np.einsum("ij,ij->j", jacobian, jacobian))
        size[size == 0.0] = 1.0
        target = np.concatenate((root * residual[rows], unit * further))
        cost = noise.cost(residual[rows]) + 0.5 * further @ further
        triangle = np.asarray(np.linalg.qr(np.column_stack((jacobian / size, target)), mode="r"))
        taken = None
        for _ in range(_MOST_SHORTENINGS):
            step, change = _step(triangle, damping)
            trial = p - step / size
            if model.is_stable(trial):
                new = model.residuals(trial)
                further, _ = model.uncertainty(trial)
                if np.isfinite(new).all() and noise.cost(new[rows]) + 0.5 * further @ further < cost:
                    taken = trial, new
                    break
            damping = max(4.0 * damping, 1e-6)
        if taken is None:
            return Optimum(p, noise, residual, True)
        p, residual = taken
        damping = max(damping / 10.0, 1e-12)
        if change <= _PRECISION * np.linalg.norm(target):
            return Optimum(p, noise.refitted(residual[clear]), residual, True)
    return Optimum(p, noise.refitted(residual[clear]), residual, False)


def _step(triangle: Array, damping: float) -> tuple[Array, float]:
    """Return the step for a damping, with columns of unit size, and the change of the residuals that it brings."""
    n = triangle.shape[1] - 1
    R, z = triangle[:n, :n], triangle[:n, n]
    damped = np.vstack((R, np.sqrt(damping) * np.eye(n)))
    step = np.linalg.lstsq(damped, np.concatenate((z, np.zeros(n))), rcond=None)[0]
    return step, float(np.linalg.norm(R @ step))


def sandwich(jacobian: Array, residual: Array, noise: Noise) -> Array:
    """Return the covariance of the free parameters at an optimum.

    ``(N/(N - n)) R (J'J)^-1 J' diag(psi^2) J (J'J)^-1 / mean(psi')^2`` (Huber, Robust Statistics, 1981, section 7.6),
    which holds whatever the distribution of the residuals is, as long as one does not tell of another.

    Parameters
    ----------
    jacobian : ndarray, shape (N, n)
        Derivatives of the residuals that count.
    residual : ndarray, shape (N,)
        These residuals.
    noise : Noise
        Their noise.

    Returns
    -------
    ndarray, shape (n, n)
    """
    samples, n = jacobian.shape
    e = residual / np.sqrt(noise.R)
    psi = np.asarray(noise.influence.psi(e))
    slope = max(float(np.mean(noise.influence.psi_deriv(e))), 1e-3)
    size = np.linalg.norm(jacobian, axis=0)
    size[size == 0.0] = 1.0
    # Derivatives of theta by the residuals, (J'J)^-1 J', without forming J'J.
    effect = np.linalg.pinv(jacobian / size, rcond=1e-10) / size[:, None] * psi
    return np.asarray(noise.R / slope**2 * samples / (samples - n) * (effect @ effect.T))
