"""ParameterTracker: a filter whose state is the parameter vector of a model."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks, _state
from robust_filterpy._checks import Array
from robust_filterpy._documentation import STOPPED, pointer
from robust_filterpy.correction.options import Information, Scaling
from robust_filterpy.identification.estimation.identify import identify
from robust_filterpy.identification.models import coefficients
from robust_filterpy.identification.models.fit import fit_percent
from robust_filterpy.identification.models.guard import GUARDS, Guard
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.regressor import Layout, Memory, bounded
from robust_filterpy.identification.models.responses import Responses
from robust_filterpy.identification.models.results import Columns, Intervals, Sample, TrackingResult, intervals
from robust_filterpy.identification.models.signals import (
    filled_output,
    one_input,
    one_output,
    recorded_input,
    recorded_variance,
)
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.models.summary import Summary, summarized
from robust_filterpy.identification.models.time_axis import TimeAxis, recording
from robust_filterpy.identification.recursive import setup
from robust_filterpy.identification.recursive.noise_scale import NoiseScale, ordinary_mean
from robust_filterpy.identification.recursive.recursion import GRADIENTS, REGRESSORS, Gradient, Recursion, Regressor
from robust_filterpy.identification.recursive.start import ColdStart
from robust_filterpy.identification.recursive.tuned import TunedTracker, tuned
from robust_filterpy.identification.recursive.watch import LostTrackerWarning, Watch
from robust_filterpy.influence.functions import Influence

if TYPE_CHECKING:
    import control

__all__ = ["ParameterTracker"]

# Samples that a tracker looks at before it takes a stand: OutputError(4, 4) with 10 % outliers needs about as many.
_START = 400

# With forgetting and no excitation P grows without end; at so many times its first trace it has forgotten everything.
_WINDUP = 1e8


class ParameterTracker(Responses, Recursion):
    """Follow the parameters of a linear model, sample by sample, through outliers.

    A filter with the parameters as its state, F = I and H = phi'(k) (paper 53 and Table 1)::

        theta(k+1) = F theta(k) + w(k)            w ~ N(0, Q)                             (8)-(10)
        y(k)       = phi(k)' theta(k) + v(k)      v mostly N(0, R), sometimes an outlier  (14)-(17)

    Parameters
    ----------
    structure : Structure or Model
        What phi is made of: ARX(..), OutputError(..), .. or what `identify` found, to go on from there. Its theta, P, R
        and constant are then where the tracker begins unless they are given, R is followed, and the memory holds the
        end of the recording.
    filter : filter object or class, optional
        Any filter of filterpy's kind with ``x, P, H, predict(), update(z)``, dim_x = structure.n_theta (one more with
        an offset) and dim_z = 1, or its class: ``filter=filterpy.kalman.KalmanFilter`` is the baseline without
        robustness. Default: a `RobustKalmanFilter`.
    theta : array_like, shape (n,), or float, optional
        Parameters to start from, a number standing for all of them. Default: found by the start; 0 with ``start=0``, or
        what filter has.
    P : array_like, shape (n, n), or float, optional
        Their covariance; a number p stands for p I. Default: found by the start; 100 I with ``start=0``, or what filter
        has.
    Q : array_like, shape (n, n), or float, optional
        Covariance W of a step of theta (8). Default: 0, parameters that stand still, or what filter has.
    R : float, optional
        Variance of the ordinary noise, in the unit of y squared; outliers are judged by it. Default: found from the
        data and followed, or what a filter object has. Setting the attribute fixes it.
    F : array_like, shape (n, n), optional
        Transition matrix C of (9). Default: the identity, or what filter has.
    start : int, optional
        How many samples the tracker may look at before it takes a stand: it makes a model of the first eighth, quarter,
        half and all of them by `identify`, and goes on from there. Default: 400, or 0 if theta, P or a filter object is
        given. 0: the recursion begins at once, as in the paper.
    offset : bool, optional
        Whether there is a constant beside theta, for outputs that are not measured from their rest. Default: with a
        start yes, except for a LinearRegression, whose columns are the caller's.
    regressor : {"measured", "cleaned"}
        Which outputs an ARX, ARMAX, AR, ARMA or BoxJenkins has in its regressor: those measured, or the prediction in
        the place of those further than 3 standard deviations from it (the filter-cleaner of Masreliez and Martin),
        unless the outputs as measured explain the next sample. Default: "cleaned" with a start, "measured" with
        ``start=0``, as in the paper. No difference for other structures.
    R_memory : int, default 150
        Number of samples that an R which is followed remembers.
    forgetting : float, optional
        Forgetting factor in (0, 1] as in recursive least squares, instead of Q or beside it: P is divided by it at
        each sample (filterpy's alpha is its -1/2 power).
    gradient : {"filtered", "pseudolinear"}
        What the gain of an OutputError (ARMAX) model is computed from: phi filtered by 1/A_hat (1/C_hat), the
        derivative of the prediction, or phi itself as in the paper. In a BoxJenkins what the inputs do goes through
        D_hat/(C_hat F_hat), the rest through 1/C_hat. See Notes. No difference for other structures.
    guard : {"halve", "reject", "none"}
        What to do with a step of theta that makes A (ARMAX: C; BoxJenkins: F or C) unstable: halve it until it does
        not, stay at the old theta, or take it. See Notes. No difference for other structures.
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
    offset : float
        Constant of the equation, as in `Model`; `level` is what it means for y.
    dt : float or None
        Sampling period in s, as the index of the first recording that has one told it; may be set.

    Raises
    ------
    ValueError
        If a shape, a number or an option does not fit, or the model to start from is unstable.
    TypeError
        If structure or filter is of the wrong kind.

    Warns
    -----
    LostTrackerWarning
        Once, if the start found no model, most samples look like outliers, the guard acts all the time, R wanders, or
        an offset is not modelled. Whenever residuals follow the inputs, since the plant has become another one or the
        sensor is stuck: a tracker that found its model itself, or has it from `identify`, then starts anew.

    Notes
    -----
    In print (20) has v(k-1) where u(k-1) belongs, and (17) and Table 1 exchange the two variances. Table 1 as it
    stands is ``scaling="unit", gradient="pseudolinear", guard="none", R=1, start=0``.

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
    >>> tracker = ParameterTracker(ARX(1, 1))
    >>> result = tracker.run(y, u)
    >>> tracker.theta.round(2), round(tracker.R, 2)
    (array([-0.8,  2. ]), 0.01)
    """

    def __init__(
        self,
        structure: Structure | Model,
        *,
        filter: Any = None,
        theta: ArrayLike | None = None,
        P: ArrayLike | None = None,
        Q: ArrayLike | None = None,
        R: ArrayLike | None = None,
        F: ArrayLike | None = None,
        forgetting: float | None = None,
        start: int | None = None,
        offset: bool | None = None,
        regressor: Regressor | None = None,
        R_memory: int = 150,
        gradient: Gradient = "filtered",
        guard: Guard = "halve",
        influence: Influence | None = None,
        scaling: Scaling | None = None,
        information: Information | None = None,
    ) -> None:
        """Set up the filter and a memory at rest."""
        self._given = {name: value for name, value in locals().items() if name != "self"}
        model = structure if isinstance(structure, Model) else None
        if model is not None:
            structure = model.structure
        elif not isinstance(structure, Structure):
            raise TypeError(
                f"structure: expected ARX(..), OutputError(..) or another structure, or a Model, got {structure!r}"
            )
        self._gradient = _checks.option("gradient", gradient, GRADIENTS)
        self._guard = _checks.option("guard", guard, GUARDS)
        ready = filter is not None and not isinstance(filter, type)
        told = theta is not None or P is not None or ready or model is not None
        samples = (0 if told else _START) if start is None else _checks.count("start", start)
        if samples and told:
            raise ValueError(f"start: expected 0 with theta, P or a filter object or model to begin with, got {start}")
        default: Regressor = "cleaned" if samples or model is not None else "measured"
        self._regressor = default if regressor is None else _checks.option("regressor", regressor, REGRESSORS)
        if offset is not None and not isinstance(offset, (bool, np.bool_)):
            raise TypeError(f"offset: expected True or False, got {offset!r}")
        if model is not None and offset is not None and offset != model.has_offset:
            raise ValueError(f"offset: expected {model.has_offset} as the model has it, got {offset}; leave it out")
        usual = bool(samples) and not structure.takes_phi if model is None else model.has_offset
        self._has_offset = usual if offset is None else bool(offset)
        self._cleans = self._regressor == "cleaned" and structure.na + structure.nd > 0
        choices = {"influence": influence, "scaling": scaling, "information": information}
        self.structure = structure
        extended = (structure.with_constant(), structure.n_inputs) if self._has_offset else (structure, -1)
        self._layout = Layout(*extended)
        places = np.arange(self._layout.n)
        self._own = np.delete(places, structure.constant_place) if self._has_offset else places
        self.filter = setup.make_filter(self._layout.n, filter, choices)
        setup.configure(
            self.filter, structure, self._own, theta=theta, P=P, Q=Q, R=R, F=F, forgetting=forgetting
        )  # fmt: skip
        if ready and Q is None:
            setup.warn_of_default_noise(self.filter)
        self.enabled = True
        self._memory = Memory(self._layout)
        self._windup = _WINDUP * max(float(np.trace(self.filter.P)), 1e-300)
        self._centre, self._watch = 0.0, Watch()
        memory = 0.0 if R is not None or ready else float(_checks.count("R_memory", R_memory, 2))
        self._scale = NoiseScale(0.0, ordinary_mean(None), memory)
        self._samples = samples or _START
        self._start = ColdStart(structure, samples) if samples else None
        self._begun = not samples
        # Whether it may make another model by itself when this one is no longer the plant's.
        self._restarts = bool(samples)
        self.dt: float | None = None
        if model is not None:
            self._begin(model)
            self._set(theta, P)
            self.dt = model.dt
        self._initial = self.state()
        # The last time that a recording told, and how many samples came after it.
        self._time: tuple[Any, int] | None = None

    def __repr__(self) -> str:
        """Show the model as it stands."""
        values = ", ".join(f"{name}={value:.4g}" for name, value in zip(self.structure.names, self.theta, strict=True))
        return f"ParameterTracker({self.structure}, {values})"

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the arguments that the tracker was made with, by scikit-learn's convention.

        Parameters
        ----------
        deep : bool, default True
            Whether the orders of the structure are there too, as "structure__na".

        Returns
        -------
        dict of str
            ``ParameterTracker(**tracker.get_params(deep=False))`` is a tracker that has not seen a sample.
        """
        orders = {f"structure__{name}": order for name, order in self.structure.get_params().items()} if deep else {}
        return self._given | orders

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
        return np.array(self.filter.x, dtype=float).ravel()[self._own]

    @property
    def offset(self) -> float:
        """Constant of the equation: what an OutputError, FIR or LinearRegression adds to the output; 0 without one."""
        a, f = self._rest_gains
        return self._centre * a + (self._constant / f if abs(f) > 1e-9 else 0.0)

    @property
    def level(self) -> float:
        """What the output is at rest; the centre that was taken off y if the model integrates."""
        a, f = self._rest_gains
        return self._centre + (self._constant / (a * f) if abs(a * f) > 1e-9 else 0.0)

    @property
    def _constant(self) -> float:
        """Constant in phi' theta, for outputs from the centre."""
        if not self._has_offset:
            return 0.0
        return float(np.ravel(self.filter.x)[self.structure.constant_place])

    @property
    def _rest_gains(self) -> tuple[float, float]:
        """A(1) and F(1)."""
        theta, places = self.theta, self.structure.polynomials
        return 1.0 + float(theta[places.a].sum()), 1.0 + float(theta[places.f].sum())

    @property
    def regressor(self) -> Regressor:
        """Which outputs phi holds: "measured" or "cleaned"."""
        return self._regressor

    @property
    def P(self) -> Array:
        """Covariance of the parameters, shape (n, n)."""
        return np.array(self.filter.P, dtype=float)[np.ix_(self._own, self._own)]

    @property
    def Q(self) -> Array:
        """Covariance of a step of theta (paper 8), shape (n, n); may be set, to a number q for q I."""
        return np.array(self.filter.Q, dtype=float)[np.ix_(self._own, self._own)]

    @Q.setter
    def Q(self, value: ArrayLike) -> None:
        self.filter.Q = setup.embedded(self.filter.Q, self._own, setup.checked_values(len(self._own), Q=value)["Q"])

    @property
    def R(self) -> float:
        """Variance of the ordinary noise, as it is followed; may be set, and is then no longer followed."""
        return setup.noise_variance(self.filter)

    @R.setter
    def R(self, value: float) -> None:
        self.filter.R = setup.checked_values(self._layout.n, R=value)["R"]
        self._scale = self._scale._replace(memory=0.0)

    @property
    def _noise_samples(self) -> float:
        """How many samples R stands on; one that is told is known."""
        return self._scale.memory or np.inf

    @property
    def F(self) -> Array:
        """Transition matrix C of (9), shape (n, n); may be set."""
        return np.array(self.filter.F, dtype=float)[np.ix_(self._own, self._own)]

    @F.setter
    def F(self, value: ArrayLike) -> None:
        self.filter.F = setup.embedded(self.filter.F, self._own, setup.checked_values(len(self._own), F=value)["F"])

    @property
    def forgetting(self) -> float:
        """Forgetting factor, in (0, 1]; may be set."""
        return float(getattr(self.filter, "alpha", 1.0)) ** -2

    @forgetting.setter
    def forgetting(self, value: float) -> None:
        setup.forget(self.filter, value)

    @property
    def std(self) -> Array:
        """Standard deviations of the parameters, shape (n,); infinite until the start has found a model."""
        return np.sqrt(np.maximum(self.P.diagonal(), 0.0)) if self._begun else np.full(len(self._own), np.inf)

    @property
    def coefficients(self) -> Any:
        """a, b and c as `Coefficients`, or of a BoxJenkins b, f, c and d as `BoxJenkinsCoefficients`."""
        return coefficients.coefficients(self.structure, self.theta)

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

    def summary(self, level: float = 0.95) -> Summary:
        """Return a table of the parameters as they stand, with their uncertainty.

        Parameters
        ----------
        level : float, default 0.95
            Probability of each interval, in (0, 1).

        Returns
        -------
        Summary
            It prints as a table.

        Raises
        ------
        ValueError
            If level is no probability.
        """
        facts = {"R": f"{self.R:.4g}", "Level": f"{self.level:.4g}", "Forgetting": f"{self.forgetting:.4g}"}
        if self.dt is not None:
            facts["Sampling period"] = f"{self.dt:.6g} s"
        waiting = "" if self._begun else "the start has not found a model yet"
        return summarized(str(self.structure), facts, self.structure.names, self.theta, self.std, level, waiting)

    def transfer_function(self, dt: float | bool | Literal["recorded"] = "recorded") -> control.TransferFunction:
        """Return the model B(q)/A(q) as it stands.

        Parameters
        ----------
        dt : float, True or "recorded", default "recorded"
            Sampling period in s; True leaves it open. "recorded": as an index told it, True if none did.

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
        return coefficients.transfer_function(self.structure, self.theta, coefficients.period(dt, self.dt))

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
        if u is None and any(nb and not nk for nb, nk in self.structure.inputs):
            raise ValueError(f"u: expected the next input, which acts at once in {self.structure}, got None")
        values = np.zeros(self.structure.n_inputs) if u is None else one_input(self.structure, u)
        if not self._begun and self._start is not None:
            return self._start.level()
        inputs = self._memory.with_input(self._layout, self._with_constant(values))
        x = np.array(self.filter.x, dtype=float).ravel()
        if self.enabled and hasattr(self.filter, "F") and self._drifts:
            x = np.asarray(self.filter.F, dtype=float).dot(x)
        return bounded(self._memory.regressor(self._layout, inputs).dot(x).item()) + self._centre

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
        axis, u = recording(self.structure, u=u)
        axis.require_period(self.dt)
        signal = recorded_input(self.structure, u, None)
        x = np.array(self.filter.x, dtype=float).ravel()
        if continued:
            with_constant = self._with_constant(signal)
            y = coefficients.simulate(self.structure, self._layout, self._memory, x, with_constant) + self._centre
        else:
            layout = Layout(self.structure)
            y = coefficients.simulate(self.structure, layout, Memory(layout), x[self._own], signal) + self.level
        return axis.series(y, "simulated")

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
        variance = None if R is None else np.array([_checks.positive("R", R)])
        output, values = np.array([one_output(y)]), one_input(self.structure, u)[None]
        held = self._held()
        try:
            if self._start is None:
                sample = self._stepped(output.item(), values[0], None if variance is None else variance.item())
                self._restart_if_lost(values, np.array([sample.prediction]), np.array([sample.residual]))
            else:
                out = Columns.empty(1, self._layout.n)
                self._advance(output, values, variance, out)
                sample = Sample(*(column[0].item() for column in out[2:]))
            if self._is_watched:
                weight, guard, residual = (np.array([v]) for v in (sample.weight, sample.guard, sample.residual))
                self._say(self._watch.see(weight, guard, residual, self.R, self._has_offset))
            self._time = None if self._time is None else (self._time[0], self._time[1] + 1)
            return sample
        except BaseException:
            self._put_back(held)
            raise

    def run(self, y: ArrayLike, u: ArrayLike | None = None, R: ArrayLike | None = None) -> TrackingResult:
        """Take a whole recording; the numbers are those of `update`, sample by sample.

        Parameters
        ----------
        y : array_like, shape (N,)
            Measured output, N >= 1; NaN where it is missing. A pandas Series has the index of u, in equal steps.
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
            If y or u is empty, not finite, they differ in length or in index, an index is not uniform or goes back
            before the last time of the run before, or R is not positive; nothing has changed then.
        LinAlgError
            If the filter refuses a sample, which the message names; nothing has changed then.

        Warns
        -----
        UserWarning
            If the times say that samples are missing since the run before, and how many; if y has fill values.

        Notes
        -----
        A fill value (9999, 1e7: one that repeats exactly, far outside the rest) is taken for missing. `update` sees no
        repetition: NaN must stand there.

        A state holds no time: after `restore` and `reset` a recording may begin at any.

        Where the kernel serves (`robust_filterpy.kernel`) and the filter is a `RobustKalmanFilter` as it
        comes with an influence function of this package, the numbers agree with those of `update` to rounding.
        """
        axis, y, u, R = recording(self.structure, y=y, u=u, R=R)
        axis.require_period(self.dt)
        fills = filled_output(y)
        output = fills.signal
        signal = recorded_input(self.structure, u, output.size)
        variances = None if R is None else recorded_variance(R, output.size)
        out = Columns.empty(output.size, self._layout.n)
        time = self._time_after(axis, output.size)
        before, held = self.state(), self._held()
        try:
            self._advance(output, signal, variances, out)
            if self._is_watched:
                self._say(self._watch.see(out.weights, out.guard, out.residual, self.R, self._has_offset))
            std = np.sqrt(np.maximum(out.variance[:, self._own], 0.0))
            rest = out.prediction, out.residual, out.weights, out.guard
            result = TrackingResult(out.theta[:, self._own], std, *rest).labelled(self.structure.names, axis.index)
            self.dt, self._time = axis.dt if self.dt is None else self.dt, time
            if fills.values:
                warnings.warn(f"ParameterTracker: y has {fills.said}", UserWarning, stacklevel=2)
            return result
        except BaseException:
            self._set_state(before)
            self._put_back(held)
            raise

    def tuned(
        self, y: ArrayLike, u: ArrayLike | None = None, *, over: Mapping[str, Any], leave_out: int | None = None
    ) -> TunedTracker:
        """Choose Q or the forgetting factor by how well each value predicts a recording one step ahead.

        Parameters
        ----------
        y : array_like, shape (N,)
            Measured output; NaN where it is missing.
        u : array_like, shape (N,) or (N, n_inputs)
            Input; the rows phi(k) for a LinearRegression.
        over : mapping of str to sequence
            Values to try: "Q" (numbers, or covariances of shape (n, n)), "forgetting", or both, and then every pair.
        leave_out : int, optional
            How many samples after the start not to judge by. Default: 20 for each parameter.

        Returns
        -------
        TunedTracker
            tracker, a copy of this one with the best values, and rows, the log-likelihood of each.

        Raises
        ------
        ValueError
            If there is nothing to try, a value or the recording does not fit, or too few samples are left.
        TypeError
            If an argument is of the wrong kind.

        Warns
        -----
        UserWarning
            If the best value is the smallest or the largest that was tried.

        Notes
        -----
        This tracker is not changed. The density of the prediction errors is the mixture that they show, for every
        value alike, whatever the influence function of the filter: outliers do not decide.

        Examples
        --------
        >>> import numpy as np
        >>> from robust_filterpy.identification import FIR
        >>> rng = np.random.default_rng(1)
        >>> u, gain = rng.choice([-1.0, 1.0], 1000), 2.0 + np.cumsum(0.01 * rng.normal(size=1000))
        >>> y = gain * u + np.where(rng.random(1000) < 0.1, 3.0, 0.3) * rng.normal(size=1000)
        >>> found = ParameterTracker(FIR(1, nk=0)).tuned(y, u, over={"Q": [0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2]})
        >>> found.best.values
        {'Q': 0.0001}
        """
        return tuned(self, y, u, over, leave_out)

    def _time_after(self, axis: TimeAxis, samples: int) -> tuple[Any, int] | None:
        """Return the time after a recording; warn if samples are missing before it, and raise if it goes back."""
        last = None if self.structure.takes_phi else axis.last
        before = self._time
        if last is None:
            return None if before is None else (before[0], before[1] + samples)
        dt = axis.dt if self.dt is None else self.dt
        missing = 0 if before is None else axis.missing_after(before, dt)
        if missing > 0:
            warnings.warn(
                f"y: {missing} missing sample(s) between {before[0]} and {axis.index[0]}, which "  # type: ignore[index]
                f"the tracker takes for neighbours; give it the gap first, tracker.run(numpy.full({missing}, "
                "numpy.nan), u) with the u of the gap",
                UserWarning,
                stacklevel=3,
            )
        return last, 0

    def _advance(self, y: Array, u: Array, R: Array | None, out: Columns) -> None:
        """Take a checked recording; the caller undoes what is refused or interrupted."""
        k = 0
        while k < y.size:
            if self._start is not None:
                part = slice(k, min(k + max(self._start.waits, 1), y.size))
                self._look_on(y, u, R, out, part)
            else:
                last = min(k + self._watch.waits, y.size) if self._restarts and self.enabled else y.size
                part = slice(k, last)
                self._run_through(y, u, R, out, part.start, part.stop)
                self._restart_if_lost(u[part], out.prediction[part], out.residual[part])
            k = part.stop

    def _held(self) -> tuple[Any, ...]:
        """Return what a sample changes: arrays are replaced, never written into."""
        start, watch = self._start, self._watch
        kept = None if start is None else (start.y, start.u, start.waits)
        names = ("_centre", "_windup", "_begun", "_restarts", "_memory", "_time", "dt")
        own = {name: getattr(self, name) for name in names}
        return *super()._held(), own, start, kept, dict(vars(watch))

    def _put_back(self, held: tuple[Any, ...]) -> None:
        """Undo what was refused, or interrupted."""
        *recursion, own, start, kept, watch = held
        vars(self).update(own)
        self._start = start
        if start is not None:
            start.y, start.u, start.waits = kept
        vars(self._watch).update(watch)
        super()._put_back(tuple(recursion))

    # The start.

    def _look_on(self, y: Array, u: Array, R: Array | None, out: Columns, part: slice) -> None:
        """Take samples up to the next look at them, and then look."""
        start = self._start
        if start is None:
            return
        if self._begun:
            self._run_through(y, u, R, out, part.start, part.stop)
            start.add(y[part], u[part])
        else:
            out.theta[part], out.variance[part] = np.ravel(self.filter.x), np.inf
            for k in range(part.start, part.stop):
                out.prediction[k] = start.level()
                start.add(y[k : k + 1], u[k : k + 1])
            out.residual[part] = y[part] - out.prediction[part]
        if self.enabled and start.waits <= 0:
            self._look()

    def _look(self) -> None:
        """Make a model of the samples so far and go on from there."""
        start = self._start
        if start is None:
            return
        last, failure = start.is_last_look, self._started(start.y, start.u)
        if last and not failure:
            self._start = None
            return
        start.wait()
        if last:
            self._say(
                self._watch.without_model(
                    f"no model can be made of {start.y.size} samples, it goes on looking: {failure}"
                )
            )

    def _restart_if_lost(self, u: Array, prediction: Array, residual: Array) -> None:
        """Look for another model from here on if the residuals follow the inputs; this one serves until then."""
        if not (self._restarts and self.enabled and u.shape[1]):
            return
        trouble = self._watch.lost(residual, np.column_stack((prediction, u)))
        if trouble:
            self._watch.forget()
            self._start = ColdStart(self.structure, self._samples)
            self._say(f"{trouble}; it starts anew, and theta may jump when a model of the next samples is found")

    def _started(self, y: Array, u: Array) -> str:
        """Go on from the model of some samples, or say why there is none."""
        R = None if self._scale.memory else self.R
        try:
            with warnings.catch_warnings():
                # A short recording leaves several models open, and those to come decide.
                warnings.simplefilter("ignore", UserWarning)
                model = identify(
                    y,
                    u if self.structure.n_inputs else None,
                    self.structure,
                    offset=self._has_offset,
                    R=R,
                    trend="constant" if self._has_offset else "none",
                )
        except ValueError as error:
            return str(error)
        self._begin(model)
        return ""

    def _begin(self, model: Model) -> None:
        """Go on from a model at the end of its recording."""
        structure, layout, kf = self.structure, self._layout, self.filter
        n, places, place = structure.n_theta, structure.polynomials, structure.constant_place
        x, P, memory = model.theta, model.P, model.memory
        if self._has_offset:
            # The constant is one more input of B/F, and drives the output from its centre.
            self._centre = model.level
            a, f = (1.0 + float(model.theta[part].sum()) for part in (places.a, places.f))
            constant, J = (model.offset - self._centre * a) * f, np.eye(n + 1)
            J[n, places.a], J[n, n] = -self._centre * f, f
            cross, square = model.offset_covariance[:, None], np.array([[model.offset_std**2]])
            joint = np.block([[P, cross], [cross.T, square]])
            order = np.insert(np.arange(n), place, n)
            x, P = np.append(x, constant)[order], (J @ joint @ J.T)[np.ix_(order, order)]
        kf.x, kf.P = x.reshape(np.shape(kf.x)).copy(), 0.5 * (P + P.T)
        self._windup = _WINDUP * max(float(np.trace(kf.P)), 1e-300)
        if self._scale.memory:
            kf.R = np.array([[model.R]])
            mean = ordinary_mean(model.noise.influence)
            self._scale = NoiseScale(float(model.weights.size), mean, self._scale.memory)
        found = Memory(layout)
        found.outputs, found.measured, found.residuals = memory.outputs, memory.outputs, memory.residuals
        found.inputs, found.gradients = memory.inputs, memory.gradients
        found.undisturbed, found.prefiltered = memory.undisturbed, memory.prefiltered
        if self._has_offset:
            found.inputs = np.append(memory.inputs, 1.0)
            f, c, d = (1.0 + float(x[part].sum()) for part in (layout.f, layout.c, layout.d))
            prefiltered = 1.0 / max(abs(f), 1e-6)
            response = prefiltered * d / max(abs(c), 1e-6)
            found.gradients = np.insert(memory.gradients, place, response, axis=1)
            found.prefiltered = np.insert(memory.prefiltered, place, prefiltered, axis=1)
        self._memory, self._begun, self._restarts = found, True, True

    @property
    def _is_watched(self) -> bool:
        """Whether the samples are those of a model that is meant to follow."""
        return self._begun and bool(self.enabled)

    def _say(self, trouble: str) -> None:
        """Warn of what is wrong, if anything."""
        if trouble:
            warnings.warn(f"ParameterTracker: {trouble}; {pointer(STOPPED)}", LostTrackerWarning, stacklevel=3)

    # Interruption.

    @property
    def _kind(self) -> str:
        """What a state belongs to."""
        return f"ParameterTracker of {self.structure}"

    def state(self) -> dict[str, Array]:
        """Return everything the recursion needs to go on, as plain arrays.

        Returns
        -------
        dict of str to ndarray
            theta and P, with the constant where there is one; the signals in memory: outputs (na,), inputs, residuals
            (nc,), gradients, measured (na,); enabled; recursion: centre of y, limit of tr P, samples, mean and memory
            of R, whether a model was found, samples until the next look; start: y and u kept for it, (L, 1 + n_inputs);
            watch: whether it may start anew and of how many samples, samples seen and autocovariances of ordinary
            residuals; followed: the residuals, predictions and inputs it judges that by, (L, 2 + n_inputs);
            and the filter's Q, R, F and alpha_sq where it has them, and what else it keeps, as ``filter_..``.
            ``format``: version, and name of tracker and structure as character codes. All of float64.
            ``numpy.savez(file, **state)`` stores it.
        """
        memory = {name: getattr(self._memory, name).copy() for name in self._layout.shapes()}
        start = self._start
        kept = np.zeros((0, 1 + self.structure.n_inputs)) if start is None else np.column_stack((start.y, start.u))
        waits = -1 if start is None else start.waits
        watch, followed = self._watch.window(1 + self.structure.n_inputs)
        arrays = {
            "theta": np.array(self.filter.x, dtype=float).ravel(),
            "P": np.array(self.filter.P, dtype=float),
            **memory,
            "enabled": bool(self.enabled),
            "recursion": [self._centre, self._windup, *self._scale, self._begun, waits],
            "start": kept,
            "watch": [self._restarts, self._samples, *watch],
            "followed": followed,
            **setup.settings(self.filter),
            **setup.kept_by(self.filter),
        }
        return _state.labelled(self._kind, arrays)

    def restore(self, state: Any) -> None:
        """Go back to a state of this tracker, or of another one with the same structure and kind of filter.

        Parameters
        ----------
        state : mapping of str to ndarray
            From `state`, or what ``numpy.load`` makes of a file that holds it.

        Raises
        ------
        ValueError
            If it is of another structure or a newer format, an array is missing, does not fit, or holds NaN or a
            variance that is not positive; nothing has changed then.
        TypeError
            If state is no mapping.

        Notes
        -----
        The continuation is the same to the last bit, for filters that hold x and P themselves. What it has warned of is
        not in a state; one from before there was a watch in it is watched from here on.
        """
        n = self._layout.n
        shapes = {"theta": (n,), "P": (n, n), **self._layout.shapes(), "enabled": (), "recursion": (7,)}
        shapes["start"] = (-1, 1 + self.structure.n_inputs)
        _state.require_kind(state, self._kind)
        watched = {"watch": (6,), "followed": (-1, 2 + self.structure.n_inputs)}
        shapes |= watched if any(name in state for name in watched) else {}
        found = setup.checked_state(state, shapes, setup.settings(self.filter))
        setup.require_consistent(found, () if self._guard == "none" else self._layout.stable)
        setup.take_over(self.filter, state)
        self._set_state(found)
        self._time = None

    def _set_state(self, found: dict[str, Array]) -> None:
        """Take over a checked state."""
        self.filter.x = found["theta"].reshape(np.shape(self.filter.x))
        setup.apply_settings(self.filter, found)
        self.filter.P = found["P"]
        for name in self._layout.shapes():
            setattr(self._memory, name, found[name])
        self.enabled = bool(found["enabled"])
        self._centre, self._windup, *scale, begun, waits = found["recursion"].tolist()
        self._scale, self._begun, self._start = NoiseScale(*scale), bool(begun), None
        watch = found.get("watch", np.array([self._restarts, self._samples, 0.0, 0.0, 0.0, 0.0]))
        self._restarts, self._samples = bool(watch[0]), int(watch[1])
        self._watch.go_on(watch[2:], found.get("followed", np.zeros((0, 1))))
        if waits >= 0:
            self._start = ColdStart(self.structure, self._samples)
            self._start.y, self._start.u = found["start"][:, 0].copy(), found["start"][:, 1:].copy()
            self._start.waits = int(waits)

    def _set(self, theta: ArrayLike | None = None, P: ArrayLike | None = None) -> None:
        """Put other parameters, or another covariance, in the place of those that were found."""
        setup.configure(
            self.filter, self.structure, self._own, theta=theta, P=P, Q=None, R=None, F=None, forgetting=None
        )  # fmt: skip

    def reset(self) -> None:
        """Go back to the start: theta, P, Q, R, F and the memory as they were when the tracker was made."""
        self.restore(self._initial)
