"""A cart that is driven, and oracles: a recording as one normal distribution of all states, without a recursion."""

from __future__ import annotations

import numpy as np
import support

CART = support.with_(support.cart(), Q=0.01 * np.array([[0.25, 0.5], [0.5, 1.0]]), P=10.0 * np.eye(2))


def drive(seed, contamination, scale=10.0, steps=200):
    """True positions and measurements of the cart, and which are outliers."""
    rng = np.random.default_rng(seed)
    x, truth = np.zeros(2), np.empty(steps)
    for k in range(steps):
        x = CART.F @ x + 0.1 * np.array([0.5, 1.0]) * rng.normal()
        truth[k] = x[0]
    bad = rng.random(steps) < contamination
    return truth, truth + np.where(bad, scale, 1.0) * rng.normal(size=steps), bad


def prior(F, Q, c, x0, P0):
    """Mean and covariance of x_0..x_N, stacked; the matrices of each step in lists."""
    n, steps = len(x0), len(F)
    mean, root = [x0], [np.hstack([np.eye(n), np.zeros((n, n * steps))])]
    for k in range(steps):
        mean.append(F[k] @ mean[-1] + c[k])
        row = F[k] @ root[-1]
        row[:, n * (k + 1) : n * (k + 2)] += np.eye(n)
        root.append(row)
    noise = np.zeros((n * (steps + 1), n * (steps + 1)))
    for k, block in enumerate([P0, *Q]):
        noise[n * k : n * (k + 1), n * k : n * (k + 1)] = block
    A = np.vstack(root)
    return np.concatenate(mean), A @ noise @ A.T


def measurement(H, n):
    """The matrix that takes x_0..x_N to all measurements; x_0 is not measured."""
    m, steps = len(H[0]), len(H)
    big = np.zeros((m * steps, n * (steps + 1)))
    for k in range(steps):
        big[m * k : m * (k + 1), n * (k + 1) : n * (k + 2)] = H[k]
    return big


def posterior(F, Q, c, H, R, z, x0, P0):
    """Mean and covariance of x_0..x_N given measurements z (N, m), NaN where missing: shapes (N + 1, n), (.., n, n)."""
    n, steps = len(x0), len(F)
    mean, P = prior(F, Q, c, x0, P0)
    big, values = measurement(H, n), np.ravel(z)
    noise = np.zeros((len(values), len(values)))
    m = len(R[0])
    for k in range(steps):
        noise[m * k : m * (k + 1), m * k : m * (k + 1)] = R[k]
    seen = ~np.isnan(values)
    big, values, noise = big[seen], values[seen], noise[np.ix_(seen, seen)]
    gain = P @ big.T @ np.linalg.inv(big @ P @ big.T + noise)
    mean, P = mean + gain @ (values - big @ mean), P - gain @ big @ P
    blocks = [P[n * k : n * (k + 1), n * k : n * (k + 1)] for k in range(steps + 1)]
    return mean.reshape(steps + 1, n), np.array(blocks)


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
    path = mean.copy()
    b = np.linalg.lstsq(B[n:], np.ravel(x) - mean[n:], rcond=None)[0]
    path = mean + B @ b
    force = np.zeros(n * (steps + 1))
    for k in range(steps):
        T = np.linalg.cholesky(np.linalg.inv(R[k])).T
        e = T @ (z[k] - H[k] @ path[n * (k + 1) : n * (k + 2)])
        force[n * (k + 1) : n * (k + 2)] = H[k].T @ T.T @ psi(e)
    return b - B.T @ force, path.reshape(steps + 1, n)
