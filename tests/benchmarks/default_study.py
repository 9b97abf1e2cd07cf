"""Which default loses least in the worst case? Every choice on problems of many kinds, none of them tuned.

Run ``python tests/benchmarks/default_study.py [--runs N] [--seed S] [--jobs J] [--steps N] [--write-page]``. The table
has a row for each problem and a column for each filter: root mean square error over that of the Kalman filter which is
given the size of every noise. Below it stand each filter's worst and mean ratio, and the same over the best filter of
each row, since some problems leave more room below the labels than others. The last columns judge the covariances of
some: the mean of d' P^-1 d / n, which is 1 if P is the error's (NEES), and how often the truth is in the 95 % region.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from adaptive_problems import Case, point, vehicle, with_labels
from filterpy.kalman import IMMEstimator, KalmanFilter
from joblib import Parallel, delayed
from measuring import consistency, on_page
from outlier_problems import gate

from robust_filterpy import AdaptiveKalmanFilter, Contaminated, Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import Scales

STEPS = 800
#: Whose covariance is judged, in two columns each.
SHOWN = ("Huber", "adaptive")
FILTERS: dict[str, Callable[[int, int], Any]] = {
    "Kalman": KalmanFilter,
    "gate": gate,
    "Huber": RobustKalmanFilter,
    "Huber, given S": partial(RobustKalmanFilter, scaling="innovation"),
    "Huber, joint": partial(RobustKalmanFilter, influence=Huber(), grouping="joint"),
    "Tukey": partial(RobustKalmanFilter, influence=TukeyBiweight()),
    "Student t": partial(RobustKalmanFilter, influence=StudentT()),
    "given (.1, 10)": partial(RobustKalmanFilter, noise=Contaminated()),
    "recovering": partial(RobustKalmanFilter, influence=TukeyBiweight(), patience=12),
    "two-sided": partial(RobustKalmanFilter, noise=Contaminated(), process=Scales((1, 10, 100), jump=0)),
    "adaptive": AdaptiveKalmanFilter,
    "adaptive, joint": partial(AdaptiveKalmanFilter, grouping="joint"),
}


def ranges(seed: int, steps: int, scale: float = 1.0) -> Case:
    """A walker among six far anchors: a range is its share of the position; walls delay a tenth, always to longer."""
    g = np.random.default_rng(seed)
    angles = np.arange(6) * np.pi / 3
    F, H = np.kron(np.eye(2), [[1.0, 0.1], [0.0, 1.0]]), np.zeros((6, 4))
    H[:, 0], H[:, 2] = np.cos(angles), np.sin(angles)
    root = np.kron(np.eye(2), 0.1 * np.array([[0.05], [1.0]]))
    truth = _path(g, F, root, steps, 4)
    behind = np.zeros((steps, 6), dtype=bool)
    for k in range(steps):
        # Behind a wall for five samples in the mean.
        behind[k] = np.where(behind[k - 1] if k else False, g.random(6) < 0.8, g.random(6) < 0.022)
    v = 0.1 * g.standard_normal((steps, 6)) + behind * g.exponential(1.0, (steps, 6))
    # No one number says how large the noise of six sensors is: `labelled` takes the sensors apart.
    label = np.where(behind, 10.0, 1.0)
    return Case(F, H, root @ root.T, scale * 0.01 * np.eye(6), np.zeros(4), np.eye(4), truth, truth @ H.T + v,
                np.ones(steps), label / np.sqrt(scale))  # fmt: skip


def beside_each_other(seed: int, steps: int, scale: float = 1.0) -> Case:
    """Two sensors of one position, one four times as good; each is wrong a tenth of the time, whatever the other is."""
    g = np.random.default_rng(seed)
    F, H, root = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]] * 2), 0.1 * np.array([[0.5], [1.0]])
    truth, R = _path(g, F, root, steps, 2), np.diag([1.0, 16.0])
    label = np.where(g.random((steps, 2)) < 0.1, 10.0, 1.0)
    zs = truth @ H.T + label * np.sqrt(R.diagonal()) * g.standard_normal((steps, 2))
    return Case(F, H, root @ root.T, scale * R, np.zeros(2), 10 * np.eye(2), truth, zs, np.ones(steps),
                label / np.sqrt(scale))  # fmt: skip


def one_stuck(seed: int, steps: int) -> Case:
    """Position and speed of three axes, of which one position at a time says the same for 20 samples in a hundred."""
    g = np.random.default_rng(seed)
    F, root = np.kron(np.eye(3), [[1.0, 0.1], [0.0, 1.0]]), np.kron(np.eye(3), 0.3 * np.array([[0.05], [1.0]]))
    H, truth = np.eye(6), _path(g, F, root, steps, 6)
    zs, label = truth + 0.2 * g.standard_normal((steps, 6)), np.ones((steps, 6))
    for k in range(20, steps - 20, 100):
        axis = 2 * g.integers(3)
        zs[k : k + 20, axis] = zs[k, axis]
    # The labels leave out what is stuck.
    label[1:][zs[1:] == zs[:-1]] = 1e4
    return Case(F, H, root @ root.T, 0.04 * np.eye(6), np.zeros(6), np.eye(6), truth, zs, np.ones(steps), label)


def vectors(seed: int, steps: int) -> Case:
    """A camera that reports three coordinates and is wrong in all of them at once, a tenth of the time."""
    g = np.random.default_rng(seed)
    F = np.kron(np.eye(3), [[1.0, 1.0], [0.0, 1.0]])
    H, root = np.kron(np.eye(3), [[1.0, 0.0]]), np.kron(np.eye(3), 0.1 * np.array([[0.5], [1.0]]))
    truth = _path(g, F, root, steps, 6)
    label = np.where(g.random(steps) < 0.1, 5.0, 1.0)
    zs = truth @ H.T + label[:, None] * g.standard_normal((steps, 3))
    return Case(F, H, root @ root.T, np.eye(3), np.zeros(6), 10 * np.eye(6), truth, zs, np.ones(steps), label)


def agile(seed: int, steps: int) -> Case:
    """A target that turns hard a fifth of the time: two models in an IMM; a tenth of the positions is wrong."""
    g = np.random.default_rng(seed)
    F, root = np.array([[1.0, 1.0], [0.0, 1.0]]), 0.1 * np.array([[0.5], [1.0]])
    w = np.where((np.arange(steps) // 20) % 5 == 4, 10.0, 1.0)
    truth = _path(g, F, root, steps, 2, w)
    label = np.where(g.random(steps) < 0.1, 10.0, 1.0)
    zs = truth[:, :1] + label[:, None] * g.standard_normal((steps, 1))
    return Case(F, np.eye(1, 2), root @ root.T, np.eye(1), np.zeros(2), 10 * np.eye(2), truth, zs, w, label)


def _path(g: np.random.Generator, F: Any, root: Any, steps: int, n: int, w: Any = 1.0) -> np.ndarray:
    """Return the states of a linear model from 0, shape (steps, n)."""
    x, truth, w = np.zeros(n), np.empty((steps, n)), np.broadcast_to(w, steps)
    for k in range(steps):
        x = truth[k] = F @ x + w[k] * root @ g.standard_normal(root.shape[1])
    return truth


def labelled(case: Case) -> np.ndarray:
    """Return the states of the filter that is given the size of every noise, of each sensor where they differ."""
    if case.v_scale.ndim == 1:
        return with_labels(case)[0]
    kf = _filled(KalmanFilter(len(case.x0), len(case.R)), case)
    return np.asarray(kf.batch_filter(case.zs, Rs=[np.diag(s**2) @ case.R for s in case.v_scale])[0])


def _filled(kf: Any, case: Case, q: float = 1.0) -> Any:
    kf.F, kf.H, kf.Q, kf.R = case.F, case.H, q * case.Q, case.R
    kf.x, kf.P = case.x0.copy(), case.P0.copy()
    return kf


def alone(build: Callable[[int, int], Any], case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Return the states of one filter, and their covariances."""
    return _filled(build(len(case.x0), len(case.R)), case).batch_filter(case.zs)[:2]  # type: ignore[no-any-return]


def in_imm(build: Callable[[int, int], Any], case: Case) -> tuple[np.ndarray, np.ndarray]:
    """Return the states of an IMM of two, and their covariances."""
    pair = [_filled(build(len(case.x0), len(case.R)), case, q) for q in (1.0, 100.0)]
    imm = IMMEstimator(pair, [0.8, 0.2], np.array([[0.98, 0.02], [0.05, 0.95]]))
    path, covariances = np.empty_like(case.truth), np.empty((*case.truth.shape, len(case.x0)))
    for k, z in enumerate(case.zs):
        imm.predict()
        imm.update(z)
        path[k], covariances[k] = np.ravel(imm.x), imm.P
    return path, covariances


def problems(steps: int) -> dict[str, tuple[Callable[[int], Case], Callable[..., Any]]]:
    """Return how each problem is drawn and filtered."""
    kinds = ("clean", "mixture .1, scale 10", "mixture .05, scale 100", "one-sided +20, .1", "Student t(2)",
             "bursts of 5", "runs of 10 at +10", "Laplace", "uniform")  # fmt: skip
    drawn = {kind: partial(point, kind=kind, steps=steps) for kind in kinds}
    mixture = partial(point, kind="mixture .1, scale 10", steps=steps)
    drawn |= {
        "R steps by 9": partial(point, kind="R steps by 9", steps=max(steps, 1200)),
        "mixture, R given 10 times too small": partial(mixture, r_factor=0.1),
        "mixture, R given 10 times too large": partial(mixture, r_factor=10.0),
        "mixture, Q given 10 times too small": partial(mixture, q_factor=0.1),
        "mixture, jump of 30": partial(mixture, jump=30.0),
        "vehicle, both noises": partial(vehicle, process=0.1, measurement=0.1, scale=10.0, steps=steps),
        "six ranges, natural delays": partial(ranges, steps=steps),
        "six ranges, R given 4 times too small": partial(ranges, steps=steps, scale=0.25),
        "two sensors, each fails on its own": partial(beside_each_other, steps=steps),
        "the same, R given 10 times too small": partial(beside_each_other, steps=steps, scale=0.1),
        "six sensors, one stuck": partial(one_stuck, steps=steps),
        "camera of three coordinates": partial(vectors, steps=steps),
    }
    found = {name: (draw, alone) for name, draw in drawn.items()}
    return {**found, "IMM of two models": (partial(agile, steps=steps), in_imm)}


def trial(name: str, steps: int, seed: int) -> tuple[list[float], list[tuple[float, float]]]:
    """Return everybody's root mean square error, the labels' first, and what P says of it, of those in `SHOWN`."""
    draw, run = problems(steps)[name]
    case = draw(seed)

    def error(path: np.ndarray) -> float:
        path = path.reshape(case.truth.shape)
        # The measured directions: H x; what is not seen has other units.
        return float(np.sqrt((((path - case.truth)[100:] @ case.H.T) ** 2).mean()))

    found = {name: run(build, case) for name, build in FILTERS.items()}
    held = [consistency(case.truth, *found[name], 100) for name in SHOWN]
    return [error(labelled(case)), *(error(path) for path, _ in found.values())], held


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--write-page", action="store_true")
    args = parser.parse_args(argv)
    seeds, names = range(args.seed, args.seed + args.runs), list(problems(args.steps))
    heads = [*FILTERS, *(f"{what} {name}" for name in SHOWN for what in ("NEES", "95 %"))]
    lines, rows = ["| problem | " + " | ".join(heads) + " |", "|" + "---|" * (len(heads) + 1)], []
    print(*lines, sep="\n")
    for name in names:
        errors, held = zip(*Parallel(n_jobs=args.jobs)(delayed(trial)(name, args.steps, s) for s in seeds), strict=True)
        found, shown = np.array(errors), np.mean(held, axis=0).ravel()
        # Geometric: one wild recording does not decide.
        ratios = np.exp(np.log(found[:, 1:] / found[:, :1]).mean(axis=0))
        rows.append(ratios)
        lines.append(f"| {name} | " + " | ".join(f"{value:.2f}" for value in [*ratios, *shown]) + " |")
        print(lines[-1], flush=True)
    table = np.array(rows)
    regret = table / table.min(axis=1, keepdims=True)
    for title, values in (("over the labels", table), ("over the best of the row", regret)):
        for what, of in (("worst", values.max(axis=0)), ("mean", np.exp(np.log(values).mean(axis=0)))):
            numbers = [f"{v:.2f}" for v in of] + [""] * 2 * len(SHOWN)
            lines.append(f"| **{what}, {title}** | " + " | ".join(numbers) + " |")
            print(lines[-1])
    if args.write_page:
        on_page("benchmarks.md", "default", "\n".join(lines))


if __name__ == "__main__":
    main()
