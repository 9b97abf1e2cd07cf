"""The problems of `adaptive_study`: many kinds of noise on one model, jumps, wrong R and Q, and a vehicle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from peers.recursion import filtered, kalman
from peers.student_t import closest_scale
from scipy.linalg import expm
from scipy.stats import chi2


class Case(NamedTuple):
    """A recording, the model that a filter is given, and the truth that it is not."""

    F: np.ndarray
    H: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    x0: np.ndarray
    P0: np.ndarray
    truth: np.ndarray
    """States, shape (N, n)."""
    zs: np.ndarray
    """Measurements, shape (N, m)."""
    w_scale: np.ndarray
    """Standard deviation of the process noise over that of Q, shape (N,)."""
    v_scale: np.ndarray
    """Standard deviation of the measurement noise over that of R, shape (N,)."""


def with_labels(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Return the states of the Kalman filter that is given the size of every noise, and their covariances."""
    x, P, path = case.x0, case.P0, np.empty_like(case.truth)
    covariances = np.empty((*path.shape, len(x)))
    for k, z in enumerate(case.zs):
        x, P = case.F @ x, case.F @ P @ case.F.T + case.w_scale[k] ** 2 * case.Q
        path[k], covariances[k] = x, P = kalman(x, P, z - case.H @ x, case.H, case.v_scale[k] ** 2 * case.R)
    return path, covariances


def _mixture(share: float, scale: float) -> Callable[..., Any]:
    def draw(g: np.random.Generator, n: int) -> Any:
        v = g.standard_normal(n)
        label = np.where(g.random(n) < share, scale, 1.0)
        return v * label, label

    return draw


def _student(g: np.random.Generator, n: int) -> Any:
    v = g.standard_normal(n)
    label = 1.0 / np.sqrt(g.chisquare(2, n) / 2.0)
    return v * label, label


def _one_sided(g: np.random.Generator, n: int) -> Any:
    v = g.standard_normal(n)
    bad = g.random(n) < 0.1
    return v + 20.0 * bad, np.where(bad, 20.0, 1.0)


def _bursts(g: np.random.Generator, n: int) -> Any:
    v, bad = g.standard_normal(n), np.zeros(n, dtype=bool)
    for first in np.flatnonzero(g.random(n) < 0.02):
        bad[first : first + 5] = True
    label = np.where(bad, 10.0, 1.0)
    return v * label, label


def _runs(g: np.random.Generator, n: int) -> Any:
    v, bad = g.standard_normal(n), np.zeros(n, dtype=bool)
    for first in range(400, n, 300):
        bad[first : first + 10] = True
    # No variance describes a constant offset: the label leaves the sample out.
    return v + 10.0 * bad, np.where(bad, 1e3, 1.0)


def _steps(size: float) -> Callable[..., Any]:
    def draw(g: np.random.Generator, n: int) -> Any:
        label = np.where((np.arange(n) // 600) % 2 == 1, size, 1.0)
        return g.standard_normal(n) * label, label

    return draw


def _unlabelled(name: str, *parameters: float) -> Callable[..., Any]:
    def draw(g: np.random.Generator, n: int) -> Any:
        g.standard_normal(n)
        return getattr(g, name)(*parameters, n), np.ones(n)

    return draw


#: Ten kinds, and a few on which nothing was tuned.
NOISES: dict[str, Callable[..., Any]] = {
    "clean": _mixture(0.0, 1.0),
    "mixture .1, scale 10": _mixture(0.1, 10.0),
    "mixture .05, scale 100": _mixture(0.05, 100.0),
    "one-sided +20, .1": _one_sided,
    "Student t(2)": _student,
    "bursts of 5": _bursts,
    "runs of 10 at +10": _runs,
    "Laplace": _unlabelled("laplace", 0.0, np.sqrt(0.5)),
    "uniform": _unlabelled("uniform", -np.sqrt(3.0), np.sqrt(3.0)),
    "R steps by 9": _steps(3.0),
    "mixture .3, scale 10": _mixture(0.3, 10.0),
    "mixture .1, scale 4": _mixture(0.1, 4.0),
    "R steps by 100": _steps(10.0),
    "R steps by 1/25": _steps(0.2),
}
ROOT = 0.1 * np.array([0.5, 1.0])
#: Densities of independent noises up to a factor, for the filter that is given all but the labels.
DENSITIES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "mixture .1, scale 10": lambda v: 0.9 * np.exp(-0.5 * v**2) + 0.01 * np.exp(-0.005 * v**2),
    "mixture .05, scale 100": lambda v: 0.95 * np.exp(-0.5 * v**2) + 0.0005 * np.exp(-0.00005 * v**2),
    "one-sided +20, .1": lambda v: 0.9 * np.exp(-0.5 * v**2) + 0.1 * np.exp(-0.5 * (v - 20.0) ** 2),
    "Student t(2)": lambda v: (1.0 + 0.5 * v**2) ** -1.5,
    "Laplace": lambda v: np.exp(-np.sqrt(2.0) * np.abs(v)),
    "mixture .3, scale 10": lambda v: 0.7 * np.exp(-0.5 * v**2) + 0.03 * np.exp(-0.005 * v**2),
}


def _moving(g: np.random.Generator, steps: int) -> np.ndarray:
    """Return the states of a point that moves with a nearly constant velocity, shape (steps, 2)."""
    F = np.array([[1.0, 1.0], [0.0, 1.0]])
    x, truth = np.zeros(2), np.empty((steps, 2))
    for k in range(steps):
        x = truth[k] = F @ x + ROOT * g.standard_normal()
    return truth


def point(
    seed: int,
    kind: str,
    steps: int = 3000,
    jump: float = 0.0,
    jump_at: int = 500,
    q_factor: float = 1.0,
    r_factor: float = 1.0,
) -> Case:
    """Return a moving point whose position is measured; the filter may be given wrong Q and R."""
    g = np.random.default_rng(seed)
    truth = _moving(g, steps)
    v, label = NOISES[kind](g, steps)
    truth[jump_at:, 0] += jump
    Q, R = np.outer(ROOT, ROOT), np.eye(1)
    return Case(
        np.array([[1.0, 1.0], [0.0, 1.0]]), np.eye(1, 2), q_factor * Q, r_factor * R, np.zeros(2), 10.0 * np.eye(2),
        truth, truth[:, :1] + v[:, None], np.full(steps, q_factor**-0.5), label * r_factor**-0.5,
    )  # fmt: skip


def vehicle(seed: int, process: float, measurement: float, scale: float, steps: int = 1000) -> Case:
    """Return the vehicle of Yang and Boyd (2025): gusts and position fixes, each with outliers."""
    g, dt = np.random.default_rng(seed), 0.05
    F, I = np.eye(4), np.eye(2)
    F[:2, 2:], F[2:, 2:] = dt * (1.0 - 0.025 * dt) * I, (1.0 - 0.05 * dt) * I
    B = np.sqrt(10.0) * np.vstack([0.5 * dt * dt * I, dt * I])
    w = np.where(g.random(steps) < process, scale, 1.0)
    v = np.where(g.random(steps) < measurement, scale, 1.0)
    x = x0 = np.array([0.0, 0.0, 5.0, 5.0])
    truth = np.empty((steps, 4))
    for k in range(steps):
        x = truth[k] = F @ x + w[k] * B @ g.normal(size=2)
    zs = truth[:, :2] + v[:, None] * np.sqrt(5.0) * g.normal(size=(steps, 2))
    return Case(F, np.eye(2, 4), B @ B.T, 5.0 * I, x0, 1e-9 * np.eye(4), truth, zs, w, v)


#: Of Cauchy's density in a plane the scale matrix that is closest to a covariance, over that.
CAUCHY = closest_scale(2, 1.0)


def manoeuvring(seed: int, steps: int = 500) -> Case:
    """Return a plane where speed and acceleration decay, and Cauchy's noise.

    The setting in which J. N. M. Neuhoefer compares nine robust filters (continental/outlier-robust-student-t-filter):
    acceleration with a time constant of 2 s, friction of .25 a second, both coordinates read each .2 s. R is given as a
    quarter of the mean speed squared, the noise's scale matrix is what of Cauchy's density is closest to that.
    """
    g, alpha, beta, dt, I = np.random.default_rng(seed), 0.5, 0.25, 0.2, np.eye(2)
    A = np.array([[0.0, 1.0, 0.0], [0.0, -beta, 1.0], [0.0, 0.0, -alpha]])

    def over(time: float) -> tuple[np.ndarray, np.ndarray]:
        """Return F and Q of a stretch of time (van Loan)."""
        both = expm(time * np.block([[-A, np.diag([0.0, 0.0, 1.0])], [np.zeros((3, 3)), A.T]]))
        F = both[3:, 3:].T
        return np.kron(F, I), np.kron(F @ both[:3, 3:], I)

    (F, Q), P0 = over(dt), over(5.0 * dt)[1]
    root, x, truth = np.linalg.cholesky(Q), np.zeros(6), np.empty((steps, 6))
    for k in range(steps):
        x = truth[k] = F @ x + root @ g.standard_normal(6)
    speed = np.hypot(*np.diff(truth[:, :2], axis=0, prepend=np.zeros((1, 2))).T).sum() / steps / dt
    label = np.sqrt(CAUCHY / g.chisquare(1, steps))
    zs = truth[:, :2] + 0.5 * speed * label[:, None] * g.standard_normal((steps, 2))
    x0 = np.linalg.cholesky(P0) @ g.standard_normal(6)
    return Case(F, np.eye(2, 6), Q, 0.25 * speed**2 * I, x0, P0, truth, zs, np.ones(steps), label)


def with_density(case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Return the states of `manoeuvring` by a filter that is given the noise's density, and their covariances.

    Cauchy's density is that of normal noises of many sizes; what each of them leads to is merged by moments.
    """
    sizes = 0.1 * np.geomspace(1.0, 1e9, 19)
    shares = np.diff(np.concatenate([[0.0], chi2.sf(CAUCHY / np.sqrt(sizes[1:] * sizes[:-1]), 1), [1.0]]))

    def correct(x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Case, memory: dict) -> tuple[np.ndarray, np.ndarray]:
        y, C = z - case.H @ x, P @ case.H.T
        inverses = np.linalg.inv(case.H @ C + sizes[:, None, None] * case.R)
        logs = np.log(shares) - 0.5 * np.einsum("i,kij,j->k", y, inverses, y) + 0.5 * np.linalg.slogdet(inverses)[1]
        weights = np.exp(logs - logs.max())
        weights /= weights.sum()
        moves = inverses @ y @ C.T
        mean = weights @ moves
        left = C @ np.tensordot(weights, inverses, 1) @ C.T
        return x + mean, P - left + ((moves - mean).T * weights) @ (moves - mean)

    return filtered(case, correct)


def optimal(case: Case, density: Callable[[np.ndarray], np.ndarray], count: int = 5000) -> np.ndarray:
    """Return the mean of a moving point given its noise's density, by particles: the best that needs no labels."""
    g = np.random.default_rng(0)
    x = case.x0 + np.sqrt(case.P0.diagonal()) * g.standard_normal((count, 2))
    path, places = np.empty_like(case.truth), np.arange(count)
    for k, z in enumerate(case.zs):
        x = x @ case.F.T + g.standard_normal((count, 1)) * ROOT
        # Where no particle is near, each counts the same.
        weights = density(z - x[:, 0]) + 1e-300
        total = np.cumsum(weights)
        path[k] = weights @ x / total[-1]
        x = x[np.searchsorted(total, (places + g.random()) / count * total[-1]).clip(max=count - 1)]
    return path
