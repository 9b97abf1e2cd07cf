"""The study behind figures 8-19: trackers of an output-error model whose parameters drift, run by run."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
from excitation import binary_input
from filterpy.kalman import KalmanFilter
from scipy.integrate import quad
from scipy.linalg.blas import dtbsv

from robust_filterpy import Contaminated, Huber
from robust_filterpy.correction import NotPositiveDefiniteError
from robust_filterpy.identification import LostTrackerWarning, OutputError, ParameterTracker
from robust_filterpy.influence import Linear
from robust_filterpy.plants import THETA_BAR, simulate_output_error
from robust_filterpy.plants.linear import Simulation, random_walk, stable
from robust_filterpy.testing import fit_percent

STEPS = 1000
KALMAN, KALMAN_TOTAL, LABELS = "Kalman, R nominal", "Kalman, R of all noise", "Kalman, outliers known"
LITERAL, UNIT_EXPECTED = "T = 1, realized (Table 1)", "T = 1, expected"
BOUNDED, INNOVATION = "bounded, realized", "T(k), realized"
FORMS = {
    LITERAL: ("unit", "realized"),
    UNIT_EXPECTED: ("unit", "expected"),
    BOUNDED: ("bounded", "realized"),
    INNOVATION: ("innovation", "realized"),
}
TRACKERS = (KALMAN, KALMAN_TOTAL, *FORMS, LABELS)
FREQUENCIES = np.linspace(0.05, 3.0, 60)  # rad/sample

#: Path of theta (steps, n) and one-step predictions (steps,) of a tracker.
Tracked: TypeAlias = "tuple[np.ndarray, np.ndarray]"
Tracking: TypeAlias = Callable[..., Tracked]


@dataclass(frozen=True)
class Plant:
    """A plant, its noise, and what a tracker is given before the first sample."""

    name: str
    theta: tuple[float, ...]  # mean of theta(0)
    start: float | None  # theta_hat(0): None is the mean of theta(0)
    variance: float  # of the ordinary noise; an outlier's is 100 times that
    contamination: float = 0.1
    P0: float = 0.01
    Q: float = 1e-6
    gradient: str = "pseudolinear"
    guard: str = "reject"
    white: bool = False  # input: white +-1 instead of the paper's

    @property
    def order(self) -> int:
        """na = nb."""
        return len(self.theta) // 2

    @cached_property
    def noise(self) -> Contaminated:
        """The noise of Table 1; scipy takes longer to set a distribution up than to draw a run from it."""
        return Contaminated(self.contamination, 10.0, self.variance**0.5)

    @cached_property
    def fisher(self) -> float:
        """Fisher information (30) of the noise in units of that of its ordinary part."""
        information = quad(lambda v: self.noise.score(v) ** 2 * self.noise.pdf(v), 0.0, 50.0 * self.noise.scale)[0]
        return 2.0 * information * self.variance


SECTION4 = Plant("section 4", tuple(THETA_BAR.tolist()), None, 0.1, Q=1e-4)
#: The other reading of the lost W.
STILL = replace(SECTION4, Q=1e-6)
WELL = Plant("well-conditioned", (-1.5, 0.7, 1.0, 0.5), 0.0, 0.25, P0=1.0, gradient="filtered", guard="halve")


class Draw(NamedTuple):
    """The data of a run."""

    data: Simulation
    is_outlier: np.ndarray  # (steps,)


def drawn(rng: np.random.Generator, plant: Plant) -> Draw:
    """Draw parameters, noise and labels, and simulate the plant."""
    n, order, inside = len(plant.theta), plant.order, stable(plant.order)
    start = np.array(plant.theta)
    if plant.start is None:
        # The prior of Table 1, as far as it is a stable plant.
        while True:
            start = np.array(plant.theta) + np.sqrt(plant.P0) * rng.standard_normal(n)
            if inside(start):
                break
    theta = random_walk(start, plant.Q, STEPS, rng, accept=inside)
    offset = int(rng.integers(1000, 8000))
    v, is_outlier = plant.noise.rvs_labelled(STEPS, rng)
    u = rng.choice([-1.0, 1.0], STEPS) if plant.white else INPUT[offset : offset + STEPS]
    return Draw(simulate_output_error(theta, u, noise=v, na=order, nb=order), is_outlier)


def tracked(name: str, plant: Plant, y: np.ndarray, u: np.ndarray, is_outlier: np.ndarray) -> Tracked:
    """Run one tracker over the recording; with psi(e) = e the robust filter is the Kalman filter."""
    choices = _choices(name, plant) or {"influence": Linear()}
    result = _tracker(name, plant, choices).run(y, u, R=_known_variance(plant, is_outlier) if name == LABELS else None)
    return result.theta, result.prediction


def looped(name: str, plant: Plant, y: np.ndarray, u: np.ndarray, is_outlier: np.ndarray) -> Tracked:
    """Do what `tracked` does sample by sample, with filterpy's own Kalman filter, as a program online does."""
    tracker = _tracker(name, plant, _choices(name, plant) or {"filter": KalmanFilter})
    variance = _known_variance(plant, is_outlier)
    path, prediction = np.empty((STEPS, len(plant.theta))), np.empty(STEPS)
    for k in range(STEPS):
        R = variance[k] if name == LABELS else None
        prediction[k] = tracker.update(y[k], u[k], R).prediction
        path[k] = tracker.theta
    return path, prediction


def _known_variance(plant: Plant, is_outlier: np.ndarray) -> np.ndarray:
    """Return the variance of each sample's noise."""
    return plant.variance * np.where(is_outlier, 100.0, 1.0)


def _choices(name: str, plant: Plant) -> dict:
    """Return the choices of a robust tracker, none for a Kalman filter."""
    if name not in FORMS:
        return {}
    scaling, information = FORMS[name]
    # Without outliers the threshold of 0.05 stands: an infinite one would be the Kalman filter itself.
    influence = Huber.from_contamination(max(plant.contamination, 0.05))
    return {"influence": influence, "scaling": scaling, "information": information}


def _tracker(name: str, plant: Plant, choices: dict) -> ParameterTracker:
    """Set up a tracker before the first sample."""
    total = plant.variance * (1 - plant.contamination + 100 * plant.contamination)
    return ParameterTracker(
        OutputError(plant.order, plant.order),
        theta=plant.theta if plant.start is None else plant.start,
        P=plant.P0,
        Q=plant.Q,
        R=total if name == KALMAN_TOTAL else plant.variance,
        gradient=plant.gradient,
        guard=plant.guard,
        **choices,
    )


class Run(NamedTuple):
    """What one run gave; NaN where a tracker refused."""

    y: np.ndarray
    y_clean: np.ndarray
    theta: np.ndarray  # (steps, n)
    start: np.ndarray  # (n,) theta_hat before the first sample
    estimates: np.ndarray  # (trackers, steps, n)
    output_fit: np.ndarray  # (trackers,) one-step prediction of the noise-free output, percent, second half
    response_error: np.ndarray  # (trackers,) relative error of the frequency response at the end
    information: np.ndarray  # (steps, n, n) of each sample about theta, for noise without outliers
    lost: np.ndarray  # (trackers,) whether a tracker warned that it no longer follows


def trial(
    rng: np.random.Generator, plant: Plant, trackers: tuple[str, ...] = TRACKERS, tracking: Tracking = tracked
) -> Run:
    """Draw the data of a run, run every tracker on them, and compare what it says with the truth."""
    (u, y, y_clean, theta), is_outlier = drawn(rng, plant)
    estimates, fits = np.full((len(trackers), *theta.shape), np.nan), np.full(len(trackers), np.nan)
    half, lost = slice(STEPS // 2, None), np.zeros(len(trackers), dtype=bool)
    for i, name in enumerate(trackers):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            try:
                estimates[i], prediction = tracking(name, plant, y, u, is_outlier)
            except NotPositiveDefiniteError:
                continue
        lost[i] = any(issubclass(one.category, LostTrackerWarning) for one in said)
        fits[i] = fit_percent(y_clean[half], prediction[half])
    response = _response_error(estimates[:, -1], theta[-1], plant.order)
    start = _tracker(KALMAN, plant, {}).theta
    information = _information(theta, u, y_clean, plant.order, plant.variance)
    return Run(y, y_clean, theta, start, estimates, fits, response, information, lost)


def squared(run: Run) -> np.ndarray:
    """Return ||theta_hat - theta||^2 of many runs, shape (runs, trackers, steps)."""
    return np.sum((run.estimates - run.theta[:, None]) ** 2, axis=-1)


def staying(run: Run) -> np.ndarray:
    """Return the squared error of an estimate that stays where it starts, shape (runs, steps)."""
    return np.sum((run.start[:, None] - run.theta) ** 2, axis=-1)


def _response_error(estimates: np.ndarray, theta: np.ndarray, order: int) -> np.ndarray:
    """Return ||G_hat - G|| / ||G|| over a grid of frequencies for each row of estimates."""
    delays = np.exp(-1j * np.outer(np.arange(1, order + 1), FREQUENCIES))
    # numpy warns of complex NaN, of which the row of a tracker that refused is full.
    with np.errstate(invalid="ignore"):
        found, true = ((t[..., order:] @ delays) / (1 + t[..., :order] @ delays) for t in (estimates, theta))
        return np.linalg.norm(found - true, axis=-1) / np.linalg.norm(true)


def _information(theta: np.ndarray, u: np.ndarray, y: np.ndarray, order: int, variance: float) -> np.ndarray:
    """Return g g' / variance, g the derivative of the noise-free output, phi filtered by 1/A."""
    g = OutputError(order, order).regressors(u, y)
    # Row k of a banded triangular system: g(k) + a_1(k) g(k-1) + .. + a_n(k) g(k-n) = phi(k).
    bands = np.ones((order + 1, len(theta)))
    for lag in range(1, order + 1):
        bands[lag, :-lag] = theta[lag:, lag - 1]
    for column in g.T:
        column[:] = dtbsv(order, bands, column, lower=1, diag=1)
    return g[:, :, None] * g[:, None, :] / variance


class Limits(NamedTuple):
    """What no estimator can do better than."""

    bayesian: np.ndarray  # (steps,), of ||error||^2 with the prior
    without_prior: float  # of ||error|| after all samples, of an unbiased estimator


def bounds(information: np.ndarray, plant: Plant) -> Limits:
    """Return the Bayesian bound of ||error||^2 after each sample, and the Cramer-Rao bound without a prior.

    The first takes the information averaged over runs, which lightly damped plants rule: it is valid and loose. The
    second is the median over runs, for theta that stands still. Both have the noise's Fisher information (30).
    """
    information = information * plant.fisher
    mean = information.mean(axis=0)
    drift = plant.Q * np.eye(mean.shape[1])
    P, bound = plant.P0 * np.eye(mean.shape[1]), np.empty(STEPS)
    for k in range(STEPS):
        P = np.linalg.inv(np.linalg.inv(P + drift) + mean[k])
        bound[k] = np.trace(P)
    without_prior = np.trace(np.linalg.inv(information.sum(axis=1)), axis1=1, axis2=2)
    return Limits(bound, float(np.sqrt(np.median(without_prior))))


INPUT = binary_input()
