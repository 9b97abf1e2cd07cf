"""A right tracker, a right robust one, and many wrong ones: each with one fault, and the checks whose name fits it."""

from __future__ import annotations

import copy
import math

import numpy as np
from wrong_filters import enlisting

PLAIN = ("robust", "validates")
WRONG_TRACKERS = []
wrong = enlisting(WRONG_TRACKERS, PLAIN)


class LeastSquares:
    """Recursive least squares as a textbook has it, cut into the pieces that can be wrong."""

    def __init__(self, structure):
        n = structure.n_theta
        self.structure = structure
        self.theta, self.P = np.zeros(n), 100.0 * np.eye(n)
        self.R, self.Q = 1.0, np.zeros((n, n))
        self.outputs, self.residuals = [0.0] * (structure.na + structure.nf), [0.0] * structure.nc
        self.inputs = [[0.0] * (nb + nk) for nb, nk in structure.inputs]

    @property
    def std(self):
        return np.sqrt(np.diag(self.P))

    def phi(self, u):
        """The regressor of this sample; u is remembered."""
        for past, value in zip(self.inputs, np.atleast_1d(u), strict=True):
            past.insert(0, float(value))
            past.pop()
        return np.concatenate([self.past(), self.delayed(), np.array(self.residuals)])

    def past(self):
        return -np.array(self.outputs)

    def delayed(self):
        parts = [past[nk : nk + nb] for past, (nb, nk) in zip(self.inputs, self.structure.inputs, strict=True)]
        return np.concatenate([np.zeros(0), *map(np.array, parts)])

    def update(self, y, u):
        phi = self.phi(u)
        self.P = self.spread(self.P)
        predicted = phi @ self.theta
        known = self.is_known(y)
        if known:
            self.learn(phi, y - predicted)
        self.remember(y if known else predicted, phi, known)

    def is_known(self, y):
        return y is not None and not math.isnan(y)

    def spread(self, P):
        return P + self.Q

    def learn(self, phi, innovation):
        S = self.innovation_variance(phi)
        K = self.P @ phi / S
        self.theta = self.moved(self.theta, K, innovation, S)
        self.P = self.shrunk(self.P, K, phi, S, innovation)

    def innovation_variance(self, phi):
        return phi @ self.P @ phi + self.R

    def moved(self, theta, K, innovation, S):
        new = theta + K * innovation
        return self.stabilized(theta, new)

    def stabilized(self, old, new):
        if self.structure.nf:
            for _ in range(30):
                if np.abs(np.roots([1.0, *new[: self.structure.nf]])).max(initial=0.0) < 1.0:
                    return new
                new = old + 0.5 * (new - old)
            return old
        return new

    def shrunk(self, P, K, phi, S, innovation):
        P = P - np.outer(K, phi @ P)
        return (P + P.T) / 2

    def remember(self, y, phi, known):
        after = phi @ self.theta
        if self.outputs:
            self.outputs = [self.kept_output(float(y), after), *self.outputs[:-1]]
        if self.residuals:
            self.residuals = [self.kept_residual(float(y) - after), *self.residuals[:-1]]

    def kept_output(self, y, after):
        return float(after) if self.structure.nf else y

    def kept_residual(self, residual):
        return residual

    def predict(self, u=None):
        if u is not None or any(nk == 0 for _, nk in self.structure.inputs):
            raise NotImplementedError("only delays of one sample and more")
        kept, self.inputs = self.inputs, copy.deepcopy(self.inputs)
        predicted = float(self.phi(np.zeros(len(self.inputs))) @ self.theta)
        self.inputs = kept
        return predicted


class RobustLeastSquares(LeastSquares):
    """Huber's psi of the standardized innovation; P keeps what was cut off."""

    k = 1.5

    def moved(self, theta, K, innovation, S):
        limit = self.k * math.sqrt(S)
        return self.stabilized(theta, theta + K * min(max(innovation, -limit), limit))

    def shrunk(self, P, K, phi, S, innovation):
        return super().shrunk(P, K, phi, S, innovation) if abs(innovation) <= self.k * math.sqrt(S) else P


@wrong("autoregression_has_the_sign_of_A")
class SignOfA(LeastSquares):
    """phi = [+y(k-1) ..]."""

    def past(self):
        return np.array(self.outputs)


@wrong("parameters_stand_in_the_order_of_the_structure")
class InputsOldestFirst(LeastSquares):
    """phi has the oldest input first."""

    def delayed(self):
        return super().delayed()[::-1]


@wrong("parameters_stand_in_the_order_of_the_structure")
class InputsBeforeOutputs(LeastSquares):
    """theta = [b, a]."""

    def phi(self, u):
        phi = super().phi(u)
        na = self.structure.na + self.structure.nf
        return np.concatenate([phi[na:], phi[:na]])

    def stabilized(self, old, new):
        return new


@wrong("inputs_act_after_their_delay")
class DelayForgotten(LeastSquares):
    """nk = 1, whatever the structure says."""

    def delayed(self):
        return np.concatenate([past[1 : 1 + nb] for past, (nb, _) in zip(self.inputs, self.structure.inputs)])  # noqa: B905


@wrong("inputs_act_after_their_delay")
class OneSampleLate(LeastSquares):
    """The input is remembered after the regressor is made."""

    def phi(self, u):
        before = copy.deepcopy(self.inputs)
        super().phi(u)
        after, self.inputs = self.inputs, before
        phi = np.concatenate([self.past(), self.delayed(), np.array(self.residuals)])
        self.inputs = after
        return phi


@wrong("several_inputs_are_told_apart")
class FirstInputForAll(LeastSquares):
    """Every input is the first one."""

    def phi(self, u):
        return super().phi(np.full(len(self.inputs), np.atleast_1d(u)[0]))


@wrong("regressor_holds_the_past_alone")
class LooksAhead(LeastSquares):
    """y(k) is pushed into the memory before phi(k) is made."""

    def update(self, y, u):
        if self.outputs and self.is_known(y):
            self.outputs = [float(y), *self.outputs[:-1]]
        super().update(y, u)

    def kept_output(self, y, after):
        return self.outputs[0]

    def remember(self, y, phi, known):
        """It was remembered before."""


@wrong("output_counts_at_once")
class LearnsLate(LeastSquares):
    """theta is what was learnt until the sample before."""

    def update(self, y, u):
        if hasattr(self, "next"):
            self.theta, self.P = self.next
        before = self.theta, self.P
        super().update(y, u)
        self.next = self.theta, self.P
        self.theta, self.P = before


@wrong("noiseless_parameters_are_found")
class SignOfInnovation(LeastSquares):
    """theta moves away."""

    def moved(self, theta, K, innovation, S):
        return theta - K * innovation


@wrong("noiseless_parameters_are_found", "covariance_is_that_of_least_squares")
class PForgottenToShrink(LeastSquares):
    """P = P_0 for good."""

    def shrunk(self, P, K, phi, S, innovation):
        return P


@wrong("covariance_is_that_of_least_squares", "parameters_are_those_of_least_squares")
class GainWithoutR(LeastSquares):
    """S = phi' P phi + 1, whatever R."""

    def innovation_variance(self, phi):
        return phi @ self.P @ phi + 1.0


@wrong("covariance_is_that_of_least_squares", "parameters_are_those_of_least_squares")
class ForgetsAlways(LeastSquares):
    """A forgetting factor of .97 that nobody asked for."""

    def spread(self, P):
        return P / 0.97 + self.Q


@wrong("covariance_is_that_of_least_squares", "parameters_are_those_of_least_squares")
class ForgetsTheWrongWay(LeastSquares):
    """P times the forgetting factor."""

    def spread(self, P):
        return P * 0.97 + self.Q


@wrong("moving_parameters_are_followed")
class QForgotten(LeastSquares):
    """Parameters stand still."""

    def spread(self, P):
        return P


@wrong("standard_deviations_are_the_roots_of_P")
class StdIsVariance(LeastSquares):
    """std = diag P."""

    @property
    def std(self):
        return np.diag(self.P)


@wrong("intervals_hold_the_truth", not_claimed=(*PLAIN, "exact"))
class TooSure(LeastSquares):
    """P is shown a third as large as it is."""

    def __init__(self, structure):
        super().__init__(structure)
        self.inner = self.P

    def update(self, y, u):
        self.P = self.inner
        super().update(y, u)
        self.inner, self.P = self.P, self.P / 3.0


@wrong("noise_on_the_output_gives_no_bias")
class MeasuredOutputs(LeastSquares):
    """An output-error model whose phi holds what was measured."""

    def kept_output(self, y, after):
        return y


@wrong("coloured_noise_gives_no_bias")
class ResidualsForgotten(LeastSquares):
    """An ARMAX model whose residuals stay zero."""

    def kept_residual(self, residual):
        return 0.0


@wrong("model_stays_stable")
class NoGuard(LeastSquares):
    """An output-error model may become unstable."""

    def stabilized(self, old, new):
        return new

    def kept_output(self, y, after):
        return float(np.clip(super().kept_output(y, after), -1e6, 1e6))


@wrong("missing_output_is_no_information")
class MissingIsZero(LeastSquares):
    """NaN is taken for 0."""

    def update(self, y, u):
        super().update(0.0 if not self.is_known(y) else y, u)


@wrong("missing_output_is_no_information")
class MissingIsZeroInMemory(LeastSquares):
    """Nothing is learnt at NaN, but phi holds 0 afterwards."""

    def remember(self, y, phi, known):
        super().remember(y if known else 0.0, phi, known)


@wrong("missing_output_is_no_information")
class MissingStopsTheClock(LeastSquares):
    """A sample with NaN is left out, its input too."""

    def update(self, y, u):
        if self.is_known(y):
            super().update(y, u)


@wrong("missing_output_is_no_information")
class NaNSpreads(LeastSquares):
    """NaN enters theta."""

    def is_known(self, y):
        return True


@wrong("influence_of_one_output_is_bounded", not_claimed=("validates",))
class NotRobust(LeastSquares):
    """Least squares, sold as robust."""


@wrong("influence_of_one_output_is_bounded", not_claimed=("validates",))
class OneSided(RobustLeastSquares):
    """Cuts what is too large, not what is too small."""

    def moved(self, theta, K, innovation, S):
        return self.stabilized(theta, theta + K * min(innovation, self.k * math.sqrt(S)))


@wrong("outliers_cost_little", not_claimed=("validates",))
class Timid(RobustLeastSquares):
    """Cuts far out only."""

    k = 9.0


@wrong("small_innovations_are_believed", not_claimed=("validates",))
class GainTooLarge(RobustLeastSquares):
    """A fifth more than the Kalman gain."""

    def moved(self, theta, K, innovation, S):
        return super().moved(theta, 1.2 * K, innovation, S)


@wrong("innovations_are_judged_by_their_own_deviation", not_claimed=("validates",))
class WeightsFromR(RobustLeastSquares):
    """The innovation is judged by R alone."""

    def moved(self, theta, K, innovation, S):
        return super().moved(theta, K, innovation, self.R)

    def shrunk(self, P, K, phi, S, innovation):
        return LeastSquares.shrunk(self, P, K, phi, S, innovation) if innovation**2 <= self.k**2 * self.R else P


@wrong("what_is_cut_off_makes_nothing_certain", not_claimed=("validates",))
class CutAndCertain(RobustLeastSquares):
    """P shrinks by what psi has cut off as well."""

    def shrunk(self, P, K, phi, S, innovation):
        return LeastSquares.shrunk(self, P, K, phi, S, innovation)


class Counts(LeastSquares):
    """Knows how many samples there have been."""

    count = 0

    def update(self, y, u):
        self.count += 1
        super().update(y, u)


@wrong("small_innovations_are_believed")
class GainFrozenLate(Counts):
    """After a hundred samples the gain stays what it is."""

    def moved(self, theta, K, innovation, S):
        if self.count <= 100:
            self.frozen = K
        return super().moved(theta, self.frozen, innovation, S)


@wrong("Q_is_added_at_any_age")
class QDroppedLate(Counts):
    """After a thousand samples parameters stand still."""

    def spread(self, P):
        return P + (self.Q if self.count <= 1000 else 0.0)


@wrong("covariance_is_that_of_least_squares")
class ForgetsLate(Counts):
    """A forgetting factor that nobody asked for, once the tracker has settled."""

    def spread(self, P):
        return super().spread(P) / (1.0 if self.count <= 500 else 0.98)


@wrong("small_innovations_are_believed")
class Retires(Counts):
    """Each sample counts a little less than the one before."""

    def moved(self, theta, K, innovation, S):
        return super().moved(theta, K * 0.9995**self.count, innovation, S)


@wrong("inputs_are_copied")
class AliasedInput(LeastSquares):
    """Keeps the caller's array, and reads it a sample later."""

    def phi(self, u):
        before = getattr(self, "held", np.zeros(len(self.inputs)))
        for past, value in zip(self.inputs, np.atleast_1d(before), strict=True):
            past[0] = float(value)
        self.held = u if isinstance(u, np.ndarray) else np.atleast_1d(u).astype(float)
        return super().phi(u)


@wrong("estimates_handed_out_stay_as_they_were")
class ThetaInPlace(LeastSquares):
    """theta is one array for ever."""

    def moved(self, theta, K, innovation, S):
        theta[:] = super().moved(theta.copy(), K, innovation, S)
        return theta


_MEMORY: dict[int, list] = {}


@wrong("two_estimators_share_nothing")
class SharedMemory(LeastSquares):
    """All trackers of one order remember the same outputs."""

    def __init__(self, structure):
        super().__init__(structure)
        self.outputs = _MEMORY.setdefault(structure.na + structure.nf, self.outputs)

    def remember(self, y, phi, known):
        shared = self.outputs
        super().remember(y, phi, known)
        shared[:] = self.outputs
        self.outputs = shared


@wrong("deepcopies_go_on_alike")
class ShallowDeepcopy(LeastSquares):
    """A deepcopy shares the memory of inputs."""

    def __deepcopy__(self, memo):
        return copy.copy(self)


@wrong("pickles_go_on_alike")
class HoldsALambda(LeastSquares):
    """Cannot be pickled."""

    def __init__(self, structure):
        super().__init__(structure)
        self.transform = lambda y: y


@wrong("run_is_update_by_update")
class RunStartsAtRest(LeastSquares):
    """run(y, u) forgets the outputs and inputs before it."""

    def run(self, y, u):
        fresh = type(self)(self.structure)
        self.outputs, self.inputs, self.residuals = fresh.outputs, fresh.inputs, fresh.residuals
        for output, value in zip(y, u, strict=True):
            self.update(output, value)


@wrong("prediction_changes_nothing")
class PredictionAdvances(LeastSquares):
    """predict() remembers an input of 0."""

    def predict(self, u=None):
        return float(self.phi(np.zeros(len(self.inputs))) @ self.theta)


@wrong("bad_input_is_refused_and_changes_nothing", not_claimed=("robust",))
class BelievesInfinity(LeastSquares):
    """Claims to refuse bad input, and takes what comes."""


@wrong("stored_states_go_on_alike")
class StateWithoutMemory(LeastSquares):
    """state() has theta and P alone."""

    def state(self):
        return {"theta": self.theta.copy(), "P": self.P.copy(), "R": self.R, "Q": self.Q.copy()}

    def restore(self, state):
        self.__dict__.update(copy.deepcopy(state))


@wrong("covariance_stays_one")
class ShrinksTooMuch(LeastSquares):
    """A little more is taken from P than was learnt."""

    def shrunk(self, P, K, phi, S, innovation):
        return super().shrunk(P, 1.02 * K, phi, S, innovation)
