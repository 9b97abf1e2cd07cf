"""This package beside others on the same recordings: who is closest to the truth, who is fastest, where others win.

Run ``python tests/benchmarks/side_by_side.py [--runs N] [--seed S] [--jobs J] [--write-page]``. The peers' parameters
are tuned by the truth, on two recordings of other seeds; ours are not tuned. --write-page writes docs/side_by_side.md.
A package that is not installed has no row.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import platform
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from adaptive_problems import Case, point
from adaptive_study import PEERS, tuned
from compare_peers import SIZES, measured, table
from default_study import alone, labelled, problems
from filterpy.kalman import KalmanFilter
from joblib import Parallel, delayed
from outlier_problems import gate
from scipy.signal import lfilter

import robust_filterpy
from robust_filterpy import ARX, AdaptiveKalmanFilter, OutputError, ParameterTracker, RobustKalmanFilter, identify
from robust_filterpy.experiments import fit_percent

PAGE = Path(__file__).parents[2] / "docs" / "side_by_side.md"
STEPS, TUNING_SEED = 800, 90_000
OURS = {"ours": RobustKalmanFilter, "ours, adaptive": AdaptiveKalmanFilter}
#: The names of those whose filters are recursions of a paper's, written in tests/benchmarks/peers.
SHORT = {
    "WoLF IMQ, tuned": "WoLF",
    "ISKF one step, tuned": "ISKF",
    "ISKF two steps, tuned": "ISKF2",
    "Student t filter, tuned": "STF",
    "variational R, tuned": "variational R",
}
STRUCTURES = {"ARX(2, 2)": ARX(2, 2), "OutputError(2, 2)": OutputError(2, 2)}
LEFT_OUT = ("IMM of two models", "Laplace", "the same, R told 10 times too small")


def drawn() -> dict[str, Callable[[int], Case]]:
    """Return how the recording of each problem is drawn."""
    found = {name: draw for name, (draw, run) in problems(STEPS).items() if run is alone and name not in LEFT_OUT}
    return {**found, "no outliers, jump of 30": partial(point, kind="clean", jump=30.0, steps=STEPS)}


def error(path: np.ndarray, case: Case) -> float:
    """Return the root mean square error of what is measured, from the 100th sample on."""
    path = np.asarray(path).reshape(case.truth.shape)
    return float(np.sqrt((((path - case.truth)[100:] @ case.H.T) ** 2).mean()))


def states(name: str, seeds: range, jobs: int) -> dict[str, float]:
    """Return everybody's error over that of the filter which knows the labels: the geometric mean over recordings."""
    draw = drawn()[name]
    practice = [draw(TUNING_SEED + k) for k in range(2)]
    filters: dict[str, Callable[[Case], np.ndarray]] = {
        "labels": labelled, "filterpy": partial(alone, KalmanFilter), "gate": partial(alone, gate)
    }  # fmt: skip
    filters |= {short: tuned(*PEERS[long])(practice, error) for long, short in SHORT.items()}
    filters |= {ours: partial(alone, build) for ours, build in OURS.items()}

    def trial(seed: int) -> list[float]:
        case = draw(seed)
        return [error(estimate(case), case) for estimate in filters.values()]

    found = np.array(Parallel(n_jobs=jobs)(delayed(trial)(seed) for seed in seeds))
    ratios = np.exp(np.log(found[:, 1:] / found[:, :1]).mean(axis=0))
    return dict(zip(list(filters)[1:], ratios.tolist(), strict=True))


def recording(seed: int) -> tuple[np.ndarray, ...]:
    """Return y, u, the input and the clean output of a fresh recording, and theta, of a plant with 10 % outliers."""
    g = np.random.default_rng(seed)
    angle, radius = g.uniform(0.2, 1.2), g.uniform(0.6, 0.9)
    theta = np.array([-2.0 * radius * np.cos(angle), radius**2, *g.normal(size=2)])
    u, fresh = g.choice([-1.0, 1.0], (2, 1000))
    clean, test = (lfilter([0.0, *theta[2:]], [1.0, *theta[:2]], x) for x in (u, fresh))
    noise = 0.2 * clean.std() * np.where(g.random(1000) < 0.1, 10.0, 1.0) * g.normal(size=1000)
    return clean + noise, u, fresh, test, theta


def models(seed: int) -> dict[str, float]:
    """Return how well the model that each package finds simulates a fresh recording, in percent."""
    y, u, fresh, test, _ = recording(seed)
    found = {}
    with contextlib.suppress(ImportError):
        from sippy_unipi import system_identification

        for kind, orders in (("ARX", {"na_ord": [2, 2], "nb_ord": [2, 2], "delays": [0, 0]}), ("N4SID", {})):
            with contextlib.redirect_stdout(None):
                if kind == "ARX":
                    chosen = system_identification(y, u, "ARX", IC="BIC", **orders).G
                    numerator, denominator = chosen.num[0][0], chosen.den[0][0]
                else:
                    space = system_identification(y, u, "N4SID", SS_fixed_order=2)
                    numerator, denominator = scipy.signal.ss2tf(space.A, space.B, space.C, space.D)
                    numerator = numerator[0]
            numerator = np.concatenate((np.zeros(len(denominator) - len(numerator)), numerator))
            found[f"SIPPY, {kind}"] = fit_percent(test, lfilter(numerator, denominator, fresh))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, structure in STRUCTURES.items():
            model = identify(y, u, structure)
            found[f"`identify(y, u, {name})`"] = fit_percent(test, model.simulate(fresh) - model.level)
    return found


def recursive(seed: int) -> dict[str, float]:
    """Return the relative error of the parameters that recursive least squares and the tracker end with."""
    y, u, _, _, theta = recording(seed)
    found = {}
    with contextlib.suppress(ImportError):
        import padasip

        phi = np.column_stack(
            [-np.r_[0.0, y[:-1]], -np.r_[0.0, 0.0, y[:-2]], np.r_[0.0, u[:-1]], np.r_[0.0, 0.0, u[:-2]]]
        )
        _, _, weights = padasip.filters.FilterRLS(n=4, mu=1.0).run(y, phi)
        found["padasip, recursive least squares"] = weights[-1]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for name, structure in STRUCTURES.items():
            tracker = ParameterTracker(structure)
            tracker.run(y, u)
            found[f"`ParameterTracker({name})`"] = tracker.theta
    return {name: float(np.linalg.norm(t - theta) / np.linalg.norm(theta)) for name, t in found.items()}


def in_rows(found: dict[str, dict[str, float]]) -> str:
    """Return errors as a table in which the least of each row is bold."""
    names = list(next(iter(found.values())))
    lines = ["| problem | " + " | ".join(names) + " |", "|---" * (len(names) + 1) + "|"]
    for problem, errors in found.items():
        least = min(errors.values())
        cells = [f"**{e:.2f}**" if e <= 1.005 * least else f"{e:.2f}" for e in errors.values()]
        lines.append(f"| {problem} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def others_win(found: dict[str, dict[str, float]]) -> str:
    """Return where somebody else is closer than both of ours, and by how much."""
    lines = []
    for problem, errors in found.items():
        ours = min(errors, key=lambda name: errors[name] if name in OURS else np.inf)
        theirs = min(errors, key=lambda name: np.inf if name in OURS else errors[name])
        if errors[ours] > 1.02 * errors[theirs]:
            lines.append(f"* **{problem}**: {theirs} {errors[theirs]:.2f}, {ours} {errors[ours]:.2f}.")
    return "\n".join(lines) or "* nowhere on this page by more than 2 %."


def medians(trial: Callable[[int], dict[str, float]], seeds: range, jobs: int, unit: str) -> str:
    """Return the median of each number over recordings as a table."""
    found = Parallel(n_jobs=jobs)(delayed(trial)(seed) for seed in seeds)
    rows = [(name, np.quantile([one[name] for one in found], (0.5, 0.05, 0.95))) for name in found[0]]
    lines = [f"| {name} | {a:.3g} | {b:.3g} to {c:.3g} |" for name, (a, b, c) in rows]
    return "\n".join([f"| | {unit}, median | from the 5th to the 95th percentile |\n|---|---|---|", *lines])


def versions() -> str:
    """Return what was compared."""
    from importlib.metadata import PackageNotFoundError, version

    found = [f"robust_filterpy {robust_filterpy.__version__}", f"Python {platform.python_version()}"]
    for name in ("filterpy", "numpy", "statsmodels", "simdkalman", "pykalman", "padasip", "sippy_unipi"):
        with contextlib.suppress(PackageNotFoundError):
            found.append(f"{name} {version(name)}")
    return ", ".join(found)


def page(args: argparse.Namespace) -> str:
    """Return the whole page."""
    seeds = range(args.seed, args.seed + args.runs)
    errors = {name: states(name, seeds, args.jobs) for name in drawn()}
    costs: dict[Any, Any] = measured(1000, 200, 3)
    return f"""# Side by side

Made by `python tests/benchmarks/side_by_side.py --write-page` on {datetime.date.today()}; no number here is typed.
{versions()}. {args.runs} recordings of each problem, seeds from {args.seed}.

## States through outliers

Root mean square error of what is measured, over that of the Kalman filter which is told the size of every noise; the
least of each row is bold. WoLF, ISKF, ISKF2, STF (a filter of Student's t) and the variational R are written from their
papers (`tests/benchmarks/peers`) and **tuned by the truth, for each row anew**, on two other recordings; the gate is at
99.73 %; ours (`RobustKalmanFilter`, and `AdaptiveKalmanFilter`), the gate and filterpy are as they come.

{in_rows(errors)}

Others are closer than both of ours here:

{others_win(errors)}

## A model of a recording

Plants of order 2, one reading in ten an outlier, the orders told: how much of a fresh recording a free run explains.

{medians(models, seeds, args.jobs, "fit, percent")}

## Parameters, sample by sample

The same recordings: error of the parameters after 1000 samples, over their length.

{medians(recursive, seeds, args.jobs, "relative error")}

## Time

Microseconds per step of one series (ratio to filterpy's in the same run, one thread); sizes {SIZES}.

{table(costs, 1000, 200, 3)}

More tables, of this package against bounds rather than peers: [benchmarks](benchmarks.md).
"""


def main(argv: list[str] | None = None) -> None:
    """Print the page, and write it if asked to."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=20_000)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--write-page", action="store_true")
    args = parser.parse_args(argv)
    text = page(args)
    print(text)
    if args.write_page:
        PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
