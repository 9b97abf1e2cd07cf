"""A right filter, a right robust filter, and many wrong ones: each with one fault, and the checks whose name fits it.

``caught_by`` lists the checks that name the fault; ``not_claimed`` what the filter does not pretend to do. A fault is
here for what no other one shows of a check: another branch, another argument, a size near its limit, a late hour.
"""

from __future__ import annotations

import copy
import math

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter

PLAIN = ("robust", "nan", "validates")
WITHOUT_NAN = ("robust", "validates")
ROBUST = ("nan", "validates", "likelihood")
WRONG_FILTERS = []


def wrong(*caught_by, not_claimed=PLAIN):
    """Return a decorator that puts a class on the list, with the checks that catch it."""

    def enlist(cls):
        cls.caught_by, cls.not_claimed = caught_by, tuple(not_claimed)
        WRONG_FILTERS.append(cls)
        return cls

    return enlist


class Textbook:
    """The Kalman filter as a textbook has it, cut into the pieces that can be wrong."""

    def __init__(self, dim_x, dim_z, dim_u=0):
        self.dim_x, self.dim_z = dim_x, dim_z
        self.x, self.P = np.zeros((dim_x, 1)), np.eye(dim_x)
        self.F, self.Q = np.eye(dim_x), np.eye(dim_x)
        self.H, self.R = np.zeros((dim_z, dim_x)), np.eye(dim_z)
        self.B = None
        self.y, self.S = np.zeros((dim_z, 1)), np.eye(dim_z)
        self.log_likelihood, self.corrections = 0.0, 0

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
        z = self.read(z)
        if z is None:
            self.skip()
            return
        self.corrections += 1
        self.y, self.S = self.innovation(np.reshape(z, (self.dim_z, 1))), self.covariance(self.P)
        K, size = self.gain(self.P, self.S), self.length(self.y, self.S)
        self.log_likelihood = self.likelihood(self.y, self.S)
        self.x = self.corrected(self.x, K, self.bounded(self.y, size))
        if self.counts(size):
            self.P = self.shrunk(self.P, K, self.S)

    def read(self, z):
        """The measurement as numbers, or None where nothing was measured."""
        return None if z is None else np.asarray(z, dtype=float)

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

    def length(self, y, S):
        return math.sqrt(max((y.T @ np.linalg.solve(S, y)).item(), 0.0))

    def bounded(self, y, size):
        return y

    def counts(self, size):
        """Tell whether the measurement makes P smaller."""
        return True

    def corrected(self, x, K, y):
        return x + K @ y

    def shrunk(self, P, K, S):
        I_KH = np.eye(self.dim_x) - K @ self.H
        return I_KH @ P @ I_KH.T + K @ self.noise() @ K.T

    def likelihood(self, y, S):
        squared = (y.T @ np.linalg.solve(S, y)).item()
        return -0.5 * (squared + np.linalg.slogdet(S)[1] + self.dim_z * math.log(2 * math.pi))


class TextbookRobust(Textbook):
    """Huber's psi of the length of the standardized innovation; P keeps what was cut off."""

    k = 2.0

    def bounded(self, y, size):
        return y * min(1.0, self.k / max(size, 1e-300))

    def counts(self, size):
        return size <= self.k


# Arrays, copies, input


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
class RefusesTooLate(Textbook):
    """What is wrong raises, after the innovation of it has been put away."""

    def update(self, z):
        super().update(z)
        if not (np.isfinite(self.x).all() and np.isfinite(self.P).all() and np.linalg.eigvalsh(self.P).min() > -1e-9):
            raise ValueError(f"z: expected finite numbers, got {z}")


# What is shown, extended, robust


@wrong("nonlinear_sensor_is_linearised_at_the_prediction")
class JacobianOfTheStateBefore(ExtendedKalmanFilter):
    """The Jacobian is that of the corrected state of the step before, which is at hand."""

    def predict(self, u=0):
        self.before = self.x.copy()
        super().predict(u)

    def update(self, z, HJacobian, Hx, **more):
        before = getattr(self, "before", self.x)
        super().update(z, lambda x, *args: HJacobian(before, *args), Hx, **more)


def fault(name, words, *caught_by, of=Textbook, not_claimed=None, **parts):
    """Put a class on the list that differs from a right one in these parts alone."""
    claims = not_claimed or (ROBUST if of is TextbookRobust else PLAIN)
    globals()[name] = wrong(*caught_by, not_claimed=claims)(
        type(name, (of,), {"__doc__": words, "__module__": __name__, **parts})
    )


def by_component(root, y):
    """Huber's psi of each component of a whitened innovation."""
    return root @ np.clip(np.linalg.solve(root, y), -1.5, 1.5)


def huber_without_constant(size, k):
    """-rho of a standardized innovation."""
    return -0.5 * min(size, k) ** 2 - k * max(size - k, 0.0)


def before_and_now(self, z):
    """The measurement before, the present one kept for the next."""
    before, self.before = getattr(self, "before", z), z
    return before


def kept(self, **values):
    """Keep values in a filter, and return it."""
    self.__dict__.update(values)
    return self


# fmt: off
fault("StalePrior", "The P of the last prediction, whatever was set since.", "nothing_is_remembered_but_x_and_P",
      prior=property(lambda self: self.__dict__.get("before", self.P)),
      predict=lambda self, u=None: (Textbook.predict(self, u), kept(self, before=self.P.copy())),
      gain=lambda self, P, S: Textbook.gain(self, self.prior, self.covariance(self.prior)))
fault("StartsAnewNowAndThen", "Every five hundredth correction begins with P of the start, against divergence.",
      "nothing_is_remembered_but_x_and_P",
      update=lambda self, z: Textbook.update(
          kept(self, P=self.__dict__.setdefault("start", self.P)) if self.corrections % 500 == 499 else
          kept(self, start=self.__dict__.get("start", self.P)), z))
fault("CachedById", "H is read again when another array is set, not when it is written into.",
      "matrices_may_change_between_calls",
      innovation=lambda self, z: z - self.__dict__.setdefault(f"H at {id(self.H)}", self.H.copy()) @ self.x)
fault("HoldsTheLastInput", "predict() without u takes the u of the call before.", "control_input_moves_the_prediction",
      held=None,
      predict=lambda self, u=None: Textbook.predict(kept(self, held=self.held if u is None else u), self.held))
fault("AliasedState", "x is corrected in place.", "estimates_handed_out_stay_as_they_were",
      corrected=lambda self, x, K, y: np.add(x, K @ y, out=x))
fault("ShownSWithoutR", "x is right, S is shown as H P H'.", "innovation_and_its_covariance_are_shown",
      update=lambda self, z: (Textbook.update(self, z), kept(self, S=self.S - self.noise() * (z is not None))))
fault("ShownInnovationOfTheOtherSign", "x is right, y is shown as H x - z.", "innovation_and_its_covariance_are_shown",
      innovation=lambda self, z: self.H @ self.x - z, corrected=lambda self, x, K, y: x - K @ y)
fault("Delay", "The measurement of the step before.", "measurement_counts_at_once",
      innovation=lambda self, z: Textbook.innovation(self, before_and_now(self, z)))
fault("ZeroIsNothing", "`if not np.any(z)`: a measurement of zeros is taken for none.", "measurement_counts_at_once",
      read=lambda self, z: Textbook.read(self, z) if np.any(z) else None)
fault("CachedR", "The R of the first correction.", "matrices_may_change_between_calls",
      noise=lambda self: self.__dict__.setdefault("first", self.R.copy()))
fault("NoneIsTheLastInnovation", "update(None) corrects by the last innovation again.", "none_is_no_information",
      skip=lambda self: Textbook.update(self, self.H @ self.x + self.y))
fault("NoneWidens", "update(None) makes P larger, as if there had been a prediction.", "none_is_no_information",
      skip=lambda self: setattr(self, "P", self.P + self.Q))
fault("NaNDropsAll", "One missing component, and the others are not used either.",
      "nan_is_a_sensor_that_is_not_there", not_claimed=WITHOUT_NAN,
      read=lambda self, z: None if z is None or np.isnan(z).any() else Textbook.read(self, z))
fault("RoundedToIntegers", "The new state is an array like the old one.", "integers_are_numbers_like_any_other",
      corrected=lambda self, x, K, y: (x + K @ y).astype(x.dtype))
fault("OneSided", "Cuts what is too large, not what is too small.", "mirror_image_of_the_data_gives_the_mirror_image",
      of=TextbookRobust,
      bounded=lambda self, y, size: (
          TextbookRobust.bounded(self, y, size) if (self.gain(self.P, self.S) @ y)[0] > 0 else y))
fault("OneSensorAfterAnother", "psi of L^-1 y by component, with L of Cholesky: the first sensor is privileged.",
      "order_of_sensors_changes_nothing", of=TextbookRobust, counts=lambda self, size: True,
      bounded=lambda self, y, size: by_component(np.linalg.cholesky(self.S), y))
fault("LikelihoodOfRobustFilterNotNormalized", "exp(-rho) without its integral.", "likelihood_integrates_to_one",
      of=TextbookRobust, not_claimed=("nan", "validates"),
      likelihood=lambda self, y, S: huber_without_constant(self.length(y, S), self.k))
fault("TransposedTransition", "x = F' x.", "prediction_moves_the_state_by_F",
      moved=lambda self, x, u: self.F.T @ x if u is None else Textbook.moved(self, x, u))
fault("TransposedTransitionOfP", "P = F' P F + Q.", "prediction_moves_the_covariance_by_F",
      spread=lambda self, P: self.F.T @ P @ self.F + self.Q)
fault("ForgottenQ", "P = F P F'.", "prediction_adds_Q_once", spread=lambda self, P: self.F @ P @ self.F.T)
fault("InputThroughF", "x = F (x + B u).", "control_input_moves_the_prediction",
      driven=lambda self, u: self.F @ Textbook.driven(self, u))
fault("ROnDiagonal", "The correlations of R left out.", "recording_is_filtered_as_by_the_kalman_filter",
      noise=lambda self: np.diag(np.diag(self.R)))
fault("BiasedSensor", "An offset left in from a calibration.", "small_innovations_are_believed",
      "mirror_image_of_the_data_gives_the_mirror_image",
      innovation=lambda self, z: Textbook.innovation(self, z) + 0.2)
fault("SignOfGain", "x+ = x - K y.", "small_innovations_are_believed", corrected=lambda self, x, K, y: x - K @ y)
fault("PNotUpdated", "P+ = P.", "measurement_makes_the_state_more_certain", shrunk=lambda self, P, K, S: P)
fault("PNeverSymmetrised",
      "P+ = P - K (H P) with K made of (H P)', which lets an asymmetry of P grow; with P H' it would die out.",
      "covariance_stays_one", shrunk=lambda self, P, K, S: P - K @ (self.H @ P))
fault("QDroppedLate", "After a thousand corrections the process is taken for free of noise.",
      "prediction_adds_Q_once",
      spread=lambda self, P: self.F @ P @ self.F.T + (self.Q if self.corrections <= 1000 else 0.0))
fault("CounterOverflows", "A counter of eight bits turns the sign of the step when it overflows.",
      "small_innovations_are_believed",
      corrected=lambda self, x, K, y: x + K @ y * (1 if self.corrections % 256 < 128 else -1))
fault("NaNIsItsPrediction",
      "A missing component is taken for what was predicted, and P shrinks as if it had been measured.",
      "nan_is_a_sensor_that_is_not_there", not_claimed=WITHOUT_NAN,
      innovation=lambda self, z: np.nan_to_num(Textbook.innovation(self, z)))
fault("GlobalRandomNumbers", "Jitter from numpy's global random state.", "same_data_give_the_same_numbers",
      corrected=lambda self, x, K, y: x + K @ y + 1e-12 * np.random.standard_normal(x.shape))  # noqa: NPY002
fault("BelievesInfinity", "Claims to refuse bad input, and takes an infinite z.",
      "bad_input_is_refused_and_changes_nothing", not_claimed=("robust", "nan"))
fault("PseudoInverse", "The pseudo-inverse of S takes a sensor in small units for none.", "units_change_nothing",
      gain=lambda self, P, S: P @ self.H.T @ np.linalg.pinv(S, rcond=1e-6))
fault("RoundedState", "x is kept to eight digits after the point.", "units_change_nothing",
      corrected=lambda self, x, K, y: np.round(Textbook.corrected(self, x, K, y), 8))
fault("LikelihoodWithoutConstant", "Without log 2 pi.", "likelihood_is_the_gaussian_density_of_the_innovation",
      likelihood=lambda self, y, S: Textbook.likelihood(self, y, S) + 0.5 * self.dim_z * math.log(2 * math.pi))
fault("Overconfident", "A gain of its own, and a P that is a fifth of what it should be.",
      "errors_are_as_large_as_P_says", not_claimed=(*PLAIN, "exact"),
      shrunk=lambda self, P, K, S: 0.2 * Textbook.shrunk(self, P, K, S))
fault("Sluggish", "A tenth of the gain, and an honest P.", "innovations_are_white", not_claimed=(*PLAIN, "exact"),
      gain=lambda self, P, S: 0.1 * Textbook.gain(self, P, S))
fault("Drifts", "Each prediction moves the state a little, as if there were a wind.", "errors_have_mean_zero",
      "mirror_image_of_the_data_gives_the_mirror_image", not_claimed=(*PLAIN, "exact", "prediction"),
      moved=lambda self, x, u: Textbook.moved(self, x, u) + np.sqrt(np.diag(self.Q))[:, None])
fault("GrowsSlowly", "psi = sqrt beyond the threshold: bounded it is not.",
      "influence_of_one_measurement_is_bounded", of=TextbookRobust,
      bounded=lambda self, y, size: y * (1.0 if size <= self.k else math.sqrt(self.k / size)))
fault("ThresholdInUnits", "The threshold is in the unit of z.", "units_change_nothing", of=TextbookRobust,
      length=lambda self, y, S: float(np.linalg.norm(y)))
fault("HardGate", "What is more than three sigma away is dropped, for ever.", "a_true_jump_is_followed",
      "what_is_cut_off_makes_nothing_certain", of=TextbookRobust, k=3.0,
      bounded=lambda self, y, size: y if size <= self.k else np.zeros_like(y), counts=lambda self, size: True)
fault("CutAndCertain", "P shrinks by what psi has cut off as well.", "what_is_cut_off_makes_nothing_certain",
      "a_true_jump_is_followed", of=TextbookRobust, counts=lambda self, size: True)
fault("GainTooLarge", "A fifth more than the Kalman gain.", "small_innovations_are_believed", of=TextbookRobust,
      corrected=lambda self, x, K, y: x + 1.2 * K @ y)
fault("WeightsFromR", "The innovation is judged by R alone.", "innovations_are_judged_by_their_own_deviation",
      of=TextbookRobust, length=lambda self, y, S: TextbookRobust.length(self, y, self.noise()))
fault("Timid", "Bounded far out only: most outliers come through.", "outliers_cost_little", of=TextbookRobust, k=9.5)
fault("Deaf", "A threshold of .1: good data are cut, and P knows it.", "innovations_are_white",
      "clean_data_are_used_well", of=TextbookRobust, k=0.1)
fault("QThroughF", "P = F (P + Q) F'.", "prediction_adds_Q_once",
      spread=lambda self, P: self.F @ (P + self.Q) @ self.F.T)
fault("DeadBand", "An innovation below a tenth of its deviation moves nothing.", "small_innovations_are_believed",
      corrected=lambda self, x, K, y: x + K @ y * ((y.T @ np.linalg.solve(self.S, y)).item() >= 0.01 * self.dim_z))
# fmt: on


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


#: Name: factory, what it does not claim. Those of this package are in tests/filters/test_filter_promises.py.
RIGHT_FILTERS = {
    "filterpy KalmanFilter": (KalmanFilter, PLAIN), "filterpy ExtendedKalmanFilter": (ExtendedKalmanFilter, PLAIN),
    "textbook": (Textbook, PLAIN), "textbook, robust": (TextbookRobust, ROBUST),
    "textbook, eigenvalue roots": (EigenvalueRoots, PLAIN),
}  # fmt: skip
