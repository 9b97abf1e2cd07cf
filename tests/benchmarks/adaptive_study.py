"""Compare the filter that learns its noise with peers, on noises, jumps and models that it was not given.

Run ``python tests/benchmarks/adaptive_study.py [--table NAME] [--runs N] [--seed S] [--jobs J] [--quick]``. All filters
see the same recordings; intervals are 95 % bootstrap intervals over them. What the peers' authors tune by the truth is
tuned so here, for each kind of noise anew, on two recordings of other seeds. --quick leaves the peers out. A target is
compared with the adaptive filter below the table. With each ratio: what the squared error is of what the filter's P
says (NEES over the number of states, 1 if P is right), and how often the truth is in its 95 % region.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from adaptive_problems import (
    DENSITIES,
    NOISES,
    Case,
    manoeuvring,
    optimal,
    point,
    vehicle,
    with_density,
    with_labels,
)
from filterpy.kalman import KalmanFilter
from joblib import Parallel, delayed
from measuring import CONSISTENCY, consistency
from measuring import target as verdict
from outlier_problems import gate
from peers import adaptive as adaptive_peers
from peers import inflation, iskf, similarity, student_t, wolf
from peers.recursion import filtered

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))
from studies import bootstrap_interval
from studies import ratio as ratio_of_means

from robust_filterpy import Contaminated, Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import Scales
from robust_filterpy.filters.conversion import AdaptiveKalmanFilter

#: States and their covariances.
Estimator = Callable[[Case], tuple[np.ndarray, np.ndarray]]
LABELS, KALMAN, ADAPTIVE = "given every size", "Kalman", "adaptive"
#: Whole process variance where a tenth has ten times the deviation.
WHOLE = 1.0 + 0.1 * 99.0
TUNING_SEED = 90_000
#: Mean square error over that of the filter given every size, at most.
TARGETS = {
    "clean": 1.009, "mixture .1, scale 10": 1.126, "mixture .05, scale 100": 1.015, "one-sided +20, .1": 1.03,
    "Student t(2)": 1.5, "bursts of 5": 1.39, "runs of 10 at +10": 4.4, "Laplace": 0.94, "uniform": 1.01,
    "R steps by 9": 1.2,
}  # fmt: skip
#: From a wrong R, from the 1000th sample on.
TARGETS_WRONG_R = {"clean": 1.01, "mixture .1, scale 10": 1.15}
#: Steps to return after a jump of 5, 10, 30 and 100 deviations.
TARGETS_JUMPS = (2, 9, 21, 49)


def of_filter(build: Callable[[int, int], Any], q_scale: float = 1.0) -> Estimator:
    """Return the estimates of a filter of filterpy's kind."""

    def estimate(case: Case) -> tuple[np.ndarray, np.ndarray]:
        kf = build(len(case.x0), len(case.R))
        kf.F, kf.H, kf.Q, kf.R = case.F, case.H, q_scale * case.Q, case.R
        kf.x, kf.P = case.x0.copy(), case.P0.copy()
        return kf.batch_filter(case.zs)[:2]

    return estimate


def ours() -> dict[str, Estimator]:
    """Return the filters of this package, and filterpy's."""
    given = Contaminated(0.1, 10.0)
    return {
        KALMAN: of_filter(KalmanFilter),
        "Huber": of_filter(partial(RobustKalmanFilter, grouping="joint")),
        "given mixture .1, 10": of_filter(partial(RobustKalmanFilter, noise=given, grouping="joint")),
        "two-sided": of_filter(
            partial(RobustKalmanFilter, noise=given, process=Scales((1, 10, 100), jump=0), grouping="joint")
        ),
        "adaptive, process trusted": of_filter(partial(AdaptiveKalmanFilter, process=Scales((1.0,)), grouping="joint")),
        ADAPTIVE: of_filter(partial(AdaptiveKalmanFilter, grouping="joint")),
    }


def tuned(make: Any, grid: list[dict[str, float]], q_scale: float = 1.0) -> Any:
    """Return a function of (recordings, error) that chooses from a grid what does best on them."""

    def choose(cases: list[Case], error: Callable[[np.ndarray, Case], float]) -> Estimator:
        def losses(case: Case) -> list[float]:
            if make not in TOGETHER:
                return [error(filtered(case, make(**choice), q_scale)[0], case) for choice in grid]
            columns = {name: np.array([[choice[name]] for choice in grid]) for name in grid[0]}
            return [error(path, case) for path in filtered(case, make(**columns), q_scale)[0].swapaxes(0, 1)]

        best = grid[int(np.argmin(np.mean([losses(case) for case in cases], axis=0)))]
        return lambda case: filtered(case, make(**best), q_scale)

    return choose


#: Whose P is the same for all choices, so that a recording is filtered once for a grid.
TOGETHER = (iskf.one_step, iskf.two_steps)
PEERS = {
    "WoLF IMQ, tuned": (wolf.imq, wolf.GRID),
    "WoLF TMD, tuned": (wolf.tmd, wolf.GRID),
    "ISKF one step, tuned": (iskf.one_step, iskf.GRID_ONE),
    "ISKF two steps, tuned": (iskf.two_steps, iskf.GRID_TWO),
    "Student t filter, tuned": (student_t.student_t, student_t.GRID),
    "variational R, tuned": (adaptive_peers.variational, adaptive_peers.GRID_VARIATIONAL),
    "innovation-based R, tuned": (adaptive_peers.innovation_based, adaptive_peers.GRID_WINDOW),
}
#: The best three of the table that `planes` repeats, and what else of ours is given S as they are.
PEERS_OF_PLANES = {
    "Student t filter of Neuhoefer, tuned": (student_t.fitted, student_t.GRID_FITTED),
    "similarity measure, tuned": (similarity.similarity, similarity.GRID),
    "inflated R, tuned": (inflation.inflated, inflation.GRID),
}
GIVEN_S = {"Huber": Huber(), "Tukey": TukeyBiweight(), "Student t(3)": StudentT(3.0)}
ONE_SIDED = ("WoLF IMQ, tuned", "WoLF TMD, tuned", "ISKF one step, tuned", "Student t filter, tuned")


def compare(
    title: str,
    draw: Callable[[int], Case],
    error: Callable[[np.ndarray, Case], float],
    reference: str,
    args: argparse.Namespace,
    whole: float | None = None,
    target: float | None = None,
    target_over_labels: float | None = None,
    peers: dict[str, Any] = PEERS,
    more: dict[str, Estimator] | None = None,
) -> None:
    """Print each filter's mean error over the reference's; with a factor for Q, one-sided filters with that too."""
    begin = time.perf_counter()
    filters = {LABELS: with_labels, **ours(), **(more or {})}
    if not args.quick:
        filters["gate, 99.73 %"] = of_filter(gate)
        practice = [draw(TUNING_SEED + k) for k in range(2)]
        for name, (make, grid) in peers.items():
            filters[name] = tuned(make, grid)(practice, error)
        if whole is not None:
            for name in ONE_SIDED:
                make, grid = PEERS[name]
                filters[f"{name}, Q x {whole:g}"] = tuned(make, grid, whole)(practice, error)
            filters[f"Huber, Q x {whole:g}"] = of_filter(partial(RobustKalmanFilter, grouping="joint"), whole)

    def trial(seed: int) -> list[tuple[float, ...]]:
        case = draw(seed)
        found = [estimate(case) for estimate in filters.values()]
        return [(error(xs, case), *consistency(case.truth, xs, Ps, 100)) for xs, Ps in found]

    seeds = range(args.seed, args.seed + args.runs)
    found = np.array(Parallel(n_jobs=args.jobs)(delayed(trial)(seed) for seed in seeds))
    errors = dict(zip(filters, found[..., 0].T, strict=True))
    held = dict(zip(filters, found[..., 1:].mean(axis=0), strict=True))
    print(f"\n{title}; {args.runs} runs, {time.perf_counter() - begin:.0f} s; error over that of: {reference}\n")
    print(f"| filter | ratio | 95 % interval | {CONSISTENCY} |\n|---|---|---|---|---|")
    for name, values in errors.items():
        if name != reference:
            ratio = bootstrap_interval((values, errors[reference]), ratio_of_means, args.seed)
            nees, within = held[name]
            cells = f"{ratio.estimate:.3f} | {ratio.low:.3f} to {ratio.high:.3f} | {nees:.2f} | {within:.2f}"
            print(f"| {name} | {cells} |", flush=True)
    for over, limit in ((reference, target), (LABELS, target_over_labels)):
        if limit is not None:
            verdict(f"over {over}", errors[ADAPTIVE].mean() / errors[over].mean(), limit)


def mean_square(path: np.ndarray, case: Case, first: int = 300) -> float:
    """Return the mean square error of the first state from a step on."""
    return float(np.mean((path - case.truth)[first:, 0] ** 2))


def root_mean_square(path: np.ndarray, case: Case) -> float:
    """Return the root of the mean squared length of the error."""
    return float(np.sqrt(((path - case.truth) ** 2).sum(axis=1).mean()))


def noises(args: argparse.Namespace) -> None:
    """Print a table for each kind of noise."""
    for kind in NOISES:
        title, draw = f"{kind}: mean square error", partial(point, kind=kind)
        compare(title, draw, mean_square, LABELS, args, target=TARGETS.get(kind))


def wrong(args: argparse.Namespace) -> None:
    """Print tables for wrong R, and wrong Q, from the 1000th sample on."""
    factors = [(1.0, r) for r in (0.01, 0.03, 0.1, 10.0, 100.0)] + [(q, 1.0) for q in (0.01, 0.1, 10.0, 100.0)]
    factors += [(0.1, 0.01), (0.1, 100.0)]
    for q_factor, r_factor in factors:
        for kind in ("clean", "mixture .1, scale 10"):
            compare(
                f"{kind}, Q times {q_factor:g}, R times {r_factor:g}: mean square error",
                partial(point, kind=kind, q_factor=q_factor, r_factor=r_factor),
                partial(mean_square, first=1000),
                LABELS,
                args,
                target=TARGETS_WRONG_R[kind] if q_factor == 1.0 else None,
            )


def vehicles(args: argparse.Namespace) -> None:
    """Print the tables of Yang and Boyd's vehicle."""
    # What is reachable differs from seed to seed: the second target is the first over that of the labels there.
    for title, target, labels, *how in (
        ("both noises with 10 % outliers of 10 times the scale", 0.639, 0.597, 0.1, 0.1, 10.0),
        ("both noises with 10 % outliers of 30 times the scale", 0.439, 0.408, 0.1, 0.1, 30.0),
        ("clean", 1.011, 1.0, 0.0, 0.0, 1.0),
        ("measurement outliers only", 0.417, 0.402, 0.0, 0.1, 10.0),
    ):
        draw, title = partial(_vehicle, how=how), f"Vehicle, {title}: RMSE of the state"
        compare(title, draw, root_mean_square, KALMAN, args, WHOLE, target, target / labels)


def _vehicle(seed: int, how: list[float]) -> Case:
    return vehicle(seed, *how)


def planes(args: argparse.Namespace) -> None:
    """Print the tables of the setting in which nine robust filters were compared.

    Their figures are mean lengths of the whole state's error, although the head of their table says position: filter
    that is given the sizes 1.77, their own 2.01, similarity measure 2.06, inflated R 2.07, a gate 2.26, the others 2.5
    and more. In the second table it is the position.
    """
    joint = partial(RobustKalmanFilter, grouping="joint", scaling="innovation")
    more = {f"{name}, given S": of_filter(partial(joint, influence=psi)) for name, psi in GIVEN_S.items()}
    more |= {"given the density": with_density}
    for what, error in (("whole state", length), ("position", distance)):
        title = f"Manoeuvres in a plane, Cauchy noise: {what}"
        compare(title, manoeuvring, error, LABELS, args, peers=PEERS_OF_PLANES, more=more)


def length(path: np.ndarray, case: Case) -> float:
    """Return the mean length of the state's error."""
    return float(np.linalg.norm((path - case.truth)[1:], axis=1).mean())


def distance(path: np.ndarray, case: Case) -> float:
    """Return the mean Euclidean distance of the position from the true one."""
    return float(np.hypot(*(path - case.truth)[1:, :2].T).mean())


def floors(args: argparse.Namespace) -> None:
    """Print what a filter can reach that is given the density of the noise, R and Q, but no labels."""
    print("\n| noise | optimal, over the labels | 95 % interval | adaptive over the optimal |\n|---|---|---|---|")
    adaptive = ours()[ADAPTIVE]
    for kind, density in DENSITIES.items():
        cases = [point(seed, kind) for seed in range(args.seed, args.seed + args.runs)]
        best, given, learnt = (
            np.array([mean_square(estimate(case), case) for case in cases])
            for estimate in (
                partial(optimal, density=density),
                lambda case: with_labels(case)[0],
                lambda case: adaptive(case)[0],
            )
        )
        ratio = bootstrap_interval((best, given), ratio_of_means, args.seed)
        cells = f"{ratio.estimate:.3f} | {ratio.low:.3f} to {ratio.high:.3f} | {learnt.mean() / best.mean():.3f}"
        print(f"| {kind} | {cells} |", flush=True)


def jumps(args: argparse.Namespace) -> None:
    """Print how many steps pass after a jump of the state until five in a row are within 3 deviations of R."""
    sizes = (5.0, 10.0, 30.0, 100.0)
    filters = {**ours(), "gate, 99.73 %": of_filter(gate)}

    def trial(seed: int) -> list[list[float]]:
        cases = [point(seed, "clean", 800, jump=size) for size in sizes]
        return [[_steps_to_return(estimate(case)[0], case) for case in cases] for estimate in filters.values()]

    found = np.array(
        Parallel(n_jobs=args.jobs)(delayed(trial)(seed) for seed in range(args.seed, args.seed + args.runs))
    )
    print(f"\nSteps to return after a jump of the position, median (95 % of runs within); {args.runs} runs\n")
    print("| filter | " + " | ".join(f"{size:g} sigma" for size in sizes) + " |\n|" + "---|" * 5)
    for k, name in enumerate(filters):
        cells = [f"{np.median(c):.0f} ({np.quantile(c, 0.95, method='higher'):.0f})" for c in found[:, k].T]
        print(f"| {name} | " + " | ".join(cells) + " |")
    for size, steps, limit in zip(sizes, found[:, list(filters).index(ADAPTIVE)].T, TARGETS_JUMPS, strict=True):
        verdict(f"steps after {size:g} sigma", float(np.median(steps)), limit)


def _steps_to_return(path: np.ndarray, case: Case, at: int = 500) -> float:
    """Return the number of steps after a jump before five in a row are within 3, infinite if there is none."""
    calm = np.convolve(np.abs(path - case.truth)[at:, 0] < 3.0, np.ones(5), "valid") == 5.0
    return float(np.argmax(calm)) if calm.any() else np.inf


TABLES = {"planes": planes, "noises": noises, "jumps": jumps, "wrong": wrong, "vehicle": vehicles, "floors": floors}


def main(argv: list[str] | None = None) -> None:
    """Print the tables that were asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--table", choices=TABLES, action="append", help="only this one (may be repeated)")
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="without the peers")
    args = parser.parse_args(argv)
    for name in args.table or TABLES:
        TABLES[name](args)


if __name__ == "__main__":
    main()
