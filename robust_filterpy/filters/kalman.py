"""RobustKalmanFilter: filterpy's KalmanFilter with a bounded correction.

A thin shell: it turns filterpy's attributes, shapes and calls into calls of `robust_filterpy.correction`, where
the equations stand.
"""

from __future__ import annotations

import copy
import math
from typing import TYPE_CHECKING, Any

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
from robust_filterpy._warning import warn
from robust_filterpy.correction.definition import Innovation
from robust_filterpy.filters.driver import without_rounding
from robust_filterpy.filters.policies import Bounded, Options, finite_product, with_options
from robust_filterpy.filters.problem import RecordingMixin
from robust_filterpy.filters.shell import is_own
from robust_filterpy.filters.snapshot import whole

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["RobustKalmanFilter"]


class RobustKalmanFilter(RecordingMixin, KalmanFilter):
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
    scaling : {"learnt", "innovation", "unit", "bounded"}, optional
        How an innovation is measured. "learnt": in its standard deviation, and thresholds in units of what that
        usually is, which is learned; x does not depend on a common factor of P, Q and R, as the Kalman filter's does
        not. "innovation": in its standard deviation, thresholds as they are, for an S that is right (36). "unit": in
        the unit of z, the paper's modification (42)-(49), a filter only while H P H' < 1. "bounded": "unit" wherever
        that is a valid filter, "innovation" elsewhere. Default: "learnt".
    information : {"realized", "expected", "weight"}
        What an innovation takes off P. "realized": psi'(e) (46), so that P stays while innovations are clipped and a
        filter that is wrong, not its sensor, comes back. "expected": E[psi'] (40, 45), which can lock out after a true
        jump. "weight": psi(e)/e.
    grouping : {"component", "joint"} or tuple of tuple of int
        Which sensors fail together: each on its own; all, as for one sensor that reports a vector and fails as a whole;
        or those named, such as ``((0, 1), (2,))``.
    noise : Contaminated, Learnt or "learnt", optional
        How measurements fail, instead of a bound: psi is then the score of what is given, or learned online, and
        influence, scaling and information follow from it. R is the covariance of ordinary noise, given or, under
        `Learnt`, a guess that may be wrong by a factor of 1000 either way. Default: psi bounds what an innovation does.
    process : "given", "scales", Scales or Contaminated, optional
        What the process noise may be, with `noise`: models of the filter that take it for s Q run side by side and are
        weighed by their likelihood. `Scales` keep their scale for long and know jumps and wrong starts, `Contaminated`
        draws anew in each step, "given" trusts Q, the start and the model: where one of them is wrong, R grows and the
        filter lags. Default: "scales" where the noise is learned, else "given".
    patience : int, optional
        Under "learnt", after how many readings of a sensor in a row that are far off and agree the state has jumped,
        >= 2: a run of outliers that is shorter is bounded, or left out by a redescending psi such as `TukeyBiweight`.
        Default: four until jumps have been seen, then as those and the runs of outliers before tell.

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
    R_learnt, noise_learnt, learnt, sensors_learnt : ndarray, LearntNoise, ndarray, dict of str to LearntNoise
        Under ``noise=Learnt(..)``, what has been learned: the covariance of ordinary noise, contamination and scale of
        outliers and length of their runs with standard errors, and all of it as an array that another filter can begin
        with; the second for each sensor that ``update(.., sensor=)`` names. None without.
    outlier_probability : float
        Under `noise`, the probability that a component of the last measurement was an outlier.
    process_probabilities, process_scale : ndarray, shapes (q, dim_x) and (dim_x,)
        Under `process`, the probability of each scale of Q for each state, and the mean scale; states that neither the
        model nor a sensor couples have their own.

    Raises
    ------
    ValueError
        If a dimension or an option is out of range, or options stand against each other. Every call checks its arrays
        first and raises ValueError or TypeError before it changes anything.

    See Also
    --------
    robust_filterpy.correction.definition.correct : The equations as a pure function.

    Notes
    -----
    ``y``, ``S``, ``SI`` and ``mahalanobis`` are those of the Kalman filter; ``K`` is the gain before psi, C T'T.
    ``log_likelihood`` is that of the least favorable density, linear in \\|e\\| beyond the threshold, with S as given.

    Under "learnt" nothing is an outlier before there is a typical innovation: the very first reading is believed as
    the Kalman filter believes it. Sensors that take turns through ``update(z, R, H)`` are distinguished by their rows
    of H, or by ``sensor=``. Where redundant sensors contradict one of them, the rest is added to its variance; where a
    sensor's innovations keep their sign and height as often in a row as `patience` says and nobody contradicts, P grows
    and the state jumps. S and K are then those of the grown P.

    NaN (or None, or a masked entry) in z is a missing component: the others are used; y, e, y_bounded and the
    columns of K are 0 there. A measurement that is missing altogether is ``update(None)``, with log-likelihood 0.

    "unit" raises `NotPositiveDefiniteError` where it would make P indefinite and leaves the filter as it was.

    Under `noise` an innovation moves the state by the score of its mixture, and P by the exact second moment (Masreliez
    1975); ``S``, ``SI``, ``K``, ``e`` and ``mahalanobis`` are those of ordinary noise, as learned before the
    measurement, and x_post is not x_prior + K y_bounded. ``log_likelihood`` is that of the mixture;
    `update_steadystate` clips. Under `Learnt` an outlier is what exceeds most samples: if ordinary samples are no
    longer the majority, the noise itself has grown. A program that assigns x or P assigns it to every model. The larger
    the scale_ratio that is given, the farther an outlier may lie, and the longer a jump of the state by less is taken
    for outliers.

    Under `patience` what agrees for longer is a jump: a sensor that fails for good is believed in turn. A jump of more
    than a thousand standard deviations of the innovation takes it twice. Innovations agree only while H stays about the
    same, so patience is nothing for a `ParameterTracker`: give that `noise` and `process`.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy import RobustKalmanFilter
    >>> kf = RobustKalmanFilter(dim_x=2, dim_z=1)
    >>> kf.F = np.array([[1.0, 1.0], [0.0, 1.0]])
    >>> kf.H = np.array([[1.0, 0.0]])
    >>> for z in [1.0, 2.0, 3.0, 4e6, 5.0]:
    ...     kf.predict()
    ...     kf.update(z)
    >>> bool(abs(kf.x[0, 0] - 5.0) < 1.5)
    True
    """

    _by_kernel = True
    # K, S and SI are what `update_steadystate` goes on with.
    _settings = {name: name for name in ("F", "H", "Q", "R", "B", "M", "K", "S", "SI")} | {"alpha_sq": "_alpha_sq"}

    def __init_subclass__(cls, **options: Any) -> None:
        """See whether the kernel's steps are a subclass's too."""
        super().__init_subclass__(**options)
        cls._by_kernel = is_own(cls, RobustKalmanFilter)

    @with_options
    def __init__(self, dim_x: int, dim_z: int, dim_u: int = 0, **options: Unpack[Options]) -> None:
        """Set up filterpy's attributes and the choices."""
        self._set_policy(options, dim_x=dim_x, dim_z=dim_z, dim_u=dim_u)
        super().__init__(dim_x, dim_z, dim_u)
        # filterpy 1.4.5 has it as (dim_z, dim_z), with which update_correlated cannot work.
        self.M = np.zeros((dim_x, dim_z))
        self._start()

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
        Q = self._noise_of_number(Q)
        if not self._predict_by_kernel(u, B, F, Q):
            self._predict(u, B, F, Q)

    @whole
    def _predict(self, u: Any, B: Any, F: Any, Q: Any) -> None:
        """Predict by the definition."""
        x, P = state_of(self)
        F, noise, Bu = self._transition(x.shape, u, B, F, Q)
        x, P, carried = regardless(self._policy.predicted, self._kept, x, P, F, noise, Bu, float(self._alpha_sq))
        regardless(require_finite_prediction, x, P)
        self.x, self.P, self._kept = x, P, carried
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
        twin = copy.deepcopy(self)
        RobustKalmanFilter.predict(twin, u, B, F, Q)
        return state_of(twin)

    def _transition(self, shape: tuple[int, ...], u: Any, B: Any, F: Any, Q: Any) -> tuple[Array, Array, Any]:
        """Return checked F, Q, and B u in the shape of x, None if there is none."""
        n = shape[0]
        F = _checks.matrix("F", self.F if F is None else F, (n, n), "dim_x")
        noise = process_noise(self.Q, Q, n)
        B = self.B if B is None else B
        return F, noise, None if B is None or u is None else control_term(B, u, shape)

    def _noise_of_number(self, Q: Any) -> Any:
        """Return Q of a prediction; where the filter's own is a number, the matrix that it stands for, and warn."""
        n = self.dim_x
        if Q is not None or n == 1 or np.ndim(self.Q):
            return Q
        noise = process_noise(self.Q, None, n)
        everywhere = self._choices.is_linear and self.noise is None
        does = "is added to every entry of P, as by filterpy" if everywhere else "means times I here"
        q = f"{float(self.Q):.6g}"
        warn(f"Q: expected a matrix, got the number {q}, which {does}; use {q}*np.eye({n})")
        return np.full((n, n), float(self.Q)) if everywhere else noise

    @whole
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
        if not 1.0 <= _checks.real("alpha", value) < 1e154:
            raise ValueError(f"alpha: expected a number >= 1 whose square is finite, got {_checks.shown(value)}")
        self._alpha_sq = float(value) ** 2

    def update(
        self, z: ArrayLike | None, R: Any = None, H: ArrayLike | None = None, *, sensor: str | int | None = None
    ) -> None:
        """Correct the state by a measurement whose influence is bounded (paper 37, 39, 42, 44, 47, 49).

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar, or None
            Measurement; NaN marks a missing component, None a missing measurement.
        R : array_like, shape (dim_z, dim_z), or scalar, optional
            Noise covariance for this call, otherwise ``self.R``. A scalar here means R I.
        H : array_like, shape (m, dim_x), optional
            Measurement matrix for this call, otherwise ``self.H``; z and R then have its height m.
        sensor : str or int, optional
            Whose reading it is, where several sensors take turns: what is learned of noise (or of how large innovations
            usually are) belongs to it. Without, a sensor is identified by its place in z, or by its row of an H that is
            passed; two that see the same through one row would have one noise.

        Raises
        ------
        ValueError, TypeError
            If a shape does not fit, z is infinite or R not positive definite; nothing has changed then.
        SingularInnovationError
            If S is singular and ``self.inv`` is numpy's inverse.
        NotPositiveDefiniteError
            If scaling is "unit" and P would become indefinite.
        """
        if sensor is not None:
            self._spoken(sensor, lambda: RobustKalmanFilter.update(self, z, R, H))
        elif not self._correct_by_kernel(z, R, H, None):
            self._correct(z, R, H, None)

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
        if not self._correct_by_kernel(z, R, H, self.M):
            self._correct(z, R, H, self.M)

    @whole
    def _correct(self, z: Any, R: Any, H: Any, M: Any) -> None:
        """Correct by the definition."""
        x, P = state_of(self)
        own = self.H
        H, R, values, M = self._measurement(z, R, H, M, len(x))
        if values is None:
            self._skip()
            return
        passed = None if H is own else H
        last, carried = regardless(self._corrected, x, P, values, H, R, M, self._prior(len(H), passed))
        self._keep(last, carried, np.atleast_1d(values), passed)

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

    def _corrected(self, x: Array, P: Array, values: Any, H: Array, R: Array, M: Any, before: Any) -> tuple[Any, Any]:
        """Return the correction of x by checked values, and what else the policy keeps; changes nothing."""

        def correct(before: Any, P: Array) -> Any:
            """Correct with this P."""
            return self._policy.corrected(before, x.ravel(), P, np.atleast_1d(values), H, R, M, self._skips)

        return without_rounding(type(self).__name__, correct, before, P, H, R)  # type: ignore[no-any-return]

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
        # By the step that `update` takes, to the last bit, of a twin: what is interrupted has then changed nothing.
        twin = copy.deepcopy(self)
        RobustKalmanFilter.update(twin, z)
        return state_of(twin)

    @whole
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
        values = np.atleast_1d(values)
        y = values - finite_product(H, x.ravel())
        # Of the correction by this S only what psi leaves of y is used: the gain is K.
        before, C, SI = self._prior(m)._replace(carried=None), P @ H.T, self.SI
        innovation = Innovation(values, y, C, np.asarray(S, dtype=float), R)
        if self.noise is None and self._stepped(values, None, *innovation[1:5]):
            last: Any = self._arrays()
        else:
            last, _ = Bounded(self._choices).corrected_by_moments(before, x.ravel(), P, innovation, self._skips)
            self._learn(last.memory, m)
        self.x = (x.ravel() + K @ last.y_bounded).reshape(x.shape)
        shape = (m, 1) if x.ndim == 2 else (m,)
        self.y, self.z, self.S, self.P, self._last = last.y.reshape(shape), values.reshape(shape), S, P, last
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
        It is `update` by a z in which the other components are missing, and shows what that shows.
        """
        m, k = self.dim_z, 1 if isinstance(z_i, float) else int(np.size(z_i))
        start = _checks.count("start", start)
        part = slice(start, start + k)
        if k < 1 or start + k > m:
            raise ValueError(f"z_i: expected 1 to {m - start} numbers from start={start} for dim_z={m}, got {k}")
        z: Any = [math.nan] * m
        z[part] = [z_i] if isinstance(z_i, float) else np.atleast_1d(measured(z_i, k, missing=True))
        own = self.H, self.R
        try:
            if H_i is not None:
                rows = np.reshape(H_i, (1, -1)) if k == 1 else H_i
                self.H = _checks.matrix("H", self.H, (m, self.dim_x), f"dim_z={m}, dim_x={self.dim_x}").copy()
                self.H[part] = _checks.matrix("H_i", rows, (k, self.dim_x), f"{k} number(s) in z_i, dim_x={self.dim_x}")
            if R_i is not None:
                self.R = noise_covariance(self.R, None, m).copy()
                self.R[part], self.R[:, part] = 0.0, 0.0
                self.R[part, part] = noise_covariance(None, R_i, k)
            RobustKalmanFilter.update(self, z)
        finally:
            self.H, self.R = own

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
        zs = _checks.entries("zs", zs)
        scales = np.empty((len(zs), self.dim_x)) if self._kept is not None and hasattr(zs, "__len__") else None
        by_kernel = saver is None and self._steps_are_own()
        if Qs is None and self.dim_x > 1 and np.ndim(self.Q) == 0 and hasattr(zs, "__len__"):
            # As filterpy passes it to each prediction: a number means times I there, an array without axes does not.
            Qs = [self.Q if np.isscalar(self.Q) else self._noise_of_number(None)] * len(zs)
        given = {"zs": zs, "Fs": Fs, "Qs": Qs, "Hs": Hs, "Rs": Rs, "Bs": Bs, "us": us}
        estimates = self._filter_recording(given, update_first, saver, by_kernel, scales)
        self._process_scales = scales
        return estimates

    def _steps_are_own(self) -> bool:
        """Return whether the kernel's steps of a recording are this filter's, by its class, its policy and itself."""
        if not self._by_kernel or self._skips:
            return False
        own = RobustKalmanFilter
        methods = (("predict", own.predict), ("update", own.update))
        return all(getattr(type(self), name) is method and name not in vars(self) for name, method in methods)

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

        Notes
        -----
        Under ``process=`` Q of step k is the ordinary Q times the roots of `process_scale`, from both sides, where Xs
        ends with the filter's state after the last `batch_filter` of that length. A loop over `predict` and `update`
        hands over ``Qs`` itself: ``np.outer(root, root) * Q`` with ``root = kf.process_scale ** 0.5`` after each
        update. A jump would otherwise be smoothed away, before and after it.
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
        scales = self._process_scales
        if scales is not None and len(scales) == len(Xs) > 0 and np.array_equal(np.ravel(Xs[-1]), np.ravel(self.x)):
            nominal = [self.Q] * len(scales) if Qs is None else Qs
            roots = np.sqrt(scales)
            Qs = [
                np.outer(root, root) * (process_noise(Q, None, n) + np.zeros((n, n)))
                for root, Q in zip(roots, nominal, strict=False)
            ]
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
        x, P = state_of(self)
        H, R, values, _ = self._measurement(z, None, None, None, len(x))
        if values is None:
            return 0.0
        if self.noise is not None:
            return float(self._corrected(x, P, values, H, R, None, self._prior(len(H)))[0].log_density)
        y = np.atleast_1d(values) - H.dot(x).ravel()
        return self._log_density(y, self.S)


def replaced(kf: Any) -> str:
    """Return which of a filter's own predict, update and inv (numpy's) has another in its place; empty: none has."""
    return min({"predict", "update"} & vars(kf).keys(), default="" if kf.inv is np.linalg.inv else "inv")
