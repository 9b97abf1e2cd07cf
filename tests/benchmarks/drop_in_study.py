"""What does a program gain or lose when only its import line changes? Ratios to filterpy and to who knows the labels.

Run ``python tests/benchmarks/drop_in_study.py [--runs N] [--seed S] [--jobs J] [--only TEXT] [--frontier [PATH]]``. A
row is a problem, its figure a mean square error of what is measured (of redundant sensors: the median over the
recordings of the root mean square error), over filterpy's filter and over the Kalman filter that is given the size of
every noise and leaves out sensors that are bad. The start 75 away counts steps until the error stays below 3, beyond
filterpy's. Box trackers: one minus the overlap with the true box, over filterpy's. Reactors: root mean square error of
all states. Daily cycles: hours read rightly. ``--frontier`` draws what the length of a run that is taken for a
jump costs: a jump of 30 deviations against bursts and runs at one height.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from adaptive_problems import Case, vehicle
from drop_in_problems import (
    BAD,
    boxes,
    daily,
    in_a_row,
    one,
    position_and_velocity,
    quantized,
    reactors,
    redundant,
    standing,
    stuck_now_and_then,
    thrown,
    turning,
    walking,
    with_labels,
)
from filterpy.kalman import (
    CubatureKalmanFilter,
    ExtendedKalmanFilter,
    KalmanFilter,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
)
from joblib import Parallel, delayed

from robust_filterpy import (
    AdaptiveKalmanFilter,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    kernel,
)
from robust_filterpy.correction import spread
from robust_filterpy.filters import (
    CorrelatedInnovationsWarning,
    OutlierShareWarning,
    RobustCubatureKalmanFilter,
    StuckSensorWarning,
)

FIGURE = Path(__file__).parents[2] / "examples" / "figures" / "drop_in_frontier.png"
OURS: dict[str, Callable[[int, int], Any]] = {
    "innovation": partial(RobustKalmanFilter, scaling="innovation"),
    "learnt": RobustKalmanFilter,
    "adaptive": AdaptiveKalmanFilter,
}
LENGTHS = (2, 3, 4, 5, 6, 8)


class Row(NamedTuple):
    """A problem, what the filters are given wrongly, how errors are counted, which class."""

    draw: Callable[[int], Case]
    P: float = 1.0
    Q: float = 1.0
    R: float = 1.0
    figure: str = "square"
    kind: str = "linear"


def rows() -> dict[str, Row]:
    """Return every problem by its name."""
    clean, mixed = partial(one, kind="clean"), partial(one, kind="mixture .1, scale 10")
    found = {kind: Row(partial(one, kind=kind)) for kind in (
        "clean", "mixture .1, scale 10", "mixture .3, scale 10", "mixture .05, scale 100", "one-sided +20, .1",
        "Student t(2)", "Laplace", "uniform", "R steps by 9",
    )}  # fmt: skip
    found["R steps by 9"] = Row(partial(one, kind="R steps by 9", steps=1800))
    for c in (0.01, 0.1, 10.0, 100.0):
        found[f"P, Q, R given x {c:g}"] = Row(clean, c, c, c)
        found[f"the same, mixture .1, x {c:g}"] = Row(mixed, c, c, c)
    for c in (0.01, 0.1, 10.0, 100.0):
        found[f"R alone x {c:g}"] = Row(clean, R=c)
        found[f"Q alone x {c:g}"] = Row(clean, Q=c)
    both = position_and_velocity
    found |= {
        "Q given 0": Row(clean, Q=0.0),
        "position and velocity": Row(both),
        "position and velocity, .1": Row(partial(both, share=0.1)),
        "position and velocity, Q x 100": Row(both, Q=100.0),
        "position and velocity, Q x 1e-6": Row(both, Q=1e-6),
    }
    for steps in (5, 10, 15, 20):
        found[f"{steps} samples, diffuse start"] = Row(partial(clean, steps=steps, prior=1e4))
        found[f"{steps} samples, diffuse start, .1"] = Row(partial(mixed, steps=steps, prior=1e4))
        found[f"{steps} samples, start 75 away"] = Row(partial(clean, steps=steps, start=75.0))
    found |= {
        "start 75 away: steps": Row(partial(clean, steps=200, start=75.0), figure="steps"),
        "bursts of 5": Row(partial(in_a_row, length=5, height=0.0, share=0.1)),
        "bursts of 10": Row(partial(in_a_row, length=10, height=0.0, share=0.1)),
        "3 in a row at +10": Row(partial(in_a_row, length=3, height=10.0, share=0.02)),
        "10 in a row at +10": Row(partial(in_a_row, length=10, height=10.0, share=0.02)),
        "a jump of 10": Row(partial(clean, jump=10.0)),
        "a jump of 30": Row(partial(clean, jump=30.0)),
        "a jump of 300": Row(partial(clean, jump=300.0)),
        "a jump of 30, .1": Row(partial(mixed, jump=30.0)),
        "standing without noise, then moving": Row(standing),
        "read in steps of 3": Row(partial(quantized, step=3.0)),
        "read in steps of 3, a jump of 30": Row(partial(quantized, step=3.0, jump=30.0)),
        "a position stuck for 20 samples in 100": Row(stuck_now_and_then),
        "vehicle, both noises": Row(partial(vehicle, process=0.1, measurement=0.1, scale=10.0, steps=600)),
        "reactors, both noises": Row(reactors, figure="states"),
        "daily cycle": Row(partial(daily, height=-80.0, stops=0), figure="ordinary"),
        "daily cycle, four stops": Row(partial(daily, height=-80.0), figure="ordinary"),
        "daily cycle, four small stops": Row(partial(daily, height=-20.0), figure="ordinary"),
        "daily cycle of 24 states, four stops": Row(partial(daily, height=-80.0, dummies=True), figure="ordinary"),
        "boxes": Row(partial(boxes, bad=0.0), figure="overlap"),
        "boxes, 3 % bad": Row(partial(boxes, bad=0.03), figure="overlap"),
    }
    for share in (0.0, 0.05):
        more = f", {share:.0%} bad" if share else ""
        found[f"a ball that bounces{more}"] = Row(partial(thrown, share=share))
        found[f"a walker, the model stands{more}"] = Row(partial(walking, share=share))
        found[f"boxes on a curve{more}"] = Row(partial(turning, share=share), figure="overlap")
    faults = ("none", "+10", "+10 from the 100th", "stuck", "drifting", "30 times noisier", "silent")
    for m in (2, 3, 4):
        for fault in faults:
            found[f"{m} sensors, {'all good' if fault == 'none' else 'one ' + fault}"] = Row(
                partial(redundant, sensors=m, fault=fault), figure="median"
            )
    found["3 sensors, two lie alike"] = Row(partial(redundant, sensors=3, fault="two lie alike"), figure="median")
    for kind in ("EKF", "UKF", "CKF"):
        found[f"{kind}, clean"], found[f"{kind}, .1"] = Row(clean, kind=kind), Row(mixed, kind=kind)
    return found


def build(kind: str, case: Case, robust: str | None) -> Any:
    """Return a filter of some class, filterpy's or ours."""
    n, m = len(case.x0), len(case.R)
    more = {} if robust is None else {"noise": "learnt"} if robust == "adaptive" else {"scaling": robust}
    if kind == "linear":
        return KalmanFilter(n, m) if robust is None else OURS[robust](n, m)
    if kind == "EKF":
        return (RobustExtendedKalmanFilter if robust else ExtendedKalmanFilter)(n, m, **more)
    if kind == "UKF":
        cls, more["points"] = RobustUnscentedKalmanFilter if robust else UnscentedKalmanFilter, _points(n)
    else:
        cls = RobustCubatureKalmanFilter if robust else CubatureKalmanFilter
    # filterpy's cubature points are columns.
    return cls(
        dim_x=n, dim_z=m, dt=1.0, hx=lambda x: case.H @ np.ravel(x), fx=lambda x, dt: case.F @ np.ravel(x), **more
    )


def _points(n: int) -> Any:
    return MerweScaledSigmaPoints(n, alpha=0.5, beta=2.0, kappa=3.0 - n)


def path_of(kf: Any, row: Row, case: Case) -> np.ndarray:
    """Return the estimates of a filter that is given what the row says."""
    if row.kind in ("linear", "EKF"):
        kf.F = case.F
    if row.kind == "linear":
        kf.H = case.H
    kf.Q, kf.R = row.Q * case.Q, row.R * case.R
    kf.x, kf.P = case.x0.copy(), row.P * case.P0
    if row.kind == "EKF":
        kf.x = kf.x[:, None]
    path = np.empty_like(case.truth)
    for k, z in enumerate(case.zs):
        kf.predict()
        if row.kind == "EKF":
            kf.update(z[:, None], lambda x: case.H, lambda x: case.H @ x)
        else:
            kf.update(z)
        path[k] = np.ravel(kf.x)
    return path


def figure(row: Row, case: Case, path: np.ndarray) -> float:
    """Return how wrong a path is."""
    error = (path - case.truth) @ case.H.T
    if row.figure == "steps":
        far = np.flatnonzero(np.abs(error[:, 0]) > 3.0)
        return float(far[-1] + 1) if len(far) else 0.0
    if row.figure == "overlap":
        return float(np.mean([1.0 - _overlap(a, b) for a, b in zip(path[1:], case.truth[1:], strict=True)]))
    if row.figure == "states":
        return float(np.sqrt(np.mean((path - case.truth) ** 2)))
    ordinary = case.v_scale[:, 0] < BAD if row.figure == "ordinary" else np.ones(len(error), dtype=bool)
    return float(np.mean(error[ordinary] ** 2))


def _overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Return the intersection of two boxes (centre, area, aspect ratio) over their union."""
    if min(a[2], a[3]) <= 0.0:
        return 0.0
    sides = [(np.sqrt(v[2] * v[3]), np.sqrt(v[2] / v[3])) for v in (a, b)]
    common = [
        max(
            0.0,
            min(a[i] + sides[0][i] / 2, b[i] + sides[1][i] / 2) - max(a[i] - sides[0][i] / 2, b[i] - sides[1][i] / 2),
        )
        for i in (0, 1)
    ]
    shared = common[0] * common[1]
    return float(shared / (a[2] + b[2] - shared))


def trial(name: str, seed: int) -> list[float]:
    """Return the figures of filterpy, of ours, and of who knows the labels."""
    # That S is given too small, and that many are clipped, is what some rows are about.
    for said in (OutlierShareWarning, CorrelatedInnovationsWarning, StuckSensorWarning):
        warnings.simplefilter("ignore", said)
    row = rows()[name]
    case = row.draw(seed)
    if case.v_scale.ndim == 1:
        case = case._replace(v_scale=np.repeat(case.v_scale[:, None], case.zs.shape[1], axis=1))
    # filterpy has no missing components: who is silent is left out for it.
    silent = np.isnan(case.zs).any()
    theirs = with_labels(case, given=True) if silent else path_of(build(row.kind, case, None), row, case)
    paths = [theirs, *(path_of(build(row.kind, case, robust), row, case) for robust in OURS), with_labels(case)]
    return [figure(row, case, path) for path in paths]


def summary(row: Row, found: np.ndarray) -> tuple[list[str], list[str]]:
    """Return the figures over filterpy's, and over who knows the labels."""
    if row.figure == "steps":
        return [f"{value:+.1f}" for value in found[:, 1:-1].mean(axis=0) - found[:, 0].mean()], ["-"] * (1 + len(OURS))
    if row.figure == "median":
        values = np.sqrt(np.median(found / found[:, -1:], axis=0))
    else:
        values = found.mean(axis=0) / found[:, -1].mean()
    labels = ["-"] * (1 + len(OURS)) if row.figure == "overlap" else [f"{value:.3g}" for value in values[:-1]]
    return [f"{value:.3g}" for value in values[1:-1] / values[0]], labels


def frontier(seeds: range, jobs: int, path: Path) -> None:
    """Print and draw a jump of 30 against bursts and runs, over how long a run must be to be taken for a jump."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    others = ("bursts of 5", "bursts of 10", "3 in a row at +10", "mixture .3, scale 10")
    print("| run taken for a jump | a jump of 30 | " + " | ".join(others) + " |\n|" + "---|" * (2 + len(others)))
    table = []
    for length in LENGTHS:
        table.append([np.mean(Parallel(n_jobs=jobs)(delayed(_with_length)(length, name, s) for s in seeds), axis=0)
                      for name in ("a jump of 30", *others)])  # fmt: skip
        print(f"| {length} | " + " | ".join(f"{v[0] / v[1]:.2f}" for v in table[-1]) + " |", flush=True)
    ratios = np.array(table)[:, :, 0] / np.array(table)[:, :, 1]
    _, panels = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
    panels[0].plot(LENGTHS, ratios[:, 0], "o-", color="black")
    for i, (name, mark) in enumerate(zip(others, "osD^", strict=True), 1):
        panels[1].plot(LENGTHS, ratios[:, i], mark + "-", label=name)
    titles = "What a true jump of 30 deviations costs", "What runs of outliers cost"
    for axis, title, over in zip(panels, titles, ("Kalman filter's", "filter's that knows the labels"), strict=True):
        axis.axvline(spread.RUN_LENGTH, color="0.7", linewidth=6, zorder=0, label="default")
        axis.set(title=title, xticks=LENGTHS, xlabel="outliers in a row that are taken for a jump", ylim=(0, None))
        axis.set_ylabel(f"squared error over the {over}")
    panels[1].legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    plt.savefig(path, dpi=150)
    print(f"\nwritten to {path}")


def _with_length(length: int, name: str, seed: int) -> tuple[float, float]:
    """Return the squared error of the definition with another length of run, and of who knows the labels."""
    row, default = rows()[name], spread.RUN_LENGTH
    case = row.draw(seed)
    kf = RobustKalmanFilter(len(case.x0), len(case.R))
    try:
        spread.RUN_LENGTH = length
        return figure(row, case, path_of(kf, row, case)), figure(row, case, with_labels(case))
    finally:
        spread.RUN_LENGTH = default


def main(argv: list[str] | None = None) -> None:
    """Print the table, or draw the frontier."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--seed", type=int, default=5000)
    parser.add_argument("--jobs", type=int, default=-1)
    parser.add_argument("--only", default="", help="rows whose name contains this")
    parser.add_argument("--frontier", type=Path, nargs="?", const=FIGURE, help="draw the frontier to a file instead")
    args = parser.parse_args(argv)
    seeds = range(args.seed, args.seed + args.runs)
    if args.frontier is not None:
        if kernel.available():
            # The kernel has a length of its own; the definition reads it from `spread`.
            command = [sys.executable, __file__, *(sys.argv[1:] if argv is None else argv)]
            os.execve(sys.executable, command, {**os.environ, "ROBUST_FILTERPY_KERNEL": "off"})
        frontier(seeds, args.jobs, args.frontier)
        return
    print(f"{args.runs} recordings from seed {args.seed}\n")
    print("| problem | " + " | ".join(f"{name} / filterpy" for name in OURS) + " | filterpy / labels | "
          + " | ".join(f"{name} / labels" for name in OURS) + " |\n|" + "---|" * (2 + 2 * len(OURS)))  # fmt: skip
    for name, row in rows().items():
        if args.only in name:
            found = np.array(Parallel(n_jobs=args.jobs)(delayed(trial)(name, seed) for seed in seeds))
            over, labels = summary(row, found)
            print(f"| {name} | " + " | ".join([*over, *labels]) + " |", flush=True)


if __name__ == "__main__":
    main()
