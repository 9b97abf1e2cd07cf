"""ParameterTracker: a filter whose state is the parameter vector of a model. TrackerBank: many of them at once."""

from __future__ import annotations

import copy
import itertools
import warnings
from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._brief import lines_of, tabulated
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import fill_values
from robust_filterpy._state import LABEL
from robust_filterpy._warning import warn
from robust_filterpy.correction.options import Information, Scaling
from robust_filterpy.filters.states import kept_with, moved_shapes
from robust_filterpy.identification.models import regressor, signals
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.noise import fit_percent, likelihood_of_mixture
from robust_filterpy.identification.models.regressor import GUARDS, Guard, Layout, Memory
from robust_filterpy.identification.models.responses import PolynomialSystem
from robust_filterpy.identification.models.results import Sample, TrackingResult, signals_of
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive import recursion, setup, track
from robust_filterpy.identification.recursive.following import Following
from robust_filterpy.identification.recursive.recursion import GRADIENTS, REGRESSORS, Form, Gradient, Regressor, State
from robust_filterpy.identification.recursive.watch import SPAN
from robust_filterpy.influence.functions import Influence
from robust_filterpy.influence.regression import mad_scale

#: Samples that a tracker looks at before it takes a stand: OutputError(4, 4) with 10 % outliers needs about as many.
START = 400

# So many parameters are printed with a line for each.
_SHOWN: Final = 12
# What may be tried, and the value with which theta stands still.
_STANDS_STILL: Final = {"Q": 0.0, "forgetting": 1.0}
# Samples left out after the start, for each parameter, and how many must be left to judge by.
_SETTLING: Final = 20
_LEAST: Final = 50
# A residual this many times as large as y varies is as wild as any.
_WILD: Final = 10.0


class Tried(NamedTuple):
    """One candidate of `TunedTracker`.

    Attributes
    ----------
    values : dict of str
        What was set, by name.
    log_likelihood : float
        Of the prediction errors one step ahead; -inf if the filter could not go through the recording.
    """

    values: dict[str, Any]
    log_likelihood: float


class TunedTracker(NamedTuple):
    """What `ParameterTracker.tuned` chose.

    Attributes
    ----------
    tracker : ParameterTracker
        The tracker as it was before the recording, with the chosen values.
    rows : tuple of Tried
        All candidates, in the order in which they were given.
    samples : int
        How many samples they were judged by.
    warning : str
        What makes the choice doubtful, in words; empty if nothing does.
    """

    tracker: ParameterTracker
    rows: tuple[Tried, ...]
    samples: int
    warning: str

    @property
    def best(self) -> Tried:
        """The candidate with the greatest log-likelihood."""
        return max(self.rows, key=lambda row: row.log_likelihood)

    def to_text(self) -> str:
        """Return the candidates as a table, values within 2 of the best predict as well.

        Returns
        -------
        str
        """
        heads = dict.fromkeys(self.best.values, 16) | {"log-likelihood": 18, "below best": 12}
        rows = []
        for row in self.rows:
            below = self.best.log_likelihood - row.log_likelihood
            numbers = f"{row.log_likelihood:.1f}", f"{below:.1f}", "  chosen" if row is self.best else ""
            rows.append((*map(_short, row.values.values()), *numbers))
        doubt = [f"Doubtful: {self.warning}"] if self.warning else []
        return tabulated(heads, rows, f"predictions one step ahead of {self.samples} samples", *doubt)

    def __str__(self) -> str:
        """Return the table."""
        return self.to_text()

    def to_frame(self) -> Any:
        """Return the candidates as a pandas DataFrame, a row for each.

        Returns
        -------
        pandas.DataFrame
            A column for each name, and log_likelihood.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        return signals.table([{**row.values, "log_likelihood": row.log_likelihood} for row in self.rows])


class ParameterTracker(Following, PolynomialSystem):
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
    filter : RobustKalmanFilter, AdaptiveKalmanFilter or filterpy's KalmanFilter, or the class of one, optional
        With dim_x = structure.n_theta (one more with an offset) and dim_z = 1.
        ``filter=filterpy.kalman.KalmanFilter`` is the baseline without robustness, the same as ``influence=Linear()``;
        an object of it is copied and stays as it is. Default: a `RobustKalmanFilter`.
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
        Whether there is a constant besides theta, for outputs that are not measured from their rest. Default: with a
        start yes, except for a LinearRegression, whose columns are the caller's.
    regressor : {"measured", "cleaned"}
        Which outputs an ARX, ARMAX, AR, ARMA or BoxJenkins has in its regressor: those measured, or the prediction in
        the place of those further than 3 standard deviations from it (the filter-cleaner of Masreliez and Martin),
        unless the outputs as measured explain the next sample. Default: "cleaned" with a start, "measured" with
        ``start=0``, as in the paper. For other structures the difference is that under "cleaned" a sensor that is stuck
        counts as missing.
    R_memory : int, default 150
        Number of samples that an R which is followed remembers.
    forgetting : float, optional
        Forgetting factor in (0, 1] as in recursive least squares, instead of Q or with it: P is divided by it at
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
    filter : RobustKalmanFilter
        The filter; Q, R, F and forgetting are read from it and written to it. Its x, P and R are always those of the
        last sample. What it shows of the last correction (y, S, K, weights, ..) is made from when this attribute was
        first read on, which makes each `update` cost more: ask for it only if you want that.
    form : Form
        What its recursion is, for what takes the recursion elsewhere (C, a fleet).
    enabled : bool
        False freezes theta and P, while predictions go on.
    offset : float
        Constant of the equation, as in `Model`; `level` is what it means for y.
    dt : float or None
        Sampling period in s, as the index of the first recording that has one says; may be set.

    Raises
    ------
    ValueError
        If a shape, a number or an option does not fit, or the model to start from is unstable.
    TypeError
        If structure or filter is of the wrong kind; no other filter, nor a subclass of filterpy's, is taken.

    Warns
    -----
    LostTrackerWarning
        Once, if the start found no model or one that leaves what follows the inputs (the structure does not fit), most
        samples look like outliers, the guard acts all the time, R wanders, or an offset is not modeled. Whenever
        residuals follow the inputs otherwise than at the start, since the plant has become another one or the sensor is
        stuck, or stay off zero, since the level of y has moved: a tracker that found its model itself, or has it from
        `identify`, then starts anew; where over 480 samples only the gain is another, it goes on with that.
    StuckSensorWarning
        Once, if y repeats its last value to the last bit, more than three standard deviations from the prediction,
        though it seldom does and its noise is white: it then counts as missing for as long as it does. Also if the
        start's own samples hold a value as `identify` says.

    Notes
    -----
    In print (20) has v(k-1) where u(k-1) belongs, and (17) and Table 1 exchange the two variances. Table 1 as it
    stands is ``scaling="unit", gradient="pseudolinear", guard="none", R=1, start=0``.

    Gradient. The pseudo-linear form converges only where 1/A (ARMAX: 1/C) is strictly positive real. Median over 400
    runs of the mean \\|theta_hat - theta\\| over samples 500-1000, a = [-1.5, .7], b = [1, .5], u = +-1 white, nominal
    noise .5, outliers 10 times that, from theta = 0, P = I, Q = 1e-6 I; "Kalman" has the variance of the mixture,
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
    of Huber's function, the default, and up to a third above it where R is given ten times too small.

    On the plant of section 4, of which 1000 samples tell little (the Cramer-Rao bound of \\|theta_hat - theta\\| is .74
    with the 1/f input), the filtered gradient has .52 of relative error in the noise-free output at contamination .1,
    the pseudo-linear form .90.

    Guard. The same error, contamination .1, the plant drifting by W, which is the tracker's Q, 400 runs:

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

    No guard is best everywhere. "halve" is the default since it is best where the parameters can be learned, and
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
        self, structure: Structure | Model, *, filter: Any = None, theta: ArrayLike | None = None,
        P: ArrayLike | None = None, Q: ArrayLike | None = None, R: ArrayLike | None = None, F: ArrayLike | None = None,
        forgetting: float | None = None, start: int | None = None, offset: bool | None = None,
        regressor: Regressor | None = None, R_memory: int = 150, gradient: Gradient = "filtered",
        guard: Guard = "halve", influence: Influence | None = None, scaling: Scaling | None = None,
        information: Information | None = None,
    ) -> None:  # fmt: skip
        """Set up the filter and a memory at rest; so many arguments, since each is one of a model's or a filter's."""
        given = dict(locals())
        model = structure if isinstance(structure, Model) else None
        self.structure = structure = setup.structure_of(structure)
        _checks.option("gradient", gradient, GRADIENTS)
        _checks.option("guard", guard, GUARDS)
        ready = filter is not None and not isinstance(filter, type)
        warm = theta is not None or P is not None or ready or model is not None
        samples = (0 if warm else START) if start is None else _checks.count("start", start)
        if samples and warm:
            raise ValueError(f"start: expected 0 with theta, P or a filter object or model to begin with, got {start}")
        default: Regressor = "cleaned" if samples or model is not None else "measured"
        kind = default if regressor is None else _checks.option("regressor", regressor, REGRESSORS)
        has_offset = setup.has_offset(offset, structure, model, bool(samples))
        layout = Layout(structure.with_constant(), structure.n_inputs) if has_offset else Layout(structure)
        judges = kind == "cleaned"
        cleans = judges and structure.na + structure.nd > 0
        own = np.delete(np.arange(layout.n), [structure.constant_place] if has_offset else [])
        flags = np.array([[gradient == "filtered", GUARDS.index(guard), cleans, True, judges]], dtype=np.intp)
        self.form = Form(structure, layout, own, has_offset, cleans, judges, flags)
        choices = {"influence": influence, "scaling": scaling, "information": information}
        kf = setup.make_filter(layout.n, filter, choices)
        setup.configure(kf, structure, own, given)
        if ready and Q is None:
            setup.warn_of_default_noise(kf)
        self.n, self._filters, self._enabled = 1, [kf], np.array([True])
        memory = 0.0 if R is not None or ready else float(_checks.count("R_memory", R_memory, 2))
        scale = np.array([[recursion.given_variance(kf), 0.0, recursion.ordinary_mean(None), memory, 0.0]])
        self._now = recursion.at_rest(self.form, np.ravel(kf.x), np.asarray(kf.P), scale, samples or START, not samples)
        self.dt, self._time, self._used = None, None, None
        self._asked = kf is filter
        if model is not None:
            self._now = track.gone_on(self.form, self._now, 0, model)
            self._load()
            # What is given goes before what was found.
            setup.configure(kf, structure, own, {"theta": theta, "P": P})
            self._now, self.dt = self._pulled(), model.dt
        self._initial = self.state()

    def __repr__(self) -> str:
        """Show the model as it stands."""
        values = ", ".join(f"{name}={value:.4g}" for name, value in zip(self.structure.names, self.theta, strict=True))
        return f"ParameterTracker({self.structure}, {values})"

    def __str__(self) -> str:
        """Return the parameters with their standard deviations, the level and the noise, as they fit a screen."""
        parts: dict[str, Any] = {"theta": self.theta, "std": self.std}
        if len(self.theta) <= _SHOWN:
            each = zip(self.structure.names, self.theta, self.std, strict=True)
            parts = {name: f"{value:.5g} +- {std:.2g}" for name, value, std in each}
        values = {**parts, "level": float(self.level), "R": float(self.R)}
        return "\n".join([self.kind, *lines_of(values)])

    # The model as it stands.

    def _alone(self, values: Any) -> Any:
        """Return what its one actuator has."""
        return values.item() if values.ndim == 1 else values[0]

    @property
    def _axes(self) -> tuple[int, ...]:
        """A state has no axis of actuators."""
        return ()

    @property
    def _filter(self) -> Any:
        """The filter, which may not show where the tracker stands."""
        return self._filters[0]

    @property
    def gradient(self) -> Gradient:
        """What the gain is computed from: "filtered" or "pseudolinear"."""
        return GRADIENTS[self.form.flags[0, 0]]

    @property
    def guard(self) -> Guard:
        """What happens to an unstable step: "halve", "reject" or "none"."""
        return GUARDS[self.form.flags[0, 1]]

    @property
    def _noise_samples(self) -> float:
        """How many samples R stands on; one that is given counts as certain."""
        return float(self._now.scale[0, 3]) or np.inf

    @property
    def forgetting(self) -> float:
        """Forgetting factor, in (0, 1]; may be set."""
        return float(self._filter.alpha) ** -2

    @forgetting.setter
    def forgetting(self, value: float) -> None:
        setup.forget(self._filter, value)
        self._used = None

    @property
    def _facts(self) -> dict[str, str]:
        """What the table says besides the parameters."""
        return {"R": f"{self.R:.4g}", "Level": f"{self.level:.4g}", "Forgetting": f"{self.forgetting:.4g}"}

    @property
    def _doubt(self) -> str:
        """That there is no model yet."""
        return "" if self._now.begun[0] else "the start has not found a model yet"

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
        axis, _, u = signals_of(self, None, u)
        signal = signals.recorded_input(self.structure, u, None)
        if continued:
            layout, signal = self.form.layout, self.form.with_constant(signal)
            now = self._standing()
            x, memory, level = now.theta[0], Memory(*(a[0] for a in now.past)), now.part("centre")[0]
        else:
            layout = Layout(self.structure)
            x, memory, level = self.theta, Memory.at_rest(layout), self.level
        y = regressor.simulate(self.structure, layout, memory, x, signal) + level
        return axis.labelled(y, "simulated")

    fit = staticmethod(fit_percent)

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
        prediction, residual, weight, guard = self._updated(y, u, R)[0].tolist()
        return Sample(prediction, residual, weight, int(guard))

    def run(
        self, y: ArrayLike, u: ArrayLike | None = None, R: ArrayLike | None = None, *, progress: bool | None = None
    ) -> TrackingResult:
        """Take a whole recording; the numbers are those of `update`, sample by sample.

        Parameters
        ----------
        y : array_like, shape (N,)
            Measured output, N >= 1; NaN where it is missing. A pandas Series has the index of u, in equal steps.
        u : array_like, shape (N,) or (N, n_inputs)
            Input; the rows phi(k) for a LinearRegression.
        R : array_like, shape (N,), or float, optional
            Variance of the noise in each sample, for sensors that say how sure they are. Default: the filter's R.
        progress : bool, optional
            Say on standard error what it is at: True at once, False never, None from 2 s on.

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
        comes with an influence function of this package, a sample takes a few microseconds; the numbers are those of
        `update` to the last bit.
        """
        axis, y, u, R = signals.recording(self.structure, y=y, u=u, R=R)
        fills = fill_values(signals.measured_output(y))
        signal = signals.recorded_input(self.structure, u, fills.signal.size)[:, None]
        columns = self._recorded(axis, [fills], signal, R, progress)
        return TrackingResult(*(column[:, 0] for column in columns)).labelled(self.structure.names, axis.index)

    def tuned(self, y: ArrayLike, u: ArrayLike | None = None, *, over: Mapping[str, Any]) -> TunedTracker:
        """Choose Q or the forgetting factor by how well each value predicts a recording one step ahead.

        Parameters
        ----------
        y : array_like, shape (N,)
            Measured output; NaN where it is missing.
        u : array_like, shape (N,) or (N, n_inputs)
            Input; the rows phi(k) for a LinearRegression.
        over : mapping of str to sequence
            Values to try: "Q" (numbers, or covariances of shape (n, n)), "forgetting", or both, and then every pair.

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
        value alike, whatever the influence function of the filter: an outlier costs a bounded amount whichever value it
        is held against. The samples of the start, and 20 for each parameter after them, in which P forgets how it
        began, are not judged.

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
        candidates = _candidates(self, over)
        _, y, u = signals_of(self, y, u)
        output = signals.recorded_output(y)
        signal = signals.recorded_input(self.structure, u, output.size)
        if not self.enabled:
            raise ValueError("tracker: expected one that learns, got enabled=False: no value makes a difference")
        ready, start = copy.deepcopy(self), self.now.starts.get(0)
        first = 0 if start is None else min(max(start.samples - start.y.size, 0), output.size)
        settling = _SETTLING * self.structure.n_theta
        judged = np.flatnonzero(~np.isnan(output[first:]) & (np.arange(output.size - first) >= settling))
        if judged.size < _LEAST:
            raise ValueError(
                f"y: expected at least {_LEAST} measured samples after the first {first + settling}, of the start and "
                f"those in which P forgets how it began, got {judged.size}; record more, or take a smaller start"
            )
        wild = _WILD * mad_scale(output[~np.isnan(output)] - np.nanmedian(output)) or np.inf
        rows = []
        with warnings.catch_warnings():
            # A value that is far off loses its way, which its likelihood says.
            warnings.simplefilter("ignore", UserWarning)
            if first:
                # No value changes the model of these samples.
                ready.run(output[:first], signal[:first])
            for values in candidates:
                try:
                    e = ready.replaced(**values).run(output[first:], signal[first:]).residual[judged]
                    rows.append(Tried(values, likelihood_of_mixture(e[~np.isnan(e)], wild)))
                except (np.linalg.LinAlgError, ValueError):
                    rows.append(Tried(values, -np.inf))
        chosen = max(rows, key=lambda row: row.log_likelihood)
        if not np.isfinite(chosen.log_likelihood):
            raise ValueError("over: expected a value with which the filter goes through the recording, got none")
        doubt = _end_of(chosen.values, candidates)
        if doubt:
            warn(f"tuned: {doubt}")
        return TunedTracker(self.replaced(**chosen.values), tuple(rows), judged.size, doubt)

    def advance(self, y: Array, u: Array, R: Array | None) -> Array:
        """Take the checked samples of a recording; the caller undoes what is refused or interrupted.

        Parameters
        ----------
        y : ndarray, shape (N,)
            Outputs, NaN where one is missing.
        u : ndarray, shape (N, n_inputs)
            Inputs, without gaps.
        R : ndarray, shape (N,), or None
            Variances of the noise.

        Returns
        -------
        ndarray, shape (N, 2 n + 4)
            Theta, with the constant where there is one, its variances, prediction, residual, weight and guard.
        """
        return self._taken(0, y[None], u[None], None if R is None else R[None])[0]

    @property
    def is_one_of_many(self) -> bool:
        """Whether the kernel takes its samples, with those of others, and its filter keeps nothing of its own."""
        return self._using().rules is not None and not kept_with(self._filter)

    def together(self, states: Mapping[str, Any], y: Array, u: Array) -> tuple[Array, dict[str, np.ndarray]]:
        """Take the checked samples of several like this one, or raise; this one stays as it is.

        Parameters
        ----------
        states : mapping of str to ndarray
            Arrays of as many states, with an axis in front; "start" and "followed", whose lengths differ, in arrays of
            objects.
        y : ndarray, shape (n, N)
            Outputs, NaN where one is missing.
        u : ndarray, shape (n, N, n_inputs)
            Inputs.

        Returns
        -------
        out : ndarray, shape (n, N, ..)
            Rows as of `advance`.
        after : dict of str to ndarray
            The states after it.
        """
        many = self._like(Following, np.zeros(len(y), dtype=int))
        many._go_back({**states, **{name: recursion.padded(states[name]) for name in ("start", "followed")}})
        out = many._taken(0, y, u, None)
        many._now, news = track.settled(many.form, many._now)
        many._say(news)
        after = many._now.arrays() | {"enabled": many._enabled}
        lengths = {"start": after["kept"], "followed": np.minimum(after["seen"], SPAN)}
        return out, after | {name: recursion.apart(after[name], size) for name, size in lengths.items()}

    @property
    def filter(self) -> Any:
        """The filter. From when it is first asked for on it shows the last correction (y, S, K, weights, ..)."""
        if not self._asked:
            self._load()
        self._asked = True
        return self._filter

    def _standing(self) -> State:
        """Return where it stands: who has the filter may have written into it."""
        return self._pulled() if self._asked else self._now

    def _pulled(self) -> State:
        """Return the state with theta, P and R as the filter has them."""
        kf, scale = self._filter, self._now.scale.copy()
        scale[0, 0] = recursion.given_variance(kf)
        return self._now.with_parts(theta=np.ravel(kf.x), P=kf.P, scale=scale)

    def replaced(self, *, Q: ArrayLike | None = None, forgetting: float | None = None) -> ParameterTracker:
        """Return a copy with another Q or forgetting, which it has after a reset, too.

        Parameters
        ----------
        Q : array_like, shape (n_theta, n_theta), or scalar, optional
            Covariance by which theta moves in a step; by default as it is.
        forgetting : float, optional
            Forgetting factor in (0, 1]; by default as it is.

        Returns
        -------
        ParameterTracker
            Independent of this one.
        """
        tracker = copy.deepcopy(self)
        values = {name: value for name, value in {"Q": Q, "forgetting": forgetting}.items() if value is not None}
        for name, value in values.items():
            setattr(tracker, name, value)
        settings = setup.settings(tracker._filter)
        changed = {name: settings[name] for name in ("Q", "alpha_sq") if name in settings}
        tracker._initial = tracker._initial | changed
        return tracker


def keeps_spread(tracker: ParameterTracker) -> bool:
    """Return whether a tracker's filter learns how large its innovations usually are."""
    return "spread" in moved_shapes(tracker._filter)


class TrackerBank(Following):
    """Follow the parameters of n actuators of one structure; equal to a loop over n `ParameterTracker`.

    Parameters
    ----------
    n : int
        Number of actuators, >= 1.
    structure : Structure or Model
        What phi is made of: ARX(..), OutputError(..) .., or the model from which all of them go on, as in
        `ParameterTracker`.
    theta : array_like, shape (n_theta,) or (n, n_theta), or float, optional
        Parameters to start from. Default: found by the start; 0 with ``start=0``.
    P : array_like, shape (n_theta, n_theta) or (n, n_theta, n_theta), or float, or shape (n,), optional
        Their covariances; a number p stands for p I. Default: found by the start; 100 I with
        ``start=0``.
    Q : array_like, any shape that P may have, optional
        Covariance of a step of theta (paper 8). Default: 0.
    R : float, or array_like, shape (n,), optional
        Variance of the ordinary noise. Default: found from the data and followed. Setting the attribute fixes it.
    F : array_like, shape (n_theta, n_theta) or (n, n_theta, n_theta), optional
        Transition matrix C of (9). Default: the identity.
    forgetting : float, or array_like, shape (n,), optional
        Forgetting factor in (0, 1].
    start : int, optional
        How many samples may be looked at for a model of each actuator, as in `ParameterTracker`. Default: 400, or 0 if
        theta or P is given.
    offset : bool, optional
        Whether there is a constant; default as in `ParameterTracker`.
    regressor, R_memory
        As in `ParameterTracker`.
    gradient, guard : str, or list of n str
        As in `ParameterTracker`.
    influence, scaling, information : optional
        As in `RobustKalmanFilter`, or lists of n.

    Attributes
    ----------
    n : int
        As given.
    structure : Structure
        As given.
    Q, F : ndarray, shape (n_theta, n_theta) or (n, n_theta, n_theta)
        As given; may be changed between samples.
    R : ndarray, shape (n,), or float
        As given; may be changed between samples.

    Raises
    ------
    ValueError, TypeError
        As by `ParameterTracker`; the message names the actuators.

    Warns
    -----
    LostTrackerWarning, StuckSensorWarning
        As `ParameterTracker`; the message names the actuators.

    Notes
    -----
    Everything is `ParameterTracker`'s, by the kernel for all actuators where that serves
    (`robust_filterpy.kernel`), otherwise one actuator after the other. The filters are always the robust
    ones: for the Kalman baseline pass ``influence=Linear()``.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.identification import ARX
    >>> rng = np.random.default_rng(1)
    >>> gains = np.linspace(1.0, 2.0, 5)
    >>> u = rng.choice([-1.0, 1.0], 400)
    >>> y = np.zeros((400, 5))
    >>> for k in range(1, 400):
    ...     y[k] = 0.8 * y[k - 1] + gains * u[k - 1] + 0.1 * rng.normal(size=5)
    >>> y[rng.random(y.shape) < 0.01] = np.nan
    >>> bank = TrackerBank(5, ARX(1, 1), R=0.01)
    >>> result = bank.run(y, u)
    >>> result.theta.shape, bool(np.abs(bank.coefficients.b[:, 0] - gains).max() < 0.05)
    ((400, 5, 2), True)
    """

    _name = "TrackerBank"

    def __init__(
        self, n: int, structure: Structure | Model, *, theta: ArrayLike | None = None, P: ArrayLike | None = None,
        Q: ArrayLike | None = None, R: ArrayLike | None = None, F: ArrayLike | None = None,
        forgetting: ArrayLike | None = None, start: int | None = None, offset: bool | None = None,
        regressor: Regressor | None = None, R_memory: int = 150,
        gradient: Gradient | Sequence[Gradient] = "filtered", guard: Guard | Sequence[Guard] = "halve",
        influence: Influence | Sequence[Influence] | None = None, scaling: Scaling | Sequence[Scaling] | None = None,
        information: Information | Sequence[Information] | None = None,
    ) -> None:  # fmt: skip
        """Set up n filters and a memory at rest; so many arguments, since they are those of a `ParameterTracker`."""
        given = {name: value for name, value in locals().items() if name not in ("self", "n")}
        n = _checks.count("n", n, 1)
        # Every actuator is a tracker; one stands for all where they have their options in common.
        trackers = setup.for_each(lambda each: ParameterTracker(**each), setup.of_each(n, given))
        if len(trackers) < n and keeps_spread(trackers[0]):
            trackers = [copy.deepcopy(trackers[0]) for _ in range(n)]
        vars(self).update(vars(trackers[0]._like(TrackerBank, np.zeros(n, dtype=int))))
        if len(trackers) > 1:
            states = [one.state() for one in trackers]
            self.form = self.form._replace(flags=np.concatenate([one.form.flags for one in trackers]))
            self._filters = [one._filters[0] for one in trackers]
            self._go_back({name: np.stack([one[name] for one in states]) for name in states[0] if name != LABEL})
        self._initial = self.state()

    def __repr__(self) -> str:
        """Show the size and the structure."""
        return f"TrackerBank(n={self.n}, {self.structure})"

    def __str__(self) -> str:
        """Show where the models stand as well."""
        return "\n".join([repr(self), *lines_of({"theta": self.theta, "std": self.std, "R": self.R})])

    # The models as they stand.

    @property
    def coefficients(self) -> Any:
        """Those of the polynomials, each with a leading axis of n; see `ParameterTracker`."""
        return regressor.coefficients(self.structure, self.theta)

    def tracker(self, i: int) -> ParameterTracker:
        """Return a tracker of one actuator that goes on where the bank is, and resets to where the bank began.

        Parameters
        ----------
        i : int
            Which actuator, from 0.

        Returns
        -------
        ParameterTracker
            Independent of the bank.

        Raises
        ------
        IndexError
            If there is no such actuator.
        TypeError
            If i is no integer.
        """
        if isinstance(i, bool) or not isinstance(i, (int, np.integer)):
            raise TypeError(f"actuator: expected an integer from 0 to {self.n - 1}, got {i!r}")
        if not 0 <= i < self.n:
            raise IndexError(f"actuator: expected 0 to {self.n - 1}, got {i}")
        one = self._like(ParameterTracker, np.array([i]))
        one._filters = copy.deepcopy(one._filters)
        one._initial = {name: value[i] for name, value in self._initial.items() if name != LABEL}
        return one

    # The recursion.

    def update(self, y: ArrayLike | None, u: ArrayLike | None = None, R: ArrayLike | None = None) -> Sample:
        """Take one sample of every actuator: the outputs y(k) and the inputs u(k).

        Parameters
        ----------
        y : array_like, shape (n,), or None
            Measured outputs; NaN where one is missing, None if all are.
        u : array_like, shape (n,), or (n, n_inputs) for several inputs, optional
            Inputs of the same sample; a number, or shape (n_inputs,), for all actuators alike.
        R : float, or array_like, shape (n,), optional
            Variances of the noise in this sample. Default: the bank's R.

        Returns
        -------
        Sample
            prediction, residual, weight, guard, each of shape (n,).

        Raises
        ------
        ValueError, TypeError
            If y is infinite, u not finite, R not positive or a shape wrong; no actuator has changed then.
        LinAlgError
            If a filter refuses its sample; no actuator has changed then.
        """
        prediction, residual, weight, guard = self._updated(y, u, R).T
        return Sample(prediction, residual, weight, guard.astype(np.int64))

    def run(
        self, y: ArrayLike, u: ArrayLike | None = None, R: ArrayLike | None = None, *, progress: bool | None = None
    ) -> TrackingResult:
        """Take whole recordings, or parts of them, which go on from each other; the numbers are those of `update`.

        Parameters
        ----------
        y : array_like, shape (N, n)
            Measured outputs, N >= 1; NaN where one is missing. A pandas DataFrame has the index of u, in equal steps.
        u : array_like, shape (N, n), or (N, n, n_inputs) for several inputs, optional
            Inputs; shape (N,), or (N, n_inputs), for all actuators alike.
        R : array_like, shape (N, n), or (N,) for all actuators alike, or float, optional
            Variances of the noise in each sample. Default: the bank's R.
        progress : bool, optional
            Say on standard error what it is at: True at once, False never, None from 2 s on.

        Returns
        -------
        TrackingResult
            theta, std, prediction, residual, weights, guard, with axes (N, n, ..); `TrackingResult.tracker` has one.

        Raises
        ------
        ValueError, TypeError
            If y or u is empty or not finite, R not positive, or a shape wrong; no actuator has changed then.
        LinAlgError
            If a filter refuses a sample; the message names both, and no actuator has changed then.

        Warns
        -----
        UserWarning
            If outputs have fill values, which are taken for missing as in `ParameterTracker.run`; it names them.
        """
        names = getattr(y, "columns", range(self.n))
        axis, y, u, R = signals.recording(self.structure, y=y, u=u, R=R)
        fills = [fill_values(column) for column in setup.outputs(y, self.n, True).T]
        signal = setup.inputs(self.structure, u, self.n, fills[0].signal.size)
        columns = self._recorded(axis, fills, signal, R, progress, [f"{name}: " for name in names])
        return TrackingResult(*columns).labelled(self.structure.names, axis.index, tuple(names))

    def _named(self, which: list[int]) -> str:
        """Return some actuators as a message begins with them."""
        return f"{setup.actuators(np.isin(np.arange(self.n), which))}: "


def _candidates(tracker: ParameterTracker, over: Any) -> list[dict[str, Any]]:
    """Return every combination of the values, checked."""
    if not isinstance(over, Mapping) or not over or set(over) - set(_STANDS_STILL):
        example = 'of Q or forgetting or both, such as {"Q": [1e-6, 1e-5]}'
        raise ValueError(f"over: expected values to try by name, {example}, got {_checks.shown(over)}")
    for name, values in over.items():
        if np.ndim(values) == 0 or not len(values):
            raise ValueError(f"over[{name!r}]: expected a sequence of values to try, got {_checks.shown(values)}")
    lists = ([one.item() if isinstance(one, np.generic) else one for one in values] for values in over.values())
    candidates = [dict(zip(over, values, strict=True)) for values in itertools.product(*lists)]
    for values in candidates:
        tracker.replaced(**values)
    return candidates


def _end_of(chosen: dict[str, Any], candidates: list[dict[str, Any]]) -> str:
    """Say which value lies at the end of what was tried, where a further one may be better; or nothing."""
    for name, value in chosen.items():
        tried = [values[name] for values in candidates]
        if any(np.ndim(one) for one in tried) or len(set(tried)) < 2 or value == _STANDS_STILL[name]:
            continue
        # Between Q = 0 and the next value are many.
        where = {max(tried): "larger", min(one for one in tried if one > 0.0): "smaller"}.get(value)
        if where:
            return f"the best {name}, {value:g}, is at the end of what was tried; try {where} ones too"
    return ""


def _short(value: Any) -> str:
    """Return a value as a cell of the table."""
    return f"{value:.3g}" if np.ndim(value) == 0 else f"trace {np.trace(np.atleast_2d(value)):.3g}"
