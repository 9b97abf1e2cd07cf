"""The study: many seeds, each with other noise, reference and physics; what the loops do, how the models fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from servo.experiment import LOOPS, NONE, ROBUST, conditions, drive, motion
from servo.models import (
    EVERY,
    TRACKERS,
    Model,
    Signals,
    fit,
    frozen_gain,
    ordinary_variance,
    reference_to_position,
    tracked,
    valve_to_velocity,
)
from studies import Interval, bootstrap_interval

#: Shares of the recording at which the model's gain is compared with that of the frozen physics.
INSTANTS = (0.4, 0.7, 1.0)
OPEN, CLOSED = "valve to velocity", "reference to position"


class Run(NamedTuple):
    """What one seed gave."""

    motion: np.ndarray  # (loops, 3), see Motion
    fits: np.ndarray  # (1 or 2, trackers), percent: valve to velocity, reference to position
    gain: np.ndarray  # (instants, 3): frozen physics, robust model, its standard deviation
    drift: float  # variance of a step of theta that the data chose for the robust model


def models_of(data: Signals, names: Sequence[str] = TRACKERS) -> dict[str, Model]:
    """Identify the same recording in every way that is named."""
    variance = ordinary_variance(data)
    return {name: tracked(data, name, variance) for name in names}


def at(share: float, steps: int) -> int:
    """Return the last sample of the piece that ends at a share of the recording."""
    return max(round(share * steps) // EVERY, 1) * EVERY - 1


def trial(
    rng: np.random.Generator,
    steps: int,
    contamination: float,
    encoder_outliers: float,
    loops: Sequence[str] = LOOPS,
    trackers: Sequence[str] = TRACKERS,
    closed: bool = True,
    gains: bool = True,
) -> Run:
    """Drive the servo on every filter's estimate, and identify it from the recording of the robust loop.

    Its gain is compared with the physics' where `gains` asks for it: a fit of the frozen physics for each instant.
    """
    given = conditions(steps, contamination, rng, encoder_outliers)
    recordings = {loop: drive(given, loop) for loop in loops}
    moved = [motion(recordings[loop], recordings[NONE]) for loop in loops]
    fits, gain, drift = [], [], 0.0
    for signals in (valve_to_velocity, reference_to_position) if closed else (valve_to_velocity,):
        data = signals(recordings[ROBUST], given)
        models = models_of(data, trackers)
        fits.append([fit(data, model) for model in models.values()])
        if signals is valve_to_velocity:
            robust = models[ROBUST]
            drift = robust.drift
            for k in (at(share, steps) for share in INSTANTS if gains):
                row = (k + 1) // EVERY - 1
                gain.append([frozen_gain(given, k), robust.gain[row], robust.gain_std[row]])
    return Run(np.array(moved), np.array(fits), np.array(gain), drift)


def mean_of(values: np.ndarray, seed: int) -> Interval:
    """Return the mean over seeds with its 95 percent interval."""
    return bootstrap_interval(values, seed=seed, resamples=1999, method="percentile")


def shown(interval: Interval, digits: int) -> str:
    """Write an interval as 'mean (low .. high)'."""
    return f"{interval.estimate:.{digits}f} ({interval.low:.{digits}f} .. {interval.high:.{digits}f})"


def table(runs: list[Run], seed: int) -> str:
    """Say what the loops did and how the models fit."""
    moved, fits = np.array([run.motion for run in runs]), np.array([run.fits for run in runs])
    head = f"{'the loop runs on':26}{'piston moved by outliers / mm':>32}{'worst / mm':>24}{'spool strokes / s':>26}"
    lines = [f"{len(runs)} seeds: mean (95 % interval)", head]
    for i, loop in enumerate(LOOPS):
        cells = (shown(mean_of(moved[:, i, j], seed), digits) for j, digits in enumerate((3, 2, 3)))
        lines.append("{:26}{:>32}{:>24}{:>26}".format(loop, *cells))
    lines.append(f"{'the model is':26}{OPEN + ', fit / %':>32}{'over constant':>24}{CLOSED + ', fit / %':>34}")
    for i, name in enumerate(TRACKERS):
        gained = shown(mean_of(fits[:, 0, i] - fits[:, 0, 0], seed), 1) if i else "-"
        one, other = (shown(mean_of(fits[:, j, i], seed), 1) for j in (0, 1))
        lines.append(f"{name:26}{one:>32}{gained:>24}{other:>34}")
    physics, model, std = np.moveaxis(np.array([run.gain for run in runs]), -1, 0)
    lines.append(
        "gain from opening to velocity / (cm/s per %): physics, robust model, half of its 95 % band, seeds it holds"
    )
    for i, share in enumerate(INSTANTS):
        half, found = 1.96 * std[:, i], shown(mean_of(model[:, i], seed), 2)
        held = np.mean(np.abs(model[:, i] - physics[:, i]) < half)
        lines.append(
            f"  at {share:4.0%} of the recording {physics[:, i].mean():12.2f}{found:>26}{half.mean():12.2f}{held:12.0%}"
        )
    return "\n".join(lines)
