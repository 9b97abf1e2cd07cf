"""Compare filters under outliers: of the measurement, of the process, after true jumps, and of jumping parameters.

Run ``python tests/benchmarks/outlier_tables.py [--runs N] [--jobs J] [--seed S] [--table NAME]``; each table says
which problem, how many runs, and gives 95 % bootstrap intervals over the runs, which all filters share.
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
from filterpy.kalman import KalmanFilter
from outlier_problems import (
    JUMP_RATE,
    JUMP_SIZE,
    errors,
    errors_with_labels,
    gate,
    jumping_parameters,
    level,
    paper,
    vehicle,
)

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))
from studies import bootstrap_interval, monte_carlo, ratio, stacked

from robust_filterpy import Contaminated, Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import Scales
from robust_filterpy.identification import ParameterTracker
from robust_filterpy.influence import Hampel

LABELS = "Kalman, given the labels"
TWO_SIDED = {"noise": Contaminated(), "process": Scales((1, 10, 100), jump=0)}


def one_sided(dim_x: int, dim_z: int) -> dict[str, Callable[[], Any]]:
    """Return the filters that doubt the measurement alone."""
    return {
        "Kalman (filterpy)": lambda: KalmanFilter(dim_x, dim_z),
        "chi-square gate, 99.73 %": lambda: gate(dim_x, dim_z),
        "Huber 1.345": lambda: RobustKalmanFilter(dim_x, dim_z, grouping="joint"),
        "Huber 1.345, given S": lambda: RobustKalmanFilter(dim_x, dim_z, scaling="innovation", grouping="joint"),
        "Tukey 4.685, given S": lambda: RobustKalmanFilter(
            dim_x, dim_z, influence=TukeyBiweight(), scaling="innovation", grouping="joint"
        ),
        "Hampel": lambda: RobustKalmanFilter(dim_x, dim_z, influence=Hampel(), grouping="joint"),
        "Tukey 4.685": lambda: RobustKalmanFilter(dim_x, dim_z, influence=TukeyBiweight(), grouping="joint"),
        "Student t, 4": lambda: RobustKalmanFilter(dim_x, dim_z, influence=StudentT(), grouping="joint"),
    }


def score_trial(rng: np.random.Generator, contamination: float, steps: int = 900) -> dict[str, float]:
    """Return each filter's mean square error of the observed state."""
    data = paper(rng, contamination, steps)
    noise = Contaminated(contamination, 10.0)
    filters = {
        **one_sided(4, 1),
        "noise-matched": lambda: RobustKalmanFilter(4, 1, noise=noise, grouping="joint"),
        "two-sided": lambda: RobustKalmanFilter(4, 1, **TWO_SIDED),
    }
    found = {name: float(np.mean(errors(build(), data)[:, 0] ** 2)) for name, build in filters.items()}
    return {**found, LABELS: float(np.mean(errors_with_labels(data)[:, 0] ** 2))}


def vehicle_trial(rng: np.random.Generator, process: float, measurement: float, steps: int = 1000) -> dict[str, float]:
    """Return each filter's root mean square error of the whole state."""
    data = vehicle(rng, process, measurement, steps)
    noise = {"noise": Contaminated(measurement, 10.0), "process": Contaminated(process, 10.0)}
    filters = {
        **one_sided(4, 2),
        "(a) noise-matched": lambda: RobustKalmanFilter(4, 2, grouping="joint", **noise),
        "(b) two-sided": lambda: RobustKalmanFilter(4, 2, grouping="joint", **TWO_SIDED),
    }
    found = {name: _rms(errors(build(), data)) for name, build in filters.items()}
    return {**found, LABELS: _rms(errors_with_labels(data))}


def _rms(error: np.ndarray) -> float:
    """Return the root of the mean squared length of the rows."""
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def ratios(title: str, trial: Callable[..., Any], reference: str, runs: int, seed: int, jobs: int) -> None:
    """Print each filter's error over that of the reference, with its interval."""
    start = time.perf_counter()
    found = stacked(monte_carlo(trial, runs, seed, jobs))
    print(
        f"\n{title}\n{runs} runs, seed {seed}, {time.perf_counter() - start:.0f} s; error over that of: {reference}\n"
    )
    print("| filter | ratio | 95 % interval |\n|---|---|---|")
    for name, values in found.items():
        interval = bootstrap_interval((values, found[reference]), ratio, seed)
        print(f"| {name} | {interval.estimate:.3f} | {interval.low:.3f} to {interval.high:.3f} |")


def score_table(runs: int, seed: int, jobs: int) -> None:
    """Print the table of measurement outliers: equations 31-34."""
    for contamination in (0.0, 0.1, 0.3):
        title = f"Equations 31-34, contamination {contamination}, 900 steps: mean square error of x1"
        ratios(title, partial(score_trial, contamination=contamination), LABELS, runs, seed, jobs)


def process_table(runs: int, seed: int, jobs: int) -> None:
    """Print the table of process outliers: the vehicle of Yang and Boyd."""
    for process, measurement in ((0.1, 0.1), (0.02, 0.1), (0.0, 0.1), (0.0, 0.0)):
        title = (
            f"Vehicle, process outliers {process}, measurement outliers {measurement}, 1000 steps: RMSE of the state"
        )
        trial = partial(vehicle_trial, process=process, measurement=measurement)
        ratios(title, trial, "Kalman (filterpy)", runs, seed, jobs)


JUMPS = (3.0, 6.0, 10.0, 30.0, 100.0)
RUN_LENGTHS = (3, 5, 10, 30)
INFORMATIONS = ("realized", "expected", "weight")


def locking_filters() -> dict[str, Callable[[], Any]]:
    """Return every influence with every information, without recovery and, where it locks out, with it."""
    gated = gate(1, 1).influence
    kinds = {"gate": gated, "Huber": Huber(), "Hampel": Hampel(), "Tukey": TukeyBiweight(), "Student t": StudentT()}
    filters: dict[str, Callable[[], Any]] = {"Kalman (filterpy)": lambda: KalmanFilter(1, 1)}
    for name, psi in kinds.items():
        for information in INFORMATIONS:
            choice = {"influence": psi, "information": information}
            filters[f"{name}, {information}"] = partial(RobustKalmanFilter, 1, 1, **choice)
    for name in ("gate", "Hampel", "Tukey"):
        for information in INFORMATIONS:
            choice = {"influence": kinds[name], "information": information}
            filters[f"{name}, {information}, recovering"] = partial(RobustKalmanFilter, 1, 1, patience=12, **choice)
    return {**filters, "two-sided": lambda: RobustKalmanFilter(1, 1, **TWO_SIDED)}


def recovery_trial(rng: np.random.Generator) -> dict[str, list[list[float]]]:
    """Return for each filter the steps to recover from each jump, and the peak error of each run of each size."""
    jumps = [level(rng, jump=size * rng.choice([-1.0, 1.0])) for size in JUMPS]
    runs = [[level(rng, run=n, size=size, steps=130) for size in JUMPS] for n in RUN_LENGTHS]
    found = {}
    for name, build in locking_filters().items():
        steps = [_steps_to_recover(errors(build(), data)[50:, 0]) for data in jumps]
        peaks = [[float(np.abs(errors(build(), data)[50:, 0]).max()) for data in row] for row in runs]
        found[name] = [steps, *peaks]
    return found


def _steps_to_recover(error: np.ndarray) -> float:
    """Return the first of five steps in a row whose error is under 1, infinite if there is none."""
    calm = np.convolve(np.abs(error) < 1.0, np.ones(5), "valid") == 5.0
    return float(np.argmax(calm)) if calm.any() else np.inf


def recovery_table(runs: int, seed: int, jobs: int) -> None:
    """Print the table of lock-out and capture."""
    start = time.perf_counter()
    found = stacked(monte_carlo(recovery_trial, runs, seed, jobs))
    seconds = time.perf_counter() - start
    print(f"\nA level (Q = 0.01, R = 1) that jumps by {JUMPS}, or an error alike for {RUN_LENGTHS} samples")
    print(
        f"{runs} runs, seed {seed}, {seconds:.0f} s; peak: mean of the largest error, for the worst size, in sqrt(R)\n"
    )
    heads = [f"jump {j:g}: steps" for j in JUMPS] + ["never, %"] + [f"run {n}: peak" for n in RUN_LENGTHS]
    print("| filter | " + " | ".join(heads) + " |\n|" + "---|" * (len(heads) + 1))
    for name, values in found.items():
        steps, peaks = values[:, 0], values[:, 1:]
        never = bootstrap_interval(100.0 * np.isinf(steps).mean(axis=1), seed=seed)
        cells = [f"{np.median(column):.0f}" for column in steps.T]
        cells.append(f"{never.estimate:.0f} ({never.low:.0f} to {never.high:.0f})")
        for k in range(len(RUN_LENGTHS)):
            worst = int(np.argmax(peaks[:, k].mean(axis=0)))
            peak = bootstrap_interval(peaks[:, k, worst], seed=seed)
            cells.append(f"{peak.estimate:.2f} ({peak.low:.2f} to {peak.high:.2f})")
        print(f"| {name} | " + " | ".join(cells) + " |")


def parameters_trial(rng: np.random.Generator, kind: str, contamination: float, steps: int = 2000) -> dict[str, float]:
    """Return each tracker's mean ||theta_hat - theta|| from sample 200 on."""
    data = jumping_parameters(rng, kind, contamination, steps)
    # A random walk of the same variance; and for those that know of jumps, what makes the widest scale, 100, a jump.
    walk, still = JUMP_RATE * JUMP_SIZE**2, (JUMP_SIZE / 100.0) ** 2
    mixture = 0.25 * (1.0 + 99.0 * contamination)
    noise = {"noise": Contaminated(contamination, 10.0), "process": Contaminated(JUMP_RATE, 100.0)}
    trackers: dict[str, dict[str, Any]] = {
        "Kalman (filterpy), random walk": {"filter": KalmanFilter(4, 1), "Q": walk, "R": mixture},
        "Huber 1.345, random walk": {"Q": walk, "R": 0.25},
        "Student t, 4, random walk": {"influence": StudentT(), "Q": walk, "R": 0.25},
        "(a) noise-matched": {"filter": RobustKalmanFilter(4, 1, **noise), "Q": still, "R": 0.25},
        "(b) two-sided": {"filter": RobustKalmanFilter(4, 1, **TWO_SIDED), "Q": still, "R": 0.25},
        "Tukey 4.685, recovering": {
            "filter": RobustKalmanFilter(4, 1, influence=TukeyBiweight(), patience=12),
            "Q": still,
            "R": 0.25,
        },
    }
    return {
        name: float(np.linalg.norm(_tracked(data, **choices) - data.theta, axis=1)[200:].mean())
        for name, choices in trackers.items()
    }


def _tracked(data: Any, **choices: Any) -> np.ndarray:
    """Return a tracker's path of theta."""
    return ParameterTracker(data.structure, P=1.0, **choices).run(data.y, data.u).theta


def parameters_table(runs: int, seed: int, jobs: int) -> None:
    """Print the table of parameters that jump."""
    for kind in ("FIR", "ARX", "OE"):
        for contamination in (0.0, 0.1):
            title = (
                f"{kind}, four parameters that jump by {JUMP_SIZE} each every {1 / JUMP_RATE:g} samples, "
                f"contamination {contamination}: mean ||theta_hat - theta||"
            )
            trial = partial(parameters_trial, kind=kind, contamination=contamination)
            ratios(title, trial, "Huber 1.345, random walk", runs, seed, jobs)


TABLES = {
    "score": (score_table, 150),
    "process": (process_table, 20),
    "recovery": (recovery_table, 20),
    "parameters": (parameters_table, 20),
}


def print_tables(
    tables: dict[str, tuple[Callable[[int, int, int], None], int]], doc: str | None, argv: list[str] | None = None
) -> None:
    """Print those of the tables that the command line asks for; each has the number of its runs."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--runs", type=int, help="runs of each table, otherwise " + str({k: v[1] for k, v in tables.items()})
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--seed", type=int, default=2025)
    parser.add_argument("--table", choices=tables, action="append", help="only this one (may be repeated)")
    chosen = parser.parse_args(argv)
    for name in chosen.table or tables:
        table, runs = tables[name]
        table(chosen.runs or runs, chosen.seed, chosen.jobs)


if __name__ == "__main__":
    print_tables(TABLES, __doc__)
