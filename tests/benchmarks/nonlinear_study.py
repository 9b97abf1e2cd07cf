"""Extended and unscented filters whose start, Q or R are wrong, clean and with outliers: what each way costs.

Run ``python tests/benchmarks/nonlinear_study.py [--runs N] [--seed S] [--jobs J] [--only TEXT] [--write-page]``. A
row is a program: a radar, beacons around a vehicle that turns, a slant range, a pendulum seen by its sine, a fall
through air, each clean and with 10 % outliers of 10 to 20 standard deviations. Error: root mean square of the
positions over that of filterpy's filter with the same settings, geometric mean of the runs, with the worst run.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import ExtendedKalmanFilter, MerweScaledSigmaPoints, UnscentedKalmanFilter
from joblib import Parallel, delayed
from measuring import on_page

from robust_filterpy import RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter

ADAPTIVE = {"noise": "learnt"}
WAYS: dict[str, dict[str, Any]] = {
    "default": {}, '`process="given"`': {**ADAPTIVE, "process": "given"}, '`noise="learnt"`': ADAPTIVE,
}  # fmt: skip
EAST = np.array([100.0, 3.0, 200.0, -1.0])


class Case(NamedTuple):
    """A program and a recording: f and h with their Jacobians, what the filter is given, what was true."""

    f: Callable[[np.ndarray], np.ndarray]
    F: Callable[[np.ndarray], np.ndarray]
    h: Callable[[np.ndarray], np.ndarray]
    H: Callable[[np.ndarray], np.ndarray]
    Q: np.ndarray
    R: np.ndarray
    x: np.ndarray
    P: np.ndarray
    truth: np.ndarray
    zs: np.ndarray
    shown: slice | list[int]
    residual: Callable[[Any, Any], Any] = np.subtract


def wrapped(a: Any, b: Any) -> np.ndarray:
    """Return a difference of ranges and bearings."""
    y = np.subtract(a, b)
    y[1] = (y[1] + np.pi) % (2 * np.pi) - np.pi
    return y


def ranges(beacons: Any) -> tuple[Callable[..., np.ndarray], Callable[..., np.ndarray]]:
    """Return distances from beacons and their Jacobian, for states (x, vx, y, vy)."""
    B = np.atleast_2d(np.asarray(beacons, dtype=float))

    def h(x: np.ndarray) -> np.ndarray:
        return np.hypot(x[0] - B[:, 0], x[2] - B[:, 1])

    def H(x: np.ndarray) -> np.ndarray:
        r = h(x)
        return np.column_stack([(x[0] - B[:, 0]) / r, 0 * r, (x[2] - B[:, 1]) / r, 0 * r])

    return h, H


def moving(dt: float, q: float) -> tuple[np.ndarray, np.ndarray]:
    """Return F and Q of a point that moves in the plane."""
    return np.kron(np.eye(2), [[1.0, dt], [0.0, 1.0]]), np.kron(np.eye(2), Q_discrete_white_noise(2, dt, q))


def radar(rng: np.random.Generator, steps: int = 300, off: float = 0.0, wide: float = 1.0, q: float = 0.01,
          true_q: float | None = None, dt: float = 1.0, r: float = 1.0) -> Case:  # fmt: skip
    """A point of which range and bearing are measured."""
    F, Q = moving(dt, q)
    root = np.linalg.cholesky(moving(dt, q if true_q is None else true_q)[1] + 1e-12 * np.eye(4))
    distance, slope, sd = *ranges([0.0, 0.0]), np.array([5.0, 0.01])

    def h(x: np.ndarray) -> np.ndarray:
        return np.array([distance(x)[0], np.arctan2(x[2], x[0])])

    def H(x: np.ndarray) -> np.ndarray:
        x = np.ravel(x)
        return np.vstack([slope(x), np.array([-x[2], 0.0, x[0], 0.0]) / (x[0] ** 2 + x[2] ** 2)])

    truth = [EAST]
    for _ in range(steps):
        truth.append(F @ truth[-1] + root @ rng.normal(size=4))
    true = np.array(truth[1:])
    zs = np.array([h(x) for x in true]) + sd * rng.normal(size=(steps, 2))
    begin = np.array([100.0 + off, 0.0, 200.0 - off, 0.0])
    return Case(
        lambda x: F @ x, lambda x: F, h, H, Q, r * np.diag(sd**2), begin, wide * np.diag([100.0, 25.0] * 2), true,
        zs, [0, 2], wrapped,
    )  # fmt: skip


def turning(rng: np.random.Generator, q: float = 0.1, r: float = 1.0) -> Case:
    """A vehicle that turns now and then between three beacons, taken for one that moves straight."""
    (F, Q), (h, H) = moving(1.0, q), ranges([[0.0, 0.0], [500.0, 0.0], [0.0, 500.0]])
    at, heading, truth = np.array([200.0, 150.0]), 0.3, []
    for k in range(300):
        heading += 0.1 * ((k // 40) % 2)
        at = at + 4.0 * np.array([np.cos(heading), np.sin(heading)])
        heading = heading if 0.0 < at[0] < 450.0 else np.pi - heading
        heading = heading if 0.0 < at[1] < 450.0 else -heading
        truth.append([at[0], 4.0 * np.cos(heading), at[1], 4.0 * np.sin(heading)])
    zs = np.array([h(np.array(x)) for x in truth]) + 2.0 * rng.normal(size=(300, 3))
    begin = np.array([200.0, 0.0, 150.0, 0.0])
    return Case(
        lambda x: F @ x, lambda x: F, h, lambda x: H(np.ravel(x)), Q, r * 4.0 * np.eye(3), begin, 25.0 * np.eye(4),
        np.array(truth), zs, [0, 2],
    )  # fmt: skip


def slant(rng: np.random.Generator, height: float = 1100.0, r: float = 1.0) -> Case:
    """An aircraft of which a radar below measures the distance; position, speed and height are wanted."""
    dt, Q = 0.05, np.diag([0.0, 0.0, 0.1])
    F, Q[:2, :2] = np.array([[1.0, dt, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), Q_discrete_white_noise(2, dt, 0.1)
    x, truth = np.array([0.0, 100.0, 1000.0]), []
    for _ in range(400):
        x = F @ x + np.array([0.0, 0.1, 0.3]) * rng.normal(size=3)
        truth.append(x)
    true = np.array(truth)
    zs = np.hypot(true[:, :1], true[:, 2:]) + 5.0 * rng.normal(size=(400, 1))

    def H(x: np.ndarray) -> np.ndarray:
        x = np.ravel(x)
        return np.array([[x[0], 0.0, x[2]]]) / np.hypot(x[0], x[2])

    begin = np.array([-100.0, 120.0, height])
    return Case(
        lambda x: F @ x, lambda x: F, lambda x: np.array([np.hypot(x[0], x[2])]), H, Q, np.array([[25.0 * r]]),
        begin, 50.0 * np.eye(3), true, zs, [0, 2],
    )  # fmt: skip


def pendulum(rng: np.random.Generator, begin: float = 1.2, q: float = 1.0, r: float = 1.0) -> Case:
    """A pendulum of which the sine of the angle is measured."""
    dt, g = 0.02, 9.81
    Q = Q_discrete_white_noise(2, dt, 0.1)
    root = np.linalg.cholesky(Q + 1e-14 * np.eye(2))

    def f(x: np.ndarray) -> np.ndarray:
        return np.array([x[0] + dt * x[1], x[1] - g * dt * np.sin(x[0])])

    x, truth = np.array([1.5, 0.0]), []
    for _ in range(500):
        x = f(x) + root @ rng.normal(size=2)
        truth.append(x)
    true = np.array(truth)
    return Case(
        f, lambda x: np.array([[1.0, dt], [-g * dt * np.cos(np.ravel(x)[0]), 1.0]]), lambda x: np.sin(x[:1]),
        lambda x: np.array([[np.cos(np.ravel(x)[0]), 0.0]]), q * Q, np.array([[0.01 * r]]), np.array([begin, 0.0]),
        (0.5 + (1.5 - begin) ** 2) * np.eye(2), true, np.sin(true[:, :1]) + 0.1 * rng.normal(size=(500, 1)), [0, 1],
    )  # fmt: skip


def falling(rng: np.random.Generator, r: float = 1.0) -> Case:
    """A body that falls through air of which the drag is wanted, seen from the side."""

    def f(x: np.ndarray) -> np.ndarray:
        dt, air = 0.1, 1e-3 * np.exp(-np.clip(x[0], -1e4, 1e5) / 6000.0)
        return np.array([x[0] + dt * x[1], x[1] + dt * (air * x[1] ** 2 * x[2] - 9.81), x[2]])

    def F(x: np.ndarray) -> np.ndarray:
        x = np.ravel(x)
        steps = np.diag(1e-4 * np.maximum(1.0, np.abs(x)))
        return np.column_stack([(f(x + d) - f(x - d)) / (2.0 * d.sum()) for d in steps])

    def H(x: np.ndarray) -> np.ndarray:
        height = np.ravel(x)[0]
        return np.array([[height / np.hypot(3000.0, height), 0.0, 0.0]])

    x, truth = np.array([10000.0, -300.0, 0.3]), []
    for _ in range(200):
        x = f(x) + np.array([0.0, 0.1, 0.0]) * rng.normal(size=3)
        truth.append(x)
    true = np.array(truth)
    zs = np.hypot(3000.0, true[:, :1]) + 10.0 * rng.normal(size=(200, 1))
    return Case(
        f, F, lambda x: np.hypot(3000.0, x[:1]), H, np.diag([0.0, 0.01, 1e-8]), np.array([[100.0 * r]]),
        np.array([10100.0, -280.0, 0.2]), np.diag([1e4, 400.0, 0.02]), true, zs, [0, 1],
    )  # fmt: skip


PROGRAMS: dict[str, Callable[[np.random.Generator], Case]] = {
    "radar": radar,
    "radar, start 6 deviations off": lambda rng: radar(rng, off=60.0),
    "radar, the same, P opened": lambda rng: radar(rng, off=60.0, wide=100.0),
    "radar, Q 1000 times too small": lambda rng: radar(rng, q=0.001, true_q=1.0),
    "radar, Q 100 times too large": lambda rng: radar(rng, q=1.0, true_q=0.01),
    "radar, steps of 10 s": lambda rng: radar(rng, steps=60, dt=10.0),
    "radar, R 100 times too large": lambda rng: radar(rng, r=100.0),
    "radar, R 100 times too small": lambda rng: radar(rng, r=0.01),
    "slant range, height 14 deviations off": slant,
    "slant range, height 140 deviations off": lambda rng: slant(rng, height=2000.0),
    "slant range, R 100 times too small": lambda rng: slant(rng, r=0.01),
    "pendulum": pendulum,
    "pendulum, start at rest below": lambda rng: pendulum(rng, begin=0.0),
    "pendulum, Q 100 times too small": lambda rng: pendulum(rng, q=0.01),
    "pendulum, R 100 times too small": lambda rng: pendulum(rng, r=0.01),
    "beacons, a vehicle that turns": turning,
    "beacons, Q 100 times too small": lambda rng: turning(rng, q=0.001),
    "beacons, R 100 times too small": lambda rng: turning(rng, r=0.01),
    "a fall through air": falling,
    "a fall, R 100 times too small": lambda rng: falling(rng, r=0.01),
}


def filtered(case: Case, cls: Any, **options: Any) -> np.ndarray:
    """Return the states after each reading."""
    n, m = len(case.x), len(case.R)
    extended = issubclass(cls, ExtendedKalmanFilter)
    if extended:
        kf = cls(n, m, **options)
        kf.predict_x = lambda u=0: setattr(kf, "x", case.f(np.ravel(kf.x)))
    else:
        kf = cls(n, m, 1.0, case.h, lambda x, dt: case.f(x), MerweScaledSigmaPoints(n, 0.5, 2.0, 3.0 - n), **options)
        kf.residual_z = case.residual
    kf.x, kf.P, kf.Q, kf.R = case.x.copy(), case.P.copy(), case.Q.copy(), case.R.copy()
    states = []
    for z in case.zs:
        if extended:
            kf.F = case.F(kf.x)
            kf.predict()
            kf.update(z, case.H, case.h, residual=case.residual)
        else:
            kf.predict()
            kf.update(z)
        states.append(np.ravel(kf.x).copy())
    return np.array(states)


def one(name: str, share: float, seed: int) -> list[float]:
    """Return the errors of each way over filterpy's, of extended, then of unscented filters."""
    warnings.simplefilter("ignore")
    case = PROGRAMS[name](np.random.default_rng([seed, 1]))
    rng, sd = np.random.default_rng([seed, 2]), np.sqrt(np.diag(case.R))
    # Outliers are as large as the noise that was drawn makes them, whatever R the filter is given.
    sd = sd / np.sqrt(100.0 if "R 100 times too large" in name else 0.01 if "R 100 times too small" in name else 1.0)
    far = rng.choice([-1.0, 1.0], case.zs.shape) * 10.0 * sd * (1.0 + rng.random(case.zs.shape))
    case = case._replace(zs=case.zs + (rng.random(case.zs.shape) < share) * far)
    ratios = []
    for plain, ours in (
        (ExtendedKalmanFilter, RobustExtendedKalmanFilter), (UnscentedKalmanFilter, RobustUnscentedKalmanFilter),
    ):  # fmt: skip
        error, *errors = (
            float(np.sqrt(((states - case.truth)[:, case.shown] ** 2).mean()))
            for states in (filtered(case, plain), *(filtered(case, ours, **options) for options in WAYS.values()))
        )
        ratios += [value / error for value in errors]
    return ratios


def main() -> None:
    """Print the table, or write it to the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", default="")
    parser.add_argument("--write-page", action="store_true")
    args = parser.parse_args()
    heads = [f"{kind}: {way}" for kind in ("extended", "unscented") for way in WAYS]
    lines = ["| program | outliers | " + " | ".join(heads) + " |", "|---|---|" + "---|" * len(heads)]
    everything = []
    for name in (name for name in PROGRAMS if args.only in name):
        for share in (0.0, 0.1):
            seeds = range(args.seed, args.seed + args.runs)
            ratios = np.array(Parallel(n_jobs=args.jobs)(delayed(one)(name, share, seed) for seed in seeds))
            everything.append(np.exp(np.log(ratios).mean(axis=0)))
            pairs = zip(everything[-1], ratios.max(axis=0), strict=True)
            cells = (f"{mean:.2f} ({worst:.2f})" for mean, worst in pairs)
            lines.append(f"| {name} | {100 * share:.0f} % | " + " | ".join(cells) + " |")
            print(lines[-1], flush=True)
    means = np.exp(np.log(everything).mean(axis=0))
    lines.append("| geometric mean | | " + " | ".join(f"{mean:.2f}" for mean in means) + " |")
    print(lines[-1])
    if args.write_page:
        on_page("learnt_noise.md", "nonlinear", "\n".join(lines))


if __name__ == "__main__":
    main()
