"""Filters that doubt the process as well as the measurement: the target manoeuvres, the parameter jumps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._arrays import process_noise, state_of
from robust_filterpy._checks import Array
from robust_filterpy._state import Shape
from robust_filterpy.correction.definition import nothing_observed
from robust_filterpy.correction.merging import MOST_HYPOTHESES, Hypothesis, merge
from robust_filterpy.correction.mixture import ContaminatedScore
from robust_filterpy.correction.options import Grouping
from robust_filterpy.filters._hypotheses import (
    MergedCorrection,
    ScoreFilter,
    ScoreInfluence,
    finite_product,
)
from robust_filterpy.influence.functions import Huber

__all__ = ["NoiseMatchedKalmanFilter"]


class NoiseMatchedKalmanFilter(ScoreFilter):
    """Filter with contaminated normal noises, of the measurement, of the process, or of both.

    Each step keeps every hypothesis (v ordinary or an outlier, w ordinary or a jump), weighs it by the likelihood of
    the innovation and merges them by moments. With an ordinary process this is the filter with the exact score of
    the innovation as psi and its exact second moment (Masreliez 1975)::

        v ~ (1 - eps_v) N(0, R) + eps_v N(0, ratio_v^2 R),    w ~ (1 - eps_w) N(0, Q) + eps_w N(0, ratio_w^2 Q)

    Parameters
    ----------
    dim_x : int
        Length of the state, >= 1.
    dim_z : int
        Length of the measurement, >= 1.
    dim_u : int, default 0
        Length of the control input.
    measurement : ContaminatedScore, default ContaminatedScore(0.1, 10)
        Contamination and scale ratio of v. ``ContaminatedScore(0)`` is ordinary.
    process : ContaminatedScore, default ContaminatedScore(0)
        Contamination and scale ratio of w.
    grouping : {"joint", "component"}
        Whether the sensors fail together, or each on its own: 2^dim_z hypotheses, dim_z <= 8.

    Attributes
    ----------
    outlier_probability : float
        Probability that a component of the last measurement was an outlier.
    jump_probability : float
        Probability that w was an outlier in the step before it.

    Raises
    ------
    ValueError, TypeError
        If a dimension or an option is out of range.

    See Also
    --------
    robust_filterpy.correction.merging.merge : The merging, as a pure function.

    Notes
    -----
    ``Q`` and ``R`` are the covariances of ordinary noise. After `predict`, ``P`` is that of the ordinary hypothesis,
    and so are ``S``, ``SI``, ``K`` and ``mahalanobis``; the other one enters in `update`, or, if the measurement is
    missing, at once. ``e``, ``weights`` and ``y_bounded`` describe psi, the score of the innovation; with a
    contaminated process x_post is not x_prior + K y_bounded, because the hypotheses have different gains.

    ``log_likelihood`` is that of the mixture. `update_steadystate` clips, with the Huber function for the same
    contamination. In `update_sequential` the first part decides about the jump.

    Examples
    --------
    >>> import numpy as np
    >>> kf = NoiseMatchedKalmanFilter(1, 1, measurement=ContaminatedScore(0.1, 10.0))
    >>> kf.H = np.eye(1)
    >>> kf.update(8.0)
    >>> round(kf.outlier_probability, 3)
    1.0
    >>> bool(abs(kf.x[0, 0]) < 0.1)
    True
    """

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        measurement: ContaminatedScore = ContaminatedScore(),
        process: ContaminatedScore = ContaminatedScore(0.0),
        grouping: Grouping = "joint",
    ) -> None:
        """Set up filterpy's attributes and the noise model."""
        steady = Huber.from_contamination(_model("measurement", measurement).contamination)
        super().__init__(dim_x, dim_z, dim_u, influence=steady, grouping=grouping)
        self._measurement_noise, self._process_noise = measurement, _model("process", process)
        self._require_few_sensors(grouping)
        self._jump = np.zeros((dim_x, dim_x))
        self._found = (0.0, 0.0, 0.0)

    def _require_few_sensors(self, grouping: Any) -> None:
        """Raise if every combination of failing sensors is too many."""
        if not isinstance(grouping, str):
            raise ValueError(f"grouping: expected 'joint' or 'component' for noise that is told, got {grouping!r}")
        if grouping == "component" and 2**self.dim_z > MOST_HYPOTHESES:
            raise ValueError(f"grouping: expected 'joint' for dim_z={self.dim_z} > 8, got 'component'")

    @property
    def measurement(self) -> ContaminatedScore:
        """Contamination and scale ratio of the measurement noise."""
        return self._measurement_noise

    @measurement.setter
    def measurement(self, value: ContaminatedScore) -> None:
        steady = Huber.from_contamination(_model("measurement", value).contamination)
        self._measurement_noise, self._choices = value, self._choices.changed(influence=steady)

    @property
    def process(self) -> ContaminatedScore:
        """Contamination and scale ratio of the process noise."""
        return self._process_noise

    @process.setter
    def process(self, value: ContaminatedScore) -> None:
        self._process_noise = _model("process", value)

    @property
    def influence(self) -> Any:
        """The noise of the measurement, whose score is psi; set it as ``measurement``."""
        return self._measurement_noise

    @influence.setter
    def influence(self, value: Any) -> None:
        raise AttributeError("influence: follows from the noise model; set measurement=ContaminatedScore(...)")

    @property
    def grouping(self) -> Grouping:
        """Whether the sensors fail "joint", or each "component" on its own."""
        return self._choices.grouping

    @grouping.setter
    def grouping(self, value: Grouping) -> None:
        choices = self._choices.changed(grouping=value)
        self._require_few_sensors(value)
        self._choices = choices

    @property
    def outlier_probability(self) -> float:
        """Probability that a component of the last measurement was an outlier."""
        return self._found[1]

    @property
    def jump_probability(self) -> float:
        """Probability that the process noise before the last measurement was an outlier."""
        return self._found[2]

    @property
    def process_scale(self) -> float:
        """Mean factor of Q in the step before the last measurement: 1 + (ratio^2 - 1) jump_probability."""
        return 1.0 + (self._process_noise.scale_ratio**2 - 1.0) * self.jump_probability

    def predict(
        self, u: ArrayLike | None = None, B: ArrayLike | None = None, F: ArrayLike | None = None, Q: Any = None
    ) -> None:
        """Predict the next state with ordinary process noise, and remember that it may have jumped.

        Parameters
        ----------
        u : array_like, shape (dim_u,) or (dim_u, 1), or scalar, optional
            Control input.
        B : array_like, shape (dim_x, dim_u), optional
            Control matrix for this call.
        F : array_like, shape (dim_x, dim_x), optional
            Transition matrix for this call.
        Q : array_like, shape (dim_x, dim_x), or scalar, optional
            Process noise covariance for this call; a scalar here means Q I.

        Raises
        ------
        ValueError
            If a shape does not fit; nothing has changed then.
        """
        super().predict(u, B, F, Q)
        n = self.dim_x
        noise = process_noise(self.Q, Q, n) + np.zeros((n, n))
        self._jump = (self._process_noise.scale_ratio**2 - 1.0) * noise

    def _predicted(self, u: Any, B: Any, F: Any, Q: Any) -> tuple[Array, Array]:
        """Return the predicted mean and covariance; a jump that no measurement has spoken about is part of it."""
        x, P = super()._predicted(u, B, F, Q)
        if self._may_have_jumped:
            F = np.asarray(self.F if F is None else F, dtype=float)
            P = P + self._alpha_sq * self._process_noise.contamination * F.dot(self._jump).dot(F.T)
        return x, P

    @property
    def _may_have_jumped(self) -> bool:
        """Whether there was a prediction since the last correction and the process is contaminated."""
        return not self._process_noise.is_ordinary and bool(self._jump.any())

    def _corrected(self, x: Array, P: Array, values: Any, H: Array, R: Array, M: Any) -> Any:
        """Return the correction of x by checked values; changes nothing but the records."""
        column = x.ravel()
        y = np.atleast_1d(values) - finite_product(H, column)
        part = np.flatnonzero(y == y)
        if part.size == 0:
            return nothing_observed(column, P, H.dot(P).dot(H.T) + R, len(H))
        hypotheses, bad, jumped = self._hypotheses(P, R[np.ix_(part, part)], None if M is None else M[:, part])
        merged = merge(column, y[part], H[part], hypotheses, self._inverse)
        self._found = (
            merged.log_density,
            float(merged.probabilities[bad].sum()),
            float(merged.probabilities[jumped].sum()),
        )
        influence = ScoreInfluence(merged.score, merged.information)
        return MergedCorrection(merged.x, merged.P, y, P.copy(), H.copy(), R.copy(), M, self._inverse, influence)

    def _hypotheses(self, P: Array, R: Array, M: Array | None) -> tuple[list[Hypothesis], list[int], list[int]]:
        """Return the hypotheses, and which of them have outliers, and which a jump."""
        jumps = [(1.0, P)]
        if self._may_have_jumped:
            probability = self._process_noise.contamination
            jumps = [(1.0 - probability, P), (probability, P + self._jump)]
        hypotheses: list[Hypothesis] = []
        bad: list[int] = []
        jumped: list[int] = []
        for leapt, (chance, cov) in enumerate(jumps):
            for probability, scale in self._measurement_noise.patterns(len(R), self.grouping):
                # A noise that is larger by a factor keeps its correlation with the state.
                noise, cross = np.outer(scale, scale) * R, None if M is None else M * scale
                if scale.max() > 1.0:
                    bad.append(len(hypotheses))
                if leapt:
                    jumped.append(len(hypotheses))
                hypotheses.append(Hypothesis(chance * probability, cov, noise, cross))
        return hypotheses, bad, jumped

    def _settle(self) -> None:
        """Let go of the jump that the measurement has spoken about."""
        self._jump = np.zeros_like(self._jump)

    def _skip(self) -> None:
        """Leave x as it is; a jump that no measurement denies widens P."""
        if self._may_have_jumped:
            self.P = state_of(self)[1] + self._process_noise.contamination * self._jump
        self._jump = np.zeros_like(self._jump)
        self._found = (None, 0.0, 0.0)
        super()._skip()

    def _moving(self) -> dict[str, Any]:
        """Return x, P and the jump that no measurement has spoken about."""
        return {**super()._moving(), "jump": self._jump}

    def _needed(self) -> dict[str, Shape]:
        """Return the shapes of x, P and the jump."""
        return {**super()._needed(), "jump": (self.dim_x, self.dim_x)}

    def _go_on(self, found: dict[str, Array]) -> None:
        """Take over a checked state."""
        super()._go_on(found)
        self._jump, self._found = found["jump"], (None, 0.0, 0.0)


def _model(name: str, value: Any) -> ContaminatedScore:
    """Return value if it is a noise model or raise."""
    if not isinstance(value, ContaminatedScore):
        raise TypeError(f"{name}: expected a ContaminatedScore(contamination, scale_ratio), got {value!r}")
    return value
