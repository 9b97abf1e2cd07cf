"""The study behind figures 8-19: trackers of an output-error model whose parameters drift, run by run."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.signal
from excitation import binary_input
from filterpy.kalman import KalmanFilter

from robust_filterpy import Huber
from robust_filterpy.correction import NotPositiveDefiniteError
from robust_filterpy.experiments import fit_percent
from robust_filterpy.identification import OutputError, ParameterTracker
from robust_filterpy.noise import EpsilonContaminated
from robust_filterpy.plants import THETA_BAR, random_walk, simulate_output_error, stable

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


@dataclass(frozen=True)
class Plant:
    """A plant, its noise, and what a tracker is told before the first sample."""

    name: str
    theta: tuple[float, ...]  # mean of theta(0)
    start: float | None  # theta_hat(0): None is the mean of theta(0)
    variance: float  # of the ordinary noise; an outlier's is 100 times that
    contamination: float = 0.1
    P0: float = 0.01
    Q: float = 1e-6
    gradient: str = "pseudolinear"
    guard: str = "reject"

    @property
    def order(self) -> int:
        """na = nb."""
        return len(self.theta) // 2


SECTION4 = Plant("section 4", tuple(THETA_BAR.tolist()), None, 0.1)
WELL = Plant("well-conditioned", (-1.5, 0.7, 1.0, 0.5), 0.0, 0.25, P0=1.0, gradient="filtered", guard="halve")


class Run(NamedTuple):
    """What one run gave; NaN where a tracker refused."""

    u: np.ndarray
    y: np.ndarray
    theta: np.ndarray  # (steps, n)
    estimates: np.ndarray  # (trackers, steps, n)
    output_fit: np.ndarray  # (trackers,) one-step prediction of the noise-free output, percent, second half
    response_error: np.ndarray  # (trackers,) relative error of the frequency response at the end
    information: np.ndarray  # (steps, n, n) of each sample about theta, for noise without outliers


def trial(rng: np.random.Generator, plant: Plant, trackers: tuple[str, ...] = TRACKERS) -> Run:
    """Draw parameters, noise and labels, and run every tracker on them."""
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
    u = INPUT[offset : offset + STEPS]
    v, is_outlier = EpsilonContaminated(
        plant.contamination, plant.variance**0.5, 10 * plant.variance**0.5
    ).rvs_labelled(STEPS, rng)
    data = simulate_output_error(theta, u, noise=v, na=order, nb=order)
    estimates, fits, response = (np.full((len(trackers), *s), np.nan) for s in ((STEPS, n), (), ()))
    for i, name in enumerate(trackers):
        try:
            path, prediction = _tracked(name, plant, data.y, u, is_outlier)
        except NotPositiveDefiniteError:
            continue
        estimates[i] = path
        half = slice(STEPS // 2, None)
        fits[i] = fit_percent(data.y_clean[half], prediction[half])
        response[i] = _response_error(path[-1], theta[-1], order)
    return Run(u, data.y, theta, estimates, fits, response, _information(theta, u, data.y_clean, order, plant.variance))


def _tracked(name: str, plant: Plant, y: np.ndarray, u: np.ndarray, is_outlier: np.ndarray):
    """Run one tracker; return its path of theta and its one-step predictions."""
    total = plant.variance * (1 - plant.contamination + 100 * plant.contamination)
    choices: dict = {"filter": KalmanFilter}
    if name in FORMS:
        scaling, information = FORMS[name]
        # Without outliers the threshold of 0.05 stands: an infinite one would be the Kalman filter itself.
        influence = Huber.from_contamination(max(plant.contamination, 0.05))
        choices = {"influence": influence, "scaling": scaling, "information": information}
    tracker = ParameterTracker(
        OutputError(plant.order, plant.order),
        theta=plant.theta if plant.start is None else plant.start,
        P=plant.P0,
        Q=plant.Q,
        R=total if name == KALMAN_TOTAL else plant.variance,
        gradient=plant.gradient,
        guard=plant.guard,
        **choices,
    )
    if name != LABELS:
        result = tracker.run(y, u)
        return result.theta, result.prediction
    path, prediction = np.empty((STEPS, len(plant.theta))), np.empty(STEPS)
    for k in range(STEPS):
        tracker.filter.R[0, 0] = plant.variance * (100 if is_outlier[k] else 1)
        prediction[k] = tracker.update(y[k], u[k]).prediction
        path[k] = tracker.theta
    return path, prediction


def _response_error(estimate: np.ndarray, theta: np.ndarray, order: int) -> float:
    """Return ||G_hat - G|| / ||G|| over a grid of frequencies."""
    found, true = (
        scipy.signal.freqz(np.r_[0, t[order:]], np.r_[1, t[:order]], FREQUENCIES)[1] for t in (estimate, theta)
    )
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def _information(theta: np.ndarray, u: np.ndarray, y: np.ndarray, order: int, variance: float) -> np.ndarray:
    """Return g g' / variance, g the derivative of the noise-free output, phi filtered by 1/A."""
    gradient, past = np.zeros((STEPS + order, 2 * order)), np.concatenate((np.zeros((order, 2)), np.c_[-y, u]))
    for k in range(STEPS):
        recent = past[k : k + order][::-1]
        gradient[k + order] = np.r_[recent[:, 0], recent[:, 1]] - theta[k, :order] @ gradient[k : k + order][::-1]
    g = gradient[order:]
    return g[:, :, None] * g[:, None, :] / variance


def bounds(information: np.ndarray, plant: Plant) -> tuple[np.ndarray, float]:
    """Return the Bayesian bound of ||error||^2 after each sample, and the Cramer-Rao bound without a prior.

    The first takes the information averaged over runs, which lightly damped plants rule: it is valid and loose. The
    second is the median over runs, for theta that stands still. Both have the noise's Fisher information (30).
    """
    if plant.contamination:
        noise = EpsilonContaminated(plant.contamination, 1.0, 10.0)
        x = np.linspace(-60, 60, 60001)
        p = noise.pdf(x)
        information = information * np.trapezoid(np.gradient(p, x) ** 2 / np.maximum(p, 1e-300), x)
    mean = information.mean(axis=0)
    n = mean.shape[1]
    J, bound = np.eye(n) / plant.P0, np.empty(STEPS)
    for k in range(STEPS):
        J = np.linalg.inv(np.linalg.inv(J) + plant.Q * np.eye(n)) + mean[k]
        bound[k] = np.trace(np.linalg.inv(J))
    without_prior = np.trace(np.linalg.inv(information.sum(axis=1)), axis1=1, axis2=2)
    return bound, float(np.sqrt(np.median(without_prior)))


INPUT = binary_input()
