"""Can a pneumatic servo be run, and identified while it drifts, on sensors that lie?

Question. A nonlinear servo (air springs, leakage, a valve with a dead band, friction) runs in a position loop while
supply, temperature, discharge coefficient and load change. One reading in ten of its encoder and of its pressure
sensors is an outlier, and the controller knows the motion from these sensors alone. What do the outliers do to the
piston when the loop runs on a Kalman filter's estimate, and what on a robust one's? What model do six seconds of such a
recording give? And does a model that is tracked, sample by sample, have the gain that the physics have at the moment?

One equation (paper Table 1)::

    theta+ = theta + P phi T psi(T (y - phi' theta))

``python examples/pneumatic_servo.py`` draws one experiment, writes its recording as CSV and MAT for other tools, and
repeats it with ``--seeds`` other references, physics and noises. ``--details`` adds other filters and the loop from
reference to position, where feedback hides the physics: there no tracked model is reliably better than another.
``python tests/benchmarks/servo_study.py --causes`` says how far such models are from the linearized physics, and why.
"""

# %%
from __future__ import annotations

import argparse
import sys
import time
import warnings
from functools import partial
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from servo.experiment import DT, LOOPS, NOMINAL, NONE, OUTLIERS, ROBUST, TOTAL, Conditions, conditions, drive
from servo.figures import LEAST_SQUARES, ROBUST_FIT, TRUTH_FIT, Identified, draw_gain, draw_model, draw_recording
from servo.models import CONSTANT, ORDER, TRACKERS, Model, Signals, best_constant, ordinary_variance, tracked
from servo.models import valve_to_velocity as signals_of
from servo.study import Run, table, trial

from robust_filterpy import Huber
from robust_filterpy.identification import OutputError, identify
from robust_filterpy.influence import Linear
from robust_filterpy.testing import fit_percent

#: What is run for the conclusion alone.
FEW: dict = dict(loops=(NONE, NOMINAL, TOTAL, ROBUST), trackers=(NOMINAL, ROBUST), closed=False, gains=False)
#: Seconds that a model is fitted to.
STRETCH = 6.0


class Progress:
    """Say what is being done, at which stage of how many, and how long it has taken so far."""

    def __init__(self, stages: int) -> None:
        self.stages, self.done, self.begun = stages, 0, time.monotonic()

    def __call__(self, what: str) -> None:
        self.done += 1
        line = f"[{self.done}/{self.stages}, {time.monotonic() - self.begun:3.0f} s] {what}"
        print(line, file=sys.stderr, flush=True)


# %% One experiment
def models_of_a_stretch(data: Signals, say: Progress) -> dict[str, Identified]:
    """Fit an output-error model to six seconds: to the true velocity, and to the readings in two ways."""
    begin = data.y.size // 2
    part = slice(begin, min(begin + round(STRETCH / DT), data.y.size))
    fitted = {}
    for name, y, influence in (
        (TRUTH_FIT, data.truth, Huber()),
        (ROBUST_FIT, data.y, Huber()),
        (LEAST_SQUARES, data.y, Linear()),
    ):
        say(f"a model of {STRETCH:.0f} s of the recording: {name}")
        with warnings.catch_warnings():
            # The servo is no constant linear model, which `identify` says: the tracked model is for that.
            warnings.filterwarnings("ignore", "identify: ", UserWarning)
            structure = OutputError(ORDER, ORDER)
            model = identify(y[part], data.u[part], structure, influence=influence, progress=False)
        run = np.asarray(model.simulate(data.u[part]))
        fitted[name] = Identified(model, float(fit_percent(data.truth[part], run)))
    return fitted


def one_experiment(given: Conditions, out: Path, say: Progress) -> dict[str, Identified]:
    """Drive the servo, identify it, draw and write what came out."""
    recordings = {}
    for loop in (NONE, NOMINAL, ROBUST):
        say(f"the servo runs in its loop: {loop}")
        recordings[loop] = drive(given, loop)
    recording = recordings[ROBUST]
    draw_recording(given, recordings, out / "servo_recording.png")
    table, names = np.column_stack(recording), ",".join(recording._fields)
    np.savetxt(out / "servo_recording.csv", table, fmt="%.17g", delimiter=",", header=names, comments="")
    data = signals_of(recording, given)
    models = models_of_a_stretch(data, say)
    draw_model(models, out / "servo_model.png")
    say("a model is tracked sample by sample, and compared with the physics of four moments")
    by_name: dict[str, Model] = {CONSTANT: constant(data), ROBUST: tracked(data, ROBUST, ordinary_variance(data))}
    draw_gain(given, recording, by_name, out / "servo_gain.png", say)
    return models


def constant(data: Signals) -> Model:
    """Fit one model to the whole recording."""
    none = np.array([])
    return Model(np.tile(best_constant(data), (data.y.size, 1)), none, none, none, 0.0)


# %% Many
def over_seeds(values: np.ndarray, digits: int) -> str:
    """Write 'mean (least .. most)': of a handful of seeds no interval can be had."""
    return f"{values.mean():.{digits}f} ({values.min():.{digits}f} .. {values.max():.{digits}f})"


def conclusion(runs: list[Run], names: dict, models: dict[str, Identified], out: Path) -> str:
    """Say what the experiment and the seeds say, each sentence below its figure."""
    moved, fits = (np.array([getattr(run, name) for run in runs]) for name in ("motion", "fits"))
    piston = {name: over_seeds(moved[:, i, 0], 2) for i, name in enumerate(names["loops"])}
    fit = {name: over_seeds(fits[:, 0, i], 1) for i, name in enumerate(names["trackers"])}
    place = names["loops"].index
    ratio = float(np.mean(moved[:, place(NOMINAL), 0] / moved[:, place(ROBUST), 0]))
    sentences = {
        "servo_recording.png": f"Of {len(runs)} seeds, mean (least .. most): outliers move the piston by "
        f"{piston[NOMINAL]} mm on the Kalman filter, {piston[TOTAL]} mm if R counts the outliers in, "
        f"{piston[ROBUST]} mm on the robust one.",
        "servo_model.png": f"Six seconds of the recording, fit to the true velocity: {models[ROBUST_FIT].fit:.0f} % by "
        f"the robust model, {models[LEAST_SQUARES].fit:.0f} % by least squares, {models[TRUTH_FIT].fit:.0f} % by a "
        "model of the same seconds without any error of the sensor: what no linear model of this order explains.",
        "servo_gain.png": "The whole recording, while the physics drift: a model that Kalman tracks fits by "
        f"{fit[NOMINAL]} %, the robust one by {fit[ROBUST]} %.",
    }
    lines = [f"Figure: {out.resolve() / name}\n{text}" for name, text in sentences.items()]
    ahead = moved[:, place(ROBUST), 0] < moved[:, place(NOMINAL), 0]
    lines.append(
        f"Conclusion: outliers move the piston {ratio:.1f} times less on the robust filter than on the Kalman filter "
        f"(less in {ahead.sum()} of {len(runs)} seeds), and a model of six seconds fits as if the sensor made no error."
    )
    return "\n".join(lines)


# %%
def main(argv: list[str] | None = None) -> list[Run]:
    """Draw one experiment, repeat it with as many seeds as asked for, and return what they gave."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=4, help="how many to conclude from, >= 2 (default %(default)s)")
    parser.add_argument("--steps", type=int, default=3000, help="samples of 10 ms, at least 300 (default %(default)s)")
    parser.add_argument("--contamination", type=float, default=0.1)
    parser.add_argument("--details", action="store_true", help="every filter, both ways to identify, tables")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    args = parser.parse_args(argv)
    if args.steps < 300 or args.seeds < 2:
        parser.error("--steps must be at least 300, --seeds at least 2")
    args.out.mkdir(parents=True, exist_ok=True)
    say = Progress(11 + args.seeds)
    given = conditions(args.steps, args.contamination, np.random.default_rng(args.seed))
    models = one_experiment(given, args.out, say)
    names = dict(loops=LOOPS, trackers=TRACKERS, closed=True) if args.details else FEW
    one = partial(trial, steps=args.steps, contamination=args.contamination, encoder_outliers=OUTLIERS[0], **names)
    runs = []
    for rng in np.random.default_rng(args.seed).spawn(args.seeds):
        say("the same with another reference, other physics and noise")
        runs.append(one(rng))
    if args.details:
        print(table(runs, args.seed))
    print(conclusion(runs, names, models, args.out))
    return runs


if __name__ == "__main__":
    main([] if "ipykernel" in sys.modules else None)
