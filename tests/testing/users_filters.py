"""More wrong filters: what users write, each written with the names of the checks known and not what they do.

`WRONG_FILTERS` are these and those of `wrong_filters`.
"""

from __future__ import annotations

import copy
import math

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from wrong_filters import ROBUST, WRONG_FILTERS, Textbook, TextbookRobust, wrong

__all__ = ["WRONG_FILTERS"]


# Prediction


@wrong("prediction_moves_the_state_by_F", "none_is_no_information", "nothing_is_remembered_but_x_and_P")
class PredictsOnceAMeasurement(Textbook):
    """A second predict() before the next measurement does nothing, as a guard against calling it twice."""

    moved_already = False

    def predict(self, u=None):
        if not self.moved_already:
            super().predict(u)
            self.moved_already = True

    def update(self, z):
        super().update(z)
        self.moved_already = self.moved_already and z is None


@wrong("prediction_moves_the_covariance_by_F")
class FirstOrderCovariance(Textbook):
    """P + (F - I) P + P (F - I)' + Q: one step of Euler for the covariance."""

    def spread(self, P):
        A = self.F - np.eye(self.dim_x)
        return P + A @ P + P @ A.T + self.Q


@wrong("units_change_nothing", "prediction_moves_the_covariance_by_F", "nothing_is_remembered_but_x_and_P")
class VarianceWithACeiling(Textbook):
    """No variance grows above 1e4."""

    def spread(self, P):
        P = super().spread(P)
        shrink = np.sqrt(np.minimum(1.0, 1e4 / np.diag(P)))
        return shrink[:, None] * P * shrink


@wrong("control_input_moves_the_prediction", "nothing_is_remembered_but_x_and_P")
class HoldsTheLastInput(Textbook):
    """predict() without u takes the u of the call before."""

    held = None

    def predict(self, u=None):
        self.held = self.held if u is None else u
        super().predict(self.held)


# Correction


@wrong("measurement_counts_at_once")
class CorrectsAtTheNextPrediction(Textbook):
    """update() only puts the measurement away; the next predict() uses it."""

    waiting = None

    def update(self, z):
        self.waiting = z

    def predict(self, u=None):
        if self.waiting is not None:
            super().update(self.waiting)
            self.waiting = None
        super().predict(u)


@wrong("measurement_counts_at_once", "nothing_is_remembered_but_x_and_P", "measurement_makes_the_state_more_certain")
class RepeatedReadingIsNoReading(Textbook):
    """A measurement equal to the one before is taken for the same one, delivered twice."""

    last = None

    def update(self, z):
        same = z is not None and self.last is not None and np.array_equal(np.ravel(z), self.last)
        self.last = None if z is None else np.array(z, dtype=float).ravel()
        if not same:
            super().update(z)


@wrong("integers_are_numbers_like_any_other", "measurement_counts_at_once", "measurement_makes_the_state_more_certain")
class ZeroIsNothing(Textbook):
    """`if not np.any(z)`: a measurement of zeros is taken for none."""

    def update(self, z):
        super().update(None if z is None or not np.any(z) else z)


@wrong(
    "two_sensors_after_one_another_are_both_at_once",
    "correction_is_the_kalman_gain_times_the_innovation",
    "correction_leaves_P_minus_K_S_K",
)
class SensorsOneByOneWithTheOldState(Textbook):
    """The sensors correct one after another; each innovation is that of the state before all of them."""

    def update(self, z):
        if z is None:
            return
        z = np.reshape(np.asarray(z, dtype=float), (-1, 1))
        self.y, self.S = self.innovation(z), self.covariance(self.P)
        self.log_likelihood = self.likelihood(self.y, self.S)
        x, P = self.x, self.P
        for i, h in enumerate(self.H):
            K = (P @ h / (h @ P @ h + self.R[i, i]))[:, None]
            x, P = x + K * self.y[i], P - K @ (h @ P)[None, :]
        self.x, self.P = x, (P + P.T) / 2


@wrong("correction_leaves_P_minus_K_S_K")
class MirroredWithTheDiagonalTwice(Textbook):
    """P is made symmetric from its upper triangle, the diagonal counted twice."""

    def shrunk(self, P, K, S):
        P = super().shrunk(P, K, S)
        return np.triu(P) + np.triu(P).T


# What is remembered


@wrong("nothing_is_remembered_but_x_and_P", "matrices_may_change_between_calls")
class SteadyGain(Textbook):
    """Once the gain changes by less than a thousandth it is kept, to save time."""

    kept = last = None

    def gain(self, P, S):
        if self.kept is None:
            K = super().gain(P, S)
            if self.last is not None and np.abs(K - self.last).max() < 1e-3 * np.abs(K).max():
                self.kept = K
            self.last = K
            return K
        return self.kept


@wrong("measurement_noise_is_R", "nothing_is_remembered_but_x_and_P")
class LearnsR(Textbook):
    """R is the mean square of the last fifty innovations less H P H', as in Sage and Husa's filter."""

    def __init__(self, dim_x, dim_z):
        super().__init__(dim_x, dim_z)
        self.squares = []

    def update(self, z):
        if z is not None:
            y = self.innovation(np.reshape(np.asarray(z, dtype=float), (-1, 1)))
            self.squares = [*self.squares[-49:], y @ y.T]
        super().update(z)

    def noise(self):
        if len(self.squares) < 50:
            return self.R
        learnt = np.mean(self.squares, axis=0) - self.H @ self.P @ self.H.T
        return learnt if np.linalg.eigvalsh(learnt).min() > 0 else self.R


@wrong("nothing_is_remembered_but_x_and_P")
class StartsAnewNowAndThen(Textbook):
    """Every five hundredth correction begins with P of the start, against divergence."""

    count, start = 0, None

    def update(self, z):
        self.start = self.P if self.start is None else self.start
        self.count += 1
        if self.count % 500 == 0:
            self.P = self.start
        super().update(z)


@wrong("estimates_handed_out_stay_as_they_were")
class RingOfStates(Textbook):
    """x is a row of a buffer for the last fifty states, which is written over in turn."""

    row = 0

    def update(self, z):
        super().update(z)
        if not hasattr(self, "ring"):
            self.ring = np.zeros((50, self.dim_x, 1))
        self.row = (self.row + 1) % 50
        self.ring[self.row] = self.x
        self.x = self.ring[self.row]


@wrong("pickles_go_on_alike", "deepcopies_go_on_alike")
class StoresWhatItShows(Textbook):
    """What is stored are x, P and the matrices, without the deviation of a slow average that corrects the sensor."""

    offset = 0.0

    def innovation(self, z):
        y = super().innovation(z)
        self.offset = 0.99 * self.offset + 0.01 * y
        return y - self.offset

    def __getstate__(self):
        return {name: value for name, value in self.__dict__.items() if name != "offset"}

    def __deepcopy__(self, memo):
        twin = type(self)(self.dim_x, self.dim_z)
        twin.__dict__.update(copy.deepcopy(self.__getstate__()))
        return twin


# Missing sensors, bad input, what is shown


@wrong("nan_is_a_sensor_that_is_not_there", not_claimed=("robust", "validates"))
class NaNIsARowOfZeros(Textbook):
    """The missing sensor's row of H and its innovation are 0; its noise still has its part in that of the others."""

    def update(self, z):
        if z is None:
            return
        z, H = np.reshape(np.asarray(z, dtype=float), (-1, 1)), self.H
        missing = np.isnan(z[:, 0])
        self.H = np.where(missing[:, None], 0.0, H)
        super().update(np.where(missing[:, None], 0.0, z))
        self.H = H


@wrong("nan_is_a_sensor_that_is_not_there", not_claimed=("robust", "validates"))
class NaNIsTheLastValue(Textbook):
    """A missing component is what it was the last time, as `ffill` makes it."""

    last = None

    def update(self, z):
        if z is not None:
            z = np.array(z, dtype=float).reshape(-1, 1)
            before = self.H @ self.x if self.last is None else self.last
            z = self.last = np.where(np.isnan(z), before, z)
        super().update(z)


@wrong("bad_input_is_refused_and_changes_nothing", not_claimed=("robust", "nan"))
class RefusesTooLate(Textbook):
    """What is wrong raises, after the innovation of it has been put away."""

    def update(self, z):
        super().update(z)
        if not (np.isfinite(self.x).all() and np.isfinite(self.P).all() and np.linalg.eigvalsh(self.P).min() > -1e-9):
            raise ValueError(f"z: expected finite numbers, got {z}")


@wrong("innovation_and_its_covariance_are_shown")
class ShowsSAfterwards(Textbook):
    """S is shown as H P+ H' + R."""

    def update(self, z):
        super().update(z)
        if z is not None:
            self.S = self.covariance(self.P)


# Extended


@wrong("nonlinear_sensor_is_linearised_at_the_prediction")
class JacobianOfTheStateBefore(ExtendedKalmanFilter):
    """The Jacobian is that of the corrected state of the step before, which is at hand."""

    def predict(self, u=0):
        self.before = self.x.copy()
        super().predict(u)

    def update(self, z, HJacobian, Hx, **more):
        before = getattr(self, "before", self.x)
        super().update(z, lambda x, *args: HJacobian(before, *args), Hx, **more)


# Robust


@wrong("nothing_is_remembered_but_x_and_P", "arguments_are_not_written_to", not_claimed=ROBUST)
class DistrustsForGood(TextbookRobust):
    """A far measurement makes R ten times as large, and R stays so."""

    def update(self, z):
        if z is not None:
            y = self.innovation(np.reshape(np.asarray(z, dtype=float), (-1, 1)))
            if self.length(y, self.covariance(self.P)) > 5.0:
                self.R = 10.0 * self.R
        super().update(z)


@wrong("influence_of_one_measurement_is_bounded", "order_of_sensors_changes_nothing", not_claimed=ROBUST)
class WatchesTheFirstSensor(TextbookRobust):
    """Only the first sensor is known to have outliers, and only it is bounded."""

    def length(self, y, S):
        return abs(y[0, 0]) / math.sqrt(S[0, 0])

    def bounded(self, y, d):
        y = y.copy()
        y[0] *= min(1.0, self.k / max(d, 1e-300))
        return y


@wrong("what_is_cut_off_makes_nothing_certain", not_claimed=ROBUST)
class LargerRForTheStateAlone(TextbookRobust):
    """R grows with the square of a far innovation and makes the gain of x; P+ is that of the told R."""

    def update(self, z):
        if z is None:
            return
        told, P = self.R, self.P
        y = self.innovation(np.reshape(np.asarray(z, dtype=float), (-1, 1)))
        d = self.length(y, self.covariance(P))
        self.R = told * max(1.0, d / self.k) ** 2
        Textbook.update(self, z)
        self.R = told
        S = self.covariance(P)
        self.P = self.shrunk(P, self.gain(P, S), S)


@wrong("influence_of_one_measurement_is_bounded", "nothing_is_remembered_but_x_and_P", not_claimed=ROBUST)
class JudgedByASpreadThatItEnters(TextbookRobust):
    """What is far is told by the mean square of the last ten innovations, the present one with them."""

    def __init__(self, dim_x, dim_z):
        super().__init__(dim_x, dim_z)
        self.lengths = []

    def length(self, y, S):
        d = super().length(y, S)
        self.lengths = [*self.lengths[-9:], d]
        return d / math.sqrt(np.mean(np.square(self.lengths)))
