"""The problems of `drop_in_study`: what existing programs do to a filter that is put in the Kalman filter's place."""

from __future__ import annotations

import numpy as np
from adaptive_problems import NOISES, ROOT, Case
from peers.recursion import kalman
from scipy.linalg import expm

F, Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.outer(ROOT, ROOT)
#: A label that leaves a sensor out.
BAD = 1e6


def moving(g: np.random.Generator, steps: int) -> np.ndarray:
    """Return the states of a point that moves with a nearly constant velocity from 0, shape (steps, 2)."""
    x, truth = np.zeros(2), np.empty((steps, 2))
    for k in range(steps):
        x = truth[k] = F @ x + ROOT * g.standard_normal()
    return truth


def one(seed: int, kind: str, steps: int = 600, prior: float = 10.0, start: float = 0.0, jump: float = 0.0) -> Case:
    """Return a point of which the position is measured; a jump is at a third."""
    g = np.random.default_rng(seed)
    truth = moving(g, steps)
    v, label = NOISES[kind](g, steps)
    truth[steps // 3 :, 0] += jump
    x0, zs = np.array([start, 0.0]), truth[:, :1] + v[:, None]
    return Case(F, np.eye(1, 2), Q, np.eye(1), x0, prior * np.eye(2), truth, zs, np.ones(steps), label[:, None])


def in_a_row(seed: int, length: int, height: float, share: float, steps: int = 600) -> Case:
    """Return outliers in runs: of one height, or, with height 0, bursts of ten times the deviation."""
    g = np.random.default_rng(seed)
    truth, v, bad = moving(g, steps), g.standard_normal(steps), np.zeros(steps, dtype=bool)
    for first in np.flatnonzero(g.random(steps) < share / length):
        bad[first : first + length] = True
    label = np.where(bad, BAD if height else 10.0, 1.0)
    v = v + height * bad if height else v * label
    zs = truth[:, :1] + v[:, None]
    return Case(F, np.eye(1, 2), Q, np.eye(1), np.zeros(2), 10 * np.eye(2), truth, zs, np.ones(steps), label[:, None])


def position_and_velocity(seed: int, share: float = 0.0, steps: int = 600) -> Case:
    """Return a point of which position and velocity are measured."""
    g = np.random.default_rng(seed)
    truth, label = moving(g, steps), np.where(g.random((steps, 2)) < share, 10.0, 1.0)
    R = np.diag([1.0, 0.09])
    zs = truth + label * g.standard_normal((steps, 2)) * np.sqrt(R.diagonal())
    return Case(F, np.eye(2), Q, R, np.zeros(2), 10 * np.eye(2), truth, zs, np.ones(steps), label)


def quantized(seed: int, step: float, jump: float = 0.0, steps: int = 600) -> Case:
    """Return a level that wanders slowly, read in steps so coarse that readings repeat; a jump is at a third."""
    g = np.random.default_rng(seed)
    truth = 0.03 * g.standard_normal((steps, 1)).cumsum(axis=0)
    truth[steps // 3 :] += jump
    zs, one = step * np.round((truth + g.standard_normal((steps, 1))) / step), np.eye(1)
    return Case(one, one, 9e-4 * one, one, np.zeros(1), 10 * one, truth, zs, np.ones(steps), np.ones((steps, 1)))


def stuck_now_and_then(seed: int) -> Case:
    """Return a point of which position and velocity are measured; the position repeats itself, 20 samples in 100."""
    case = position_and_velocity(seed)
    zs, label = case.zs.copy(), case.v_scale.copy()
    for k in range(20, len(zs) - 20, 100):
        zs[k : k + 20, 0], label[k + 1 : k + 20, 0] = zs[k, 0], BAD
    return case._replace(zs=zs, v_scale=label)


def redundant(seed: int, sensors: int, fault: str, steps: int = 600) -> Case:
    """Return a point that several sensors see, the first of them bad; the labels leave that out."""
    g = np.random.default_rng(seed)
    truth, v, k = moving(g, steps), g.standard_normal((steps, sensors)), np.arange(steps)
    zs, label = truth[:, :1] + v, np.ones((steps, sensors))
    if fault == "+10":
        zs[:, 0] += 10.0
    elif fault == "+10 from the 100th":
        zs[100:, 0] += 10.0
    elif fault == "stuck":
        zs[50:, 0] = zs[50, 0]
    elif fault == "drifting":
        zs[:, 0] += 0.1 * k
    elif fault == "30 times noisier":
        zs[:, 0] += 29.0 * v[:, 0]
    elif fault == "silent":
        zs[50:, 0] = np.nan
    elif fault == "two lie alike":
        zs[:, :2] += 10.0
    if fault not in ("none", "silent"):
        label[:, : 2 if fault == "two lie alike" else 1] = BAD
    H = np.tile(np.eye(1, 2), (sensors, 1))
    return Case(F, H, Q, np.eye(sensors), np.zeros(2), 10 * np.eye(2), truth, zs, np.ones(steps), label)


def standing(seed: int, still: int = 300, steps: int = 600) -> Case:
    """Return a point that stands, measured without any noise, and then moves with noise."""
    g = np.random.default_rng(seed)
    truth, v = np.zeros((steps, 2)), g.standard_normal((steps, 1))
    truth[still:], v[:still] = moving(g, steps - still), 0.0
    zs, x0 = truth[:, :1] + v, np.array([1.0, 0.0])
    return Case(F, np.eye(1, 2), Q, np.eye(1), x0, 10 * np.eye(2), truth, zs, np.ones(steps), np.ones((steps, 1)))


def daily(seed: int, height: float, stops: int = 4, dummies: bool = False, steps: int = 1200) -> Case:
    """Return a level that wanders with a slow daily cycle, and stops, 8 to 24 hours read wrongly by one height.

    The cycle is two harmonics, or, with dummies, one state for each hour of a day but one.
    """
    g = np.random.default_rng(seed)
    hours = np.arange(24)
    if dummies:
        A, H = np.zeros((24, 24)), np.eye(1, 24) + np.eye(1, 24, 1)
        A[0, 0], A[1, 1:], A[2:, 1:-1] = 1.0, -1.0, np.eye(22)
        cycle = 8 * np.sin(2 * np.pi * hours / 24) + 4 * np.cos(4 * np.pi * hours / 24) + g.standard_normal(24)
        x, q, p = np.r_[100.0, (cycle - cycle.mean())[:23]], np.r_[0.25, 0.01, np.zeros(22)], np.r_[5.0, [10.0] * 23]
    else:
        A, H = np.eye(5), np.array([[1.0, 1.0, 0.0, 1.0, 0.0]])
        for harmonic, i in ((1, 1), (2, 3)):
            c, s = np.cos(2 * np.pi * harmonic / 24), np.sin(2 * np.pi * harmonic / 24)
            A[i : i + 2, i : i + 2] = [[c, s], [-s, c]]
        x, q, p = np.array([100.0, 5.0, -3.0, 2.0, 2.0]), np.r_[0.25, np.full(4, 1e-4)], np.r_[5.0, np.ones(4)]
    truth, bad = np.empty((steps, len(x))), np.zeros(steps, dtype=bool)
    for k in range(steps):
        x = truth[k] = A @ x + q * g.standard_normal(len(x))
    for first in g.integers(60, steps - 60, stops):
        bad[first : first + g.integers(8, 24)] = True
    zs = truth @ H.T + 0.5 * g.standard_normal((steps, 1)) + height * bad[:, None]
    x0, label = 100.0 * np.eye(len(q))[0], np.where(bad, BAD, 1.0)[:, None]
    return Case(A, H, np.diag(q**2), np.array([[0.25]]), x0, np.diag(p**2), truth, zs, np.ones(steps), label)


def reactors(seed: int, share: float = 0.1, scale: float = 10.0, steps: int = 1000) -> Case:
    """Return three stirred tanks in a row (Yang and Boyd 2025), temperatures measured, outliers in both noises."""
    g, dt = np.random.default_rng(seed), 0.05
    tank, flow = np.array([[-5.0, -0.3427], [47.68, 2.785]]), np.diag([1.0, 0.3])
    rates = np.kron(np.eye(3), tank) + np.kron(np.eye(3, k=-1), flow)
    # A zero-order hold by the exponential of both at once.
    both = expm(dt * np.block([[rates, np.kron(np.eye(3), flow)], [np.zeros((6, 12))]]))
    A, B, H = both[:6, :6], both[:6, 6:], np.kron(np.eye(3), [[0.0, 1.0]])
    w, v = (np.where(g.random(steps) < share, scale, 1.0) for _ in range(2))
    x, truth = np.zeros(6), np.empty((steps, 6))
    for k in range(steps):
        x = truth[k] = A @ x + w[k] * B @ (np.sqrt(0.1) * g.standard_normal(6))
    zs = truth @ H.T + v[:, None] * g.standard_normal((steps, 3))
    return Case(A, H, 0.1 * B @ B.T, np.eye(3), np.zeros(6), np.eye(6), truth, zs, w, v)


def boxes(seed: int, bad: float, steps: int = 60) -> Case:
    """Return a walker's box as trackers hold it: centre, area, aspect ratio, R far too small for the area."""
    g = np.random.default_rng(seed)
    truth = np.zeros((steps, 7))
    truth[0] = [*g.uniform(100, 500, 2), g.uniform(60, 100) ** 2 * 2.2, 0.42, *g.normal(0, 2, 2), g.normal(0, 20)]
    A = np.eye(7)
    A[:3, 4:] = np.eye(3)
    for k in range(1, steps):
        truth[k] = A @ truth[k - 1] + np.array([0, 0, 0, 0, *g.normal(0, 0.3, 2), g.normal(0, 4.0)])
        truth[k, 2] = max(truth[k, 2], 2000.0)
    width, height = np.sqrt(truth[:, 2] * truth[:, 3]), np.sqrt(truth[:, 2] / truth[:, 3])
    is_bad = g.random(steps) < bad
    # A detector's box is off by a part of its size.
    off = np.where(is_bad, 10.0, 1.0)[:, None] * 0.02 * g.standard_normal((steps, 4))
    x, y = truth[:, 0] + off[:, 0] * width, truth[:, 1] + off[:, 1] * height
    w, h = width * np.exp(off[:, 2]), height * np.exp(off[:, 3])
    zs, q = np.column_stack([x, y, w * h, w / h]), np.diag([1, 1, 1, 1, 0.01, 0.01, 1e-4])
    R, P0 = np.diag([1.0, 1.0, 10.0, 10.0]), np.diag([10.0] * 4 + [1e4] * 3)
    x0 = np.r_[zs[0], np.zeros(3)]
    label = np.where(is_bad, BAD, 1.0)[:, None] * np.ones(4)
    return Case(A, np.eye(4, 7), q, R, x0, P0, truth, zs, np.ones(steps), label)


def _told(F: np.ndarray, Q: np.ndarray, R: np.ndarray, x0: np.ndarray, P0: np.ndarray, truth: np.ndarray,
          zs: np.ndarray, is_bad: np.ndarray) -> Case:  # fmt: skip
    """Return a case of which the first states are measured."""
    label = np.where(is_bad, BAD, 1.0)[:, None] * np.ones(len(R))
    return Case(F, np.eye(len(R), len(F)), Q, R, x0, P0, truth, zs, np.ones(len(zs)), label)


def thrown(seed: int, share: float = 0.0, steps: int = 60) -> Case:
    """Return a ball that bounces, 30 pictures a second, for a program that starts at 0 with next to no Q."""
    g, dt = np.random.default_rng(seed), 1.0 / 30.0
    t, bounce = np.arange(steps) * dt, g.uniform(0.8, 1.3)
    after = np.maximum(t - bounce, 0.0)
    truth = np.zeros((steps, 6))
    truth[:, 0] = 300.0 + g.uniform(300, 700) * t
    truth[:, 1] = 100.0 + 200.0 * t + 300.0 * t**2 - (600.0 * bounce + 550.0) * after
    is_bad = g.random(steps) < share
    zs = truth[:, :2] + np.where(is_bad, 100.0, 1.5)[:, None] * g.standard_normal((steps, 2))
    block = np.outer([dt**2 / 2, dt, 1.0], [dt**2 / 2, dt, 1.0])
    F = np.kron([[1.0, dt, dt**2 / 2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]], np.eye(2))
    P0 = np.diag([10.0] * 4 + [1.0] * 2)
    return _told(F, np.kron(block, np.eye(2)), 5.0 * np.eye(2), np.zeros(6), P0, truth, zs, is_bad)


def walking(seed: int, share: float = 0.0, steps: int = 150) -> Case:
    """Return a point in pictures that moves on, for a program whose model is that it stands, with all noises 1."""
    g = np.random.default_rng(seed)
    truth = 300.0 + np.cumsum(6.0 * g.standard_normal(2) + g.standard_normal((steps, 2)), axis=0)
    is_bad = g.random(steps) < share
    zs = truth + np.where(is_bad, 60.0, 2.0)[:, None] * g.standard_normal((steps, 2))
    return _told(np.eye(2), np.eye(2), np.eye(2), zs[0], 3.0 * np.eye(2), truth, zs, is_bad)


def turning(seed: int, share: float = 0.0, steps: int = 120) -> Case:
    """Return a walker's box on a curve, its shape swinging with the steps, as trackers hold it (see `boxes`)."""
    g, t = np.random.default_rng(seed), np.arange(steps)
    centre = np.cumsum(4.0 * g.standard_normal(2) + 3.0 * np.column_stack([np.sin(0.1 * t), np.cos(0.1 * t)]), axis=0)
    is_bad = g.random(steps) < share
    size = np.column_stack([centre + [500.0, 300.0], 50.0 + 3.0 * np.sin(0.5 * t), 120.0 + 0.5 * t])
    seen = size + np.where(is_bad, 10.0, 1.0)[:, None] * g.standard_normal((steps, 4)) * [2.0, 2.0, 2.0, 3.0]
    seen[:, 2:] = np.maximum(seen[:, 2:], 5.0)
    truth = np.zeros((steps, 7))
    zs = np.empty((steps, 4))
    for into, box in ((truth, size), (zs, seen)):
        into[:, :4] = np.column_stack([box[:, :2], box[:, 2] * box[:, 3], box[:, 2] / box[:, 3]])
    F = np.eye(7)
    F[:3, 4:] = np.eye(3)
    Q, P0 = np.diag([1.0] * 4 + [0.01, 0.01, 1e-4]), np.diag([10.0] * 4 + [1e4] * 3)
    return _told(F, Q, np.diag([1.0, 1.0, 10.0, 10.0]), np.r_[zs[0], np.zeros(3)], P0, truth, zs, is_bad)


def with_labels(case: Case, given: bool = False) -> np.ndarray:
    """Return the Kalman filter's states, given the size of every noise or, with given, what Q and R say."""
    x, P, path = case.x0, case.P0, np.empty_like(case.truth)
    w_scale = np.ones_like(case.w_scale) if given else case.w_scale
    v_scale = np.ones_like(case.v_scale) if given else case.v_scale
    for k, z in enumerate(case.zs):
        x, P = case.F @ x, case.F @ P @ case.F.T + w_scale[k] ** 2 * case.Q
        here = np.flatnonzero(np.isfinite(z) & (v_scale[k] < BAD))
        if len(here):
            H, s = case.H[here], np.diag(v_scale[k][here])
            x, P = kalman(x, P, z[here] - H @ x, H, s @ case.R[np.ix_(here, here)] @ s)
        path[k] = x
    return path
