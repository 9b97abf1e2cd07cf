"""The subject of a tracker's checks: a factory ``make(structure)``, and what is done with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.structures import Structure
from robust_filterpy.testing.checks import Subject
from robust_filterpy.testing.plant_scenarios import Plant, PlantScenario
from robust_filterpy.testing.scenarios import draw
from robust_filterpy.testing.tracker_runs import TrackerRun, parameters, run_tracker

#: What a tracker can claim; `check_tracker` tests all of it that is not in not_claimed.
TRACKER_TAGS = {
    "exact": "it is recursive least squares to rounding (never tested of a tracker that claims to be robust)",
    "robust": "one wrong output moves the parameters by a bounded amount",
    "drift": "told Q, it follows parameters that move",
    "missing": "NaN in y is a missing output",
    "intervals": "P is the covariance of the parameters' errors",
    "several inputs": "structures of several inputs",
    "output error": "output-error models, which noise does not bias",
    "armax": "models of the noise",
    "stable": "output-error models stay stable",
    "validates": "bad input raises, and a refused call changes nothing",
    "pickle": "it can be pickled",
}


@dataclass(frozen=True)
class TrackerSubject(Subject):
    """Make trackers and run them."""

    @property
    def is_exact(self) -> bool:
        """Whether the tracker claims to be recursive least squares."""
        return "exact" in self.claims

    def made(self, structure: Structure) -> Any:
        """Make a tracker, or say what make returned."""
        if not callable(self.make):
            raise TypeError(f"make: expected a class or a function of a structure, got {_checks.shown(self.make)}")
        tracker = self.make(structure)
        for name in ("theta", "update"):
            if isinstance(tracker, type) or not hasattr(tracker, name):
                raise TypeError(
                    f"make: expected a function of a structure that returns a tracker with theta and update(y, u), got "
                    f"{_checks.shown(tracker)} without {name}"
                )
        try:
            parameters(tracker, structure.n_theta)
        except ValueError as error:
            raise ValueError(f"make: {structure}: {error}") from None
        return tracker

    def draw(self, plant: str | Plant, samples: int = 200, **options: Any) -> PlantScenario:
        """Draw a recording."""
        scenario: PlantScenario = draw(plant, samples, rng=self.rng, **options)
        return scenario

    def clean(self, plant: str | Plant, samples: int = 200) -> PlantScenario:
        """Draw a recording without noise."""
        scenario = self.draw(plant, samples)
        return replace(scenario, y=scenario.y_clean)

    def new(self, scenario: PlantScenario) -> Any:
        """Make a tracker for a scenario and tell it R and Q."""
        return scenario.load(self.made(scenario.structure))

    def run(self, scenario: PlantScenario) -> TrackerRun:
        """Run a new tracker over a scenario."""
        return run_tracker(self.new(scenario), scenario)


def theta_of(tracker: Any) -> Array:
    """Return the parameters as a copy, shape (n,)."""
    return np.array(tracker.theta, dtype=float).ravel()


def advance(tracker: Any, scenario: PlantScenario, start: int = 0, stop: int | None = None) -> Any:
    """Update along a part of a recording and return the tracker."""
    for k in range(start, len(scenario.y) if stop is None else stop):
        tracker.update(float(scenario.y[k]), scenario.u[k])
    return tracker
