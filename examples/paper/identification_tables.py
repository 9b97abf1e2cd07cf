"""What many runs of section 4 say, as tables: the lost W, the errors of every tracker, and what W and P0 do."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from identification import (
    BOUNDED,
    INNOVATION,
    KALMAN,
    LITERAL,
    SECTION4,
    STILL,
    TRACKERS,
    WELL,
    Plant,
    Run,
    bounds,
    squared,
    staying,
    trial,
)
from report import Options, geometric_ratio, markdown_table
from studies import Interval, monte_carlo

LATE = slice(500, None)
STAY = "stay at the start"
STUDIED = (KALMAN, LITERAL, BOUNDED, INNOVATION)
READINGS = {"W = 1e-4 I": SECTION4, "W = 1e-6 I": STILL}

#: Studies of one plant by their contamination.
Found = dict[float, Run]


def study(plant: Plant, runs: int, options: Options, trackers: tuple[str, ...] = TRACKERS) -> Run:
    """Run a plant many times; every field gets a first axis of runs."""
    results = monte_carlo(partial(trial, plant=plant, trackers=trackers), runs, options.seed, options.jobs)
    return Run(*(np.array(column) for column in zip(*results, strict=True)))


def errors_of(run: Run, name: str, steps: slice = LATE) -> np.ndarray:
    """Return the mean squared error of a tracker, or of staying at the start, run by run; NaN where it refused."""
    errors = staying(run) if name == STAY else squared(run)[:, TRACKERS.index(name)]
    return errors[:, steps].mean(axis=1)


def ratio_of(run: Run, numerator: str, denominator: str, seed: int, steps: slice = LATE) -> Interval:
    """Return the geometric mean ratio of squared errors over the runs that neither refused."""
    pair = np.array([errors_of(run, name, steps) for name in (numerator, denominator)])
    return geometric_ratio(*pair[:, np.isfinite(pair).all(axis=0)], seed)


def about_w(found: dict[str, Found]) -> str:
    """Say what the two readings of the lost W are, in numbers, and which makes the figures."""
    rows = []
    for reading, plant in READINGS.items():
        run, limits = found[reading][0.1], bounds(found[reading][0.1].information, plant)
        refused = np.mean((np.diff(run.theta, axis=1) == 0).all(axis=2))
        size = np.median(run.y_clean.std(axis=1)) / plant.variance**0.5
        stay = np.sqrt(errors_of(run, STAY).mean())
        rows.append([reading, f"{size:.1f}", f"{refused:.1%}", f"{stay:.2f}", f"{limits.without_prior:.2f}",
                     f"{np.sqrt(limits.bayesian[LATE].mean()):.2f}"])  # fmt: skip
    head = ["reading", "output / ordinary noise", "walk steps refused", "rms error of staying at theta-bar",
            "Cramer-Rao bound", "Bayesian bound"]  # fmt: skip
    return (
        "**The lost W.** The text of section 4 announces the covariance of w(k), and the formula is missing. With "
        "W = 1e-6 I theta hardly moves from where the prior has put it, the output is as small as the noise, and a "
        "recording tells less about theta than the prior does: no filter, not even the one that knows the outliers, "
        "is clearly better than one that never moves. With W = 1e-4 I the walk takes the plant to the border of "
        "stability, where its output is large and tells much. **W = 1e-4 I, with steps to unstable plants refused, is "
        "the reading under which the figures show what the text says of them**: estimates that follow the parameters, "
        "a Kalman filter that does not, and a distance between them that grows with the contamination. It is the main "
        "reading here; the other stands "
        "beside it. (Contamination 0.1, medians over runs; the bounds are those of ||theta_hat - theta|| after 1000 "
        "samples, for a theta that stands still and no prior, and with walk and prior over samples 500-1000.)\n\n"
        + markdown_table(head, rows)
    )


def table(level: float, found: dict[str, Found], well: Run) -> str:
    """Say what every tracker did at one contamination, on the plants of both readings and on the one to learn."""
    studies = [*((reading, runs[level]) for reading, runs in found.items()), (WELL.name, well)]
    rows = []
    for name in (*TRACKERS, STAY):
        row = [name]
        for _, run in studies:
            refused = int(np.isnan(errors_of(run, name)).sum())
            if refused == len(run.y):
                row += ["refused: P indefinite", ""]
                continue
            over = np.exp(np.nanmean(np.log(errors_of(run, name) / errors_of(run, STAY))))
            lost = 0 if name == STAY else int(run.lost[:, TRACKERS.index(name)].sum())
            note = f" ({refused} refused)" if refused else f" ({lost} lost)" if lost else ""
            fit = "" if name == STAY else f"{np.nanmedian(run.output_fit[:, TRACKERS.index(name)]):.1f} %"
            row += [f"{over:.3g}{note}", fit]
        rows.append(row)
    head = ["tracker", *(cell for name, _ in studies for cell in (f"{name}: error over staying", "fit"))]
    return (
        f"**Contamination {level:g}**, {len(well.y)} runs, samples 500-1000: squared error of theta over that of an "
        "estimate that stays at its start (geometric mean; below 1, something is learnt), and the median fit of the "
        f"one-step prediction to the noise-free output. Lost: runs in which the tracker says that it is."
        f"\n\n{markdown_table(head, rows)}"
    )


def sensitivity(options: Options) -> str:
    """Show what W and P0, lost or open in the text, do."""
    rows, runs = [], max(2, options.runs // 4)
    for Q in (1e-6, 1e-5, 1e-4):
        for P0 in (0.01, 0.1, 1.0):
            run = study(replace(SECTION4, Q=Q, P0=P0), runs, options, STUDIED)
            error, stay = np.sqrt(squared(run)[:, :, LATE].mean(axis=2)), np.sqrt(errors_of(run, STAY))
            cells = []
            for i in range(len(STUDIED)):
                refused = int(np.isnan(error[:, i]).sum())
                value = "-" if refused == runs else f"{np.nanmedian(error[:, i]):.3f}"
                cells.append(value + (f" ({refused} of {runs} refused)" if refused else ""))
            rows.append([f"{Q:g}", f"{P0:g}", *cells, f"{np.median(stay):.3f}"])
    return (
        f"**Sensitivity to W and P0**, section 4, contamination 0.1, {runs} runs, median ||theta_hat - theta|| over "
        "samples 500-1000. P0 is the prior of theta(0) as well as P(0). Where the literal form is refused (P would "
        "turn indefinite), the bounded and the T(k) form stand beside it.\n\n"
        + markdown_table(["W / I", "P0 / I", *STUDIED, STAY], rows)
    )
