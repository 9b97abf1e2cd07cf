"""How much faster the two studies are than with a Python loop over the samples: the same runs in one process."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import identification
import numpy as np
import state_estimation
from state_estimation_study import filtered, looped, study
from studies import monte_carlo

TARGET = 20


class Comparison(NamedTuple):
    """What a study gains; ratios of durations, with a loop over without."""

    name: str
    filtering: float
    whole: float
    difference: float  # largest difference of two estimates


class Clocked:
    """A function that adds up the processor time spent in it, which other work on the machine leaves alone."""

    def __init__(self, function: Callable[..., Any]) -> None:
        """Start at zero."""
        self.function, self.seconds = function, 0.0

    def __call__(self, *args: Any) -> Any:
        """Pass the call on."""
        start = time.process_time()
        try:
            return self.function(*args)
        finally:
            self.seconds += time.process_time() - start


def compared(name: str, run: Callable[[Callable[..., Any]], np.ndarray], fast: Any, slow: Any) -> Comparison:
    """Do a study in both ways and raise RuntimeError unless they agree; run(filtering) returns its estimates."""
    _timed(run, fast)  # loads the compiled loops, which is no part of the study
    (estimates, whole, filtering), (expected, loop_whole, loop_filtering) = (_best(run, way) for way in (fast, slow))
    if not np.allclose(estimates, expected, rtol=1e-9, atol=1e-9, equal_nan=True):
        raise RuntimeError(f"{name}: the numbers differ from those of a loop over the samples")
    difference = float(np.nanmax(np.abs(estimates - expected)))
    return Comparison(name, loop_filtering / filtering, loop_whole / whole, difference)


def _best(run: Callable[[Callable[..., Any]], np.ndarray], filtering: Any) -> tuple[np.ndarray, float, float]:
    """Return what `_timed` does, the durations the shorter ones of two rounds."""
    (estimates, *first), (_, *second) = _timed(run, filtering), _timed(run, filtering)
    return estimates, *map(min, first, second)


def _timed(run: Callable[[Callable[..., Any]], np.ndarray], filtering: Any) -> tuple[np.ndarray, float, float]:
    """Return estimates, duration of the study, duration of its filters."""
    inner, outer = Clocked(filtering), Clocked(run)
    return outer(inner), outer.seconds, inner.seconds


def comparisons(runs: int, seed: int) -> list[Comparison]:
    """Compare both studies on one thread."""

    def states(filtering: Callable[..., Any]) -> np.ndarray:
        settings = (state_estimation.USUAL, state_estimation.UNCERTAIN)
        return np.array([study(setting, runs, state_estimation.STEPS, seed, filtering) for setting in settings])

    def parameters(plant: identification.Plant, tracking: Callable[..., Any]) -> np.ndarray:
        one = partial(identification.trial, plant=plant, tracking=tracking)
        return np.array([run.estimates for run in monte_carlo(one, runs, seed)])

    found = [compared("state estimation (31)-(34)", states, partial(filtered, threads=1), looped)]
    for plant in (identification.SECTION4, identification.WELL):
        name = f"identification, {plant.name} plant"
        found.append(compared(name, partial(parameters, plant), identification.tracked, identification.looped))
    return found


def report(runs: int, seed: int) -> str:
    """Say how much faster the studies are."""
    lines = [f"Duration with a loop over the samples, in that of the study as it is; {runs} runs, one thread:"]
    for c in comparisons(runs, seed):
        verdict = "met" if c.whole >= TARGET else "MISSED"
        lines.append(
            f"  {c.name:40} filters {c.filtering:6.1f}   whole study {c.whole:6.1f} ({TARGET} {verdict})   "
            f"numbers agree to {c.difference:.0e}"
        )
    return "\n".join(lines)
