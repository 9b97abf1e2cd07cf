"""Can a pneumatic servo be run, and its physics be followed, on sensors that lie?

Question. A nonlinear servo (air springs, leakage, a valve with a dead band, friction) runs in a position loop while
supply, temperature, discharge coefficient and load change. One reading in ten of its encoder and of its pressure
sensors is an outlier, and the controller knows the motion from these sensors alone. What do the outliers do to the
piston when the loop runs on a Kalman filter's estimate, and what on a robust one's? And does a model from valve to
velocity, tracked from the recording, have the gain that the physics have at the moment?

One equation (paper Table 1)::

    theta+ = theta + P phi T psi(T (y - phi' theta))

Run ``python examples/pneumatic_servo.py`` (a minute or two). It draws one experiment, writes its recording as CSV
and MAT for other tools, and repeats it with ``--seeds`` other references, physics and noises: the conclusion speaks of
all of them. The loop from reference to position is identified beside it: feedback hides the physics there, as it is
meant to, and a constant model fits nearly as well as a tracked one.
"""

# %%
from __future__ import annotations

import argparse
import os
import sys
import textwrap
from functools import partial
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from servo.experiment import NOMINAL, NONE, OUTLIERS, ROBUST, conditions, drive
from servo.figures import FREQUENCIES, Response, decibel, draw_bode, draw_gain, draw_recording, responses
from servo.models import TRACKERS, valve_to_velocity
from servo.study import INSTANTS, LOOPS, Run, at, mean_of, models_of, shown, table, trial

from robust_filterpy.experiments import monte_carlo
from robust_filterpy.plants.servo import ServoRecording


# %% One experiment
def one_experiment(seed: int, steps: int, contamination: float, out: Path) -> None:
    """Drive the servo, identify it, draw and write what was found."""
    given = conditions(steps, contamination, np.random.default_rng(seed))
    recordings = {loop: drive(given, loop) for loop in (NONE, NOMINAL, ROBUST)}
    recording = recordings[ROBUST]
    data = valve_to_velocity(recording, given)
    models = models_of(data)
    draw_recording(given, recordings, out / "servo_recording.png")
    draw_gain(given, recording, models, out / "servo_gain.png")
    found = responses(recording, models[ROBUST])
    draw_bode(recording, found, out / "servo_bode.png")
    recording.to_csv(out / "servo_recording.csv")
    recording.to_mat(out / "servo_recording.mat")
    for name in ("servo_recording.png", "servo_gain.png", "servo_bode.png"):
        print(f"Figure: {out.resolve() / name}")
    for name in ("servo_recording.csv", "servo_recording.mat"):
        print(f"Data: {out.resolve() / name}", flush=True)
    print(bode_table(recording, found))


def bode_table(recording: ServoRecording, found: list[Response]) -> str:
    """Say where model and linearized physics differ, and why (``servo_study.py --causes`` takes the causes apart)."""
    lines = ["Robust model less linearized servo in mid-stroke, dB (its 95 % band)"]
    for share, response in zip(INSTANTS, found, strict=True):
        middle, cells = decibel(response.linearized[1]), []
        for frequency in (0.5, 5.0, FREQUENCIES[np.argmax(middle)], 25.0):
            i = int(np.argmin(np.abs(FREQUENCIES - frequency)))
            apart, (low, high) = decibel(response.model[i]) - middle[i], response.gain[:, i] - middle[i]
            cells.append(f"{frequency:.3g} Hz {apart:+.1f} ({low:+.1f} .. {high:+.1f})")
        lines.append(f"  t = {recording.t[at(share, recording.t.size)]:4.1f} s: " + ", ".join(cells))
    reason = (
        "Up to 5 Hz dry friction takes about half a dB: at each reversal it holds the piston until the pressures have "
        "turned. At the resonance the model is a blur: the piston crosses the stroke, and the resonance moves with it, "
        "from 12 Hz to the 15 Hz of the grey curves; without dry friction most of the difference is left at this "
        "amplitude, and next to nothing at a tenth of it. Above, the reference, held for 0.2 s, has little power, and "
        "the structure decides."
    )
    return "\n".join([*lines, textwrap.fill(reason, 118, initial_indent="  ", subsequent_indent="  ")])


# %% Many
def conclusion(runs: list[Run], seed: int) -> str:
    """Say what all the seeds say together."""
    moved, fits = np.array([run.motion for run in runs])[..., 0], np.array([run.fits for run in runs])
    kalman, robust = (mean_of(moved[:, LOOPS.index(name)], seed) for name in (NOMINAL, ROBUST))
    verdict = "the intervals do not overlap" if robust.high < kalman.low else "the intervals overlap"
    over = {
        name: mean_of(fits[:, 0, TRACKERS.index(ROBUST)] - fits[:, 0, TRACKERS.index(name)], seed)
        for name in ("constant", NOMINAL)
    }
    closed = mean_of(fits[:, 1, TRACKERS.index(ROBUST)] - fits[:, 1, 0], seed)
    gain = np.array([run.gain for run in runs])
    apart = np.mean(np.abs(gain[..., 1] / gain[..., 0] - 1))
    return textwrap.fill(
        f"Conclusion, of {len(runs)} seeds: the outliers move the piston by {shown(kalman, 2)} mm with the loop on the "
        f"Kalman filter, by {shown(robust, 2)} mm on the robust one ({verdict}). From valve to velocity the robust "
        f"tracked model fits {shown(over['constant'], 1)} points better than one constant model, "
        f"{shown(over[NOMINAL], 1)} better than the Kalman filter's; its gain is within {apart:.1%} of the physics' on "
        f"average, while that doubles. From reference to position a tracked model gains {shown(closed, 1)} points on a "
        "constant one: the loop hides the physics.",
        width=118,
    )


# %%
def main(argv: list[str] | None = None) -> list[Run]:
    """Draw one experiment, repeat it with as many seeds as asked for, and return what they gave."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=4, help="how many to conclude from, >= 2 (default %(default)s)")
    parser.add_argument("--steps", type=int, default=3000, help="samples of 10 ms, at least 300 (default %(default)s)")
    parser.add_argument("--contamination", type=float, default=0.1)
    parser.add_argument("--jobs", type=int, default=-1, help="processes, -1 for one per processor (the default)")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "output", help="folder of the figures")
    args = parser.parse_args(argv)
    if args.steps < 300 or args.seeds < 2:
        parser.error("--steps must be at least 300, --seeds at least 2")
    args.out.mkdir(parents=True, exist_ok=True)
    # This folder, for processes that joblib starts.
    here = str(Path(__file__).resolve().parent)
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (here, os.environ.get("PYTHONPATH"))))
    print(f"One experiment of {args.steps} samples, driven three times and identified ...", file=sys.stderr, flush=True)
    one_experiment(args.seed, args.steps, args.contamination, args.out)
    print(f"{args.seeds} more, with other references, physics and noises ...", file=sys.stderr, flush=True)
    one = partial(trial, steps=args.steps, contamination=args.contamination, encoder_outliers=OUTLIERS[0])
    runs = monte_carlo(one, args.seeds, args.seed, args.jobs).results
    print(table(runs, args.seed))
    print(conclusion(runs, args.seed))
    return runs


if __name__ == "__main__":
    main([] if "ipykernel" in sys.modules else None)
