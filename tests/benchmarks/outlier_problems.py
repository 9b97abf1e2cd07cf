"""The problems that `outlier_tables` compares filters on, and the filters that ours are compared with."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy import stats
from statsmodels.robust.norms import TrimmedMean

from robust_filterpy import Contaminated, RobustKalmanFilter
from robust_filterpy.identification import ARX, FIR, OutputError
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.plants import simulate_arx, simulate_output_error
from robust_filterpy.plants.linear import stable


class Recording(NamedTuple):
    """A problem's matrices, its true states and measurements, and what no filter is given."""

    F: np.ndarray
    H: np.ndarray
    Q: np.ndarray
    R: np.ndarray
    x0: np.ndarray
    P0: np.ndarray
    truth: np.ndarray
    zs: np.ndarray
    jumps: np.ndarray
    outliers: np.ndarray


def paper(rng: np.random.Generator, contamination: float, steps: int) -> Recording:
    """Equations 31-34 of the paper: four states, the first measured, outliers of ten times the deviation."""
    F = np.array(
        [
            [0.99, -0.012, 0.001, -0.001],
            [-0.005, 0.98, -0.001, 0.005],
            [-0.001, 0.01, 1.0, -0.001],
            [0.01, 0.001, -0.002, 1.0],
        ]
    )
    Q, R, P0 = 0.001 * np.eye(4), 0.1 * np.eye(1), 0.1 * np.eye(4)
    return _simulate(rng, F, np.eye(1, 4), Q, np.sqrt(0.001) * np.eye(4), R, np.zeros(4), P0, 0.0, contamination, steps)


def vehicle(rng: np.random.Generator, process: float, measurement: float, steps: int) -> Recording:
    """The vehicle of Yang and Boyd (2025): gusts and position fixes, each with outliers of ten times the deviation."""
    h, gamma = 0.05, 0.05
    d, I, zero = h * (1 - 0.5 * gamma * h), np.eye(2), np.zeros((2, 2))
    F = np.block([[I, d * I], [zero, (1 - gamma * h) * I]])
    B = np.sqrt(10) * np.vstack([0.5 * h * h * I, h * I])
    x0 = np.array([0.0, 0.0, 5.0, 5.0])
    return _simulate(rng, F, np.eye(2, 4), B @ B.T, B, 5 * I, x0, np.zeros((4, 4)), process, measurement, steps)


def _simulate(
    rng: np.random.Generator,
    F: Any,
    H: Any,
    Q: Any,
    root: Any,
    R: Any,
    x0: Any,
    P0: Any,
    jump: float,
    bad: float,
    n: int,
) -> Recording:
    """Draw a recording; each noise is ten times larger with its own probability."""
    jumps, outliers = rng.random(n) < jump, rng.random(n) < bad
    w = rng.normal(size=(n, root.shape[1])) @ root.T * np.where(jumps, 10.0, 1.0)[:, None]
    v = rng.normal(size=(n, len(R))) * np.sqrt(R.diagonal()) * np.where(outliers, 10.0, 1.0)[:, None]
    x, truth = x0 + np.sqrt(P0.diagonal()) * rng.normal(size=len(x0)), np.empty((n, len(x0)))
    for k in range(n):
        x = truth[k] = F @ x + w[k]
    return Recording(F, H, Q, R, x0, P0, truth, truth @ H.T + v, jumps, outliers)


def prepared(kf: Any, data: Recording) -> Any:
    """Put the problem into a filter."""
    kf.F, kf.H, kf.Q, kf.R = (getattr(data, name).copy() for name in "FHQR")
    kf.x, kf.P = data.x0.copy(), data.P0 + 1e-9 * np.eye(len(data.x0))
    return kf


def errors(kf: Any, data: Recording) -> np.ndarray:
    """Return the estimates' errors, shape (steps, n)."""
    return np.asarray(prepared(kf, data).batch_filter(data.zs)[0] - data.truth)


def errors_with_labels(data: Recording) -> np.ndarray:
    """Return the errors of the Kalman filter that knows which noises are large."""
    kf = prepared(KalmanFilter(len(data.x0), len(data.R)), data)
    path = np.empty_like(data.truth)
    for k, z in enumerate(data.zs):
        kf.predict(Q=data.Q * (100.0 if data.jumps[k] else 1.0))
        kf.update(z, R=data.R * (100.0 if data.outliers[k] else 1.0))
        path[k] = kf.x
    return path - data.truth


def gate(dim_x: int, dim_z: int, level: float = 0.9973) -> RobustKalmanFilter:
    """Return the Kalman filter that leaves out what its chi-square gate refuses."""
    threshold = float(np.sqrt(stats.chi2.ppf(level, dim_z)))
    return RobustKalmanFilter(dim_x, dim_z, influence=TrimmedMean(threshold), scaling="innovation", grouping="joint")


def level(rng: np.random.Generator, jump: float = 0.0, run: int = 0, size: float = 0.0, steps: int = 250) -> Recording:
    """A wandering level measured with noise of deviation 1: after 50 steps a true jump, or a run of outliers alike."""
    one = np.eye(1)
    truth = 0.1 * np.cumsum(rng.normal(size=steps))
    truth[50:] += jump
    v = rng.normal(size=steps)
    v[50 : 50 + run] += size
    none = np.zeros(steps, dtype=bool)
    data = (truth[:, None], (truth + v)[:, None], none, none)
    return Recording(one, one, 0.01 * one, one, np.zeros(1), 0.1 * one, *data)


class Identification(NamedTuple):
    """A recording of a plant whose parameters jump, and what no tracker is given."""

    structure: Structure
    theta: np.ndarray
    u: np.ndarray
    y: np.ndarray
    outliers: np.ndarray


JUMP_RATE, JUMP_SIZE = 1.0 / 250.0, 0.3


def jumping_parameters(rng: np.random.Generator, kind: str, contamination: float, steps: int) -> Identification:
    """A plant of four parameters that stand still and then jump, all at once; noise .5, outliers ten times that."""
    theta = np.empty((steps, 4))
    inside = (lambda new: True) if kind == "FIR" else stable(2)
    now = np.array([1.0, 0.5, -0.3, 0.2] if kind == "FIR" else [-1.5, 0.7, 1.0, 0.5])
    for k in range(steps):
        if rng.random() < JUMP_RATE:
            drawn = now + JUMP_SIZE * rng.standard_normal((1000, 4))
            now = next(new for new in drawn if inside(new))
        theta[k] = now
    u = rng.choice([-1.0, 1.0], steps)
    noise = Contaminated(contamination, 10.0, 0.5).rvs_labelled(steps, rng)
    if kind == "FIR":
        y = np.einsum("ij,ij->i", FIR(4).regressors(u), theta) + noise.values
        return Identification(FIR(4), theta, u, y, noise.is_outlier)
    structure, simulated = {"ARX": (ARX(2, 2), simulate_arx), "OE": (OutputError(2, 2), simulate_output_error)}[kind]
    return Identification(structure, theta, u, simulated(theta, u, noise=noise.values, na=2, nb=2).y, noise.is_outlier)
