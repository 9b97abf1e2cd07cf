"""This package and others on the same recordings: who is closest to the truth, who is fastest, where others win.

Run ``python tests/benchmarks/side_by_side.py [--runs N] [--seed S] [--jobs J] [--rows TEXT ..] [--store FILE]
[--write-page]``. Peers are tuned by the truth, on recordings of other seeds; ours are not tuned. --write-page writes
docs/side_by_side.md. A package that is not installed has no row. A row takes four seconds; --store keeps what was
measured, so that a run that was broken off goes on, and --rows measures anew those whose name has one of the texts.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import json
import platform
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy
from adaptive_problems import Case, point
from adaptive_study import PEERS, tuned
from compare_peers import SIZES, measured, table
from default_study import alone, labelled, problems
from drop_in_problems import in_a_row, with_labels
from drop_in_study import rows
from filterpy.kalman import KalmanFilter
from joblib import Parallel, delayed
from peers.gating import gate
from peers.recursion import filtered, kalman
from scipy.signal import lfilter

import robust_filterpy
from robust_filterpy import ARX, AdaptiveKalmanFilter, OutputError, ParameterTracker, RobustKalmanFilter, identify
from robust_filterpy.testing import fit_percent

PAGE = Path(__file__).parents[2] / "docs" / "side_by_side.md"
STEPS, TUNING_SEED = 800, 90_000
OURS = {"ours": RobustKalmanFilter, "ours, adaptive": AdaptiveKalmanFilter}
#: Those that nothing was tuned for: neither they nor ours need the truth.
UNTUNED = ("filterpy", "gate", "gate, reset")
#: The names of those whose filters are recursions of a paper's, written in tests/benchmarks/peers.
SHORT = {
    "WoLF IMQ, tuned": "WoLF",
    "ISKF one step, tuned": "ISKF",
    "ISKF two steps, tuned": "ISKF2",
    "Student t filter, tuned": "STF",
    "variational R, tuned": "variational R",
}
STRUCTURES = {"ARX(2, 2)": ARX(2, 2), "OutputError(2, 2)": OutputError(2, 2)}
LEFT_OUT = ("IMM of two models", "Laplace", "the same, R given 10 times too small")


class Drawn(NamedTuple):
    """How the recording of a problem is drawn, what the filters are given wrongly, and who knows the labels."""

    draw: Callable[[int], Case]
    P: float = 1.0
    Q: float = 1.0
    R: float = 1.0
    labels: Callable[[Case], np.ndarray] = with_labels

    def true(self, seed: int) -> Case:
        """Return a recording, with a label for each sensor where these are what `with_labels` reads."""
        case = self.draw(seed)
        if self.labels is with_labels and case.v_scale.ndim == 1:
            case = case._replace(v_scale=np.repeat(case.v_scale[:, None], case.zs.shape[1], axis=1))
        return case

    def given(self, seed: int) -> Case:
        """Return a recording with the matrices that every filter is given."""
        case = self.true(seed)
        return case._replace(P0=self.P * case.P0, Q=self.Q * case.Q, R=self.R * case.R)


def jumping(seed: int, size: float, every: int, share: float = 0.0, held: int = 1, steps: int = STEPS) -> Case:
    """Return a point that jumps now and then; share: of outliers; held: samples that a reading is repeated for."""
    g, case = np.random.default_rng(seed + 1), in_a_row(seed, 1, 0.0, share, steps)
    jump = np.where(np.arange(steps) % every == every - 1, size * g.choice([-1.0, 1.0], steps), 0.0).cumsum()
    zs = (case.zs + jump[:, None])[np.arange(steps) // held * held]
    return case._replace(truth=case.truth + np.outer(jump, [1.0, 0.0]), zs=zs)


def coloured(seed: int, sensors: int, pole: float, steps: int = STEPS) -> Case:
    """Return a point that sensors see whose errors are coloured."""
    g, case = np.random.default_rng(seed + 1), in_a_row(seed, 1, 0.0, 0.0, steps)
    v = lfilter([np.sqrt(1 - pole**2)], [1.0, -pole], g.standard_normal((steps, sensors)), axis=0)
    H = np.tile(case.H, (sensors, 1))
    return case._replace(H=H, R=np.eye(sensors), zs=case.truth[:, :1] + v, v_scale=np.ones((steps, sensors)))


def drawn() -> dict[str, Drawn]:
    """Return every problem by its name."""
    found = {
        name: Drawn(draw, labels=labelled)
        for name, (draw, run) in problems(STEPS).items() if run is alone and name not in LEFT_OUT
    }  # fmt: skip
    found["no outliers, jump of 30"] = Drawn(partial(point, kind="clean", jump=30.0, steps=STEPS), labels=labelled)
    for name, row in rows().items():
        if row.kind == "linear" and row.figure != "steps" and "silent" not in name and "samples, " not in name:
            found.setdefault(name, Drawn(row.draw, row.P, row.Q, row.R))
    for held in (1, 2, 3, 5):
        more = f", readings held for {held}" if held > 1 else ""
        found[f"jumps of 30 each 200{more}"] = Drawn(partial(jumping, size=30.0, every=200, held=held))
    return found | {
        "jumps of 30 each 200, .05": Drawn(partial(jumping, size=30.0, every=200, share=0.05)),
        "jumps of 8 each 100": Drawn(partial(jumping, size=8.0, every=100)),
        "two sensors, colored .9": Drawn(partial(coloured, sensors=2, pole=0.9)),
        "four sensors, colored .98": Drawn(partial(coloured, sensors=4, pole=0.98)),
    }


def error(path: np.ndarray, case: Case) -> float:
    """Return the root mean square error of what is measured, without the first eighth of the recording."""
    path = np.asarray(path).reshape(case.truth.shape)
    return float(np.sqrt((((path - case.truth)[len(path) // 8 :] @ case.H.T) ** 2).mean()))


def plain(x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Case, memory: dict) -> tuple[np.ndarray, np.ndarray]:
    """Return the Kalman filter's correction."""
    return kalman(x, P, z - case.H @ x, case.H, case.R)


def kalman_q(practice: list[Case]) -> Callable[[Case], np.ndarray]:
    """Return the Kalman filter whose Q does best on some recordings."""
    factors = np.geomspace(1e-4, 1e4, 9)
    best = min(factors, key=lambda q: sum(error(filtered(case, plain, q)[0], case) for case in practice))
    return lambda case: filtered(case, plain, best)[0]


def states(problem: Drawn, seeds: range) -> dict[str, float]:
    """Return everybody's error over that of the filter which knows the labels: the geometric mean over recordings."""
    practice = [problem.given(TUNING_SEED)]
    filters: dict[str, Callable[[Case], Any]] = {
        "filterpy": partial(alone, KalmanFilter), "Q tuned": kalman_q(practice),
        "gate": partial(filtered, correct=gate()), "gate, reset": partial(filtered, correct=gate(patience=10)),
    }  # fmt: skip
    for long, short in SHORT.items():
        best = tuned(*PEERS[long])(practice, lambda path, case: error(path, case))
        filters[short] = lambda case, best=best: best(case)[0]
    filters |= {ours: partial(alone, build) for ours, build in OURS.items()}
    ratios = []
    for seed in seeds:
        case, labels = problem.given(seed), error(_path(problem.labels(problem.true(seed))), problem.true(seed))
        ratios.append([error(_path(estimate(case)), case) / labels for estimate in filters.values()])
    return dict(zip(filters, np.exp(np.log(ratios).mean(axis=0)).tolist(), strict=True))


def _path(found: Any) -> np.ndarray:
    """Return the states of what may be states and covariances."""
    return np.asarray(found[0] if isinstance(found, tuple) else found)


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
    """Return how often, and where, ours are above 1.02 of the Kalman filter, or the better is 2 % behind a peer."""
    lost = {f"{name}: above 1.02 of filterpy": 0 for name in OURS}
    lost |= {"the better of ours: 2 % behind the best untuned peer": 0, "2 % behind the best peer, tuned or not": 0}
    lines = []
    for problem, errors in found.items():
        best = min(errors[name] for name in OURS)
        untuned, every = (min((errors[name], name) for name in names) for names in (UNTUNED, set(errors) - set(OURS)))
        here = [errors[name] > 1.02 * errors["filterpy"] for name in OURS]
        here += [best > 1.02 * peer[0] for peer in (untuned, every)]
        lost = {what: count + more for (what, count), more in zip(lost.items(), here, strict=True)}
        if any(here):
            mine = [
                f"**{errors[name]:.2f}**" if bad else f"{errors[name]:.2f}"
                for name, bad in zip(OURS, here[:2], strict=True)
            ]
            theirs = [
                f"{error:.2f} {name}" if bad else ""
                for (error, name), bad in zip((untuned, every), here[2:], strict=True)
            ]
            lines.append(" | ".join([f"| {problem}", f"{errors['filterpy']:.2f}", *mine, *theirs]) + " |")
    counts = "\n".join(f"| {what} | {count} of {len(found)} |" for what, count in lost.items())
    heads = " | ".join(["| problem", "filterpy", *OURS, "best untuned peer, if ahead", "best peer, if ahead"]) + " |"
    return "\n".join(["| | rows |\n|---|---|", counts, "", heads, "|---" * (4 + len(OURS)) + "|", *lines])


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


def _quietly(problem: Drawn, seeds: range) -> dict[str, float]:
    """Return what `states` does, without the warnings of filters that are given wrongly."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return states(problem, seeds)


def stored(args: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Return the errors of every problem: those that are stored, and what is missing or was asked for, measured."""
    made = {"runs": args.runs, "seed": args.seed, "rows": {}}
    if args.store and args.store.exists():
        old = json.loads(args.store.read_text(encoding="utf-8"))
        if (old["runs"], old["seed"]) != (args.runs, args.seed):
            raise SystemExit(f"{args.store}: holds {old['runs']} runs from seed {old['seed']}; name another --store")
        made = old
    every = drawn()
    chosen = [name for name in every if any(part in name for part in args.rows)]
    chosen = chosen or [name for name in every if name not in made["rows"]]
    seeds = range(args.seed, args.seed + args.runs)
    jobs = (delayed(_quietly)(every[name], seeds) for name in chosen)
    for name, errors in zip(chosen, Parallel(n_jobs=args.jobs, return_as="generator")(jobs), strict=True):
        made["rows"][name] = errors
        print(name, {who: round(error, 3) for who, error in errors.items()}, file=sys.stderr, flush=True)
        if args.store:
            args.store.write_text(json.dumps(made, indent=1), encoding="utf-8")
    return {name: made["rows"][name] for name in every if name in made["rows"]}


def page(args: argparse.Namespace) -> str:
    """Return the whole page."""
    seeds = range(args.seed, args.seed + args.runs)
    errors = stored(args)
    costs: dict[Any, Any] = measured(1000, 200, 3)
    return f"""# Side by side

Made by `python tests/benchmarks/side_by_side.py --write-page` on {datetime.date.today()}; no number here is typed.
{versions()}. {args.runs} recordings of each problem, seeds from {args.seed}.

## States through outliers

Root mean square error of what is measured, over that of the Kalman filter which knows the size of every noise; the
least of each row is bold. WoLF, ISKF, ISKF2, STF (a filter of Student's t) and the variational R are written from their
papers (`tests/benchmarks/peers`) and **tuned by the truth, for each row anew**, on another recording, and so is "Q
tuned", the Kalman filter with Q times 1e-4 to 1e4. The gate is at 99.73 %; with "reset" it begins anew after ten
refusals in a row. Daily cycles count all hours, those of the stops too. Ours (`RobustKalmanFilter`, and
`AdaptiveKalmanFilter`), the gates and filterpy are as they come.

{in_rows(errors)}

Where ours are above 1.02 of filterpy (bold), or the better of ours is more than 2 % behind a peer:

{others_win(errors)}

## A model of a recording

Plants of order 2, one reading in ten an outlier, the orders given: how much of a fresh recording a free run explains.

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
    parser.add_argument("--rows", nargs="+", default=[], help="problems of states whose name contains one of these")
    parser.add_argument("--store", type=Path, help="where errors of states stand and are put")
    parser.add_argument("--write-page", action="store_true")
    args = parser.parse_args(argv)
    text = page(args)
    print(text)
    if args.write_page:
        PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
