"""A right filter, a right robust filter, and many wrong ones: each with one fault, and the checks whose name fits it.

``caught_by`` lists the checks that name the fault; ``not_claimed`` what the filter does not pretend to do.
"""

from __future__ import annotations

import copy
import math

import numpy as np

PLAIN = ("robust", "nan", "validates")
WRONG_FILTERS = []


def enlisting(register, plain):
    """Return a decorator that puts a class on a list of wrong ones, with the checks that catch it."""

    def wrong(*caught_by, not_claimed=plain):
        def enlist(cls):
            cls.caught_by, cls.not_claimed = caught_by, tuple(not_claimed)
            register.append(cls)
            return cls

        return enlist

    return wrong


wrong = enlisting(WRONG_FILTERS, PLAIN)


class Textbook:
    """The Kalman filter as a textbook has it, cut into the pieces that can be wrong."""

    def __init__(self, dim_x, dim_z, dim_u=0):
        self.dim_x, self.dim_z = dim_x, dim_z
        self.x, self.P = np.zeros((dim_x, 1)), np.eye(dim_x)
        self.F, self.Q = np.eye(dim_x), np.eye(dim_x)
        self.H, self.R = np.zeros((dim_z, dim_x)), np.eye(dim_z)
        self.B = None
        self.y, self.S = np.zeros((dim_z, 1)), np.eye(dim_z)
        self.log_likelihood = 0.0

    def predict(self, u=None):
        self.x = self.moved(self.x, u)
        self.P = self.spread(self.P)

    def moved(self, x, u):
        x = self.F @ x
        return x if u is None or self.B is None else x + self.driven(u)

    def driven(self, u):
        return self.B @ np.reshape(u, (-1, 1))

    def spread(self, P):
        return self.F @ P @ self.F.T + self.Q

    def update(self, z):
        if z is None:
            self.skip()
            return
        z = np.reshape(np.asarray(z, dtype=float), (self.dim_z, 1))
        self.y, self.S = self.innovation(z), self.covariance(self.P)
        K = self.gain(self.P, self.S)
        self.log_likelihood = self.likelihood(self.y, self.S)
        self.x, self.P = self.corrected(self.x, K, self.y), self.shrunk(self.P, K, self.S)

    def skip(self):
        """Nothing was measured."""

    def innovation(self, z):
        return z - self.H @ self.x

    def covariance(self, P):
        return self.H @ P @ self.H.T + self.noise()

    def noise(self):
        return self.R

    def gain(self, P, S):
        return np.linalg.solve(S, self.H @ P).T

    def corrected(self, x, K, y):
        return x + K @ y

    def shrunk(self, P, K, S):
        I_KH = np.eye(self.dim_x) - K @ self.H
        return I_KH @ P @ I_KH.T + K @ self.noise() @ K.T

    def likelihood(self, y, S):
        return -0.5 * (
            (y.T @ np.linalg.solve(S, y)).item() + np.linalg.slogdet(S)[1] + self.dim_z * math.log(2 * math.pi)
        )


class TextbookRobust(Textbook):
    """Huber's psi of the length of the standardized innovation; P keeps what was cut off."""

    k = 2.0

    def update(self, z):
        if z is None:
            self.skip()
            return
        z = np.reshape(np.asarray(z, dtype=float), (self.dim_z, 1))
        self.y, self.S = self.innovation(z), self.covariance(self.P)
        d = self.length(self.y, self.S)
        K = self.gain(self.P, self.S)
        self.x = self.corrected(self.x, K, self.bounded(self.y, d))
        if self.counts(d):
            self.P = self.shrunk(self.P, K, self.S)

    def length(self, y, S):
        return math.sqrt((y.T @ np.linalg.solve(S, y)).item())

    def bounded(self, y, d):
        return y * min(1.0, self.k / max(d, 1e-300))

    def counts(self, d):
        return d <= self.k


# Prediction


@wrong("prediction_moves_the_state_by_F")
class TransposedTransition(Textbook):
    """x = F' x."""

    def moved(self, x, u):
        return self.F.T @ x if u is None else super().moved(x, u)


@wrong("prediction_moves_the_state_by_F")
class TransitionTwice(Textbook):
    """x = F F x."""

    def moved(self, x, u):
        return self.F @ super().moved(x, u) if u is None else super().moved(x, u)


@wrong("prediction_moves_the_covariance_by_F")
class TransposedTransitionOfP(Textbook):
    """P = F' P F + Q."""

    def spread(self, P):
        return self.F.T @ P @ self.F + self.Q


@wrong("prediction_moves_the_covariance_by_F")
class TransitionOnOneSide(Textbook):
    """P = F P + Q, made symmetric."""

    def spread(self, P):
        return (self.F @ P + P @ self.F.T) / 2 + self.Q


@wrong("prediction_moves_the_covariance_by_F")
class FadingMemoryLeftOn(Textbook):
    """P = 1.05 F P F' + Q."""

    def spread(self, P):
        return 1.05 * self.F @ P @ self.F.T + self.Q


@wrong("prediction_adds_Q_once")
class ForgottenQ(Textbook):
    """P = F P F'."""

    def spread(self, P):
        return self.F @ P @ self.F.T


@wrong("prediction_adds_Q_once")
class QTwice(Textbook):
    """P = F P F' + 2 Q."""

    def spread(self, P):
        return super().spread(P) + self.Q


@wrong("prediction_adds_Q_once")
class QSquared(Textbook):
    """Q taken for a deviation."""

    def spread(self, P):
        return self.F @ P @ self.F.T + self.Q @ self.Q


@wrong("prediction_adds_Q_once")
class QOnDiagonal(Textbook):
    """The correlations of Q left out."""

    def spread(self, P):
        return self.F @ P @ self.F.T + np.diag(np.diag(self.Q))


@wrong("control_input_moves_the_prediction")
class ForgottenInput(Textbook):
    """x = F x whatever u."""

    def driven(self, u):
        return np.zeros((self.dim_x, 1))


@wrong("control_input_moves_the_prediction")
class InputOfTheOtherSign(Textbook):
    """x = F x - B u."""

    def driven(self, u):
        return -super().driven(u)


@wrong("control_input_moves_the_prediction")
class InputThroughF(Textbook):
    """x = F (x + B u)."""

    def driven(self, u):
        return self.F @ super().driven(u)


# Innovation and gain


@wrong("measurement_noise_is_R")
class RSquared(Textbook):
    """R taken for a deviation."""

    def noise(self):
        return self.R @ self.R


@wrong("measurement_noise_is_R")
class RHalved(Textbook):
    """Half of R."""

    def noise(self):
        return self.R / 2


@wrong("measurement_noise_is_R")
class ROnDiagonal(Textbook):
    """The correlations of R left out."""

    def noise(self):
        return np.diag(np.diag(self.R))


@wrong("measurement_noise_is_R", "order_of_sensors_changes_nothing")
class ROfFirstSensor(Textbook):
    """The first sensor's variance for all."""

    def noise(self):
        return self.R[0, 0] * np.eye(self.dim_z)


@wrong("measurement_noise_is_R")
class MeasurementCountedTwice(Textbook):
    """Two corrections by one measurement."""

    def update(self, z):
        super().update(z)
        super().update(z)


@wrong("measurement_at_its_prediction_moves_nothing")
class SignOfH(Textbook):
    """y = z + H x."""

    def innovation(self, z):
        return z + self.H @ self.x


@wrong("measurement_at_its_prediction_moves_nothing")
class BiasedSensor(Textbook):
    """An offset left in from a calibration."""

    def innovation(self, z):
        return super().innovation(z) + 0.2


@wrong("measurement_at_its_prediction_moves_nothing")
class InnovationOfStaleState(Textbook):
    """y = z - H x with the x before the prediction."""

    def predict(self, u=None):
        self.before = self.x.copy()
        super().predict(u)

    def innovation(self, z):
        return z - self.H @ getattr(self, "before", np.zeros_like(self.x))


@wrong("innovation_and_its_covariance_are_shown")
class ShownInnovationOfTheOtherSign(Textbook):
    """x is right, y is shown as H x - z."""

    def update(self, z):
        super().update(z)
        self.y = -self.y


@wrong("innovation_and_its_covariance_are_shown")
class ShownSWithoutR(Textbook):
    """x is right, S is shown as H P H'."""

    def update(self, z):
        super().update(z)
        if z is not None:
            self.S = self.S - self.noise()


@wrong("innovation_and_its_covariance_are_shown")
class ShownResidualAfter(Textbook):
    """x is right, y is shown as z - H x+."""

    def update(self, z):
        super().update(z)
        if z is not None:
            self.y = self.innovation(np.reshape(z, (self.dim_z, 1)))


@wrong("estimate_moves_towards_the_measurement")
class SignOfGain(Textbook):
    """x+ = x - K y."""

    def corrected(self, x, K, y):
        return x - K @ y


@wrong("estimate_moves_towards_the_measurement", "ordinary_data_keep_everything_finite")
class GainWithoutS(Textbook):
    """K = P H', not divided by S."""

    def gain(self, P, S):
        return P @ self.H.T


@wrong("correction_is_the_kalman_gain_times_the_innovation")
class InverseEntryByEntry(Textbook):
    """K = P H' / S, right for one sensor."""

    def corrected(self, x, K, y):
        return x + (self.P @ self.H.T / self.S.sum(axis=1)) @ y


@wrong("correction_is_the_kalman_gain_times_the_innovation")
class GainOfCorrectedP(Textbook):
    """P is corrected first, and its P+ makes the gain."""

    def corrected(self, x, K, y):
        P = super().shrunk(self.P, K, self.S)
        return x + self.gain(P, self.covariance(P)) @ y


@wrong("correction_is_the_kalman_gain_times_the_innovation")
class HalfGain(Textbook):
    """Half of the step, for safety; P as if it were whole."""

    def corrected(self, x, K, y):
        return x + 0.5 * K @ y


@wrong("measurement_makes_the_state_more_certain")
class PNotUpdated(Textbook):
    """P+ = P."""

    def shrunk(self, P, K, S):
        return P


@wrong("measurement_makes_the_state_more_certain")
class PGrows(Textbook):
    """P+ = P + K S K'."""

    def shrunk(self, P, K, S):
        return P + K @ S @ K.T


@wrong("correction_leaves_P_minus_K_S_K")
class JosephWithoutR(Textbook):
    """P+ = (I - K H) P (I - K H)'."""

    def shrunk(self, P, K, S):
        I_KH = np.eye(self.dim_x) - K @ self.H
        return I_KH @ P @ I_KH.T


@wrong("correction_leaves_P_minus_K_S_K")
class JosephOfOtherSign(Textbook):
    """P+ = (I - K H) P (I - K H)' - K R K'."""

    def shrunk(self, P, K, S):
        I_KH = np.eye(self.dim_x) - K @ self.H
        return I_KH @ P @ I_KH.T - K @ self.R @ K.T


@wrong("correction_leaves_P_minus_K_S_K", "measurement_makes_the_state_more_certain")
class POnDiagonal(Textbook):
    """The correlations of P+ left out."""

    def shrunk(self, P, K, S):
        return np.diag(np.diag(super().shrunk(P, K, S)))


@wrong("correction_leaves_P_minus_K_S_K")
class PHalved(Textbook):
    """P+ half as large as it is."""

    def shrunk(self, P, K, S):
        return 0.5 * super().shrunk(P, K, S)


@wrong("covariance_stays_one")
class PNeverSymmetrised(Textbook):
    """P+ = P - K (H P) with K made of (H P)', which lets an asymmetry of P grow; with P H' it would die out."""

    def shrunk(self, P, K, S):
        return P - K @ (self.H @ P)


# Memory


@wrong("nothing_is_remembered_but_x_and_P")
class GainOfStepBefore(Textbook):
    """The gain that the last update computed."""

    def gain(self, P, S):
        K = super().gain(P, S)
        last, self.last = getattr(self, "last", K), K
        return last


@wrong("nothing_is_remembered_but_x_and_P")
class GainForGood(Textbook):
    """The first gain, kept."""

    def gain(self, P, S):
        if not hasattr(self, "first"):
            self.first = super().gain(P, S)
        return self.first


@wrong("nothing_is_remembered_but_x_and_P")
class StalePrior(Textbook):
    """The P of the last prediction, whatever was set since."""

    def predict(self, u=None):
        super().predict(u)
        self.prior = self.P.copy()

    def gain(self, P, S):
        P = getattr(self, "prior", P)
        return super().gain(P, self.covariance(P))


@wrong("nothing_is_remembered_but_x_and_P")
class SmoothedMeasurement(Textbook):
    """Each measurement is averaged with the one before."""

    def innovation(self, z):
        before, self.before = getattr(self, "before", z), z
        return super().innovation(0.5 * (z + before))


@wrong("measurement_counts_at_once")
class Delay(Textbook):
    """The measurement of the step before."""

    def innovation(self, z):
        before, self.before = getattr(self, "before", z), z
        return super().innovation(before)


@wrong("matrices_may_change_between_calls")
class CachedInverse(Textbook):
    """The inverse of the first R."""

    def noise(self):
        if not hasattr(self, "first"):
            self.first = self.R.copy()
        return self.first


@wrong("matrices_may_change_between_calls")
class CachedTransition(Textbook):
    """The transpose of the first F."""

    def spread(self, P):
        if not hasattr(self, "FT"):
            self.FT = self.F.T.copy()
        return self.F @ P @ self.FT + self.Q


@wrong("matrices_may_change_between_calls")
class CachedById(Textbook):
    """H is read again when another array is set, not when it is written into."""

    def innovation(self, z):
        if getattr(self, "known", None) is not self.H:
            self.known, self.copy = self.H, self.H.copy()
        return z - self.copy @ self.x


# Age


class Counts(Textbook):
    """Knows how many corrections there have been."""

    count = 0

    def update(self, z):
        self.count += 1
        super().update(z)


@wrong("small_innovations_are_believed")
class GainFrozenLate(Counts):
    """After a hundred corrections the gain stays what it is."""

    def gain(self, P, S):
        if self.count <= 100:
            self.frozen = super().gain(P, S)
        return self.frozen


@wrong("prediction_adds_Q_once")
class QDroppedLate(Counts):
    """After a thousand corrections the process is taken for free of noise."""

    def spread(self, P):
        return self.F @ P @ self.F.T + (self.Q if self.count <= 1000 else 0.0)


@wrong("small_innovations_are_believed")
class Retires(Counts):
    """Each correction counts a little less than the one before, as in stochastic approximation."""

    def corrected(self, x, K, y):
        return x + K @ y * 0.9995**self.count


@wrong("small_innovations_are_believed")
class CounterOverflows(Counts):
    """A counter of eight bits turns the sign of the step when it overflows."""

    def corrected(self, x, K, y):
        return x + K @ y * (1 if self.count % 256 < 128 else -1)


@wrong("small_innovations_are_believed", not_claimed=(*PLAIN, "memoryless"))
class RLearntFromTheFirstHundred(Counts):
    """R is what it was when it had been told a hundred times."""

    def noise(self):
        if self.count <= 100:
            self.kept = self.R.copy()
        return self.kept


@wrong("prediction_adds_Q_once")
class FadesLate(Counts):
    """A fading memory that nobody asked for, once the filter has settled."""

    def spread(self, P):
        return super().spread(P) * (1.0 if self.count <= 500 else 1.02)


# Missing measurements


@wrong("none_is_no_information")
class NoneIsTheLastMeasurement(Textbook):
    """update(None) corrects with the last z again."""

    def update(self, z):
        self.z = z = getattr(self, "z", np.zeros(self.dim_z)) if z is None else z
        super().update(z)


@wrong("none_is_no_information")
class NoneWidens(Textbook):
    """update(None) makes P larger, as if there had been a prediction."""

    def skip(self):
        self.P = self.P + self.Q


@wrong("nan_is_a_sensor_that_is_not_there", not_claimed=("robust", "validates"))
class NaNIsZero(Textbook):
    """A missing component is taken for 0."""

    def update(self, z):
        super().update(None if z is None or np.isnan(z).all() else np.nan_to_num(np.asarray(z, dtype=float)))


@wrong("nan_is_a_sensor_that_is_not_there", not_claimed=("robust", "validates"))
class NaNDropsAll(Textbook):
    """One missing component, and the others are not used either."""

    def update(self, z):
        super().update(None if z is None or np.isnan(np.asarray(z, dtype=float)).any() else z)


@wrong("nan_is_a_sensor_that_is_not_there", not_claimed=("robust", "validates"))
class NaNIsItsPrediction(Textbook):
    """A missing component is taken for what was predicted, and P shrinks as if it had been measured."""

    def innovation(self, z):
        return np.nan_to_num(super().innovation(z))


@wrong("nan_is_a_sensor_that_is_not_there", not_claimed=("robust", "validates"))
class NaNSpreads(Textbook):
    """A missing component makes x NaN."""


# Arrays, copies, input


@wrong("estimates_handed_out_stay_as_they_were", "arguments_are_not_written_to")
class AliasedState(Textbook):
    """x is corrected in place."""

    def corrected(self, x, K, y):
        x += K @ y
        return x


@wrong("arguments_are_not_written_to")
class WritesIntoMeasurement(Textbook):
    """z becomes the innovation in the caller's array."""

    def update(self, z):
        if isinstance(z, np.ndarray) and z.dtype == float:
            predicted = np.ravel(self.H @ self.x)
            super().update(z.copy())
            z -= predicted.reshape(z.shape)
        else:
            super().update(z)


@wrong("arguments_are_not_written_to")
class WritesIntoQ(Textbook):
    """P = F P F' is added to the caller's Q."""

    def spread(self, P):
        kept = self.Q.copy()
        self.Q += self.F @ P @ self.F.T
        P, self.Q[:] = self.Q.copy(), np.maximum(kept, 0.0)
        return P


_SHARED = {}


@wrong("two_estimators_share_nothing")
class SharedDefault(Textbook):
    """All filters start with one and the same array, which the first update of any of them changes."""

    def __init__(self, dim_x, dim_z, dim_u=0):
        super().__init__(dim_x, dim_z, dim_u)
        self.seen = _SHARED.setdefault((dim_x, dim_z), np.zeros(dim_z))

    def innovation(self, z):
        y = super().innovation(z)
        self.seen += np.abs(np.ravel(y))
        return y


@wrong("integers_are_numbers_like_any_other")
class RoundedToIntegers(Textbook):
    """The new state is written into an array like the old one."""

    def corrected(self, x, K, y):
        new = np.empty_like(x)
        new[:] = x + K @ y
        return new


@wrong("same_data_give_the_same_numbers")
class GlobalRandomNumbers(Textbook):
    """Jitter from numpy's global random state."""

    def corrected(self, x, K, y):
        return x + K @ y + 1e-12 * np.random.standard_normal(x.shape)  # noqa: NPY002


@wrong("deepcopies_go_on_alike")
class ShallowDeepcopy(Textbook):
    """A deepcopy shares P, into which updates write."""

    def __init__(self, dim_x, dim_z, dim_u=0):
        super().__init__(dim_x, dim_z, dim_u)
        self.count = np.zeros(1)

    def update(self, z):
        self.count += 1
        super().update(z)

    def __deepcopy__(self, memo):
        return copy.copy(self)


@wrong("pickles_go_on_alike")
class HoldsALambda(Textbook):
    """Cannot be pickled."""

    def __init__(self, dim_x, dim_z, dim_u=0):
        super().__init__(dim_x, dim_z, dim_u)
        self.inv = lambda S: np.linalg.inv(S)


@wrong("state_keeps_its_shape")
class Broadcasts(Textbook):
    """A flat z makes a matrix of a column x."""

    def update(self, z):
        if z is None or np.ndim(z) == 0:
            super().update(z)
            return
        z = np.asarray(z, dtype=float)
        self.y, self.S = z - self.H @ self.x, self.covariance(self.P)
        K = self.gain(self.P, self.S)
        self.x, self.P = self.x + K @ self.y, self.shrunk(self.P, K, self.S)


@wrong("bad_input_is_refused_and_changes_nothing", not_claimed=("robust", "nan"))
class BelievesInfinity(Textbook):
    """Claims to refuse bad input, and takes an infinite z."""


# Units


@wrong("units_change_nothing")
class Regularised(Textbook):
    """A little is added to S, in a unit of its own."""

    def gain(self, P, S):
        return super().gain(P, S + 1e-6 * np.eye(self.dim_z))


@wrong("units_change_nothing")
class PseudoInverse(Textbook):
    """The pseudo-inverse of S takes a sensor in small units for none."""

    def gain(self, P, S):
        return P @ self.H.T @ np.linalg.pinv(S, rcond=1e-6)


@wrong("units_change_nothing")
class ClippedState(Textbook):
    """No state is larger than 1000, whatever its unit."""

    def corrected(self, x, K, y):
        return np.clip(super().corrected(x, K, y), -1e3, 1e3)


@wrong("units_change_nothing")
class CovarianceWithAFloor(Textbook):
    """No variance is below 1e-6."""

    def shrunk(self, P, K, S):
        P = super().shrunk(P, K, S)
        return P + np.diag(np.maximum(1e-6 - np.diag(P), 0.0))


@wrong("units_change_nothing")
class RoundedState(Textbook):
    """x is kept to eight digits after the point."""

    def corrected(self, x, K, y):
        return np.round(super().corrected(x, K, y), 8)


# Likelihood


@wrong("likelihood_is_the_gaussian_density_of_the_innovation")
class LikelihoodWithoutDeterminant(Textbook):
    """-y' S^-1 y / 2 - m log(2 pi)/2."""

    def likelihood(self, y, S):
        return super().likelihood(y, S) + 0.5 * np.linalg.slogdet(S)[1]


@wrong("likelihood_is_the_gaussian_density_of_the_innovation")
class LikelihoodWithoutConstant(Textbook):
    """Without log 2 pi."""

    def likelihood(self, y, S):
        return super().likelihood(y, S) + 0.5 * self.dim_z * math.log(2 * math.pi)


@wrong("likelihood_is_the_gaussian_density_of_the_innovation")
class LikelihoodOfTheResidual(Textbook):
    """That of z - H x+, after the update."""

    def likelihood(self, y, S):
        return super().likelihood(y - self.H @ self.gain(self.P, S) @ y, S)


# Filters that do not claim to be the Kalman filter


@wrong("errors_are_as_large_as_P_says", not_claimed=(*PLAIN, "exact"))
class Overconfident(Textbook):
    """A gain of its own, and a P that is a fifth of what it should be."""

    def shrunk(self, P, K, S):
        return 0.2 * super().shrunk(P, K, S)


@wrong("innovations_are_white", not_claimed=(*PLAIN, "exact"))
class Sluggish(Textbook):
    """A tenth of the gain, and an honest P."""

    def gain(self, P, S):
        return 0.1 * super().gain(P, S)


@wrong("measurement_counts_at_once", "innovations_are_white", not_claimed=(*PLAIN, "exact", "memoryless"))
class ThrowsAway(Textbook):
    """Uses every eighth measurement."""

    def update(self, z):
        self.steps = getattr(self, "steps", 0) + 1
        if self.steps % 8 == 1:
            super().update(z)


@wrong(
    "errors_have_mean_zero",
    "mirror_image_of_the_data_gives_the_mirror_image",
    not_claimed=(*PLAIN, "exact", "prediction"),
)
class Drifts(Textbook):
    """Each prediction moves the state a little, as if there were a wind."""

    def moved(self, x, u):
        return super().moved(x, u) + np.sqrt(np.diag(self.Q))[:, None]


# Robust filters

ROBUST = ("nan", "validates", "likelihood")


@wrong("influence_of_one_measurement_is_bounded", not_claimed=("nan", "validates"))
class NotRobust(Textbook):
    """The Kalman filter, sold as robust."""


@wrong("influence_of_one_measurement_is_bounded", not_claimed=ROBUST)
class GrowsSlowly(TextbookRobust):
    """psi = sqrt beyond the threshold: bounded it is not."""

    def bounded(self, y, d):
        return y * (1.0 if d <= self.k else math.sqrt(self.k / d))


@wrong("mirror_image_of_the_data_gives_the_mirror_image", not_claimed=ROBUST)
class OneSided(TextbookRobust):
    """Cuts what is too large, not what is too small."""

    def bounded(self, y, d):
        upwards = (self.gain(self.P, self.S) @ y)[0, 0] > 0
        return super().bounded(y, d) if upwards else y


@wrong("units_change_nothing", not_claimed=ROBUST)
class ThresholdInUnits(TextbookRobust):
    """The threshold is in the unit of z."""

    def length(self, y, S):
        return float(np.linalg.norm(y))


@wrong("order_of_sensors_changes_nothing", not_claimed=ROBUST)
class OneSensorAfterAnother(TextbookRobust):
    """psi of L^-1 y, component by component, with L of Cholesky: the first sensor is privileged."""

    def bounded(self, y, d):
        L = np.linalg.cholesky(self.S)
        return L @ np.clip(np.linalg.solve(L, y), -1.5, 1.5)

    def counts(self, d):
        return True


@wrong("a_true_jump_is_followed", "what_is_cut_off_makes_nothing_certain", not_claimed=ROBUST)
class HardGate(TextbookRobust):
    """What is more than three sigma away is dropped, for ever."""

    k = 3.0

    def bounded(self, y, d):
        return y if d <= self.k else np.zeros_like(y)

    def counts(self, d):
        return True


@wrong("what_is_cut_off_makes_nothing_certain", "a_true_jump_is_followed", not_claimed=ROBUST)
class CutAndCertain(TextbookRobust):
    """P shrinks by what psi has cut off as well."""

    def counts(self, d):
        return True


@wrong("small_innovations_are_believed", not_claimed=ROBUST)
class GainTooLarge(TextbookRobust):
    """A fifth more than the Kalman gain."""

    def corrected(self, x, K, y):
        return x + 1.2 * K @ y


@wrong("innovations_are_judged_by_their_own_deviation", not_claimed=ROBUST)
class WeightsFromR(TextbookRobust):
    """The innovation is judged by R alone."""

    def length(self, y, S):
        return super().length(y, self.noise())


@wrong("innovations_are_judged_by_their_own_deviation", not_claimed=ROBUST)
class WeightsFromPredictedState(TextbookRobust):
    """The innovation is judged by H P H' alone."""

    def length(self, y, S):
        return super().length(y, S - self.noise() + 1e-9 * S)


@wrong("what_is_cut_off_makes_nothing_certain", not_claimed=ROBUST)
class KeepsALittle(TextbookRobust):
    """A tenth of what was cut off stays in P, the rest is taken for known."""

    def update(self, z):
        before = self.P
        super().update(z)
        if z is not None and not self.counts(self.length(self.y, self.S)):
            self.P = 0.1 * before + 0.9 * self.shrunk(before, self.gain(before, self.S), self.S)


@wrong("outliers_cost_little", not_claimed=ROBUST)
class Timid(TextbookRobust):
    """Bounded far out only: most outliers come through."""

    k = 9.5


@wrong("innovations_are_white", "clean_data_are_used_well", not_claimed=ROBUST)
class Deaf(TextbookRobust):
    """A threshold of .1: good data are cut, and P knows it."""

    k = 0.1


@wrong("likelihood_integrates_to_one", not_claimed=("nan", "validates"))
class LikelihoodOfRobustFilterNotNormalised(TextbookRobust):
    """exp(-rho) without its integral."""

    def update(self, z):
        super().update(z)
        if z is not None:
            d = self.length(self.y, self.S)
            self.log_likelihood = -0.5 * min(d, self.k) ** 2 - self.k * max(d - self.k, 0.0)


# Right ones


class EigenvalueRoots(Textbook):
    """Right: the Kalman filter that keeps a root of P, made by eigenvalues."""

    @property
    def P(self):
        return self.root @ self.root.T

    @P.setter
    def P(self, P):
        values, vectors = np.linalg.eigh((P + P.T) / 2)
        self.root = vectors * np.sqrt(np.maximum(values, 0.0))


class NoSetter(Textbook):
    """Right, but nobody can set its P."""

    P = property(lambda self: self._P)

    def __init__(self, dim_x, dim_z):
        self._P = np.eye(dim_x)
        self.dim_x, self.dim_z, self.x = dim_x, dim_z, np.zeros((dim_x, 1))
