"""Mixin of the robust filters: options, diagnostics of the last correction, robust log-likelihood."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._arrays import state_of
from robust_filterpy._checks import Array
from robust_filterpy.correction.result import Correction
from robust_filterpy.filters._correlated import look_at_signs
from robust_filterpy.filters._options import OptionsMixin
from robust_filterpy.filters._outlier_share import EVERY, Share
from robust_filterpy.filters._parts import log_density
from robust_filterpy.filters._policy import policy_of
from robust_filterpy.filters._printing import PrintingMixin
from robust_filterpy.filters._sensors import Customs
from robust_filterpy.filters._step import StepMixin
from robust_filterpy.filters.snapshot import SLOTS, whole
from robust_filterpy.filters.states import StateMixin
from robust_filterpy.filters.stuck import look_for_repeats, look_for_stuck
from robust_filterpy.kernel.moments import Taken
from robust_filterpy.kernel.record import correction_of, weights_of

_DEFAULT_INVERSE = np.linalg.inv
Inverse = Callable[[Array], Array]


class _Emptied(NamedTuple):
    """A correction with nothing observed, made when somebody looks."""

    last: Any
    #: Of the innovation.
    log_density: float = 0.0

    def as_arrays(self) -> Correction:
        """Return what led to it."""
        last = self.last if type(self.last) is Correction else self.last.as_arrays()
        zero, none = np.zeros_like(last.y), np.full(last.y.shape, np.nan)
        return last._replace(y=zero, score=zero, e=zero, weights=none, psi_deriv=none, log_density=0.0, memory=None)


class RobustFilterMixin(OptionsMixin, PrintingMixin, StepMixin, StateMixin):
    """Add to a filter of filterpy's the choices of a robust correction and the attributes that show what it did.

    Comes before filterpy's class among the bases. The filter stores its `Correction` in ``_last`` and sets
    ``_y = _S = _SI = None`` (and ``_K = None``, unless it sets K).
    """

    __slots__ = SLOTS

    #: Whether z is a column after `update(None)` though x is none, as filterpy has it.
    _none_is_column = False

    def _set_policy(self, dim_z: int, *choices: Any) -> None:
        """Check and keep what was chosen, as `policy_of` takes it; called before filterpy's constructor."""
        self._policy = policy_of(*choices)
        self._require_possible(self._policy)
        self._choices, self._last, self._outlier_probability = self._policy.choices, None, 0.0
        self._share, self._signs, self._updates, self._process_scales = Share(), None, 0, None
        self._kept = self._y = self._S = self._SI = self._K = None
        # The kernel takes arrays of the right shape, from the first measurement on.
        self._keep_sensors(Customs(self._policy.begin(dim_z), {}))
        self._named_sensors = {}

    def _start(self) -> None:
        """Let what is kept beside x and P begin at them; called at the end of a constructor."""
        x, P = state_of(self)
        self._kept = self._policy.start(np.ravel(x), P, self.dim_z)

    @property
    def _inverse(self) -> Inverse | None:
        """What the user wants S inverted by, None if that is what filterpy does by default."""
        return None if self.inv is _DEFAULT_INVERSE else self.inv

    @property
    def weights(self) -> Array:
        """psi(e)/e of the last correction, shape of y; NaN where a component was missing."""
        if type(self._last) is np.ndarray:
            # What wraps a filter asks for these alone at every step; the whole record takes longer than the step.
            found = weights_of(self._last)
            return found if np.ndim(self.x) == 1 else found[:, None]
        return self._shown("weights", np.nan)

    @property
    def clipped(self) -> np.ndarray:
        """Whether psi'(e) <= 0 in the last correction, shape of y."""
        return self._shown("clipped", False)

    @property
    def e(self) -> Array:
        """Standardized innovation T y of the last correction, shape of y (paper 29)."""
        return self._shown("e", 0.0)

    @property
    def y_bounded(self) -> Array:
        """Bounded innovation T^-1 psi(T y) of the last correction, shape of y, in the unit of z."""
        return self._shown("y_bounded", 0.0)

    @property
    def T(self) -> Array:
        """Scaling of the last correction, shape (dim_z, dim_z) (paper 36)."""
        last = self._arrays()
        return np.eye(self.dim_z) if last is None or not last.order else last.T

    def _look(self, last: Any) -> None:
        """Count a correction, and look now and then whether most of them clip."""
        self._updates += 1
        if self._policy.noise is not None:
            look_for_stuck(self, last.weights)
            if self._counts_clipped:
                self._signs = look_at_signs(self, self._signs, last, self._updates)
        # Under a mixture psi follows from probabilities, and by custom from what is usual: no share is expected there.
        expected = self._policy.noise is None and self._choices.scaling == "innovation"
        if expected and self._counts_clipped and self._updates % EVERY == 0:
            self._share.look(self, last if isinstance(last, Correction) else last.as_arrays())

    def _look_back(self, weights: Array, y: Array) -> None:
        """Look whether most corrections of a recording clip, whose weights and innovations have shape (N, m)."""
        if self._counts_clipped:
            self._share.look_at_recording(self, weights, y)

    def _keep(self, last: Any, kept: Any, z: Array, passed: Array | None = None) -> None:
        """Write a correction and the measurement it came from, z of shape (m,), into the attributes."""
        column = np.ndim(self.x) == 2
        if not (np.isfinite(last.x).all() and np.isfinite(last.P).all()):
            raise ValueError("update: expected a finite x and P, got NaN or infinity; check z, P and R, or units")
        self._learn(last.memory, len(z), passed)
        if self._policy.noise is None and last.memory is not None:
            look_for_repeats(self, last.memory)
        self._look(last)
        self.x = last.x[:, None] if column else last.x
        self.P, self._last, self._kept = last.P, last, kept
        self._outlier_probability = getattr(last, "outlier_probability", 0.0)
        self.z = z[:, None] if column else z
        self._y = self._S = self._SI = self._K = None
        self._as_posterior()

    @whole
    def _skip(self) -> None:
        """Do what filterpy does for update(None), and forget the last innovation."""
        m, column = self.dim_z, np.ndim(self.x) != 1
        self.z = np.full((m, 1) if column or self._none_is_column else m, None)
        self.y = np.zeros((m, 1) if column else m)
        # S, SI and K stay: those that were asked for, and those that the last correction tells on request.
        self._last, self._outlier_probability = self._emptied(), 0.0
        self._as_posterior()

    def _as_posterior(self) -> None:
        """Show x and P as what a correction has made of them, and let its likelihood be computed anew."""
        self.x_post, self.P_post = np.copy(self.x), np.copy(self.P)
        self._log_likelihood = self._likelihood = self._mahalanobis = None

    def _emptied(self) -> _Emptied | None:
        """Return the last correction with nothing observed: the scaling stays, the innovation is forgotten."""
        last = self._record()
        return last if last is None or type(last) is _Emptied else _Emptied(last)

    def _log_density(self, y: Array, S: Array) -> float:
        """Return the log-likelihood of an innovation: the correction of a state without components."""
        memory = self._known(len(y)).memory if self._learns_spread else None
        return log_density(y, S, self._choices, memory, self._inverse is not None)

    def _record(self) -> Any:
        """Return the last correction, or what makes one by `as_arrays`; x_post and P_post belong to it no longer."""
        return Taken(self.x_post, self.P_post, self._last, None) if type(self._last) is np.ndarray else self._last

    def _arrays(self) -> Correction | None:
        """Return the last correction, as arrays."""
        if type(self._last) is np.ndarray:
            self._last = correction_of(self._last, self.x_post, self.P_post)
        elif self._last is not None and type(self._last) is not Correction:
            self._last = self._last.as_arrays()
        return self._last  # type: ignore[no-any-return]

    def _shown(self, name: str, absent: Any) -> Array:
        """Return a field of the last correction in the shape that y has for this kind of state."""
        column, last = np.ndim(self.x) != 1, self._arrays()
        if last is None:
            return np.full((self.dim_z, 1) if column else self.dim_z, absent)
        values = np.array(getattr(last, name))
        return values[:, None] if column else values

    # y, S, SI and K are filterpy's. Few programs look at them at every step, so they are made when asked for.

    @property
    def y(self) -> Array:
        """Innovation z - H x of the last correction, 0 where missing, shape (dim_z, 1) or (dim_z,)."""
        if self._y is None:
            self._y = self._shown("y", 0.0)
        return self._y

    @y.setter
    def y(self, value: Array) -> None:
        self._y = value

    @property
    def S(self) -> Array:
        """Innovation covariance H P H' + R, shape (dim_z, dim_z)."""
        if self._S is None:
            self._S = self._arrays().S  # type: ignore[union-attr]
        return self._S

    @S.setter
    def S(self, value: Array) -> None:
        self._S = value

    @property
    def SI(self) -> Array:
        """Inverse of S, shape (dim_z, dim_z)."""
        if self._SI is None:
            last = self._arrays()
            inverse = self._inverse
            self._SI = last.inverse if inverse is None else inverse(last.S)  # type: ignore[union-attr]
        return self._SI

    @SI.setter
    def SI(self, value: Array) -> None:
        self._SI = value

    @property
    def K(self) -> Array:
        """Gain before psi, C T'T, shape (dim_x, dim_z)."""
        if self._K is None:
            self._K = self._arrays().K  # type: ignore[union-attr]
        return self._K

    @K.setter
    def K(self, value: Array) -> None:
        self._K = value

    @property
    def log_likelihood(self) -> float:
        """Log-likelihood of the last measurement under the density of psi; 0 if it was missing altogether."""
        if self._log_likelihood is None:
            last = self._arrays() if type(self._last) is np.ndarray else self._last
            self._log_likelihood = 0.0 if last is None else last.log_density
        return self._log_likelihood

    @property
    def likelihood(self) -> float:
        """exp(log_likelihood), at least the smallest normal float."""
        if self._likelihood is None:
            self._likelihood = max(math.exp(min(self.log_likelihood, 700.0)), sys.float_info.min)
        return self._likelihood

    @property
    def mahalanobis(self) -> float:
        """Length of the innovation in standard deviations, sqrt(y' S^-1 y), the Kalman filter's."""
        if self._mahalanobis is None:
            y, last = np.ravel(self.y), self._arrays()
            # After `update_sequential` S and SI are not those of y.
            SI = self.SI if last is None or self._inverse is not None else last.inverse
            peak = float(np.abs(y).max()) or 1.0
            length = math.sqrt(max(float(y / peak @ SI @ (y / peak)), 0.0))
            self._mahalanobis = min(peak * length, sys.float_info.max)
        return self._mahalanobis


def leave_unwatched(kf: RobustFilterMixin) -> None:
    """Let a filter count no clipped innovations: what wraps it watches them."""
    kf._counts_clipped = False
