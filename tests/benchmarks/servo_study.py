"""The pneumatic servo on sensors that lie: what each filter makes of the loop, and how well each model fits.

    python tests/benchmarks/servo_study.py --seeds 40 [--first 0] [--outliers 5 2] [--jobs 1] [--causes]

prints, for each size of the encoder's outliers in mm, what the outliers do to the piston and to the valve with the loop
on each filter, the free-run fits of constant, Kalman, robust and label-knowing models in open loop (valve to velocity)
and closed loop (reference to position), all with 95 % intervals, and the targets. ``--causes`` prints what separates
a model of the frozen physics from their linearization.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))

from servo.experiment import DT, LOOPS, NOMINAL, ROBUST, SERVO, TOTAL, conditions
from servo.figures import decibel, linearized, model_response
from servo.models import TRACKERS, frozen
from servo.study import Run, at, mean_of, shown, table, trial
from studies import monte_carlo


def targets(runs: list[Run], seed: int) -> str:
    """Say whether the robust filter beats both Kalman filters by intervals that do not overlap."""
    moved, fits = np.array([run.motion for run in runs]), np.array([run.fits for run in runs])[:, 0]
    lines = []

    def line(what: str, robust: np.ndarray, other_one: np.ndarray, digits: int, less: bool) -> None:
        one, other = mean_of(robust, seed), mean_of(other_one, seed)
        better = one.high < other.low if less else one.low > other.high
        verdict = "robust better" if better else "ROBUST NOT BETTER"
        lines.append(f"  {what:62}{shown(one, digits):>26}{shown(other, digits):>26}  {verdict}")

    for name in (NOMINAL, TOTAL):
        for j, what in ((0, "piston moved by outliers / mm"), (2, "spool strokes / s")):
            pair = (moved[:, LOOPS.index(loop), j] for loop in (ROBUST, name))
            line(f"{what}: robust, {name}", *pair, 3, less=True)
        pair = (fits[:, TRACKERS.index(model)] for model in (ROBUST, name))
        line(f"valve to velocity, fit / %: robust, {name}", *pair, 1, less=False)
    line("valve to velocity, fit / %: robust, constant", fits[:, TRACKERS.index(ROBUST)], fits[:, 0], 1, less=False)
    return "\n".join(["Robust against the others, by intervals that do not overlap:", *lines])


def causes(seed: int, steps: int) -> str:
    """Compare the best linear model of frozen physics with their linearization, without what may separate them."""
    given = conditions(steps, 0.1, np.random.default_rng(seed))
    k = at(0.4, steps)
    physics = {name: given.physics[name][k] for name in ("load", "alpha", "beta")}
    z = np.exp(2j * np.pi * np.array([0.5, 5.0, 12.0, 25.0]) * DT)
    sliding = replace(SERVO, coulomb_friction=0.0, static_friction=0.0)
    lines = ["Best linear model of the frozen physics less their linearization, dB at 0.5, 5, 12, 25 Hz:"]
    for what, servo, amplitude in (
        ("as it is", SERVO, 1.0),
        ("without leakage", replace(SERVO, leakage_area=0.0), 1.0),
        ("without dead band", replace(SERVO, dead_band=0.0), 1.0),
        ("without dry friction", sliding, 1.0),
        ("without dry friction, amplitude x 0.3", sliding, 0.3),
        ("without dry friction, amplitude x 0.1", sliding, 0.1),
    ):
        model = model_response(frozen(given, k, servo, amplitude), z)
        apart = decibel(model) - decibel(linearized(servo, 0.0, 0.12 * amplitude, z, **physics))
        lines.append(f"  {what:40}" + " ".join(f"{value:+6.1f}" for value in apart))
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> None:
    """Print the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=40, help="at least 2 (default %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="root of the seeds (default %(default)s)")
    parser.add_argument("--outliers", type=float, nargs="+", default=[5.0], help="of the encoder, mm (default 5)")
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--contamination", type=float, default=0.1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--causes", action="store_true", help="only print what separates model and linearization")
    args = parser.parse_args(argv)
    if args.causes:
        print(causes(args.first, args.steps))
        return
    # For processes that joblib starts.
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (sys.path[0], os.environ.get("PYTHONPATH"))))
    for size in args.outliers:
        one = partial(trial, steps=args.steps, contamination=args.contamination, encoder_outliers=1e-3 * size)
        runs = monte_carlo(one, args.seeds, args.first, args.jobs)
        print(f"Encoder outliers of {size:g} mm, contamination {args.contamination:g}; {table(runs, args.first)}")
        print(targets(runs, args.first), flush=True)


if __name__ == "__main__":
    main()
