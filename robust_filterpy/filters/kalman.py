"""RobustKalmanFilter: filterpy's KalmanFilter with a bounded correction.

A thin shell: it turns filterpy's attributes, shapes and calls into calls of `robust_filterpy.correction`, where
the equations stand.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._arrays import (
    control_term,
    measured,
    noise_covariance,
    process_noise,
    regardless,
    require_finite_prediction,
    state_of,
)
from robust_filterpy._checks import FLOAT, Array
from robust_filterpy._filterpy import KalmanFilter
from robust_filterpy.correction.definition import embed_block, innovation_moments
from robust_filterpy.correction.options import Grouping, Information, Scaling
from robust_filterpy.correction.result import Correction
from robust_filterpy.filters import _step
from robust_filterpy.filters._mixin import RobustFilterMixin, Snapshot
from robust_filterpy.filters._outlier_share import EVERY
from robust_filterpy.filters._recording import CompiledLoop, filter_recording, is_own
from robust_filterpy.filters._sensors import Customs, nothing_known
from robust_filterpy.influence.functions import Huber, Influence

__all__ = ["RobustKalmanFilter"]


class RobustKalmanFilter(RobustFilterMixin, KalmanFilter):
    """Filter like `filterpy.kalman.KalmanFilter`, without believing outliers.

    Every attribute, method and shape is filterpy's, and so are the gains. What differs is how much of an innovation
    moves the state: sensor by sensor, the most plausible first, e = t y goes through a bounded function psi whose
    threshold is in units of what the innovations of this sensor usually are (paper 26-28 and 37-49)::

        x += C_i t s psi(e_i / s),    P -= d C_i t t C_i',    C = P H',  t = S_ii^(-1/2)

    and the innovations of the sensors still to come likewise.

    Parameters
    ----------
    dim_x : int
        Length of the state, >= 1.
    dim_z : int
        Length of the measurement, >= 1.
    dim_u : int, default 0
        Length of the control input.
    influence : Influence, default Huber(1.345)
        psi: `Huber`, `Linear` (the Kalman filter), `Hampel`, `TukeyBiweight`, `StudentT`, or any norm of
        `statsmodels.robust.norms`.
    scaling : {"learnt", "innovation", "unit", "bounded"}
        How an innovation is measured. "learnt": in its standard deviation, and thresholds in units of what that
        usually is, which is learnt; x does not depend on a common factor of P, Q and R, as the Kalman filter's does
        not. "innovation": in its standard deviation, thresholds as they are, for an S that is right (36). "unit": in
        the unit of z, the paper's modification (42)-(49), a filter only while H P H' < 1. "bounded": "unit" wherever
        that is a valid filter, "innovation" elsewhere.
    information : {"realized", "expected", "weight"}
        What an innovation takes off P. "realized": psi'(e) (46), so that P stays while innovations are clipped and a
        filter that is wrong, not its sensor, comes back. "expected": E[psi'] (40, 45), which can lock out after a true
        jump. "weight": psi(e)/e.
    grouping : {"component", "joint"} or tuple of tuple of int
        Which sensors fail together: each on its own; all, as for one sensor that reports a vector and fails as a whole;
        or those named, such as ``((0, 1), (2,))``.

    Attributes
    ----------
    weights : ndarray, shape of y
        psi(e)/e of the last update: 1 is full trust, NaN a missing component.
    clipped : ndarray of bool, shape of y
        Whether psi'(e) <= 0.
    e : ndarray, shape of y
        Standardized innovation of each sensor given those taken before it; T y while none of these was clipped.
    spread : ndarray, shape (dim_z,)
        How large each sensor's e usually is; NaN before its first.
    T : ndarray, shape (dim_z, dim_z)
        Scaling: the inverse Cholesky factor of S in the order in which the sensors were taken, T S T' = I.
    y_bounded : ndarray, shape of y
        What psi leaves of y, in the unit of z, so that x_post == x_prior + K @ y_bounded.

    Raises
    ------
    ValueError
        If a dimension or an option is out of range. Every call checks its arrays first and raises ValueError or
        TypeError before it changes anything.

    See Also
    --------
    robust_filterpy.correction.correct : The equations as a pure function.

    Notes
    -----
    ``y``, ``S``, ``SI`` and ``mahalanobis`` are those of the Kalman filter; ``K`` is the gain before psi, C T'T.
    ``log_likelihood`` is that of the least favourable density, linear in \\|e\\| beyond the threshold, with S as told.

    Under "learnt" nothing is an outlier before there is a custom: the very first reading is believed as the Kalman
    filter believes it. Sensors that take turns through ``update(z, R, H)`` are told apart by their rows of H. Where
    redundant sensors contradict one of them, the rest is charged to it as noise of its own; where a sensor's
    innovations keep their sign and height four times in a row and nobody contradicts, P grows and the state jumps. S
    and K are then those of the grown P.

    NaN (or None, or a masked entry) in z is a missing component: the others are used; y, e, y_bounded and the
    columns of K are 0 there. A measurement that is missing altogether is ``update(None)``, with log-likelihood 0.

    "unit" raises `NotPositiveDefiniteError` where it would make P indefinite and leaves the filter as it was.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy import RobustKalmanFilter
    >>> kf = RobustKalmanFilter(dim_x=2, dim_z=1)
    >>> kf.F = np.array([[1.0, 1.0], [0.0, 1.0]])
    >>> kf.H = np.array([[1.0, 0.0]])
    >>> for z in [1.0, 2.0, 3e6, 4.0]:
    ...     kf.predict()
    ...     kf.update(z)
    >>> bool(abs(kf.x[0, 0] - 4.0) < 1.5)
    True
    """

    _counts_clipped = True
    _by_kernel = True
    # K, S and SI are what `update_steadystate` goes on with.
    _settings = {name: name for name in ("F", "H", "Q", "R", "B", "M", "K", "S", "SI")} | {"alpha_sq": "_alpha_sq"}

    def __init_subclass__(cls, **options: Any) -> None:
        """See whether the kernel's steps are a subclass's too."""
        super().__init_subclass__(**options)
        cls._by_kernel = _step.is_own(cls, RobustKalmanFilter)

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        influence: Influence = Huber(),
        scaling: Scaling = "learnt",
        information: Information = "realized",
        grouping: Grouping = "component",
    ) -> None:
        """Set up filterpy's attributes and the choices."""
        for name, value, least in (("dim_x", dim_x, 1), ("dim_z", dim_z, 1), ("dim_u", dim_u, 0)):
            _checks.count(name, value, least)
        self._set_choices(influence, scaling, information, grouping)
        super().__init__(dim_x, dim_z, dim_u)
        # The kernel takes arrays of the right shape, from the first measurement on.
        self._keep_sensors(nothing_known(dim_z))
        # filterpy 1.4.5 has it as (dim_z, dim_z), with which update_correlated cannot work.
        self.M = np.zeros((dim_x, dim_z))

    def predict(
        self, u: ArrayLike | None = None, B: ArrayLike | None = None, F: ArrayLike | None = None, Q: Any = None
    ) -> None:
        """Predict the next state: x = F x + B u, P = alpha^2 F P F' + Q (paper 27, 38, 43, 48).

        Parameters
        ----------
        u : array_like, shape (dim_u,) or (dim_u, 1), or scalar, optional
            Control input.
        B : array_like, shape (dim_x, dim_u), optional
            Control matrix for this call, otherwise ``self.B``.
        F : array_like, shape (dim_x, dim_x), optional
            Transition matrix for this call, otherwise ``self.F``.
        Q : array_like, shape (dim_x, dim_x), or scalar, optional
            Process noise covariance for this call, otherwise ``self.Q``. A scalar here means Q I.

        Raises
        ------
        ValueError
            If a shape does not fit or Q is negative or not symmetric; nothing has changed then.
        """
        if B is None and F is None and Q is None and _step.predict(self, u):
            return
        x, P = regardless(self._predicted, u, B, F, Q)
        self.x, self.P = x, P
        self.x_prior, self.P_prior = x.copy(), P.copy()

    def get_prediction(
        self, u: ArrayLike | None = None, B: ArrayLike | None = None, F: ArrayLike | None = None, Q: Any = None
    ) -> tuple[Array, Array]:
        """Return what `predict` would make of x and P, and change nothing.

        Parameters
        ----------
        u, B, F, Q : optional
            As in `predict`.

        Returns
        -------
        x : ndarray, shape of ``self.x``
            Predicted state.
        P : ndarray, shape (dim_x, dim_x)
            Its covariance.
        """
        found: tuple[Array, Array] = regardless(self._predicted, u, B, F, Q)
        return found

    def _predicted(self, u: Any, B: Any, F: Any, Q: Any) -> tuple[Array, Array]:
        """Return the predicted mean, in the shape of x, and covariance."""
        x, P = state_of(self)
        F, noise, Bu = self._transition(x.shape, u, B, F, Q)
        x = F.dot(x)
        if Bu is not None:
            x = x + Bu
        P = F.dot(P).dot(F.T)
        if self._alpha_sq != 1.0:
            P *= self._alpha_sq
        P += noise
        P = 0.5 * (P + P.T)
        require_finite_prediction(x, P)
        return x, P

    def _transition(self, shape: tuple[int, ...], u: Any, B: Any, F: Any, Q: Any) -> tuple[Array, Array, Any]:
        """Return checked F, Q, and B u in the shape of x, None if there is none."""
        n = shape[0]
        F = _checks.matrix("F", self.F if F is None else F, (n, n), "dim_x")
        noise = process_noise(self.Q, Q, n)
        B = self.B if B is None else B
        return F, noise, None if B is None or u is None else control_term(B, u, shape)

    def predict_steadystate(self, u: ArrayLike | None = 0, B: ArrayLike | None = None) -> None:
        """Predict the next state and leave P as it is.

        Parameters
        ----------
        u : array_like, shape (dim_u,) or (dim_u, 1), or scalar
            Control input.
        B : array_like, shape (dim_x, dim_u), optional
            Control matrix for this call, otherwise ``self.B``.

        Raises
        ------
        ValueError
            If a shape does not fit; nothing has changed then.
        """
        x, P = state_of(self)
        x = _checks.matrix("F", self.F, (len(x), len(x)), "dim_x").dot(x)
        B = self.B if B is None else B
        if B is not None and u is not None:
            x = x + control_term(B, u, x.shape)
        require_finite_prediction(x, P)
        self.x = x
        self.x_prior, self.P_prior = x.copy(), P.copy()

    @property
    def alpha(self) -> float:
        """Fading memory factor, >= 1: P is multiplied by alpha^2 at each prediction."""
        return math.sqrt(self._alpha_sq)

    @alpha.setter
    def alpha(self, value: float) -> None:
        if not 1.0 <= _checks.real("alpha", value) < math.inf:
            raise ValueError(f"alpha: expected a finite number >= 1, got {value!r}")
        self._alpha_sq = float(value) ** 2

    def update(self, z: ArrayLike | None, R: Any = None, H: ArrayLike | None = None) -> None:
        """Correct the state by a measurement whose influence is bounded (paper 37, 39, 42, 44, 47, 49).

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar, or None
            Measurement; NaN marks a missing component, None a missing measurement.
        R : array_like, shape (dim_z, dim_z), or scalar, optional
            Noise covariance for this call, otherwise ``self.R``. A scalar here means R I.
        H : array_like, shape (m, dim_x), optional
            Measurement matrix for this call, otherwise ``self.H``; z and R then have its height m.

        Raises
        ------
        ValueError
            If a shape does not fit, z is infinite or R not positive definite; nothing has changed then.
        SingularInnovationError
            If S is singular and ``self.inv`` is numpy's inverse.
        NotPositiveDefiniteError
            If scaling is "unit" and P would become indefinite.
        """
        self._update(z, R, H, None)

    def update_correlated(self, z: ArrayLike | None, R: Any = None, H: ArrayLike | None = None) -> None:
        """Correct the state by a measurement whose noise is correlated with the state's error.

        Uses ``self.M``, shape (dim_x, dim_z): C = P H' + M and S = H P H' + H M + M' H' + R.

        Parameters
        ----------
        z, R, H : optional
            As in `update`.

        Raises
        ------
        ValueError, SingularInnovationError, NotPositiveDefiniteError
            As in `update`.
        """
        self._update(z, R, H, self.M)

    def _update(self, z: Any, R: Any, H: Any, M: Any) -> None:
        """Correct by a whole measurement; every check comes before the first assignment."""
        if _step.correct(self, z, R, H, M):
            return
        x, P = state_of(self)
        H, R, values, M = self._measurement(z, R, H, M, len(x))
        if values is None:
            self._skip()
            return
        last = regardless(self._corrected, x, P, values, H, R, M)
        if getattr(last, "memory", None) is not None:
            self._keep_sensors(self._known_sensors().updated(last.memory, None if H is self.H else H, self.H))
        self._updates += 1
        if self._updates % EVERY == 0 and self._counts_clipped:
            self._share.look(self, last)
        x_post, P_post = last.x, last.P
        if x.ndim == 1:
            values = np.atleast_1d(values)
        else:
            values = np.array([[values]]) if len(H) == 1 else values[:, None]
            if x_post.ndim == 1:
                x_post = x_post[:, None]
        self.x, self.P, self.z, self._last = x_post, P_post, values, last
        self._y = self._S = self._SI = self._K = None
        self.x_post, self.P_post = x_post.copy(), P_post.copy()
        self._log_likelihood = self._likelihood = self._mahalanobis = None

    def _measurement(self, z: Any, R: Any, H: Any, M: Any, n: int) -> tuple[Array, Array, Any, Any]:
        """Return checked H, R, z (a float, an array of shape (m,), or None if all is missing) and M."""
        given = H is not None
        H = self.H if H is None else H
        if not (type(H) is np.ndarray and H.dtype == FLOAT and H.ndim == 2 and H.shape[1] == n):
            rows = np.shape(H)[0] if given and np.ndim(H) == 2 else self.dim_z
            H = _checks.matrix("H", H, (rows, n), f"dim_z={rows}, dim_x={n}")
        m = H.shape[0]
        if m != self.dim_z and not given:
            raise ValueError(f"H: expected shape {(self.dim_z, n)} for dim_z={self.dim_z}, dim_x={n}, got {H.shape}")
        values = None if z is None else measured(z, m)
        if values is None:
            return H, self.R, None, M
        R = noise_covariance(self.R, R, m)
        if M is not None:
            M = _checks.matrix("M", M, (n, m), f"dim_x={n}, dim_z={m}")
            if not np.isfinite(M).all():
                raise ValueError("M: expected finite numbers, got NaN or infinity")
        return H, R, values, M

    def _corrected(self, x: Array, P: Array, values: Any, H: Array, R: Array, M: Any) -> Any:
        """Return the correction of x by checked values; changes nothing."""
        x, values = x.ravel(), np.atleast_1d(values)
        predicted = H.dot(x)
        if not np.isfinite(predicted).all():
            raise _not_finite(H, predicted)
        C, S = innovation_moments(P, H, R, M)
        memory = None
        if self._learns_spread:
            memory = self._known_sensors().of(len(H), None if H is self.H else H, self.H)
        return self._corrected_by(x, P, values - predicted, C, S, R, H, memory)

    def _skip(self) -> None:
        """Do what filterpy does for update(None), and forget the last innovation."""
        m = self.dim_z
        self.z = np.full((m, 1) if np.ndim(self.x) != 1 else m, None)
        self.x_post, self.P_post = np.copy(self.x), np.copy(self.P)
        self.y = np.zeros((m, 1) if np.ndim(self.x) != 1 else m)
        S, SI, K = self.S, self.SI, self.K
        self._last = self._emptied()
        self.S, self.SI, self.K = S, SI, K
        self._log_likelihood = self._likelihood = self._mahalanobis = None

    def get_update(self, z: ArrayLike | None = None) -> tuple[Array, Array]:
        """Return what `update` would make of x and P, and change nothing.

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar, or None
            Measurement, as in `update`.

        Returns
        -------
        x : ndarray, shape of ``self.x``
            Corrected state.
        P : ndarray, shape (dim_x, dim_x)
            Its covariance.
        """
        # By the step that `update` takes, to the last bit, and undone.
        before = Snapshot(self)
        try:
            self._update(z, None, None, None)
            x, P = state_of(self)
            return x.copy(), P.copy()
        finally:
            before.put_back(self)

    def update_steadystate(self, z: ArrayLike | None) -> None:
        """Correct the state with the gain K as it stands, and leave P and K as they are.

        x+ = x + K T^-1 psi(T y), with T from the S of the last correction (from H P H' + R if there was none).

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar, or None
            Measurement, as in `update`.

        Raises
        ------
        ValueError, SingularInnovationError
            As in `update`; also if K does not have shape (dim_x, dim_z).

        Notes
        -----
        K has a column of zeros for a sensor that was missing in the last `update`; let the last one before the
        steady state be complete.
        """
        x, P = state_of(self)
        n = len(x)
        H, R, values, _ = self._measurement(z, None, None, None, n)
        if values is None:
            self._skip()
            return
        m = H.shape[0]
        K = _checks.matrix("K", self.K, (n, m), f"dim_x={n}, dim_z={m}")
        S = self.S if np.shape(self.S) == (m, m) and np.any(self.S) else H.dot(P).dot(H.T) + R
        values, predicted = np.atleast_1d(values), H.dot(x).ravel()
        if not np.isfinite(predicted).all():
            raise _not_finite(H, predicted)
        y = values - predicted
        # Of the correction by this S only what psi leaves of y is used: the gain is K.
        last = self._corrected_by(x.ravel(), P, y, P @ H.T, S, R, H)
        if last.memory is not None:
            self._keep_sensors(self._known_sensors().updated(last.memory))
        SI = self.SI
        self.x = (x.ravel() + K @ last.y_bounded).reshape(x.shape)
        shape = (m, 1) if x.ndim == 2 else (m,)
        self.y, self.z, self.S, self._last = last.y.reshape(shape), values.reshape(shape), S, last
        self.K, self.SI = K, SI
        self.x_post, self.P_post = self.x.copy(), P.copy()
        self._log_likelihood = self._likelihood = self._mahalanobis = None

    def residual_of(self, z: ArrayLike) -> Array:
        """Return z - H x_prior.

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar
            Measurement.

        Returns
        -------
        ndarray, shape of y
        """
        predicted = np.dot(self.H, self.x_prior)
        return np.reshape(measured(z, len(predicted), missing=True), predicted.shape) - predicted

    def update_sequential(self, start: int, z_i: ArrayLike, R_i: Any = None, H_i: ArrayLike | None = None) -> None:
        """Correct the state by a part of the measurement: one robust correction by z[start:start + len(z_i)].

        Parameters
        ----------
        start : int
            Place of the first component in z.
        z_i : array_like, shape (k,) or (k, 1), or scalar
            The components; NaN marks a missing one.
        R_i : array_like, shape (k, k), or scalar, optional
            Their noise covariance, otherwise that block of ``self.R``.
        H_i : array_like, shape (k, dim_x), optional
            Their measurement matrix, otherwise those rows of ``self.H``.

        Raises
        ------
        ValueError, SingularInnovationError, NotPositiveDefiniteError
            As in `update`; also if the part leaves z.

        Notes
        -----
        y, K, T, e and weights keep what earlier blocks left in their places; S and SI stay as they were, as filterpy's.
        ``log_likelihood`` is that of all blocks, so that after the last one it is that of the whole measurement.
        """
        x, P = state_of(self)
        n, m, k = len(x), self.dim_z, int(np.size(z_i))
        start = _checks.count("start", start)
        part = slice(start, start + k)
        if k < 1 or start + k > m:
            raise ValueError(f"z_i: expected 1 to {m - start} numbers from start={start} for dim_z={m}, got {k}")
        H = _checks.matrix("H", self.H, (m, n), f"dim_z={m}, dim_x={n}")[part] if H_i is None else H_i
        H = _checks.matrix("H_i", np.reshape(H, (1, -1)) if k == 1 else H, (k, n), f"{k} number(s) in z_i, dim_x={n}")
        R = noise_covariance(
            _checks.matrix("R", self.R, (m, m), f"dim_z={m}")[part, part] if R_i is None else R_i, R_i, k
        )
        values = measured(z_i, k, missing=True)
        some = regardless(self._corrected_part, x, P, values, H, np.ascontiguousarray(R), start)
        some = some if isinstance(some, Correction) else some.as_arrays()
        last = embed_block(self._arrays(), some, start, m)
        seen = np.where(np.isnan(last.weights), np.nan, last.y)
        last = last._replace(log_density=self._log_density(seen, last.S))
        z = np.array([None] * m) if np.size(self.z) != m else np.ravel(self.z).copy()
        z[part] = values
        # S and SI stay what they were, as in filterpy.
        S, SI = self.S, self.SI
        self.x, self.P, self.K, self._last = some.x.reshape(x.shape), some.P, last.K, last
        self.z = (z if None in z.tolist() else z.astype(float)).reshape((m, 1) if x.ndim == 2 else m)
        self._y, self.S, self.SI = None, S, SI
        self.x_post, self.P_post = self.x.copy(), self.P.copy()
        self._log_likelihood = self._likelihood = self._mahalanobis = None

    def _corrected_part(self, x: Array, P: Array, values: Any, H: Array, R: Array, start: int) -> Any:
        """Return the correction by the sensors from place start on; changes nothing but what is known of them."""
        customs, k = self._known_sensors(), len(H)
        try:
            self._keep_sensors(Customs(customs.of(start + k)[start:], {}))
            some = self._corrected(x, P, values, H, R, None)
        finally:
            self._keep_sensors(customs)
        if getattr(some, "memory", None) is not None:
            places = customs.of(max(len(customs.places), start + k))
            places[start : start + k] = some.memory
            self._keep_sensors(Customs(places, customs.rows))
        return some

    def batch_filter(
        self,
        zs: Any,
        Fs: Any = None,
        Qs: Any = None,
        Hs: Any = None,
        Rs: Any = None,
        Bs: Any = None,
        us: Any = None,
        update_first: bool = False,
        saver: Any = None,
    ) -> tuple[Array, Array, Array, Array]:
        """Filter a whole recording.

        Parameters
        ----------
        zs : sequence of length N
            Measurements as `update` takes them: numbers, arrays, rows with NaN, None.
        Fs, Qs, Hs, Rs, Bs, us : sequence of length N, optional
            Matrices and control inputs for each step, otherwise the filter's own and no input.
        update_first : bool, default False
            Whether each step corrects first and then predicts.
        saver : filterpy.common.Saver, optional
            Its ``save()`` is called after each step.

        Returns
        -------
        means : ndarray, shape (N, dim_x) or (N, dim_x, 1)
            Corrected states.
        covariances : ndarray, shape (N, dim_x, dim_x)
            Their covariances.
        means_p : ndarray, shape of means
            Predicted states.
        covariances_p : ndarray, shape (N, dim_x, dim_x)
            Their covariances.

        Raises
        ------
        ValueError, LinAlgError
            As in `predict` and `update`, with the step named. After these, an interrupt, or an error of the saver or
            of psi, the filter is as it was before the call; what the saver has kept by then it keeps.
        """
        return filter_recording(self, zs, Fs, Qs, Hs, Rs, Bs, us, update_first, saver, self._compiled_loop(saver))

    def _compiled_loop(self, saver: Any) -> CompiledLoop | None:
        """Return what takes steps of a recording by the kernel, None if all are for the filter's own methods."""
        own = saver is None and self._inverse is None and type(self)._by_kernel
        own = own and is_own(self, RobustKalmanFilter, ("predict", "update"))
        return CompiledLoop(self) if own else None

    def rts_smoother(
        self, Xs: Array, Ps: Array, Fs: Any = None, Qs: Any = None, inv: Any = np.linalg.inv
    ) -> tuple[Array, Array, Array, Array]:
        """Smooth what `batch_filter` returned, by Rauch, Tung and Striebel.

        Parameters
        ----------
        Xs : ndarray, shape (N, dim_x) or (N, dim_x, 1)
            Corrected states.
        Ps : ndarray, shape (N, dim_x, dim_x)
            Their covariances.
        Fs, Qs : sequence of length N, optional
            Matrices of each step, otherwise the filter's own.
        inv : callable, default numpy.linalg.inv
            Inverse of a predicted covariance.

        Returns
        -------
        x : ndarray, shape of Xs
            Smoothed states.
        P : ndarray, shape (N, dim_x, dim_x)
            Their covariances.
        K : ndarray, shape (N, dim_x, dim_x)
            Gains of the smoother.
        Pp : ndarray, shape (N, dim_x, dim_x)
            Predicted covariances.

        Raises
        ------
        ValueError, TypeError
            If the lengths or shapes do not fit.
        """
        n = self.dim_x
        Xs, Ps = _checks.numbers("Xs", Xs), _checks.numbers("Ps", Ps)
        if Xs.shape[1:] not in ((n,), (n, 1)):
            raise ValueError(f"Xs: expected shape (N, {n}) or (N, {n}, 1) for dim_x={n}, got {Xs.shape}")
        if Ps.shape != (len(Xs), n, n):
            raise ValueError(f"Ps: expected shape {(len(Xs), n, n)} for {len(Xs)} states in Xs, got {Ps.shape}")
        for name, values in (("Fs", Fs), ("Qs", Qs)):
            if values is None:
                continue
            if not hasattr(values, "__getitem__") or not hasattr(values, "__len__"):
                raise TypeError(f"{name}: expected a sequence of {len(Xs)} matrices, got {type(values).__name__}")
            if len(values) < len(Xs):
                raise ValueError(f"{name}: expected an entry for each of the {len(Xs)} states in Xs, got {len(values)}")
        smoothed: tuple[Array, Array, Array, Array] = super().rts_smoother(Xs, Ps, Fs, Qs, inv)
        return smoothed

    def log_likelihood_of(self, z: ArrayLike | None) -> float:
        """Return the log-likelihood of a measurement given the present state and S.

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar, or None
            Measurement; NaN marks a missing component.

        Returns
        -------
        float
            0 if z is missing altogether.
        """
        x, _ = state_of(self)
        H, _, values, _ = self._measurement(z, None, None, None, len(x))
        if values is None:
            return 0.0
        y = np.atleast_1d(values) - H.dot(x).ravel()
        return self._log_density(y, self.S)


def _not_finite(H: Array, predicted: Array) -> ValueError:
    """Return what to raise for a predicted measurement that is NaN or infinite."""
    if not np.isfinite(H).all():
        return ValueError("H: expected finite numbers, got NaN or infinity")
    return ValueError(f"x: expected finite numbers, got H x = {predicted}")


_METHODS = ("predict", "update", "_predicted", "_transition", "_update", "_measurement", "_corrected")
