"""The experiment: a servo whose physics drift, in a loop on one filter's estimate of the motion or another's."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter
from servo.observer import ServoObserver

from robust_filterpy import Contaminated, RobustKalmanFilter
from robust_filterpy.correction import Scales
from robust_filterpy.plants.excitation import bandlimited_pink_autocovariance, receding_horizon_binary
from robust_filterpy.plants.servo import PneumaticParameters, simulate_servo
from robust_filterpy.plants.servo.position_loop import ServoRecording

DT, HOLD = 0.01, 20  # s, samples
AMPLITUDE = 0.03  # m
SERVO = PneumaticParameters()
#: Standard deviation of the position encoder, P_a and P_b in m, Pa, Pa: of ordinary readings, and of outliers.
STD, OUTLIERS = np.array([5e-5, 500.0, 500.0]), np.array([5e-3, 2e4, 2e4])

NONE, NOMINAL, TOTAL, ROBUST, TWO_SIDED, LABELS = LOOPS = (
    "no outliers",
    "Kalman, R nominal",
    "Kalman, R of all noise",
    "robust",
    "two-sided",
    "Kalman, outliers known",
)


class Conditions(NamedTuple):
    """What a run of the servo meets; N samples."""

    reference: np.ndarray  # (N,), m
    physics: dict  # alpha, beta, load, supply, each (N,)
    noise: np.ndarray  # (N, 3) of position, P_a, P_b
    is_outlier: np.ndarray  # (N, 3)
    outlier_std: np.ndarray  # (3,)

    @property
    def ordinary(self) -> np.ndarray:
        """The same noise, every outlier shrunk to an ordinary error."""
        return np.where(self.is_outlier, self.noise * STD / self.outlier_std, self.noise)

    @property
    def variance(self) -> np.ndarray:
        """Variance of each reading, for who knows which are outliers."""
        return np.where(self.is_outlier, self.outlier_std, STD) ** 2


def conditions(
    steps: int, contamination: float, rng: np.random.Generator, encoder_outliers: float = OUTLIERS[0]
) -> Conditions:
    """Draw a reference, physics that drift, and the errors of the sensors; outliers of the encoder in m."""
    shape = bandlimited_pink_autocovariance(0.2, 3.0, 40)
    reference = AMPLITUDE * np.repeat(receding_horizon_binary(shape, -(-steps // HOLD), rng=rng), HOLD)[:steps]
    t = DT * np.arange(steps)
    share = t / t[-1]
    alpha = wandering(t, 1.05, 1.35, rng)
    # The valve wears in, the air warms up and cools down, a load comes half-way, the supply sags as others draw on it.
    # Equation (6): heat coefficient, discharge coefficient, and the root of the temperature over the nominal one.
    beta = alpha * (0.16 + 0.18 * share) * np.sqrt(1 + 0.1 * np.sin(2 * np.pi * share))
    load = np.interp(share, [0, 0.5, 0.53], [0.0, 0.0, 5.0])
    supply = SERVO.supply_pressure - 1.5e4 * (1 - np.cos(2 * np.pi * t / 10))
    physics = dict(alpha=alpha, beta=beta, load=load, supply=supply)
    outlier_std = np.array([encoder_outliers, *OUTLIERS[1:]])
    laws = (Contaminated(contamination, wide / std, std) for std, wide in zip(STD, outlier_std, strict=True))
    drawn = [law.rvs_labelled(steps, rng) for law in laws]
    noise, is_outlier = (np.column_stack(part) for part in zip(*drawn, strict=True))
    return Conditions(reference, physics, noise, is_outlier, outlier_std)


def wandering(t: np.ndarray, low: float, high: float, rng: np.random.Generator) -> np.ndarray:
    """Draw a slow random walk that is reflected at two bounds; a free one would move .05 of the way in a second."""
    width = high - low
    steps = 0.05 * width * np.sqrt(np.diff(t)) * rng.standard_normal(t.size - 1)
    free = 0.5 * width + np.concatenate([[0.0], np.cumsum(steps)])
    # To fold a free walk is the same as to reflect it at the bounds.
    return low + np.abs((free + width) % (2 * width) - width)


def drive(given: Conditions, loop: str) -> ServoRecording:
    """Run the servo, its controller on one filter's estimate of position and acceleration."""
    filters = {
        ROBUST: RobustKalmanFilter,
        TWO_SIDED: partial(
            RobustKalmanFilter, noise=Contaminated(0.1, 5.0), process=Scales((1.0, 10.0, 100.0), jump=0.0)
        ),
    }
    std = np.sqrt(given.variance.mean(axis=0)) if loop == TOTAL else STD
    observer = ServoObserver(filters.get(loop, KalmanFilter)(6, 3, 6), DT, std, SERVO)
    variance = iter(given.variance)

    def knowing(readings: np.ndarray, valve: float) -> tuple[float, float]:
        return observer(readings, valve, np.diag(next(variance)))

    return simulate_servo(
        given.reference,
        DT,
        SERVO,
        noise=given.ordinary if loop == NONE else given.noise,
        observer=knowing if loop == LABELS else observer,
        **given.physics,
    )


class Motion(NamedTuple):
    """What the outliers did to the piston and to the valve."""

    deviation: float  # from the motion of the loop without outliers, root mean square in mm
    worst: float  # the largest, in mm
    travel: float  # of the valve's spool, strokes per second


def motion(recording: ServoRecording, without: ServoRecording) -> Motion:
    """Compare a run with the one without outliers."""
    deviation = 1e3 * (recording.position - without.position)
    travel = np.abs(np.diff(recording.valve)).sum() / (recording.t[-1] - recording.t[0])
    return Motion(float(np.sqrt(np.mean(deviation**2))), float(np.abs(deviation).max()), float(travel))
