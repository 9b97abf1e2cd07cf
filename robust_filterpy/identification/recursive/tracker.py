"""ParameterTracker: a filter whose state is the parameter vector of a model. TrackerBank: many of them at once."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._brief import lines_of
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import fill_values
from robust_filterpy._state import LABEL
from robust_filterpy.identification.models import regressor, signals
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.noise import fit_percent
from robust_filterpy.identification.models.regressor import GUARDS, Guard, Layout, Memory
from robust_filterpy.identification.models.responses import PolynomialSystem
from robust_filterpy.identification.models.results import Sample, TrackingResult, signals_of
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive import recursion, setup, track
from robust_filterpy.identification.recursive.following import Following
from robust_filterpy.identification.recursive.recursion import GRADIENTS, Gradient
from robust_filterpy.identification.recursive.watch import SPAN

# So many parameters are printed with a line for each.
_SHOWN: Final = 12


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
        ``filter=filterpy.kalman.KalmanFilter`` is the baseline without robustness, the same as ``influence=Linear()``.
        An object is copied and stays as it is. Default: a `RobustKalmanFilter`.
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
        given. 0: the recursion begins at once, as in the paper. P of a model of fewer samples does not count that
        outliers in a regressor of outputs may be other samples; that of all of them does.
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
        A copy of the filter as the tracker stands: what is written into it is the copy's. Q, R, F and forgetting may be
        set on the tracker, theta and P by ``tracker.restore({**tracker.state(), "P": ..})``. `corrections` shows what
        it does with each sample.
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

    def _sample(self, rows: Array) -> Sample:
        """Return what a sample gave."""
        prediction, residual, weight, guard = rows[0].tolist()
        return Sample(prediction, residual, weight, int(guard))

    @property
    def _axes(self) -> tuple[int, ...]:
        """A state has no axis of actuators."""
        return ()

    @property
    def gradient(self) -> Gradient:
        """What the gain is computed from: "filtered" or "pseudolinear"."""
        return GRADIENTS[self.form.flags[0]]

    @property
    def guard(self) -> Guard:
        """What happens to an unstable step: "halve", "reject" or "none"."""
        return GUARDS[self.form.flags[1]]

    @property
    def _noise_samples(self) -> float:
        """How many samples R stands on; one that is given counts as certain."""
        return float(self._now.scale[0, 3]) or np.inf

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
            now = self._now
            x, memory, level = now.theta[0], Memory(*(a[0] for a in now.past)), now.part("centre")[0]
        else:
            layout = Layout(self.structure)
            x, memory, level = self.theta, Memory.at_rest(layout), self.level
        y = regressor.simulate(self.structure, layout, memory, x, signal) + level
        return axis.labelled(y, "simulated")

    fit = staticmethod(fit_percent)

    # The recursion.

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

        def made(columns: list[Array]) -> TrackingResult:
            return TrackingResult(*(column[:, 0] for column in columns)).labelled(self.structure.names, axis.index)

        return self._recorded(axis, [fills], signal, R, progress, made)

    def corrections(self, y: ArrayLike, u: Any = None) -> Iterator[Any]:
        """Yield the filter as it shows the correction of each sample, by the definition; this tracker stays as it is.

        Parameters
        ----------
        y : array_like, shape (N,)
            Measured outputs; NaN where one is missing.
        u : array_like, shape (N,) or (N, n_inputs), optional
            Inputs.

        Yields
        ------
        RobustKalmanFilter
            The same object every time, with y, S, K, weights, .. of the last sample that was not missing.
        """
        tracker = copy.deepcopy(self)
        tracker.form = tracker.form._replace(rules=None)
        for k, output in enumerate(np.ravel(y)):
            tracker.update(output, None if u is None else u[k])
            yield tracker.form.filter

    def advance(self, y: Array, u: Array, R: Array | None) -> Array:
        """Take the checked samples of a recording, or raise; nothing has changed then.

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
        self._now, out = self._advanced(y[None], u[None], None if R is None else R[None], self._place)
        return out[0]

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
        now, out = many._advanced(y, u, None, many._place)
        many._now, news = track.settled(many.form, now)
        many._say(news)
        after = {name: values for name, values in many.state().items() if name in states}
        lengths = {"start": after["kept"], "followed": np.minimum(after["seen"], SPAN)}
        return out, after | {name: recursion.apart(after[name], size) for name, size in lengths.items()}

    @property
    def filter(self) -> Any:
        """A copy of the filter as the tracker stands, with x (and the constant), P, Q, R, F and what it has learned."""
        now = self._now
        recursion.load(self.form, now, 0, now.theta[0], now.P[0], float(now.scale[0, 0]))
        return copy.deepcopy(self.form.filter)


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
    **options : optional
        All others of `ParameterTracker`, which all actuators share.

    Attributes
    ----------
    n : int
        As given.
    structure : Structure
        As given.
    Q, F : ndarray, shape (n, n_theta, n_theta)
        May be set between samples, in the forms of above.
    R, forgetting : ndarray, shape (n,)
        May be set between samples.

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
    (`robust_filterpy.kernel`), otherwise one actuator after the other.

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
        forgetting: ArrayLike | None = None, **options: Any,
    ) -> None:  # fmt: skip
        """Set up n memories at rest."""
        self.n = _checks.count("n", n, 1)
        super().__init__(structure, theta=theta, P=P, Q=Q, R=R, F=F, forgetting=forgetting, **options)

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
        one.form = copy.deepcopy(self.form)
        one._initial = {name: value[i] for name, value in self._initial.items() if name != LABEL}
        return one

    # The recursion.

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

        def made(columns: list[Array]) -> TrackingResult:
            return TrackingResult(*columns).labelled(self.structure.names, axis.index, tuple(names))

        return self._recorded(axis, fills, signal, R, progress, made, [f"{name}: " for name in names])

    def _named(self, which: list[int]) -> str:
        """Return some actuators as a message begins with them."""
        return f"{setup.actuators(np.isin(np.arange(self.n), which))}: "
