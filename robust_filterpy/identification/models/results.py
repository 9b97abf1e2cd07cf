"""What models and trackers tell: parameters with intervals, a table, samples, what a recording has besides them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from robust_filterpy._brief import Pictured, brief, lines_of, wrapped
from robust_filterpy._checks import Array, count, numbers, real, shown
from robust_filterpy._fill_values import FillValues
from robust_filterpy.identification.models.noise import fit_percent, likelihood_of_mixture
from robust_filterpy.identification.models.signals import TimeAxis, are_equal, recording, table
from robust_filterpy.influence.regression import mad_scale

_WIDTH: Final = 78
# Samples that are not judged, for each parameter, and how many must be left.
_SETTLING: Final = 20
_LEAST: Final = 50
# A residual this many times as large as y varies is as wild as any.
_WILD: Final = 10.0


class Finding(NamedTuple):
    """One thing that breaks an assumption of `identify`, and what was made of it.

    Attributes
    ----------
    kind : str
        "fill value", "stuck", "copy", "step", "ramp", "slow start", "another plant", "input outliers", "gap", "wraps",
        "another delay", "closed loop", "noise that follows itself", "nonlinear".
    text : str
        In words, with time and size.
    evidence : float
        Twice the log-likelihood that it explains; NaN where it is no matter of likelihood.
    place : tuple of int
        First sample that it concerns, and the one after the last.
    """

    kind: str
    text: str
    evidence: float
    place: tuple[int, int]


def of_fill_values(fills: FillValues) -> tuple[Finding, ...]:
    """Return the finding that y has fill values, or none."""
    if not fills.values:
        return ()
    return (Finding("fill value", f"y has {fills.said}", float("nan"), (0, fills.signal.size)),)


def said(findings: tuple[Finding, ...]) -> str:
    """Return all findings in one sentence, empty if there are none."""
    return "; ".join(finding.text for finding in findings)


class Intervals(NamedTuple):
    """Confidence intervals of the parameters.

    Attributes
    ----------
    lower, upper : ndarray, shape of theta
        Ends of the intervals.
    """

    lower: Array
    upper: Array

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class Sample(NamedTuple):
    """What one update did, of n actuators in arrays of shape (n,).

    Attributes
    ----------
    prediction : float or ndarray
        yhat(k) = phi(k)' theta(k-1), before y(k) is used (paper 22).
    residual : float or ndarray
        y(k) - prediction (23); NaN if y is missing.
    weight : float or ndarray
        psi(e)/e in [0, 1]: how much of the innovation was believed; 1 for a filter that has no weights, NaN if there
        was no correction (y missing, or adaptation off).
    guard : int or ndarray of int
        0: the step was taken as it is; h > 0: it was halved h times; -1: it was not taken.
    """

    prediction: Any
    residual: Any
    weight: Any
    guard: Any

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class Recorded(NamedTuple):
    """The columns of a `TrackingResult`; see there."""

    theta: Array
    std: Array
    prediction: Array
    residual: Array
    weights: Array
    guard: np.ndarray

    def confidence_intervals(self, level: float = 0.95) -> Intervals:
        """Return theta -+ z std for every sample, z the normal quantile of the level.

        Parameters
        ----------
        level : float, default 0.95
            Probability of the interval, in (0, 1).

        Returns
        -------
        Intervals
            lower, upper, each of the shape of theta.
        """
        return intervals(self.theta, self.std, level)

    def log_likelihood(self, first: int | None = None) -> Any:
        """Return how likely the predictions one step ahead are: of several Q or ``forgetting`` the best has the most.

        Parameters
        ----------
        first : int, optional
            The first sample that is judged. Default: after those without a model, and 20 for each parameter after them,
            in which P forgets how it began.

        Returns
        -------
        float, of a bank ndarray, shape (n,)

        Raises
        ------
        ValueError
            If fewer than 50 samples are left to judge by.

        Notes
        -----
        The density is the mixture that the residuals show, whatever the influence function of the tracker: an outlier
        costs a bounded amount, whichever value it is held against.

        Examples
        --------
        >>> import numpy as np
        >>> from robust_filterpy.identification import FIR, ParameterTracker
        >>> rng = np.random.default_rng(1)
        >>> u, gain = rng.choice([-1.0, 1.0], 1000), 2.0 + np.cumsum(0.01 * rng.normal(size=1000))
        >>> y = gain * u + np.where(rng.random(1000) < 0.1, 3.0, 0.3) * rng.normal(size=1000)
        >>> runs = {Q: ParameterTracker(FIR(1, nk=0), Q=Q).run(y, u) for Q in (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)}
        >>> max(runs, key=lambda Q: runs[Q].log_likelihood())
        0.0001
        """
        usual = np.isinf(self.std).any(axis=-1).sum(axis=0) + _SETTLING * self.theta.shape[-1]
        begins = np.atleast_1d(usual if first is None else count("first", first))
        predictions, residuals = (np.atleast_2d(column.T) for column in (self.prediction, self.residual))
        begins = np.broadcast_to(begins, len(residuals))
        found = [_likelihood(*one) for one in zip(predictions, residuals, begins, strict=True)]
        return found[0] if self.prediction.ndim == 1 else np.array(found)


class TrackingResult(Pictured, Recorded):
    """What a recording of N samples gave, row k after sample k; a tuple of its first six attributes.

    That of a bank has an axis of actuators after that of the samples.

    Attributes
    ----------
    theta : ndarray, shape (N, n)
        Parameters.
    std : ndarray, shape (N, n)
        Their standard deviations, sqrt(diag P).
    prediction : ndarray, shape (N,)
        phi(k)' theta(k-1), before y(k) is used (paper 22).
    residual : ndarray, shape (N,)
        y(k) - prediction (23), NaN where y is missing.
    weights : ndarray, shape (N,)
        psi(e)/e; 1 for a filter that has no weights, NaN where there was no correction.
    guard : ndarray of int, shape (N,)
        0: step taken as it is; h > 0: halved h times; -1: not taken.
    names : tuple of str, length n
        Names of the parameters.
    index : pandas.Index or None
        When the samples were taken, if the recording was a pandas object.
    actuators : tuple
        Of a bank the columns of y if it was a pandas DataFrame, otherwise 0, 1, ..; empty of a tracker.
    """

    picture = "figures.plot_states"

    names: tuple[str, ...] = ()
    index: Any = None
    actuators: tuple[Any, ...] = ()

    def __str__(self) -> str:
        """Return what fits a screen, and where the parameters end."""
        if not len(self.theta) or self.actuators or len(self.names) != self.theta.shape[1]:
            return brief(self)
        each = zip(self.names, self.theta[-1], self.std[-1], strict=True)
        end = ", ".join(f"{name} {value:.4g} +- {std:.2g}" for name, value, std in each)
        return "\n".join([brief(self), *lines_of({"at the end": end})])

    def labelled(self, names: tuple[str, ...], index: Any = None, actuators: tuple[Any, ...] = ()) -> TrackingResult:
        """Return the same columns with names of the parameters, an index, and names of the actuators."""
        result = TrackingResult(*self)
        result.names, result.index, result.actuators = names, index, actuators
        return result

    def tracker(self, i: int) -> TrackingResult:
        """Return what actuator i of a bank gave.

        Parameters
        ----------
        i : int
            Which actuator.

        Returns
        -------
        TrackingResult
        """
        return TrackingResult(*(column[:, i] for column in self)).labelled(self.names, self.index)

    def to_frame(self) -> Any:
        """Return all columns as a pandas DataFrame, a row for each sample.

        Returns
        -------
        pandas.DataFrame
            The parameters by their names, their standard deviations as "a1_std", prediction, residual, weight, guard;
            on the index of the recording. Of a bank columns (actuator, name).

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        columns: dict[Any, Array] = {} if self.actuators else {**self.columns()}
        for i, actuator in enumerate(self.actuators):
            columns |= {(actuator, name): column for name, column in self.tracker(i).columns().items()}
        return table(columns, self.index, "sample" if self.index is None else None)

    def columns(self) -> dict[str, Array]:
        """Return the columns by name."""
        names = self.names or tuple(f"theta{j + 1}" for j in range(self.theta.shape[-1]))
        columns = dict(zip(names, np.moveaxis(self.theta, -1, 0), strict=True))
        columns |= {f"{name}_std": std for name, std in zip(names, np.moveaxis(self.std, -1, 0), strict=True)}
        rest = {"prediction": self.prediction, "residual": self.residual, "weight": self.weights, "guard": self.guard}
        return columns | rest


def _likelihood(prediction: Array, residual: Array, first: int) -> float:
    """Return the log-likelihood of residuals from a sample on, or raise if they are too few."""
    y, e = prediction + residual, residual[first:]
    y, e = y[~np.isnan(y)], e[~np.isnan(e)]
    if e.size < _LEAST:
        raise ValueError(
            f"expected at least {_LEAST} measured samples from sample {first} on, got {e.size}; record more"
        )
    return likelihood_of_mixture(e, _WILD * mad_scale(y - np.median(y)) or np.inf)


def intervals(theta: Array, std: Array, level: float) -> Intervals:
    """Return normal confidence intervals or raise if the level is no probability."""
    half = float(ndtri(0.5 * (1.0 + probability(level)))) * std
    return Intervals(theta - half, theta + half)


def probability(level: Any) -> float:
    """Return a probability of an interval, a band or a test, checked."""
    value = real("level", level)
    if not 0.0 < value < 1.0:
        raise ValueError(f"level: expected a probability in (0, 1), got {shown(level)}")
    return value


class Report:
    """A result with rows that prints as a table and becomes a DataFrame."""

    rows: tuple[Any, ...]
    to_text: Any
    #: What the first entry of a row is.
    row: ClassVar[str]

    def to_frame(self) -> Any:
        """Return the whole table as a pandas DataFrame, a row for each.

        Returns
        -------
        pandas.DataFrame
            A column for each further entry of the rows.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        fields = type(self.rows[0])._fields[1:] if self.rows else ()
        columns = {name: [getattr(row, name) for row in self.rows] for name in fields}
        return table(columns | self._more(), [str(row[0]) for row in self.rows], self.row)

    def _more(self) -> dict[str, list[Any]]:
        """Return further columns of the DataFrame."""
        return {}

    def __str__(self) -> str:
        """Return the table."""
        return str(self.to_text())


class Estimate(NamedTuple):
    """One parameter.

    Attributes
    ----------
    name : str
        Its name.
    estimate : float
        Its value.
    std : float
        Its standard deviation.
    z : float
        Estimate over standard deviation: how far from 0 it is; NaN where the estimate is held, and has none.
    lower, upper : float
        Ends of its interval.
    """

    name: str
    estimate: float
    std: float
    z: float
    lower: float
    upper: float


@dataclass(frozen=True, repr=False)
class Summary(Report):
    """Parameters with their uncertainty, and what was found besides them.

    Attributes
    ----------
    title : str
        The structure.
    facts : dict of str to str
        What was found besides the parameters.
    rows : tuple of Estimate
        The parameters.
    level : float
        Probability of each interval.
    warning : str
        What makes the estimates doubtful; empty if nothing does.
    findings : str
        What the recording has besides the model and its noise; empty if nothing.
    """

    row = "parameter"

    title: str
    facts: dict[str, str]
    rows: tuple[Estimate, ...]
    level: float
    warning: str
    findings: str = ""

    def to_text(self) -> str:
        """Return the table.

        Returns
        -------
        str
        """
        half = _WIDTH // 2 - 1
        cells = [f"{name + ':':<18}{value:>{half - max(len(name) + 1, 18)}}" for name, value in self.facts.items()]
        pairs = zip(cells[::2], [*cells[1::2], ""][: len(cells[::2])], strict=True)
        lower, upper = (f"{100 * edge:.4g} %" for edge in (0.5 - 0.5 * self.level, 0.5 + 0.5 * self.level))
        lines = [self.title.center(_WIDTH).rstrip(), "=" * _WIDTH, *(f"{a}  {b}".rstrip() for a, b in pairs)]
        lines += ["-" * _WIDTH, f"{'':<12}{'estimate':>14}{'std':>13}{'z':>11}{lower:>14}{upper:>14}", "-" * _WIDTH]
        for name, estimate, std, z, low, high in self.rows:
            # A parameter that is given, or stands at a bound, or was not estimated, has nothing to be doubted.
            short = f"{z:.1f}" if abs(z) < 1e6 else f"{z:.1e}"
            sure = f"{'held':>13}" if std == 0.0 else f"{std:>13.3g}{short:>11}{low:>14.5g}{high:>14.5g}"
            lines.append(f"{name:<12}{estimate:>14.5g}{sure}")
        words = {"Found": self.findings, "Doubtful": self.warning}
        return "\n".join([*lines, "=" * _WIDTH, *(f"{name}: {text}" for name, text in words.items() if text)])

    __repr__ = to_text


def coloured(colour: float) -> dict[str, str]:
    """Return what a summary says of residuals that are not white."""
    return {} if colour == 1.0 else {"Colored residuals": f"std times {colour:.2g}"}


class Estimated:
    """Parameters with standard deviations: a model, a tracker, physics."""

    structure: Any
    theta: Any
    P: Any
    dt: float | None = None
    # Of a model, (y, u, t, steps): time axis, measured outputs, and those so many steps ahead, or with 0 from inputs.
    _run: Callable[..., tuple[TimeAxis, Any, Any]]

    @property
    def std(self) -> Array:
        """Standard deviations of the parameters, shape (n,)."""
        return np.sqrt(np.maximum(np.diagonal(self.P), 0.0))

    def _valued(self, names: tuple[str, ...]) -> str:
        """Return the parameters with their standard deviations, as a line shows them."""
        each = zip(names, self.theta, self.std, strict=True)
        return ", ".join(f"{name}={value:.4g}+-{std:.2g}" for name, value, std in each)

    def __str__(self) -> str:
        """Return what `repr` says, on lines that a screen holds."""
        return wrapped(repr(self))

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
        Of a tracker as honest as its Q and R: P is the covariance for noise of variance R.
        """
        return intervals(self.theta, self.std, level)

    def summary(self, level: float = 0.95) -> Summary:
        """Return a table of the parameters with their uncertainty, and what was found besides them.

        Parameters
        ----------
        level : float, default 0.95
            As in `confidence_intervals`.

        Returns
        -------
        Summary
            It prints as a table.

        Raises
        ------
        ValueError
            If level is no probability.
        """
        names, theta, std = self._rows
        facts, findings = dict(self._facts), said(getattr(self, "findings", ()))
        if self.dt is not None:
            facts["Sampling period"] = f"{self.dt:.6g} s"
        lower, upper = intervals(theta, std, level)
        z = np.divide(theta, std, out=np.full(np.shape(theta), np.nan), where=std != 0.0)
        columns = (column.tolist() for column in (theta, std, z, lower, upper))
        rows = tuple(Estimate(*row) for row in zip(names, *columns, strict=True))
        return Summary(str(self.structure), facts, rows, float(level), self._doubt, findings)

    def to_frame(self, level: float = 0.95) -> Any:
        """Return the parameters as a pandas DataFrame, the table of `summary`.

        Parameters
        ----------
        level : float, default 0.95
            As in `confidence_intervals`.

        Returns
        -------
        pandas.DataFrame
            A row for each: estimate, std, z, lower, upper.

        Raises
        ------
        ValueError
            If level is no probability.
        ImportError
            If pandas is not installed.
        """
        return self.summary(level).to_frame()

    @property
    def _noise_samples(self) -> Any:
        """How many samples R stands on."""
        return np.inf

    @property
    def _rows(self) -> tuple[tuple[str, ...], Array, Array]:
        """Names of what is estimated, values and standard deviations."""
        return self.structure.names, self.theta, self.std

    @property
    def _facts(self) -> dict[str, str]:
        """What the table says besides the parameters."""
        return {}

    @property
    def _doubt(self) -> str:
        """What makes the parameters doubtful; empty if nothing does."""
        return getattr(self, "warning", "")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Identified(Estimated):
    """What `identify` found in a recording, whatever the kind of model: predictions, residuals, how well it fits.

    Attributes
    ----------
    structure : Structure, StateSpace or GreyBox
        What was looked for.
    P : ndarray, shape (n, n)
        Covariance of the parameters.
    noise : Noise or tuple of Noise
        Of the output, or of each.
    weights : ndarray, shape (N,) or (N, n_outputs)
        How much each sample was believed; NaN where it is missing.
    log_likelihood : float
        Of what is measured.
    warning : str
        What makes the estimate doubtful; empty if nothing does.
    dt : float or None
        Sampling period in s, if the index of the recording has it.
    findings : tuple of Finding
        What the recording has besides the model.
    trends : tuple of (int, ndarray)
        Fingerprint of each recording whose levels break, and these: methods that are given the same y take them off
        it, and put them back.
    colour : float
        How many times as large standard deviations are as those of white residuals, which P counts.
    """

    structure: Any
    P: Array
    noise: Any
    weights: Array
    log_likelihood: float
    warning: str
    dt: float | None = None
    findings: tuple[Finding, ...] = ()
    trends: tuple[tuple[int, Array], ...] = ()
    colour: float = 1.0

    @property
    def R(self) -> Any:
        """Variance of the ordinary noise of each output, shape (n_outputs,)."""
        return np.array([one.R for one in self.noise])

    def predict(self, y: ArrayLike, u: ArrayLike | None = None, steps: int = 1, t: ArrayLike | None = None) -> Any:
        """Predict each output of a recording from the samples up to ``steps`` before it.

        Parameters
        ----------
        y : array_like, shape (N,) or (N, n_outputs)
            Measured outputs, which tell the start too; NaN where one is missing.
        u : array_like, shape (N,) or (N, n_inputs)
            Input.
        steps : int, default 1
            How many samples ahead. Inputs are taken as known.
        t : array_like, shape (N,), optional
            Times in s, in equal steps but of a `GreyBoxModel`. Default: those of the index.

        Returns
        -------
        ndarray, shape of y
            NaN in the first samples of a `Model`, whose regressors lie before the recording.

        Raises
        ------
        ValueError, TypeError
            If y, u or t does not fit, or steps is not a positive integer.

        Notes
        -----
        An OutputError, FIR or LinearRegression, states without disturbance, and physics, predict from inputs alone,
        whatever ``steps``; only what was in motion when the recording began is estimated from all of y. For ARX and
        ARMAX an outlier in y is replaced, by the model and the samples before it, in the regressor of the samples after
        it.
        """
        axis, _, output = self._run(y, u, t, count("steps", steps, 1))
        return axis.labelled(output, "prediction")

    def free_run(self, y: ArrayLike, u: ArrayLike | None = None, t: ArrayLike | None = None) -> Any:
        """Compute the outputs from inputs alone, beginning with what was in motion when the recording began.

        Parameters
        ----------
        y, u, t
            As in `predict`.

        Returns
        -------
        ndarray, shape of y
            NaN in the first samples of a `Model`, whose regressors lie before the recording.

        Raises
        ------
        ValueError, TypeError
            If y, u or t does not fit, or the model overflows.
        """
        axis, _, output = self._run(y, u, t, 0)
        return axis.labelled(output, "free run")

    def residuals(self, y: ArrayLike, u: ArrayLike | None = None, t: ArrayLike | None = None) -> Any:
        """Return measured less predicted outputs, one step ahead.

        Parameters
        ----------
        y, u, t
            As in `predict`.

        Returns
        -------
        ndarray, shape of y
            NaN where y is missing and where there is no prediction.

        Raises
        ------
        ValueError, TypeError
            If y, u or t does not fit.
        """
        axis, measured, output = self._run(y, u, t, 1)
        return axis.labelled(measured - output, "residual")

    def fit(self, y: ArrayLike, u: ArrayLike | None = None, t: ArrayLike | None = None) -> Any:
        """Compute how well the outputs, from inputs alone, agree with a recording.

        Parameters
        ----------
        y, u, t
            As in `predict`; a missing output does not count.

        Returns
        -------
        float, or ndarray, shape (n_outputs,)
            100 (1 - ||y - y_model||/||y - mean(y)||), in percent; see `fit_percent`. What was in motion when the
            recording began is estimated.

        Raises
        ------
        ValueError, TypeError
            If y, u or t does not fit, y is constant, or the model overflows.
        """
        _, measured, output = self._run(y, u, t, 0)
        return fit_percent(np.where(np.isnan(output), np.nan, measured), np.nan_to_num(output))

    @property
    def _noise_samples(self) -> Any:
        """How many samples R of each output stands on."""
        return np.maximum(np.nansum(self.weights, axis=0), 1.0)

    @property
    def _facts(self) -> dict[str, str]:
        """What the table says of a model whose outputs have each a noise."""
        count = int((~np.isnan(self.weights)).sum())
        facts = {"Samples": f"{count} of {self.weights.size}", "Log-likelihood": f"{self.log_likelihood:.1f}"}
        for j, one in enumerate(self.noise):
            share = getattr(one.influence, "contamination", None)
            wild = "" if share is None else f", {100 * share:.1f} % wild"
            facts[f"Noise, output {j}"] = f"{np.sqrt(one.R):.4g}{wild}"
        return facts | coloured(self.colour)

    @property
    def _remarks(self) -> str:
        """What was found besides the model, and what makes it doubtful, for `repr`."""
        remarks = {"found": said(self.findings), "doubtful": self.warning}
        return "".join(f"; {name}: {text}" for name, text in remarks.items() if text)


def signals_of(model: Estimated, y: Any, u: Any, t: Any = None) -> tuple[TimeAxis, Any, Any]:
    """Return the time axis of a recording, and its signals without index; or raise if the axis does not fit."""
    if t is not None:
        steps = np.diff(numbers("t", t))
        if steps.shape != (len(y) - 1,):
            raise ValueError(f"t: expected {len(y)} times like y, got shape {np.shape(t)}")
        if not (steps.size and are_equal(steps)):
            raise ValueError("t: expected equal steps for a model in discrete time, got others; identify a GreyBox")
        TimeAxis(None, float(np.median(steps))).require_period(model.dt)
    axis, y, u = recording(model.structure, y=y, u=u)
    axis.require_period(model.dt)
    return axis, y, u
