"""Models of the servo from its recording: valve to velocity and reference to position, tracked, with their gain."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import numpy as np
import scipy.stats
from servo.experiment import DT, LABELS, NOMINAL, ROBUST, SERVO, STD, TOTAL, Conditions
from servo.linearization import linearized, opened

from robust_filterpy import Huber
from robust_filterpy.identification import LostTrackerWarning, OutputError, ParameterTracker, identify
from robust_filterpy.identification.models.results import TrackingResult
from robust_filterpy.influence import Linear
from robust_filterpy.influence.functions import Influence
from robust_filterpy.plants.servo import PneumaticParameters, simulate_servo
from robust_filterpy.plants.servo.linearization import operating_point
from robust_filterpy.plants.servo.position_loop import ServoRecording
from robust_filterpy.testing import fit_percent

ORDER, P0 = 4, 0.01
CONSTANT = "constant"
TRACKERS = (CONSTANT, NOMINAL, TOTAL, ROBUST, LABELS)
#: Variances of a step of theta among which the data choose.
DRIFTS = tuple(10.0 ** np.arange(-8.0, -3.9, 0.5))
#: Samples between two looks at the covariance of theta.
EVERY = 25


class Signals(NamedTuple):
    """Input and output of a model; N samples."""

    u: np.ndarray
    y: np.ndarray  # measured
    truth: np.ndarray  # that no sensor saw
    outliers: np.ndarray  # (N,), variance that the outliers add to a sample of y
    theta: np.ndarray  # to start from: the linear model of the data sheet's servo


def valve_to_velocity(recording: ServoRecording, given: Conditions, servo: PneumaticParameters = SERVO) -> Signals:
    """Take the opening (percent) as input, the encoder's differences (cm/s) as output."""
    opening = 100 * opened(recording.valve, servo.dead_band)
    scale = 100 / DT
    extra = scale**2 * (given.variance[:, 0] - STD[0] ** 2)
    extra[1:] += extra[:-1].copy()
    model = linearized(servo, DT).valve_to_velocity
    # m/s per unit of the command: cm/s per percent of opening.
    theta = _theta(model) * np.repeat([1.0, 1 - servo.dead_band], ORDER)
    measured, truth = (
        scale * np.diff(signal, prepend=signal[0]) for signal in (recording.position_measured, recording.position)
    )
    return Signals(opening, measured, truth, extra, theta)


def reference_to_position(recording: ServoRecording, given: Conditions) -> Signals:
    """Take the reference (cm) as input, the encoder's position (cm) as output."""
    extra = 100**2 * (given.variance[:, 0] - STD[0] ** 2)
    theta = _theta(linearized(SERVO, DT).reference_to_position)
    measured, truth = 100 * recording.position_measured, 100 * recording.position
    return Signals(100 * recording.reference, measured, truth, extra, theta)


def _theta(model) -> np.ndarray:
    """Return [a_1 .. a_4, b_1 .. b_4] of a transfer function of fourth order."""
    den, num = model.den[0][0], model.num[0][0]
    return np.concatenate((den[1:], np.zeros(ORDER - num.size), num)) / den[0]


class Model(NamedTuple):
    """A tracked model: N samples."""

    theta: np.ndarray  # (N, 8)
    gain: np.ndarray  # (N / EVERY,), at samples EVERY - 1, 2 EVERY - 1, ..
    gain_std: np.ndarray
    covariance: np.ndarray  # (N / EVERY, 8, 8)
    drift: float  # variance of a step of theta that the data chose


def ordinary_variance(data: Signals) -> float:
    """Return the variance of what a linear model leaves over, as its median size tells it: outliers count little."""
    with warnings.catch_warnings():
        # Only the median of its residuals is wanted, and the guard keeps it stable.
        warnings.simplefilter("ignore", LostTrackerWarning)
        result = _tracker(data, 1e-6, Huber()).run(data.y, data.u)
    return float(scipy.stats.median_abs_deviation(result.residual, scale="normal") ** 2)


def tracked(data: Signals, name: str, variance: float) -> Model:
    """Track a model; the data choose how fast theta may drift."""
    if name == CONSTANT:
        theta = best_constant(data)
        return Model(np.tile(theta, (data.y.size, 1)), np.array([]), np.array([]), np.array([]), 0.0)
    R = np.full(data.y.size, variance + (data.outliers.mean() if name == TOTAL else 0.0))
    if name == LABELS:
        R += data.outliers

    def run(tracker: ParameterTracker, piece: slice) -> TrackingResult:
        with warnings.catch_warnings():
            # Some drifts are too fast, and the Kalman filter loses its way: the tables tell what that costs.
            warnings.simplefilter("ignore", LostTrackerWarning)
            # The robust tracker finds R itself.
            return tracker.run(data.y[piece], data.u[piece], None if name == ROBUST else R[piece])

    def loss(drift: float) -> float:
        residual = run(_tracker(data, drift, influence), slice(None)).residual[data.y.size // 5 :]
        # The same yardstick for all: how far the next sample was missed, an outlier counting no more than its size.
        return float(np.mean(Huber().rho(residual / np.sqrt(variance))))

    influence = Huber() if name == ROBUST else Linear()
    drift = min(DRIFTS, key=loss)
    tracker = _tracker(data, drift, influence)
    theta, gains, covariances = [], [], []
    for start in range(0, data.y.size, EVERY):
        piece = slice(start, start + EVERY)
        theta.append(run(tracker, piece).theta)
        gains.append(gain_of(tracker.theta, tracker.P))
        covariances.append(tracker.P)
    gain, std = np.transpose(gains)
    return Model(np.concatenate(theta), gain, std, np.array(covariances), drift)


def best_constant(data: Signals) -> np.ndarray:
    """Fit one constant output-error model to the whole recording."""
    with warnings.catch_warnings():
        # The servo is no constant linear model, which `identify` says: that is what the study is about.
        warnings.filterwarnings("ignore", "identify: ", UserWarning)
        return identify(data.y, data.u, OutputError(ORDER, ORDER), influence=Huber(), progress=False).theta


def _tracker(data: Signals, drift: float, influence: Influence) -> ParameterTracker:
    """Set up a tracker at the data sheet's model."""
    return ParameterTracker(OutputError(ORDER, ORDER), theta=data.theta, P=P0, Q=drift, influence=influence)


def gain_of(theta: np.ndarray, P: np.ndarray) -> tuple[float, float]:
    """Return the static gain B(1)/A(1) and its standard deviation, to first order in theta."""
    A, B = 1 + theta[:ORDER].sum(), theta[ORDER:].sum()
    slope = np.repeat([-B / A**2, 1 / A], ORDER)
    return float(B / A), float(np.sqrt(slope @ P @ slope))


def sliding_gain(recording: ServoRecording, k: int) -> float:
    """Return the physics' own gain, cm/s per percent of opening: steady sliding, the mean of both directions."""
    point = dict(load=recording.load[k], alpha=recording.alpha[k], beta=recording.beta[k])
    gains = []
    for velocity in (-0.1, 0.1):
        valve = operating_point(SERVO, velocity=velocity, **point).valve
        gains.append(velocity / opened(valve, SERVO.dead_band))
    return float(np.mean(gains))


def frozen(given: Conditions, k: int, servo: PneumaticParameters = SERVO, amplitude: float = 1.0) -> np.ndarray:
    """Return theta of the best linear model of the physics of one moment: frozen, without any noise."""
    physics = {name: np.full(values.size, values[k]) for name, values in given.physics.items()}
    clean = given._replace(noise=np.zeros_like(given.noise), is_outlier=np.zeros_like(given.is_outlier))
    recording = simulate_servo(amplitude * given.reference, DT, servo, **physics)
    return best_constant(valve_to_velocity(recording, clean, servo))


def frozen_gain(given: Conditions, k: int) -> float:
    """Return the static gain of the best linear model of the physics of one moment."""
    return gain_of(frozen(given, k), np.eye(2 * ORDER))[0]


def free_run(theta: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Simulate the tracked model from the input alone, each sample with that sample's parameters."""
    y, past = np.zeros(u.size + ORDER), np.concatenate((np.zeros(ORDER), u))
    for k in range(u.size):
        recent = slice(k, k + ORDER)
        # A model that is unstable for a moment must not end the simulation.
        new = theta[k, ORDER:] @ past[recent][::-1] - theta[k, :ORDER] @ y[recent][::-1]
        y[k + ORDER] = np.clip(new, -1e6, 1e6)
    return y[ORDER:]


def fit(data: Signals, model: Model) -> float:
    """Return the free run's fit to what no sensor saw, percent, after the first third."""
    late = slice(data.u.size // 3, None)
    return float(fit_percent(data.truth[late], free_run(model.theta, data.u)[late]))
