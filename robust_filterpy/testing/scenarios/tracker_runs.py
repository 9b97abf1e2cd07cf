"""What a tracker made of a recording, as arrays: the one form that every assertion about parameters reads."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array

if TYPE_CHECKING:
    from robust_filterpy.testing.scenarios.plants import PlantScenario

__all__ = ["TrackerRun", "run_tracker"]


@dataclass(frozen=True, eq=False)
class TrackerRun:
    """Hold N samples of a tracker. What is None it does not tell.

    Attributes
    ----------
    theta : ndarray, shape (N, n)
        Parameters after each sample.
    std : ndarray, shape (N, n), optional
        Their standard deviations, sqrt(diag P).
    P : ndarray, shape (n, n), optional
        Their covariance after the last sample.
    truth : ndarray, shape (N, n), optional
        True parameters.
    scenario : PlantScenario, optional
        What it ran over.

    Raises
    ------
    ValueError
        If the shapes do not fit together.
    """

    theta: Array
    std: Array | None = None
    P: Array | None = None
    truth: Array | None = None
    scenario: PlantScenario | None = None

    def __post_init__(self) -> None:
        """Check every shape against that of theta."""
        shape = np.shape(self.theta)
        if len(shape) != 2:
            raise ValueError(f"theta: expected shape (N, n), got {shape}")
        for name, wanted in {"std": shape, "P": shape[-1:] * 2, "truth": shape}.items():
            value = getattr(self, name)
            if value is not None and np.shape(value) != wanted:
                raise ValueError(f"{name}: expected shape {wanted} for theta of shape {shape}, got {np.shape(value)}")

    @property
    def error(self) -> Array:
        """Estimate minus truth, shape (N, n)."""
        if self.truth is None:
            raise ValueError("truth: expected a run with the true parameters, this one has none")
        return self.theta - self.truth

    @property
    def known(self) -> PlantScenario:
        """The scenario, or an error if there is none."""
        if self.scenario is None:
            raise ValueError("scenario: expected a run of run_tracker(tracker, scenario), this one has none")
        return self.scenario


def as_tracker_runs(runs: Any) -> list[TrackerRun]:
    """Return a list of runs from a run or several.

    Parameters
    ----------
    runs : TrackerRun or iterable of TrackerRun
        What to read.

    Returns
    -------
    list of TrackerRun

    Raises
    ------
    TypeError
        If it is neither.
    """
    found = [runs] if isinstance(runs, TrackerRun) else list(runs) if isinstance(runs, Iterable) else []
    if not found or not all(isinstance(run, TrackerRun) for run in found):
        raise TypeError(f"runs: expected a TrackerRun or a list of these, got {_checks.shown(runs)}")
    return found


def run_tracker(tracker: Any, scenario: PlantScenario, sample: Callable[[int], Any] | None = None) -> TrackerRun:
    """Run a tracker over a scenario, sample by sample.

    Parameters
    ----------
    tracker : tracker object
        With ``update(y, u)`` and ``theta``; ``P`` if it has it. It is changed.
    scenario : PlantScenario
        Inputs and outputs.
    sample : callable, optional
        ``sample(k)`` in the place of ``tracker.update(y[k], u[k])``.

    Returns
    -------
    TrackerRun

    Raises
    ------
    ValueError
        If theta has another length than the structure's.
    """
    n, N = scenario.structure.n_theta, len(scenario.y)
    theta, std = np.empty((N, n)), np.full((N, n), np.nan)
    for k in range(N):
        if sample is None:
            tracker.update(float(scenario.y[k]), scenario.u[k])
        else:
            sample(k)
        theta[k] = parameters(tracker, n)
        P = getattr(tracker, "P", None)
        if P is not None:
            std[k] = np.sqrt(np.maximum(np.diagonal(P), 0.0))
    P = None if P is None else np.array(P, dtype=float)
    return TrackerRun(theta, None if P is None else std, P, scenario.theta, scenario)


def parameters(tracker: Any, n: int) -> Array:
    """Return theta, shape (n,), or raise."""
    theta = np.ravel(np.asarray(tracker.theta, dtype=float))
    if theta.size != n:
        raise ValueError(f"tracker: expected theta of {n} numbers for this structure, got {theta.size}")
    return theta
