"""The subject of a tracker's checks: a factory ``make(structure)``, and what is done with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification import ARX
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.testing.assertions.tracking import assert_tracks
from robust_filterpy.testing.checks.bench import Corrected, Subject, not_applicable
from robust_filterpy.testing.scenarios.contamination import Kinds
from robust_filterpy.testing.scenarios.drawing import draw
from robust_filterpy.testing.scenarios.plants import Plant, PlantScenario
from robust_filterpy.testing.scenarios.runs import TrackerRun, parameters, run_tracker

#: What a tracker can claim; `check_tracker` tests all of it that is not in not_claimed.
TRACKER_TAGS = {
    "exact": "it is recursive least squares to rounding (never tested of a tracker that claims to be robust)",
    "robust": "one wrong output moves the parameters by a bounded amount",
    "drift": "given Q, it follows parameters that move",
    "linear": "innovations within their noise move the parameters by the Kalman gain",
    "recovers": "what psi cuts off makes nothing certain",
    "missing": "NaN in y is a missing output",
    "intervals": "P is the covariance of the parameters' errors",
    "several inputs": "structures of several inputs",
    "output error": "output-error models, which noise does not bias",
    "armax": "models of the noise",
    "stable": "output-error models stay stable",
    "validates": "bad input raises, and a refused call changes nothing",
    "pickle": "it can be pickled",
}


#: y and u of samples that cannot be right.
BAD_SAMPLES: dict[str, tuple[Any, Any]] = {
    "an infinite y": (np.inf, 1.0),
    "text for y": ("high", 1.0),
    "two outputs": ([1.0, 2.0], 1.0),
    "a missing u": (1.0, np.nan),
    "an infinite u": (1.0, np.inf),
    "two inputs": (1.0, [1.0, 2.0]),
}


@dataclass(frozen=True)
class TrackerSubject(Subject):
    """Make trackers and run them."""

    shown: ClassVar[tuple[str, ...]] = ("theta", "P")

    def made(self, structure: Structure) -> Any:
        """Make a tracker, or say what make returned."""
        returned = "a tracker with theta and update(y, u)"
        tracker = self.make_one("a structure", ("theta", "update"), returned, structure)
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

    def try_out(self) -> None:
        """Make a tracker, or say what make returned."""
        self.made(ARX(2, 2))

    def work(self) -> tuple[Callable[[], Any], Sequence[Callable[[Any], Any]]]:
        """Return what makes trackers, and samples; inputs of +-1 would hide a memory that is shared."""
        scenario = self.draw("armax" if "armax" in self.claims else "arx", 60)
        scenario = replace(scenario, u=self.rng.standard_normal(60))
        steps = [partial(_update, float(y), u) for y, u in zip(scenario.y, scenario.u, strict=True)]
        return lambda: self.new(scenario), steps

    def bad_calls(self) -> Mapping[str, Callable[[Any], Any]]:
        """Return samples that cannot be right."""
        return {words: partial(_update, y, u) for words, (y, u) in BAD_SAMPLES.items()}

    def covariances(self) -> list[Array]:
        """Return P while the input says nothing new."""
        scenario = self.draw("arx", 400)
        scenario = replace(scenario, u=np.ones(400), y=scenario.y - scenario.y_clean)
        tracker = self.showing_P(scenario)
        return [np.array(advance(tracker, scenario, k, k + 1).P, dtype=float) for k in range(400)]

    def showing_P(self, scenario: PlantScenario) -> Any:
        """Make a tracker for a scenario, or skip the check if it shows no P."""
        tracker = self.new(scenario)
        if not hasattr(tracker, "P"):
            raise not_applicable("shows no P")
        return tracker

    def corrected(self, e: float, age: int = 0, R_ratio: float = 1.0) -> Corrected:
        """Correct by e deviations of the output of a finite impulse response."""
        k = max(age, 1)
        scenario = self.draw("fir", k + 1)
        scenario = replace(scenario, R=R_ratio * scenario.R)
        tracker = advance(self.showing_P(scenario), scenario, 0, k)
        theta, P = theta_of(tracker), np.array(tracker.P, dtype=float)
        phi = scenario.structure.regressors(scenario.u, scenario.y)[k]
        S = float(phi @ P @ phi + scenario.R)
        y = e * np.sqrt(S)
        tracker.update(float(phi @ theta + y), scenario.u[k])
        return Corrected(theta_of(tracker) - theta, P @ phi * (y / S), P, np.array(tracker.P, dtype=float))

    def assert_efficient(self, contamination: Kinds) -> None:
        """Compare with the tracker that is told every label, over many recordings."""
        clean = contamination == "none"
        samples, count, at_least = (80, 20, 0.9 if self.is_exact else 0.5) if clean else (120, 60, 0.4)
        found = [self.run(self.draw("fir", samples, contamination=contamination)) for _ in range(count)]
        assert_tracks(found, at_least=at_least, skip=40, false_alarm=self.false_alarm)


def _update(y: Any, u: Any, tracker: Any) -> None:
    """Make one call."""
    tracker.update(y, u)


def theta_of(tracker: Any) -> Array:
    """Return the parameters as a copy, shape (n,)."""
    return np.array(tracker.theta, dtype=float).ravel()


def advance(tracker: Any, scenario: PlantScenario, start: int = 0, stop: int | None = None) -> Any:
    """Update along a part of a recording and return the tracker."""
    for k in range(start, len(scenario.y) if stop is None else stop):
        tracker.update(float(scenario.y[k]), scenario.u[k])
    return tracker
