"""More wrong trackers: what users write, each written with the names of the checks known and not what they do.

`WRONG_TRACKERS` are these and those of `wrong_trackers`.
"""

from __future__ import annotations

import math

import numpy as np
from wrong_trackers import WRONG_TRACKERS, LeastSquares, RobustLeastSquares, wrong

__all__ = ["WRONG_TRACKERS"]


@wrong("covariance_is_that_of_least_squares", "parameters_are_those_of_least_squares")
class ResetsP(LeastSquares):
    """Whenever P has become small it starts anew, so that the tracker stays awake."""

    def spread(self, P):
        P = super().spread(P)
        return 100.0 * np.eye(len(P)) if np.trace(P) < 1e-3 * len(P) else P


@wrong("parameters_are_those_of_least_squares", "noiseless_parameters_are_found")
class SubtractsTheMean(LeastSquares):
    """The mean of the outputs so far is taken off before they are used."""

    count, mean = 0, 0.0

    def update(self, y, u):
        if self.is_known(y):
            self.count += 1
            self.mean += (y - self.mean) / self.count
            y = y - self.mean
        super().update(y, u)


@wrong("parameters_are_those_of_least_squares", "noiseless_parameters_are_found")
class ParametersWithinOne(LeastSquares):
    """No parameter is larger than 1."""

    def moved(self, theta, K, innovation, S):
        return np.clip(super().moved(theta, K, innovation, S), -1.0, 1.0)


@wrong("small_innovations_are_believed", "parameters_are_those_of_least_squares")
class DeadZone(LeastSquares):
    """An innovation within half of the noise moves nothing."""

    def moved(self, theta, K, innovation, S):
        return theta if abs(innovation) < 0.5 * math.sqrt(S) else super().moved(theta, K, innovation, S)


@wrong("standard_deviations_are_the_roots_of_P")
class DeviationsTimesR(LeastSquares):
    """std is the root of R diag P, as where P is counted in units of R."""

    @property
    def std(self):
        return np.sqrt(self.R * np.diag(self.P))


@wrong("Q_is_added_at_any_age", "moving_parameters_are_followed")
class QInUnitsOfR(LeastSquares):
    """P grows by R Q."""

    def spread(self, P):
        return P + self.R * self.Q


@wrong("missing_output_is_no_information", "Q_is_added_at_any_age")
class StandsStillWhereOutputsAreMissing(LeastSquares):
    """P does not grow by Q at a sample without an output."""

    def update(self, y, u):
        Q = self.Q
        if not self.is_known(y):
            self.Q = np.zeros_like(Q)
        super().update(y, u)
        self.Q = Q


@wrong("missing_output_is_no_information")
class MissingIsTheLastOutput(LeastSquares):
    """Nothing is learnt at NaN, but phi holds the output before it afterwards."""

    def remember(self, y, phi, known):
        super().remember(y if known or not self.outputs else self.outputs[0], phi, known)


@wrong("several_inputs_are_told_apart", "inputs_act_after_their_delay")
class DelayOfTheFirstForAll(LeastSquares):
    """Every input has the delay of the first one."""

    def delayed(self):
        nk = self.structure.inputs[0][1]
        parts = [
            (past + [0.0] * nk)[nk : nk + nb] for past, (nb, _) in zip(self.inputs, self.structure.inputs, strict=True)
        ]
        return np.concatenate([np.zeros(0), *map(np.array, parts)])


@wrong("coloured_noise_gives_no_bias")
class SignOfResiduals(LeastSquares):
    """phi holds the residuals with the sign of outputs."""

    def kept_residual(self, residual):
        return -residual


@wrong("model_stays_stable")
class GuardOfTheProductOfRoots(LeastSquares):
    """An output-error model is taken for stable if its last coefficient is below 1."""

    def stabilized(self, old, new):
        return new if not self.structure.nf or abs(new[self.structure.nf - 1]) < 1.0 else old

    def kept_output(self, y, after):
        return float(np.clip(super().kept_output(y, after), -1e6, 1e6))


@wrong("bad_input_is_refused_and_changes_nothing", not_claimed=("robust",))
class RefusedInputIsRemembered(LeastSquares):
    """What is wrong raises, after the input of it has entered the memory."""

    def update(self, y, u):
        if np.ndim(y) or not np.isfinite(np.array(u, dtype=float)).all() or np.size(u) != len(self.inputs):
            raise ValueError(f"expected one finite output and finite inputs, got {y}, {u}")
        if isinstance(y, str) or math.isinf(y):
            self.phi(u)
            raise ValueError(f"y: expected a finite number or NaN, got {y}")
        super().update(y, u)


@wrong("run_is_update_by_update")
class RunLeavesOutGaps(LeastSquares):
    """run(y, u) leaves out the samples without an output, their inputs too."""

    def run(self, y, u):
        for output, value in zip(y, u, strict=True):
            if self.is_known(output):
                self.update(output, value)


@wrong("stored_states_go_on_alike")
class StateIsShared(LeastSquares):
    """state() hands out the memories themselves, which samples after it go on to change."""

    def state(self):
        return dict(self.__dict__)

    def restore(self, state):
        self.__dict__.update(state)


@wrong("estimates_handed_out_stay_as_they_were")
class PInPlace(LeastSquares):
    """P is one array for ever."""

    def shrunk(self, P, K, phi, S, innovation):
        self.kept = P.copy() if not hasattr(self, "kept") else self.kept
        self.kept[:] = super().shrunk(P, K, phi, S, innovation)
        return self.kept


@wrong("output_counts_at_once", "parameters_are_those_of_least_squares")
class ShowsTheMeanOfParameters(LeastSquares):
    """theta is the mean of the last twenty estimates, and goes on from there."""

    def __init__(self, structure):
        super().__init__(structure)
        self.last = []

    def moved(self, theta, K, innovation, S):
        self.last = [*self.last[-19:], super().moved(theta, K, innovation, S)]
        return np.mean(self.last, axis=0)


@wrong("influence_of_one_output_is_bounded", not_claimed=())
class JudgedByASpreadThatItEnters(RobustLeastSquares):
    """What is far is told by the mean square of the last ten innovations, the present one with them."""

    def __init__(self, structure):
        super().__init__(structure)
        self.last = []

    def moved(self, theta, K, innovation, S):
        self.last = [*self.last[-9:], innovation]
        return super().moved(theta, K, innovation, max(S, np.mean(np.square(self.last))))
