"""ParameterTracker: a filter whose state is the parameter vector of a model."""

from __future__ import annotations

import math
from itertools import repeat
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Information, Scaling
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.identification import _compiled_dispatch, _model, _setup
from robust_filterpy.identification._conditioning import SHARP, repaired, tempering
from robust_filterpy.identification._regressor import Layout, Memory, bounded, gradient, pushed
from robust_filterpy.identification._signals import (
    one_input,
    one_output,
    recorded_input,
    recorded_output,
    recorded_variance,
)
from robust_filterpy.identification.guard import GUARDS, Guard, is_stable, restrained
from robust_filterpy.identification.results import Coefficients, Columns, Intervals, Sample, TrackingResult, intervals
from robust_filterpy.identification.structures import Structure
from robust_filterpy.identification.validation import fit_percent
from robust_filterpy.influence.functions import Influence

if TYPE_CHECKING:
    import control

__all__ = ["GRADIENTS", "ParameterTracker"]

#: What the gain is computed from.
Gradient: TypeAlias = Literal["pseudolinear", "filtered"]
GRADIENTS: Final[tuple[Gradient, ...]] = ("pseudolinear", "filtered")

# What a sample moves in a filter, besides what only shows its last correction.
_MOVING: Final = ("x", "P", "H", "x_prior", "P_prior")

# phi of so many samples stays in a processor's cache.
_CHUNK: Final = 4096

# So many samples at most go to the definition before the kernel has another try.
_MOST_ODD: Final = 1024

# With forgetting and no excitation P grows without end; at so many times its first trace it has forgotten everything.
_WINDUP = 1e8


class ParameterTracker:
    """Follow the parameters of a linear model, sample by sample, through outliers.

    A filter with the parameters as its state, F = I and H = phi'(k) (paper 53 and Table 1)::

        theta(k+1) = F theta(k) + w(k)            w ~ N(0, Q)                             (8)-(10)
        y(k)       = phi(k)' theta(k) + v(k)      v mostly N(0, R), sometimes an outlier  (14)-(17)

    Parameters
    ----------
    structure : ARX, OutputError, ARMAX, FIR or LinearRegression
        What phi is made of.
    filter : filter object or class, optional
        Any filter of filterpy's kind with ``x, P, H, predict(), update(z)``, dim_x = structure.n_theta and dim_z = 1,
        or its class: ``filter=filterpy.kalman.KalmanFilter`` is the baseline without robustness. Default: a
        `RobustKalmanFilter`.
    theta : array_like, shape (n,), or float, optional
        Parameters to start from, a number standing for all of them. Default: 0, or what filter has.
    P : array_like, shape (n, n), or float, optional
        Their covariance; a number p stands for p I. Default: 100 I, or what filter has.
    Q : array_like, shape (n, n), or float, optional
        Covariance W of a step of theta (8). Default: 0, parameters that stand still, or what filter has.
    R : float, optional
        Variance of the ordinary noise, in the unit of y squared; outliers are judged by it. Default: 1, or what
        filter has.
    F : array_like, shape (n, n), optional
        Transition matrix C of (9). Default: the identity, or what filter has.
    forgetting : float, optional
        Forgetting factor in (0, 1] as in recursive least squares, instead of Q or beside it: P is divided by it at
        each sample (filterpy's alpha is its -1/2 power).
    gradient : {"filtered", "pseudolinear"}
        What the gain of an OutputError (ARMAX) model is computed from: phi filtered by 1/A_hat (1/C_hat), the
        derivative of the prediction, or phi itself as in the paper. See Notes. No difference for other structures.
    guard : {"halve", "reject", "none"}
        What to do with a step of theta that makes A (ARMAX: C) unstable: halve it until it does not, stay at the old
        theta, or take it. See Notes. No difference for other structures.
    influence, scaling, information : optional
        Choices of the `RobustKalmanFilter`; not together with filter.

    Attributes
    ----------
    structure : Structure
        As given.
    filter : filter object
        The filter; Q, R, F and forgetting are read from it and written to it.
    enabled : bool
        False freezes theta and P, while predictions go on.

    Raises
    ------
    ValueError
        If a shape, a number or an option does not fit, or the model to start from is unstable.
    TypeError
        If structure or filter is of the wrong kind.

    Notes
    -----
    In print (20) has v(k-1) where u(k-1) belongs, and (17) and Table 1 exchange the two variances. Table 1 as it
    stands is ``scaling="unit", gradient="pseudolinear", guard="none", R=1``.

    Gradient. The pseudo-linear form converges only where 1/A (ARMAX: 1/C) is strictly positive real. Median over 400
    runs of the mean \\|theta_hat - theta\\| over samples 500-1000, a = [-1.5, .7], b = [1, .5], u = +-1 white, nominal
    noise .5, outliers 10 times that, from theta = 0, P = I, Q = 1e-6 I; "Kalman" is told the variance of the mixture,
    "labels" which samples are outliers, "student" is ``influence=StudentT(4)``:

    ============= ======= ======= ======= ======= ======= ======= ======= =======
    .             filtered                        pseudolinear
    ------------- ------------------------------- -------------------------------
    contamination Kalman  robust  labels  student Kalman  robust  labels  student
    ============= ======= ======= ======= ======= ======= ======= ======= =======
    0             .024    .024    .024    .024    .066    .077    .066    .080
    .1            .074    .029    .028    .027    .166    .100    .077    .101
    .2            .099    .035    .031    .030    .257    .127    .095    .124
    .3            .118    .045    .033    .035    .302    .178    .116    .177
    ============= ======= ======= ======= ======= ======= ======= ======= =======

    Student's t has its price after a jump of theta: over the next 200 samples its error is some 5 to 10 % above that
    of Huber's function, the default, and up to a third above it where R is told ten times too small.

    On the plant of section 4, of which 1000 samples tell little (the Cramer-Rao bound of \\|theta_hat - theta\\| is .74
    with the 1/f input), the filtered gradient has .52 of relative error in the noise-free output at contamination .1,
    the pseudo-linear form .90.

    Guard. The same error, contamination .1, the plant drifting by W and the tracker told so, 400 runs:

    ============= ===== ====== ====== ===== ====== ======
    .             filtered            pseudolinear
    ------------- ------------------- -------------------
    plant, W      none  reject halve  none  reject halve
    ============= ===== ====== ====== ===== ====== ======
    above, 1e-6   .038  .035   .034   .102  .116   .105
    above, 1e-5   .076  .072   .073   .118  .118   .115
    above, 1e-4   .331  .299   .304   .280  .244   .246
    sec. 4, 1e-6  .712  .763   .768   .562  .639   .590
    sec. 4, 1e-5  .687  .776   .762   .472  .518   .500
    sec. 4, 1e-4  .520  .595   .591   .402  .387   .378
    ============= ===== ====== ====== ===== ====== ======

    No guard is best everywhere. "halve" is the default since it is best where the parameters can be learnt, and
    leaves a model that can be simulated; "none" does not. ``tests/benchmarks/output_error_study.py`` prints the
    tables.

    Extremes. Signals beyond 1e100 are clipped there, and so is what an unstable model feeds back. A sample may
    shrink a variance by at most 1e13 (a spike in the y that stands in phi would shrink it by more); beyond that it is
    down-weighted. P stops growing under forgetting at 1e8 times its first
    trace.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.identification import ARX
    >>> rng = np.random.default_rng(1)
    >>> u = rng.choice([-1.0, 1.0], 500)
    >>> y = np.zeros(500)
    >>> for k in range(1, 500):
    ...     y[k] = 0.8 * y[k - 1] + 2.0 * u[k - 1] + 0.1 * rng.normal()
    >>> tracker = ParameterTracker(ARX(1, 1), R=0.01)
    >>> result = tracker.run(y, u)
    >>> tracker.theta.round(2)
    array([-0.8,  2. ])
    """

    def __init__(
        self,
        structure: Structure,
        *,
        filter: Any = None,
        theta: ArrayLike | None = None,
        P: ArrayLike | None = None,
        Q: ArrayLike | None = None,
        R: ArrayLike | None = None,
        F: ArrayLike | None = None,
        forgetting: float | None = None,
        gradient: Gradient = "filtered",
        guard: Guard = "halve",
        influence: Influence | None = None,
        scaling: Scaling | None = None,
        information: Information | None = None,
    ) -> None:
        """Set up the filter and a memory at rest."""
        if not isinstance(structure, Structure):
            raise TypeError(f"structure: expected ARX(..), OutputError(..) or another structure, got {structure!r}")
        self._gradient = _checks.option("gradient", gradient, GRADIENTS)
        self._guard = _checks.option("guard", guard, GUARDS)
        choices = {"influence": influence, "scaling": scaling, "information": information}
        self.structure = structure
        self.filter = _setup.make_filter(structure.n_theta, filter, choices)
        _setup.configure(self.filter, structure, theta=theta, P=P, Q=Q, R=R, F=F, forgetting=forgetting)
        self.enabled = True
        self._layout = Layout(structure)
        self._memory = Memory(self._layout)
        self._windup = _WINDUP * max(float(np.trace(self.filter.P)), 1e-300)
        self._initial = self.state()

    def __repr__(self) -> str:
        """Show the model as it stands."""
        values = ", ".join(f"{name}={value:.4g}" for name, value in zip(self.structure.names, self.theta, strict=True))
        return f"ParameterTracker({self.structure}, {values})"

    # The model as it stands.

    @property
    def gradient(self) -> Gradient:
        """What the gain is computed from: "filtered" or "pseudolinear"."""
        return self._gradient

    @property
    def guard(self) -> Guard:
        """What happens to an unstable step: "halve", "reject" or "none"."""
        return self._guard

    @property
    def theta(self) -> Array:
        """Parameters, shape (n,)."""
        return np.array(self.filter.x, dtype=float).ravel()

    @property
    def P(self) -> Array:
        """Covariance of the parameters, shape (n, n)."""
        return np.array(self.filter.P, dtype=float)

    @property
    def Q(self) -> Array:
        """Covariance of a step of theta (paper 8), shape (n, n); may be set, to a number q for q I."""
        return np.array(self.filter.Q, dtype=float)

    @Q.setter
    def Q(self, value: ArrayLike) -> None:
        self.filter.Q = _setup.checked_values(self._layout.n, Q=value)["Q"]

    @property
    def R(self) -> float:
        """Variance of the ordinary noise; may be set."""
        return _setup.noise_variance(self.filter)

    @R.setter
    def R(self, value: float) -> None:
        self.filter.R = _setup.checked_values(self._layout.n, R=value)["R"]

    @property
    def F(self) -> Array:
        """Transition matrix C of (9), shape (n, n); may be set."""
        return np.array(self.filter.F, dtype=float)

    @F.setter
    def F(self, value: ArrayLike) -> None:
        self.filter.F = _setup.checked_values(self._layout.n, F=value)["F"]

    @property
    def forgetting(self) -> float:
        """Forgetting factor, in (0, 1]; may be set."""
        return float(getattr(self.filter, "alpha", 1.0)) ** -2

    @forgetting.setter
    def forgetting(self, value: float) -> None:
        _setup.forget(self.filter, value)

    @property
    def std(self) -> Array:
        """Standard deviations of the parameters, shape (n,)."""
        return np.sqrt(np.maximum(self.P.diagonal(), 0.0))

    @property
    def coefficients(self) -> Coefficients:
        """a, b and c of the model; see `Coefficients`."""
        return _model.coefficients(self.structure, self.theta)

    def confidence_intervals(self, level: float = 0.95) -> Intervals:
        """Return theta -+ z std, z the normal quantile of the level.

        Parameters
        ----------
        level : float, default 0.95
            Probability of each interval, in (0, 1).

        Returns
        -------
        Intervals
            lower, upper, each of shape (n,).

        Raises
        ------
        ValueError
            If level is no probability.

        Notes
        -----
        As honest as Q and R: P is the covariance for noise of variance R.
        """
        return intervals(self.theta, self.std, level)

    def transfer_function(self, dt: float | bool = True) -> control.TransferFunction:
        """Return the model B(q)/A(q) as it stands.

        Parameters
        ----------
        dt : float or True, default True
            Sampling period in s; True leaves it open.

        Returns
        -------
        control.TransferFunction
            One output and as many inputs as the structure has.

        Raises
        ------
        ValueError
            If the structure has no input, or a regressor of the caller's.

        Examples
        --------
        >>> from robust_filterpy.identification import ARX
        >>> tf = ParameterTracker(ARX(1, 1), theta=[-0.5, 2.0]).transfer_function(dt=0.1)
        >>> tf.poles().real, float(tf.dcgain())
        (array([0.5]), 4.0)
        """
        return _model.transfer_function(self.structure, self.theta, dt)

    def predict(self, u: ArrayLike | None = None) -> float:
        """Predict the next output, phi(k+1)' theta (paper 22), and change nothing.

        Parameters
        ----------
        u : array_like, shape (n_inputs,), or float, optional
            The next input; needed if it acts at once (nk = 0).

        Returns
        -------
        float

        Raises
        ------
        ValueError
            If the next input is needed and not given.
        """
        if u is None and self._layout.direct:
            raise ValueError(f"u: expected the next input, which acts at once in {self.structure}, got None")
        values = np.zeros(self.structure.n_inputs) if u is None else one_input(self.structure, u)
        H = self._memory.regressor(self._layout, self._memory.with_input(self._layout, values))
        theta = self.theta
        if self.enabled and hasattr(self.filter, "F") and self._drifts:
            theta = np.asarray(self.filter.F, dtype=float).dot(theta)
        return bounded(H.dot(theta).item())

    def simulate(self, u: ArrayLike, *, continued: bool = False) -> Array:
        """Run the model as it stands on inputs alone, without measurements: y = B/A u.

        Parameters
        ----------
        u : array_like, shape (N,) or (N, n_inputs)
            Input.
        continued : bool, default False
            Whether the run goes on where the tracker is, with its past inputs and outputs; otherwise it starts at
            rest.

        Returns
        -------
        ndarray, shape (N,)

        Raises
        ------
        ValueError
            If u does not fit or is not finite, or the output of an unstable model overflows.
        """
        signal = recorded_input(self.structure, u, None)
        memory = self._memory if continued else Memory(self._layout)
        return _model.simulate(self.structure, self._layout, memory, self.theta, signal)

    @staticmethod
    def fit(y: ArrayLike, y_model: ArrayLike) -> float:
        """Compute the normalised root-mean-square fit, 100 (1 - ||y - y_model||/||y - mean(y)||), in percent.

        Parameters
        ----------
        y : array_like, shape (N,)
            Measured output; NaN does not count.
        y_model : array_like, shape (N,)
            Output of the model.

        Returns
        -------
        float
            100 is perfect, 0 no better than the mean.

        Raises
        ------
        ValueError
            If the shapes differ or y is constant.
        """
        return fit_percent(y, y_model)

    # The recursion.

    def update(self, y: float | None, u: ArrayLike | None = None, R: float | None = None) -> Sample:
        """Take one sample: the output y(k) and the input u(k).

        Parameters
        ----------
        y : float or None
            Measured output; NaN or None if it is missing: the recursion then goes on with its own prediction.
        u : array_like, shape (n_inputs,), or float
            Input of the same sample (which first acts nk samples later); phi(k) for a LinearRegression.
        R : float, optional
            Variance of the noise in this sample. Default: the filter's R.

        Returns
        -------
        Sample
            prediction, residual, weight, guard.

        Raises
        ------
        ValueError, TypeError
            If y is infinite, u not finite or of the wrong length, or R not positive; nothing has changed then.
        LinAlgError
            If the filter refuses the sample; nothing has changed then.
        """
        variance = None if R is None else _checks.positive("R", R)
        return self._step(one_output(y), one_input(self.structure, u), variance)

    def run(self, y: ArrayLike, u: ArrayLike | None = None, R: ArrayLike | None = None) -> TrackingResult:
        """Take a whole recording; the numbers are those of `update`, sample by sample.

        Parameters
        ----------
        y : array_like, shape (N,)
            Measured output, N >= 1; NaN where it is missing.
        u : array_like, shape (N,) or (N, n_inputs)
            Input; the rows phi(k) for a LinearRegression.
        R : array_like, shape (N,), or float, optional
            Variance of the noise in each sample, for sensors that say how sure they are. Default: the filter's R.

        Returns
        -------
        TrackingResult
            theta, std, prediction, residual, weights, guard, a row for each sample.

        Raises
        ------
        ValueError, TypeError
            If y or u is empty, not finite, they differ in length, or R is not positive; nothing has changed then.
        LinAlgError
            If the filter refuses a sample, which the message names; nothing has changed then.

        Notes
        -----
        Where the kernel serves (`robust_filterpy.compiled.dispatch`) and the filter is a `RobustKalmanFilter` as it
        comes with an influence function of this package, the numbers agree with those of `update` to rounding.
        """
        output = recorded_output(y)
        signal = recorded_input(self.structure, u, output.size)
        variances = None if R is None else recorded_variance(R, output.size)
        out = Columns.empty(output.size, self._layout.n)
        before, held = self.state(), self._held()
        try:
            if self._is_plain and _compiled_dispatch.serves((self.filter._choices,), output.size):
                self._run_fast(output, signal, variances, out)
            else:
                self._run_stepwise(output, signal, variances, out, 0, output.size)
        except BaseException:
            self._set_state(before)
            self._put_back(held)
            raise
        std = np.sqrt(np.maximum(out.variance, 0.0))
        return TrackingResult(out.theta, std, out.prediction, out.residual, out.weights, out.guard)

    @property
    def _drifts(self) -> bool:
        """Whether the next sample begins with a step of theta: not once P has wound up under forgetting."""
        kf = self.filter
        return bool(getattr(kf, "alpha", 1.0) == 1.0 or np.trace(kf.P) <= self._windup)

    def _held(self) -> dict[str, Any]:
        """Return what a sample changes in a filter of filterpy's kind."""
        return {name: getattr(self.filter, name) for name in _MOVING if hasattr(self.filter, name)}

    def _put_back(self, held: dict[str, Any]) -> None:
        """Undo a sample that was refused, or interrupted."""
        for name, value in held.items():
            setattr(self.filter, name, value)

    def _step(self, y: float, u: Array, R: float | None) -> Sample:
        """Advance by one checked sample."""
        kf, layout, memory, part = self.filter, self._layout, self._memory, self._layout.part
        inputs = memory.with_input(layout, u)
        H = memory.regressor(layout, inputs)
        known, held = y == y, self._held()
        old, gradients = np.ravel(kf.x), memory.gradients
        weight, event = math.nan, 0
        filtered = self._gradient == "filtered" and part is not None
        try:
            if self.enabled and self._drifts:
                kf.predict()
            x = kf.x
            predicted = H.dot(x).item()
            G, target = H, y
            if filtered:
                past = np.ravel(x)[part]
                if self._guard != "none" or is_stable(past.tolist()):
                    G = gradient(H[0], past, gradients)[None, :]
                gradients = pushed(gradients, G[0])
            if self.enabled and known:
                square, trace, r = G[0].dot(G[0]), np.trace(kf.P), _setup.noise_variance(kf) if R is None else R
                factor = tempering(square, trace, r)
                if filtered or factor < 1.0:
                    G = G * factor
                    # So that the filter's own innovation, target - G x, is y - phi' theta.
                    target = (y - predicted) * factor + G.dot(x).item()
                kf.H = G
                if R is None:
                    kf.update(target)
                else:
                    kf.update(target, R=R)
                if square * trace > SHARP * r:
                    P = kf.P
                    mended = repaired(P)
                    if mended is not P:
                        kf.P = mended
                weight = float(np.ravel(getattr(kf, "weights", 1.0))[0])
            if self.enabled and part is not None:
                moved, event = restrained(np.ravel(kf.x), old, part, self._guard)
                if event:
                    kf.x = moved.reshape(np.shape(kf.x))
            after = H.dot(kf.x).item()
        except BaseException:
            self._put_back(held)
            raise
        if self.structure.uses_model_output:
            memory.outputs = pushed(memory.outputs, -bounded(after))
        else:
            memory.outputs = pushed(memory.outputs, -(y if known else bounded(predicted)))
        memory.residuals = pushed(memory.residuals, bounded(y - after) if known else 0.0)
        memory.inputs, memory.gradients = inputs, gradients
        return Sample(predicted, y - predicted, weight, event)

    def _run_stepwise(self, y: Array, u: Array, R: Array | None, out: Columns, start: int, stop: int) -> None:
        """Advance through samples start to stop - 1 of a recording with any filter, one by one."""
        k = start
        variances = repeat(None) if R is None else R[start:stop].tolist()
        try:
            for k, output, r in zip(range(start, stop), y[start:stop].tolist(), variances, strict=False):
                out.prediction[k], out.residual[k], out.weights[k], out.guard[k] = self._step(output, u[k], r)
                out.theta[k], out.variance[k] = np.ravel(self.filter.x), np.diagonal(self.filter.P)
        except (ValueError, TypeError, np.linalg.LinAlgError) as error:
            error.args = (f"sample {k}: {error}", *error.args[1:])
            raise

    @property
    def _is_plain(self) -> bool:
        """Whether the filter is our own as it comes, for which there are faster ways to the numbers of `update`."""
        kf, n = self.filter, self._layout.n
        return bool(
            self.enabled
            and type(kf) is RobustKalmanFilter
            and kf._choices.pointwise is not None
            and kf._inverse is None
            and _setup.is_array(kf.F, (n, n))
            and _setup.is_array(kf.Q, (n, n))
            and _setup.is_array(kf.R, (1, 1))
            and _setup.is_array(kf.P, (n, n))
            and (_setup.is_array(kf.x, (n,)) or _setup.is_array(kf.x, (n, 1)))
            and np.isfinite(kf.x).all()
            and np.isfinite(kf.P).all()
            and 0.0 < kf.R.item() < math.inf
            and np.isfinite(kf.F).all()
            and np.isfinite(kf.Q).all()
            and all(np.abs(a - a.T).max() <= 1e-13 * np.abs(a).max() for a in (kf.P, kf.Q))
        )

    def _run_fast(self, y: Array, u: Array, R: Array | None, out: Columns) -> None:
        """Advance by the kernel, except for the last sample and the last measured one.

        These two leave the attributes that the filter shows.
        """
        measured = np.flatnonzero(y == y)
        stops, start = sorted({*measured[-1:].tolist(), len(y) - 1}), 0
        for stop in stops:
            if stop > start:
                self._run_kernel(y, u, R, out, start, stop)
            self._run_stepwise(y, u, R, out, stop, stop + 1)
            start = stop + 1

    def _run_kernel(self, y: Array, u: Array, R: Array | None, out: Columns, start: int, stop: int) -> None:
        """Advance from sample start to stop - 1 by the kernel, and by the definition where the kernel declines."""
        kf, layout, k, odd = self.filter, self._layout, start, 1
        variances = np.full(len(y), kf.R.item()) if R is None else R
        recursion = _compiled_dispatch.Recursion(
            (kf._choices,), self.structure.uses_model_output, np.array([self._gradient == "filtered"]),
            np.array([self._guard]), kf.F[None], kf.Q[None], np.array([kf._alpha_sq]), np.array([self._windup]),
        )  # fmt: skip
        while k < stop:
            chunk = slice(k, min(k + _CHUNK, stop))
            phi, inputs = self._memory.regressors(layout, u[chunk])
            x, P, memory = np.array(kf.x).reshape(1, -1), np.array(kf.P, order="C")[None], self._memory
            past = _compiled_dispatch.Memories(
                memory.outputs[None], inputs[None], memory.residuals[None], memory.gradients[None]
            )
            here = Columns(*(column[None, chunk] for column in out))
            signals = y[None, chunk], phi[None], variances[None, chunk]
            done = int(_compiled_dispatch.advance(layout, recursion, *signals, x, P, past, here)[0])
            kf.x, kf.P = x.reshape(np.shape(kf.x)), P[0]
            k += done
            if k == chunk.stop:
                memory.inputs = inputs
                continue
            # Older inputs than the memory holds need not go through it.
            for values in u[max(k - layout.length, chunk.start) : k]:
                memory.inputs = memory.with_input(layout, values)
            odd = 1 if done >= odd else min(2 * odd, _MOST_ODD)
            self._run_stepwise(y, u, R, out, k, min(k + odd, stop))
            k = min(k + odd, stop)

    # Interruption.

    def state(self) -> dict[str, Array]:
        """Return everything the recursion needs to go on, as plain arrays.

        Returns
        -------
        dict of str to ndarray
            theta, P; the signals in memory: outputs (na,), inputs, residuals (nc,), gradients; enabled; and the
            filter's Q, R, F and alpha_sq where it has them. ``numpy.savez(file, **state)`` stores it.
        """
        memory = {name: getattr(self._memory, name).copy() for name in self._layout.shapes()}
        return {
            "theta": self.theta,
            "P": self.P,
            **memory,
            "enabled": np.array(bool(self.enabled)),
            **_setup.settings(self.filter),
        }

    def restore(self, state: Any) -> None:
        """Go back to a state of this tracker, or of another one with the same structure and kind of filter.

        Parameters
        ----------
        state : mapping of str to ndarray
            From `state`, or what ``numpy.load`` makes of a file that holds it.

        Raises
        ------
        ValueError
            If an array is missing, does not fit, or holds NaN or a variance that is not positive; nothing has changed
            then.
        TypeError
            If state is no mapping.

        Notes
        -----
        The continuation is the same to the last bit, for filters that hold x and P themselves.
        """
        n = self._layout.n
        shapes = {"theta": (n,), "P": (n, n), **self._layout.shapes(), "enabled": ()}
        self._set_state(_setup.checked_state(state, shapes, _setup.settings(self.filter)))

    def _set_state(self, found: dict[str, Array]) -> None:
        """Take over a checked state."""
        self.filter.x = found["theta"].reshape(np.shape(self.filter.x))
        _setup.apply_settings(self.filter, found)
        self.filter.P = found["P"]
        for name in self._layout.shapes():
            setattr(self._memory, name, found[name])
        self.enabled = bool(found["enabled"])

    def reset(self) -> None:
        """Go back to the start: theta, P, Q, R, F and the memory as they were when the tracker was made."""
        self.restore(self._initial)
