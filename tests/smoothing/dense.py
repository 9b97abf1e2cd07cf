"""A cart that is driven, and oracles: a recording as one normal distribution of all states, without a recursion."""

from __future__ import annotations

import numpy as np
import support
from scipy.linalg import block_diag

CART = support.with_(support.cart(), Q=0.01 * np.array([[0.25, 0.5], [0.5, 1.0]]), P=10.0 * np.eye(2))


def drive(seed, contamination, scale=10.0, steps=200):
    """True positions and measurements of the cart, and which are outliers."""
    rng = np.random.default_rng(seed)
    truth = support.states(CART.F, 0.1 * np.outer(rng.normal(size=steps), [0.5, 1.0]))[:, 0]
    bad = rng.random(steps) < contamination
    return truth, truth + np.where(bad, scale, 1.0) * rng.normal(size=steps), bad


def prior(F, Q, c, x0, P0):
    """Mean and covariance of x_0..x_N, stacked; the matrices of each step in lists."""
    n = len(x0)
    # Of x_k - F x_(k-1) = c + w.
    differences = np.eye(n * (len(F) + 1))
    differences[n:, :-n] -= block_diag(*F)
    A = np.linalg.inv(differences)
    return A @ np.concatenate([x0, *c]), A @ block_diag(P0, *Q) @ A.T


def posterior(F, Q, c, H, R, z, x0, P0):
    """Mean and covariance of x_0..x_N given measurements z (N, m), NaN where missing: shapes (N + 1, n), (.., n, n)."""
    n, (mean, P) = len(x0), prior(F, Q, c, x0, P0)
    seen = ~np.isnan(np.ravel(z))
    # x_0 is not measured.
    big, noise = np.pad(block_diag(*H), ((0, 0), (n, 0)))[seen], block_diag(*R)[np.ix_(seen, seen)]
    gain = P @ big.T @ np.linalg.inv(big @ P @ big.T + noise)
    mean, P = mean + gain @ (np.ravel(z)[seen] - big @ mean), P - gain @ big @ P
    blocks = [P[k : k + n, k : k + n] for k in range(0, len(P), n)]
    return mean.reshape(-1, n), np.array(blocks)


def gradient(F, Q, c, H, R, z, x, x0, P0, psi):
    """Gradient of sum rho(z - H x) + squares of the process noise at states x_1..x_N, in the directions that can move.

    psi takes the residuals of one measurement, in units of the noise. With prior covariance C = B B' of all states the
    cost is rho + |b|^2/2, x = mean + B b: the gradient with respect to b.
    """
    n, steps = len(x0), len(F)
    mean, P = prior(F, Q, c, x0, P0)
    values, vectors = np.linalg.eigh(P)
    B = vectors[:, values > 1e-12 * values.max()] * np.sqrt(values[values > 1e-12 * values.max()])
    # x_0 is free: it follows from the others.
    b = np.linalg.lstsq(B[n:], np.ravel(x) - mean[n:], rcond=None)[0]
    path = mean + B @ b
    force = np.zeros(n * (steps + 1))
    for k in range(steps):
        T = np.linalg.cholesky(np.linalg.inv(R[k])).T
        e = T @ (z[k] - H[k] @ path[n * (k + 1) : n * (k + 2)])
        force[n * (k + 1) : n * (k + 2)] = H[k].T @ T.T @ psi(e)
    return b - B.T @ force, path.reshape(steps + 1, n)
