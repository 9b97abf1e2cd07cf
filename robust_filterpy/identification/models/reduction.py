"""A linear system with fewer states: balanced, and those that do least left out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.linalg import cholesky, solve_discrete_lyapunov, svd

from robust_filterpy import _checks
from robust_filterpy._checks import Array

if TYPE_CHECKING:
    import control


def observer_form(a: Array, numerators: Array) -> tuple[Array, Array, Array, Array]:
    """Return the matrices of b/(1 + a_1 q^-1 + ..) for each input."""
    n = a.size
    A, C = np.zeros((n, n)), np.zeros((1, n))
    if n:
        A[:, 0], A[: n - 1, 1:], C[0, 0] = -a, np.eye(n - 1), 1.0
    return A, (numerators[:, 1:] - numerators[:, :1] * a).T, C, numerators[:, :1].T


def balancing(A: Array, B: Array, C: Array) -> Array:
    """Return the basis in which each state is as easy to reach as to see, those that do most first."""
    try:
        reached = solve_discrete_lyapunov(A, B @ B.T)
        seen = solve_discrete_lyapunov(A.T, C.T @ C)
        jitter = 1e-13 * np.eye(len(A))
        L = cholesky(reached + jitter * np.trace(reached), lower=True)
        M = cholesky(seen + jitter * np.trace(seen), lower=True)
        _, values, right = svd(M.T @ L)
        return np.asarray(L @ right.T / np.sqrt(values))
    except (np.linalg.LinAlgError, ValueError):
        return np.eye(len(A))


def truncated(matrices: tuple[Any, Any, Any, Any], n: Any, dt: Any) -> control.StateSpace:
    """Return a system in a balanced basis with its first states alone."""
    import control

    A, B, C, D = matrices
    if _checks.count("n", n, 1) > len(A):
        raise ValueError(f"n: expected 1 to {len(A)} states, got {n}")
    return control.ss(A[:n, :n], B[:n], C[:, :n], D, dt)
