"""validate: what a model leaves in its residuals, and how well it predicts.

Residuals e are tested through v = psi(e), which is bounded, so that outliers change neither the correlations nor their
bounds. With the columns of Z the earlier v, or the inputs at each lag, the covariance of Z'v has two parts (v before
the parameters were fitted has the covariance Gamma; J are the derivatives of the prediction, P is the covariance of the
parameters)::

    Z' M Gamma M Z                          for the recording that the model was made from, M = I - J (J'J)^-1 J'
    Z' Gamma Z + E[psi']^2 Z' J P J' Z      for another one

The portmanteau statistic c' Cov(c)^-1 c, c = Z'v, leaves out the directions that the fit has made zero (Ljung, System
Identification, 2nd ed., 1999, section 16.6; Davies, Triggs and Newbold, Biometrika 64, 1977). Where v is not white,
Gamma in the test against the input has its autocorrelations.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.signal import fftconvolve, lfilter
from scipy.stats import chi2, norm

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._pictures import drawn
from robust_filterpy.identification.estimation.cleaning import Cleaned, cleaned
from robust_filterpy.identification.models.fit import ordinary_fit, ordinary_samples
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.prediction import cleaned_residuals
from robust_filterpy.identification.models.signals import recorded_output
from robust_filterpy.identification.models.time_axis import recording, table
from robust_filterpy.identification.models.transfer_model import as_model

if TYPE_CHECKING:
    import control

__all__ = ["Fit", "Portmanteau", "Validation", "validate"]

# A direction of which the fit leaves less than this share of the variance is one that it has made zero.
_LEFT: Final = 0.1
# Weights of the samples as alike as this belong to the same recording; those of two recordings have a correlation of 0.
_SAME_RECORDING: Final = 0.7
# A residual believed by less than this share left a prediction in its place, which touches those after it where its
# response is above the other; unless that leaves too few of them.
_BELIEVED: Final = 0.5
_TOUCH: Final = 0.1
_LONGEST_REACH: Final = 50
_LEAST_CLEAR: Final = 0.1
# Measured samples for each lag.
_SAMPLES_EACH: Final = 4


class Portmanteau(NamedTuple):
    """All correlations in one number.

    Attributes
    ----------
    statistic : float
        Chi-squared distributed if the model is right.
    degrees : int
        Its degrees of freedom; 0 if the fit has used all of them.
    p_value : float
        Probability of a statistic as large, if the model is right.
    """

    statistic: float
    degrees: int
    p_value: float


class Fit(NamedTuple):
    """How well one kind of prediction agrees with the recording, in percent.

    Attributes
    ----------
    kind : str
        "1 step", "10 steps" or "free run".
    ordinary : float
        On the samples within three standard deviations of the noise.
    all : float
        On all measured samples.
    """

    kind: str
    ordinary: float
    all: float


@dataclass(frozen=True, eq=False)
class Validation:
    """What a model leaves in its residuals.

    Attributes
    ----------
    autocorrelation, autocorrelation_bound : ndarray, shape (lags,)
        Of psi(residual) at the lags 1 .. lags, and what each stays below in size with probability `level` if the
        residuals are white.
    cross_correlation, cross_bound : ndarray, shape (n_inputs, lags + 1)
        Of each input and psi(residual), which comes 0 .. lags samples later, and its bound if the input says nothing
        about the residuals.
    whiteness : Portmanteau
        Of the autocorrelations.
    independence : Portmanteau or None
        Of the cross-correlations; None without input.
    fits : tuple of Fit
        One step ahead, some steps ahead, and from inputs alone.
    samples : int
        How many residuals there are.
    level : float
        Probability of each bound, and of the verdict where nothing is wrong.
    same_recording : bool
        Whether this is the recording that the model was made from, which its weights show.
    """

    autocorrelation: Array
    autocorrelation_bound: Array
    cross_correlation: Array
    cross_bound: Array
    whiteness: Portmanteau
    independence: Portmanteau | None
    fits: tuple[Fit, ...]
    samples: int
    level: float
    same_recording: bool

    @property
    def verdict(self) -> str:
        """What is wrong, in words."""
        found = []
        if self.independence is not None and self.independence.p_value < 1.0 - self.level:
            excess = np.abs(self.cross_correlation) / np.maximum(self.cross_bound, np.finfo(float).tiny)
            several = len(excess) > 1
            worst = int(excess.max(axis=1).argmax())
            which = f"input {worst}" if several else "u"
            found.append(f"dynamics are missing: residuals follow {which} at {_lags(excess[worst], 0, self.level)}")
        if self.whiteness.p_value < 1.0 - self.level:
            excess = np.abs(self.autocorrelation) / np.maximum(self.autocorrelation_bound, np.finfo(float).tiny)
            what = "" if found else "the noise is not white: "
            found.append(f"{what}residuals follow one another at {_lags(excess, 1, self.level)}")
        return "; ".join(found) or "nothing is left in the residuals"

    def to_text(self) -> str:
        """Return the verdict, the statistics and the fits.

        Returns
        -------
        str
        """
        tests = [("residuals among themselves", self.whiteness), ("residuals and input", self.independence)]
        lines = [self.verdict]
        for name, test in tests:
            if test is not None:
                lines.append(f"{name:<28}chi2({test.degrees}) = {test.statistic:.1f}, p = {test.p_value:.3g}")
        lines.append(f"{'fit, %':<28}{'ordinary':>10}{'all':>10}")
        lines += [f"{fit.kind:<28}{fit.ordinary:>10.2f}{fit.all:>10.2f}" for fit in self.fits]
        return "\n".join(lines)

    def plot(self, **options: Any) -> Any:
        """Draw the correlations with their bounds.

        Parameters
        ----------
        **options : dict, optional
            Of `robust_filterpy.plotting.plot_validation`.

        Returns
        -------
        ndarray of matplotlib.axes.Axes
        """
        return drawn("plot_validation", self, options)

    def to_frame(self) -> Any:
        """Return the correlations and their bounds as a pandas DataFrame, a row for each lag.

        Returns
        -------
        pandas.DataFrame
            autocorrelation and cross_correlation with several inputs "cross_correlation[0]", .., each with a column
            "_bound"; NaN for the autocorrelation at lag 0.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        pairs = [("autocorrelation", self.autocorrelation, self.autocorrelation_bound)]
        several = len(self.cross_correlation) > 1
        for i, each in enumerate(zip(self.cross_correlation, self.cross_bound, strict=True)):
            pairs.append((f"cross_correlation[{i}]" if several else "cross_correlation", *each))
        lags = self.autocorrelation.size + 1
        columns = {}
        for name, values, bound in pairs:
            columns[name], columns[f"{name}_bound"] = (
                np.concatenate((np.full(lags - part.size, np.nan), part)) for part in (values, bound)
            )
        return table(columns, name="lag")

    def __str__(self) -> str:
        """Return the text."""
        return self.to_text()


def validate(
    model: Model | control.TransferFunction,
    y: ArrayLike,
    u: ArrayLike | None = None,
    lags: int = 20,
    level: float = 0.99,
    steps: int = 10,
) -> Validation:
    """Test what a model leaves in its residuals, and how well it predicts.

    Parameters
    ----------
    model : Model or control.TransferFunction
        What `identify` found, in this recording or another one; or a transfer function in discrete time with one input,
        whose parameters are taken as known for sure, and its level and noise from this recording.
    y : array_like, shape (N,)
        Measured output; NaN where it is missing.
    u : array_like, shape (N,) or (N, n_inputs), optional
        Input.
    lags : int, default 20
        Longest lag in samples.
    level : float, default 0.99
        Probability that a right model passes a test, and that a correlation stays within its bound.
    steps : int, default 10
        How many samples ahead the second prediction looks.

    Returns
    -------
    Validation

    Raises
    ------
    ValueError
        If y or u does not fit, the recording is too short for so many lags, or level is no probability.
    TypeError
        If model is none of these, or lags or steps no integer.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.identification import OutputError, identify
    >>> from robust_filterpy import Contaminated
    >>> from robust_filterpy.plants import simulate_output_error
    >>> u = np.random.default_rng(1).choice([-1.0, 1.0], 1000)
    >>> noise = Contaminated(0.1, 10.0, 0.3)
    >>> y = simulate_output_error([-1.5, 0.7, 1.0, 0.5], u, noise=noise, rng=2, na=2, nb=2).y
    >>> validate(identify(y, u, OutputError(2, 2)), y, u).verdict
    'nothing is left in the residuals'
    >>> validate(identify(y, u, OutputError(1, 1)), y, u).verdict.split(":")[0]
    'dynamics are missing'
    """
    model = as_model("model", model, y, u)
    lags, steps = _checks.count("lags", lags, 1), _checks.count("steps", steps, 1)
    level = _probability(level)
    axis, y, u = recording(model.structure, y=y, u=u)
    axis.require_period(model.dt)
    measured, residual = recorded_output(y), model.residuals(y, u)
    known = ~np.isnan(residual)
    if known.sum() < _SAMPLES_EACH * (lags + 1):
        raise ValueError(
            f"y: expected at least {_SAMPLES_EACH * (lags + 1)} measured samples for {lags} lags, got {known.sum()}; "
            "record more or take fewer lags"
        )
    score = _Score.of(model, residual, y, u)
    before = _delayed(score.v[:, None], range(1, lags + 1))
    same = score.same_recording
    white = np.ones(1)
    auto, auto_bound, whiteness = score.tested(before, white, level)
    prepared, _ = model._prepared(y, u)
    independence = None
    cross: Array = np.zeros((0, lags + 1))
    cross_bound: Array = np.zeros((0, lags + 1))
    if prepared.u.shape[1]:
        kernel = white if whiteness.p_value >= 1.0 - level else _covariances(score.v, lags)
        inputs = _delayed(prepared.u - prepared.u.mean(axis=0), range(lags + 1))
        found, bound, independence = score.tested(inputs, kernel, level)
        shape = (prepared.u.shape[1], lags + 1)
        cross, cross_bound = found.reshape(shape), bound.reshape(shape)
    fits = _fits(model, measured, u, residual, steps)
    return Validation(
        auto, auto_bound, cross, cross_bound, whiteness, independence, fits, int(known.sum()), level, same
    )


class _Score(NamedTuple):
    """psi of the residuals, 0 where there are none, and how the parameters enter."""

    v: Array
    known: Any
    J: Array
    spread: Array
    same_recording: bool

    @classmethod
    def of(cls, model: Model, residual: Array, y: Any, u: Any) -> _Score:
        """Return the score of a recording."""
        known: Any = ~np.isnan(residual)
        e = np.where(known, residual, 0.0)
        weights = model.noise.weights(e)
        found = cleaned(model, y, u)
        known = known & (_untouched(model, known, weights) if found is None else found.clear)
        e = np.where(known, e if found is None else found.residual, 0.0)
        v = np.where(known, model.noise.weights(e) * e, 0.0)
        v = np.where(known, v - v.sum() / known.sum(), 0.0)
        seen = np.where(np.isnan(residual), np.nan, weights)
        same = model.weights.size == e.size and _alike(model.weights, seen)
        # The fit has seen those rows too that are not tested.
        J = _derivatives(model, residual, y, u, found) * ~np.isnan(residual)[:, None]
        slope = float(np.mean(model.noise.influence.psi_deriv(e[known] / np.sqrt(model.R))))
        n = model.theta.size
        P = np.zeros((n + model.has_offset, n + model.has_offset))
        P[:n, :n] = model.P
        if model.has_offset:
            P[:n, n] = P[n, :n] = model.offset_covariance
            # What differences do not show changes none of them.
            P[n, n] = model.offset_std**2 if np.isfinite(model.offset_std) else 0.0
        return cls(v, known, J, slope**2 * P, same)

    def tested(self, Z: Array, kernel: Array, level: float) -> tuple[Array, Array, Portmanteau]:
        """Return correlations of v with the columns of Z, their bounds, and all of them in one number."""
        Z = np.where(self.known[:, None], Z, 0.0)
        c, gram = Z.T @ self.v, Z.T @ Z
        variance = float(self.v @ self.v) / self.known.sum()
        if self.same_recording:
            Q, _ = np.linalg.qr(self.J)
            W = Z - Q @ (Q.T @ Z)
        else:
            W = Z
        covariance = variance * (W.T @ (W if kernel.size == 1 else _smeared(W, kernel)))
        if not self.same_recording:
            entering = Z.T @ self.J
            covariance += entering @ self.spread @ entering.T
        size = np.sqrt(np.maximum(variance * self.known.sum() * gram.diagonal(), np.finfo(float).tiny))
        share = np.maximum(covariance.diagonal(), _LEFT * variance * gram.diagonal())
        bound = float(norm.ppf(0.5 + 0.5 * level)) * np.sqrt(share) / size
        return c / size, bound, _portmanteau(c, covariance, variance * gram)


def _untouched(model: Model, known: Any, weights: Array) -> Any:
    """Return which residuals no outlier or gap before them reaches: what stands in its place is wrong for a while.

    Two residuals after the same outlier share that error, and would look as if the noise were not white.
    """
    parts = model._parts()
    impulse = np.concatenate(([1.0], np.zeros(_LONGEST_REACH)))
    h = lfilter(np.convolve(parts.a, parts.d), parts.c, impulse)
    reach = int(np.flatnonzero(np.abs(h) > _TOUCH)[-1])
    doubtful = ~known | (weights < _BELIEVED)
    if not reach or not doubtful.any():
        return np.ones(known.size, dtype=bool)
    clear = np.convolve(doubtful, np.concatenate(([0.0], np.ones(reach))))[: known.size] < 0.5
    return clear if (clear & known).sum() >= _LEAST_CLEAR * known.sum() else np.ones(known.size, dtype=bool)


def _portmanteau(c: Array, covariance: Array, full: Array) -> Portmanteau:
    """Return c' Cov(c)^-1 c in the directions of which the fit has left enough."""
    ridge = np.finfo(float).tiny + 1e-10 * np.trace(full) / len(full)
    left, directions = eigh(covariance, full + ridge * np.eye(len(full)))
    kept = left > _LEFT
    statistic = float(np.sum((directions.T @ c)[kept] ** 2 / left[kept]))
    degrees = int(kept.sum())
    return Portmanteau(statistic, degrees, float(chi2.sf(statistic, degrees)) if degrees else 1.0)


def _derivatives(model: Model, residual: Array, y: Any, u: Any, whole: Cleaned | None) -> Array:
    """Return the derivatives of the prediction by theta and offset, outliers in the regressor replaced."""
    prepared, known = model._prepared(y, u)
    n = model.theta.size
    p = np.concatenate((model.theta, [model.offset], np.zeros(prepared.nf)))
    parts, first = model._parts(), prepared.first
    if whole is not None:
        prepared = whole.prepared
    elif prepared.na or parts.c.size + parts.d.size > 2:
        found = cleaned_residuals(parts, model._equation_error(prepared, known), known[first:], model.noise)
        output = prepared.y.copy()
        output[first:] += (found.weights - 1.0) * found.residual
        prepared = prepared.with_output(output)
    J = np.zeros((residual.size, n + model.has_offset))
    J[first:] = -prepared.jacobian(p)[:, : n + model.has_offset]
    return J


def _delayed(signals: Array, lags: range) -> Array:
    """Return each signal delayed by each lag, 0 before its start; the lags of the first signal first."""
    columns = np.zeros((len(signals), signals.shape[1] * len(lags)))
    for i, signal in enumerate(signals.T):
        for j, lag in enumerate(lags):
            columns[lag:, i * len(lags) + j] = signal[: len(signal) - lag]
    return columns


def _covariances(v: Array, lags: int) -> Array:
    """Return the autocorrelations of v at -lags .. lags with Bartlett's taper, which keeps them positive definite."""
    rho = np.array([v[lag:] @ v[: v.size - lag] for lag in range(lags + 1)]) / max(v @ v, np.finfo(float).tiny)
    rho *= 1.0 - np.arange(lags + 1) / (lags + 1)
    return np.concatenate((rho[:0:-1], rho))


def _smeared(W: Array, kernel: Array) -> Array:
    """Return Gamma W for noise with these autocorrelations."""
    return np.asarray(fftconvolve(W, kernel[:, None], mode="same", axes=0))


def _alike(weights: Array, others: Array) -> bool:
    """Tell whether these are the weights of the same samples."""
    both = ~np.isnan(weights) & ~np.isnan(others)
    a, b = weights[both], others[both]
    if a.size < 2 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return False
    return bool(np.corrcoef(a, b)[0, 1] > _SAME_RECORDING)


def _fits(model: Model, y: Array, u: Any, residual: Array, steps: int) -> tuple[Fit, ...]:
    """Return the fits of the predictions."""
    outputs = {"1 step": y - residual}
    if steps > 1:
        outputs[f"{steps} steps"] = model.predict(y, u, steps)
    if model.structure.n_inputs:
        outputs["free run"] = model.free_run(y, u)
    ordinary, everything = ordinary_samples(residual), ~np.isnan(residual)
    return tuple(
        Fit(kind, ordinary_fit(y, output, ordinary), ordinary_fit(y, output, everything))
        for kind, output in outputs.items()
    )


def _lags(excess: Array, first: int, level: float) -> str:
    """Return the lags that are no accident, at this level for all together, as "lags 3-6, 9"; at least the largest."""
    all_together = norm.isf(0.5 * (1.0 - level) / excess.size) / norm.isf(0.5 * (1.0 - level))
    outside = np.flatnonzero(excess > all_together)
    outside = outside if outside.size else np.array([excess.argmax()])
    runs = [[int(k) for _, k in run] for _, run in groupby(enumerate(outside + first), lambda pair: pair[1] - pair[0])]
    text = ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)
    return f"lag{'s' if outside.size > 1 else ''} {text}"


def _probability(level: Any) -> float:
    """Return a number in (0, 1) or raise."""
    value = _checks.real("level", level)
    if not 0.0 < value < 1.0:
        raise ValueError(f"level: expected a probability in (0, 1), got {level!r}")
    return value
