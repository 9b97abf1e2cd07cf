"""validate: what a model leaves in its residuals, and how well it predicts; compare: which of several is the best.

Correlations of what a model leaves with what it should not depend on, and how large they are by chance.

Residuals e are tested through v = psi(e), which is bounded, so that outliers change neither the correlations nor their
bounds. With the columns of Z the earlier v, or the inputs at each lag, the covariance of Z'v has two parts (v before
the parameters were fitted has the covariance Gamma; J are the derivatives of the prediction, P is the covariance of the
parameters)::

    Z' M Gamma M Z                          for the recording that the model was made from, M = I - J (J'J)^-1 J'
    Z' Gamma Z + E[psi']^2 Z' J P J' Z      for another one

The portmanteau statistic c' Cov(c)^-1 c, c = Z'v, leaves out the directions that the fit has made zero (Ljung, System
Identification, 2nd ed., 1999, section 16.6; Davies, Triggs and Newbold, Biometrika 64, 1977). Where v is not white,
Gamma in the test against the input has its autocorrelations.

Of several outputs the residuals are those of all, each in units of its noise, and Z stands in the rows of one of them.
What every recording tells anew, the start, is in M for another recording too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.signal import fftconvolve
from scipy.stats import chi2, norm

from robust_filterpy import _checks
from robust_filterpy._brief import Pictured, tabulated
from robust_filterpy._checks import Array
from robust_filterpy.identification.estimation.outliers import cleaned
from robust_filterpy.identification.models.dependence import basis_of
from robust_filterpy.identification.models.grey_box import GreyBoxModel
from robust_filterpy.identification.models.model import Model, as_model
from robust_filterpy.identification.models.noise import Noise, ordinary_fit, ordinary_samples
from robust_filterpy.identification.models.recording import ANY_TIMES
from robust_filterpy.identification.models.results import Report, probability, signals_of
from robust_filterpy.identification.models.signals import recorded_output, recording, table
from robust_filterpy.identification.models.state_space import StateSpaceModel
from robust_filterpy.identification.models.structures import fill_with_delays
from robust_filterpy.influence.regression import mad_scale

if TYPE_CHECKING:
    import control

# A residual believed by less than this share left a prediction in its place, which touches those after it where its
# response is above the other; unless that leaves too few of them.
_BELIEVED: Final = 0.5
_TOUCH: Final = 0.1
_LONGEST_REACH: Final = 50
_LEAST_CLEAR: Final = 0.1
# A direction of which the fit leaves less than this share of the variance is one that it has made zero.
_LEFT: Final = 0.1
# Weights of the samples as alike as this belong to the same recording; those of two recordings have a correlation of 0.
_SAME_RECORDING: Final = 0.7
# A mean residual of more standard deviations than this is a level that the model has not.
_FAR: Final = 3.0


def any_model(name: str, given: Any, y: Any, u: Any) -> Any:
    """Return a model that can be judged, made of a transfer function if it is one, or raise."""
    if isinstance(y, (list, tuple)):
        shapes = {np.shape(row) for row in y}
        if len(shapes) > 1 or any(len(shape) > 1 or 1 < len(y) < shape[0] for shape in shapes if shape):
            raise ValueError("y: expected one recording, got a list of several; judge the model on each")
    return given if isinstance(given, (StateSpaceModel, GreyBoxModel)) else as_model(name, given, y, u)


class Judged(NamedTuple):
    """A model on one recording of N samples with p outputs."""

    y: Array  # Measured outputs, NaN where they are missing, shape (N, p).
    residual: Array  # Less those predicted one step ahead.
    tested: Array  # Residuals whose correlations are judged, NaN where what came before spoils them.
    inputs: Array  # Shape (N, m).
    noise: tuple[Noise, ...]  # Of each output.
    weights: Array  # How much each sample of the model's own recording was believed, shape (.., p).
    J: Array  # Derivatives of the residuals by what was estimated, 0 where there is none, shape (N, p, k).
    P: Array  # Its covariance, infinite for what only this recording tells, as the start.
    levelled: bool  # Whether the model has a level, so that the mean of the residuals says nothing.

    @classmethod
    def of(cls, model: Any, y: Any, u: Any, t: Any) -> Judged:
        """Return what is judged of a model on a recording."""
        if not isinstance(model, Model):
            return _of_outputs(model, *model.started(y, u, t))
        return _of_one(model, *signals_of(model, y, u, t)[1:])


def _of_one(model: Model, y: Any, u: Any) -> Judged:
    """Return what is judged of a model with one output."""
    (prepared, measured), residual = model.prepared(y, u), model.residuals(y, u)
    seen: Any = ~np.isnan(residual)
    e, clean = np.where(seen, residual, 0.0), cleaned(model, y, u)
    memory = model.parts.pattern(_LONGEST_REACH + 1)[1:, None, None]
    clear = _untouched(memory, seen[:, None], model.noise.weights(e)[:, None])[:, 0]
    clear = seen & (clear if clean is None else clean.clear)
    tested = np.where(clear, e if clean is None else clean.residual, np.nan)
    n, P = model.theta.size + model.has_offset, model.joint if model.has_offset else model.P
    # The fit has seen those rows too that are not tested; outliers in the regressor are replaced.
    whole = model.without_outliers(prepared, measured) if clean is None else clean.prepared
    J = np.zeros((residual.size, n))
    J[whole.first :] = whole.jacobian(np.concatenate((model.theta, [model.offset], np.zeros(whole.nf))))[:, :n]
    J *= seen[:, None]
    return Judged(
        recorded_output(y)[:, None], residual[:, None], tested[:, None], prepared.u, (model.noise,),
        model.weights[:, None], J[:, None], P, True,
    )  # fmt: skip


def _of_outputs(model: Any, measured: Array, signal: Array, predictor: Any, q: Array) -> Judged:
    """Return what is judged of states, or of physics, which predict from inputs alone however far ahead."""
    seen, k = ~np.isnan(measured), model.theta.size
    residual = np.where(seen, predictor.residuals(q).reshape(measured.shape), np.nan)
    weights = np.column_stack([one.weights(e) for one, e in zip(model.noise, np.nan_to_num(residual).T, strict=True)])
    J = predictor.jacobian(q).reshape(*residual.shape, -1) * seen[:, :, None]
    P = np.diag(np.full(q.size, np.inf))
    P[:k, :k] = model.P
    levelled = isinstance(model, StateSpaceModel)
    memory = _memory_of_states(model) if levelled else np.zeros((0, 1, 1))
    tested = np.where(_untouched(memory, seen, weights), residual, np.nan)
    return Judged(measured, residual, tested, signal, model.noise, model.weights, J, P, levelled)


def _memory_of_states(model: StateSpaceModel) -> Array:
    """Return what innovations that are not believed do to residuals after them, in units of the noise, (lags, p, p)."""
    size, x, responses = np.sqrt(model.R), model.K, []
    for _ in range(_LONGEST_REACH if model.K.any() else 0):
        responses.append(model.C @ x * size / size[:, None])
        x = (model.A - model.K @ model.C) @ x
    return np.array(responses).reshape(-1, size.size, size.size)


def _untouched(memory: Array, seen: Any, weights: Array) -> Any:
    """Return which residuals no outlier or gap before them reaches: what stands in its place is wrong for a while."""
    # Two residuals after the same outlier share that error, and would look as if the noise were not white.
    doubtful = (~seen | (weights < _BELIEVED)).astype(float)
    reached = np.zeros(seen.shape)
    for i, j in np.ndindex(memory.shape[1:]):
        above = np.flatnonzero(np.abs(memory[:, i, j]) > _TOUCH)
        if above.size:
            window = np.concatenate(([0.0], np.ones(above[-1] + 1)))
            reached[:, i] += np.convolve(doubtful[:, j], window)[: len(seen)]
    clear = reached < 0.5
    enough = (clear & seen).sum(axis=0) >= _LEAST_CLEAR * seen.sum(axis=0)
    return clear | ~enough


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


class Score(NamedTuple):
    """psi of the residuals of N samples of p outputs, and how the parameters enter."""

    v: Array  # psi in units of the noise, 0 where there is none, shape (N, p).
    seen: Any  # Where there is one.
    J: Array  # Derivatives of the residuals in the same units, shape (N, p, k).
    slope: Array  # E[psi'] of each output.
    P: Array  # Covariance of the parameters that this recording does not estimate.
    basis: Array  # Directions of the residuals that were fitted to it, shape (N, p, r).
    same_recording: bool  # Whether it is the one that the model was made from.
    shift: Array  # How far the level of each output is from the model's, 0 if it may be the same.

    @classmethod
    def of(cls, judged: Judged) -> Score:
        """Return the score of a model on a recording."""
        seen: Any = ~np.isnan(judged.tested)
        v, slope, J = np.zeros(seen.shape), np.ones(seen.shape[1]), judged.J.copy()
        shift, e = np.zeros(seen.shape[1]), judged.tested.copy()
        believed = np.column_stack(
            [one.weights(left) for one, left in zip(judged.noise, judged.residual.T, strict=True)]
        )
        same = judged.weights.shape == believed.shape and _alike(judged.weights, believed)
        for j, (noise, rows) in enumerate(zip(judged.noise, seen.T, strict=True)):
            middle = float(np.median(e[rows, j]))
            if judged.levelled and abs(middle) > _FAR * np.sqrt(noise.R):
                shift[j], e[:, j] = middle, e[:, j] - middle
            if not (same or noise.given):
                # The noise that this recording shows: to the model's all that a wrong one leaves is wild.
                noise = replace(noise, R=max(mad_scale(e[rows, j]) ** 2, noise.least)).settled(e[rows, j])
            # What is left of a recording without noise is rounding, which is alike from sample to sample.
            v[rows, j] = 0.0 if noise.is_rounding else noise.psi(e[rows, j])
            v[rows, j] -= v[rows, j].mean() if judged.levelled else 0.0
            slope[j] = noise.slope(e[rows, j])
            J[:, j] /= np.sqrt(noise.R)
        estimated = np.isinf(judged.P.diagonal()) | same
        fitted = J[:, :, estimated] * np.sqrt(slope)[:, None]
        basis = basis_of(fitted.reshape(v.size, -1)).reshape(*v.shape, -1)
        return cls(v, seen, J, slope, np.where(np.outer(~estimated, ~estimated), judged.P, 0.0), basis, same, shift)

    def tested(self, j: int, Z: Array, kernel: Array, level: float) -> tuple[Array, Array, Portmanteau]:
        """Return correlations of v of an output with the columns of Z, their bounds, and all of them in one number."""
        seen, v = self.seen[:, j], self.v[:, j]
        Z = np.where(seen[:, None], Z, 0.0)
        c, gram = Z.T @ v, Z.T @ Z
        variances = np.square(self.v).sum(axis=0) / np.maximum(self.seen.sum(axis=0), 1)
        shadow = self.basis[:, j].T @ Z
        covariance, entering = np.zeros(gram.shape), np.zeros((Z.shape[1], self.J.shape[2]))
        for i, ratio in enumerate(self.slope[j] / self.slope):
            W = (Z if i == j else 0.0) - np.sqrt(ratio) * (self.basis[:, i] @ shadow)
            own = W if i != j or kernel.size == 1 else fftconvolve(W, kernel[:, None], mode="same", axes=0)
            covariance += variances[i] * (W.T @ own)
            entering += self.slope[i] * (W.T @ self.J[:, i])
        covariance += entering @ self.P @ entering.T
        variance = variances[j]
        size = np.sqrt(np.maximum(variance * seen.sum() * gram.diagonal(), np.finfo(float).tiny))
        share = np.maximum(covariance.diagonal(), _LEFT * variance * gram.diagonal())
        bound = float(norm.ppf(0.5 + 0.5 * level)) * np.sqrt(share) / size
        return c / size, bound, _portmanteau(c, covariance, variance * gram)


def _portmanteau(c: Array, covariance: Array, full: Array) -> Portmanteau:
    """Return c' Cov(c)^-1 c in the directions of which the fit has left enough."""
    size = float(np.trace(full)) / len(full)
    # Residuals that are rounding have no correlations.
    if not size > np.finfo(float).tiny:
        return Portmanteau(0.0, 0, 1.0)
    c, covariance, full = c / np.sqrt(size), covariance / size, full / size
    left, directions = eigh(covariance, full + 1e-10 * np.eye(len(full)))
    enough = left > _LEFT
    statistic = float(np.sum((directions.T @ c)[enough] ** 2 / left[enough]))
    degrees = int(enough.sum())
    return Portmanteau(statistic, degrees, float(chi2.sf(statistic, degrees)) if degrees else 1.0)


def delayed(signals: Array, lags: range) -> Array:
    """Return each signal delayed by each lag, 0 before its start; the lags of the first signal first."""
    rows = np.zeros((signals.shape[1], len(lags), len(signals)))
    for own, signal in zip(rows, signals.T, strict=True):
        fill_with_delays(own, signal, lags.start)
    return np.ascontiguousarray(rows.reshape(-1, len(signals)).T)


def covariances(v: Array, lags: int) -> Array:
    """Return the autocorrelations of v at -lags .. lags with Bartlett's taper, which keeps them positive definite."""
    rho = np.array([v[lag:] @ v[: v.size - lag] for lag in range(lags + 1)]) / max(v @ v, np.finfo(float).tiny)
    rho *= 1.0 - np.arange(lags + 1) / (lags + 1)
    return np.concatenate((rho[:0:-1], rho))


def _alike(weights: Array, others: Array) -> bool:
    """Tell whether these are the weights of the same samples."""
    both = ~np.isnan(weights) & ~np.isnan(others)
    a, b = weights[both], others[both]
    if a.size < 2 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return False
    return bool(np.corrcoef(a, b)[0, 1] > _SAME_RECORDING)


_RIGHT: Final = "nothing is left in the residuals"
_DYNAMICS: Final = "right: residuals do not follow the inputs"
# Percent of the output from which on the inputs explain most of it: three quarters of its variance.
_MOST: Final = 50.0
_NO_INPUT: Final = "not judged: there is no input"
_WHITE: Final = "white: residuals do not follow one another"
# Measured samples for each lag.
_SAMPLES_EACH: Final = 4


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
class Validation(Pictured):
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
    shift : float
        How far the level of the recording is from the model's; 0 unless that is more than three standard deviations of
        the noise. Correlations are those without it.
    """

    picture = "models.plot_validation"

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
    shift: float = 0.0

    @property
    def dynamics(self) -> str:
        """Whether the model has the dynamics from the inputs, in words; noise of any color is allowed for."""
        if self.independence is None:
            return _NO_INPUT
        if not self.independence.p_value < 1.0 - self.level:
            explained = max(self.fits[-1].all, 0.0)
            return _DYNAMICS + (f", which explain {explained:.0f} % of the output" if explained < _MOST else "")
        excess = np.abs(self.cross_correlation) / np.maximum(self.cross_bound, np.finfo(float).tiny)
        worst = int(excess.max(axis=1).argmax())
        which = f"input {worst}" if len(excess) > 1 else "u"
        return f"missing: residuals follow {which} at {_lags(excess[worst], 0, self.level)}"

    @property
    def noise(self) -> str:
        """Whether the model has the color of the noise, in words; the intervals of a model that has not are wrong."""
        if not self.whiteness.p_value < 1.0 - self.level:
            return _WHITE
        excess = np.abs(self.autocorrelation) / np.maximum(self.autocorrelation_bound, np.finfo(float).tiny)
        return f"not white: residuals follow one another at {_lags(excess, 1, self.level)}"

    @property
    def verdict(self) -> str:
        """What is wrong, in words: with the level, the dynamics, the noise."""
        faults = [f"the level is {self.shift:+.4g} from the model's"] if self.shift else []
        missing = self.dynamics.startswith("missing")
        if missing:
            faults.append(f"dynamics are {self.dynamics}")
        if self.noise != _WHITE:
            faults.append(self.noise.removeprefix("not white: ") if missing else f"the noise is {self.noise}")
        return "; ".join(faults) or _RIGHT

    def to_text(self) -> str:
        """Return the verdict, the statistics and the fits.

        Returns
        -------
        str
        """
        said = {"dynamics": self.dynamics, "noise": self.noise}
        tests = {"residuals among themselves": self.whiteness, "residuals and input": self.independence}
        said |= {
            name: f"chi2({test.degrees}) = {test.statistic:.1f}, p = {test.p_value:.3g}"
            for name, test in tests.items()
            if test is not None
        }
        fits = [(fit.kind, f"{fit.ordinary:.2f}", f"{fit.all:.2f}") for fit in self.fits]
        words = [f"{name:<28}{text}" for name, text in said.items()]
        return "\n".join([self.verdict, *words, tabulated({"fit, %": -28, "ordinary": 10, "all": 10}, fits)])

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

    __str__ = to_text


def _by_output(name: str, good: str, doc: str) -> Any:
    """Return a property that says of each output what is not good."""

    def read(self: Validations) -> str:
        said = [getattr(one, name) for one in self]
        if len(set(said)) == 1 and (len(said) == 1 or said[0] == _NO_INPUT):
            return str(said[0])
        return "; ".join(f"output {j}: {text}" for j, text in enumerate(said) if text != good) or good

    return property(read, doc=doc)


class Validations(Pictured, tuple[Validation, ...]):
    """What a model of several outputs leaves in the residuals of each: a `Validation` for each output."""

    picture = "models.plot_validation"

    verdict = _by_output("verdict", _RIGHT, "What is wrong, in words, by output.")
    dynamics = _by_output(
        "dynamics", _DYNAMICS,
        "Whether the model has the dynamics from the inputs, in words, by output; see `Validation.dynamics`.",
    )  # fmt: skip
    noise = _by_output(
        "noise", _WHITE, "Whether the model has the color of the noise, in words, by output; see `Validation.noise`."
    )

    def to_text(self) -> str:
        """Return the verdict, the statistics and the fits of each output.

        Returns
        -------
        str
        """
        several = len(self) > 1
        return "\n\n".join(f"output {j}: {one.to_text()}" if several else one.to_text() for j, one in enumerate(self))

    def to_frame(self) -> Any:
        """Return the frames of all outputs side by side, as `Validation.to_frame`, "output 0" etc. above the columns.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        frames = [one.to_frame() for one in self]
        columns = {(f"output {j}", name): each[name] for j, each in enumerate(frames) for name in each}
        return table(columns, frames[0].index)

    __repr__ = to_text


@overload
def validate(
    model: Model | control.TransferFunction, y: ArrayLike, u: ArrayLike | None = None, lags: int = 20,
    level: float = 0.99, steps: int = 10, t: ArrayLike | None = None,
) -> Validation: ...  # fmt: skip
@overload
def validate(
    model: StateSpaceModel | GreyBoxModel, y: ArrayLike, u: ArrayLike | None = None, lags: int = 20,
    level: float = 0.99, steps: int = 10, t: ArrayLike | None = None,
) -> Validations: ...  # fmt: skip
def validate(
    model: Model | StateSpaceModel | GreyBoxModel | control.TransferFunction, y: ArrayLike,
    u: ArrayLike | None = None, lags: int = 20, level: float = 0.99, steps: int = 10, t: ArrayLike | None = None,
) -> Validation | Validations:  # fmt: skip
    """Test what a model leaves in its residuals, and how well it predicts.

    Parameters
    ----------
    model : Model, StateSpaceModel, GreyBoxModel or control.TransferFunction
        What `identify` found, in this recording or another one; or a transfer function in discrete time with one input,
        whose parameters are taken as known for sure, and its level and noise from this recording.
    y : array_like, shape (N,) or (N, n_outputs)
        Measured outputs; NaN where one is missing.
    u : array_like, shape (N,) or (N, n_inputs), optional
        Input.
    lags : int, default 20
        Longest lag in samples.
    level : float, default 0.99
        Probability that a right model passes a test, for all outputs together, and that a correlation stays within its
        bound.
    steps : int, default 10
        How many samples ahead the second prediction looks.
    t : array_like, shape (N,), optional
        Times in s, for a `GreyBoxModel`, which may be at any distance: its lags count samples. Default: those of the
        index.

    Returns
    -------
    Validation or Validations
        Of a `StateSpaceModel` and a `GreyBoxModel` one for each output.

    Raises
    ------
    ValueError
        If y, u or t does not fit, the recording is too short for so many lags, or level is no probability.
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
    >>> validate(identify(y, u, OutputError(1, 1)), y, u).dynamics.split(":")[0]
    'missing'
    """
    model = any_model("model", model, y, u)
    lags, steps = _checks.count("lags", lags, 1), _checks.count("steps", steps, 1)
    level = probability(level)
    judged = Judged.of(model, y, u, t)
    counts, n_outputs = (~np.isnan(judged.residual)).sum(axis=0), judged.residual.shape[1]
    if counts.min() < _SAMPLES_EACH * (lags + 1):
        which = f" of output {counts.argmin()}" if n_outputs > 1 else ""
        raise ValueError(
            f"y: expected at least {_SAMPLES_EACH * (lags + 1)} measured samples{which} for {lags} lags, got "
            f"{counts.min()}; record more or take fewer lags"
        )
    score, outputs = Score.of(judged), _outputs(model, judged, (y, u), steps)
    inputs = delayed(judged.inputs - judged.inputs.mean(axis=0), range(lags + 1))
    level = level ** (1.0 / n_outputs)
    validations = [_of_output(j, judged, score, inputs, outputs, lags, level) for j in range(n_outputs)]
    return validations[0] if isinstance(model, Model) else Validations(validations)


def _of_output(
    j: int, judged: Judged, score: Score, inputs: Array, outputs: dict[str, Array], lags: int, level: float
) -> Validation:
    """Return what is left in the residuals of one output."""
    white, v, shape = np.ones(1), score.v[:, j], (judged.inputs.shape[1], lags + 1)
    auto, auto_bound, whiteness = score.tested(j, delayed(v[:, None], range(1, lags + 1)), white, level)
    cross, cross_bound, independence = np.zeros(0), np.zeros(0), None
    if inputs.size:
        kernel = white if whiteness.p_value >= 1.0 - level else covariances(v, lags)
        cross, cross_bound, independence = score.tested(j, inputs, kernel, level)
    y, seen = judged.y[:, j], ~np.isnan(judged.residual[:, j])
    ordinary = ordinary_samples(judged.residual[:, j], y)
    fits = tuple(
        Fit(kind, ordinary_fit(y, output[:, j], ordinary), ordinary_fit(y, output[:, j], seen))
        for kind, output in outputs.items()
    )
    return Validation(
        auto, auto_bound, cross.reshape(shape), cross_bound.reshape(shape), whiteness, independence, fits,
        int(seen.sum()), level, score.same_recording, float(score.shift[j]),
    )  # fmt: skip


def _outputs(model: Any, judged: Judged, signals: tuple[Any, ...], steps: int) -> dict[str, Array]:
    """Return the predictions by kind, shape (N, p); a physical model's are from inputs alone however far ahead."""
    if isinstance(model, GreyBoxModel):
        return {"free run": judged.y - judged.residual}
    outputs = {"1 step": judged.y - judged.residual}
    if steps > 1:
        outputs[f"{steps} steps"] = np.asarray(model.predict(*signals, steps)).reshape(judged.y.shape)
    if judged.inputs.shape[1]:
        outputs["free run"] = np.asarray(model.free_run(*signals)).reshape(judged.y.shape)
    return outputs


def _lags(excess: Array, first: int, level: float) -> str:
    """Return the lags that are no accident, at this level for all together, as "lags 3-6, 9"; at least the largest."""
    all_together = norm.isf(0.5 * (1.0 - level) / excess.size) / norm.isf(0.5 * (1.0 - level))
    outside = np.flatnonzero(excess > all_together)
    outside = outside if outside.size else np.array([excess.argmax()])
    runs = [[int(k) for _, k in run] for _, run in groupby(enumerate(outside + first), lambda pair: pair[1] - pair[0])]
    text = ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)
    return f"lag{'s' if outside.size > 1 else ''} {text}"


# Several models.


class Compared(NamedTuple):
    """One model of a comparison.

    Attributes
    ----------
    name : str
        Its name.
    fit : float
        Fit of the output from inputs alone, in percent on ordinary samples; without input that of one step ahead. Of
        several outputs the mean of their fits.
    one_step : float
        Fit one step ahead on ordinary samples.
    all : float
        The first fit on all samples.
    """

    name: str
    fit: float
    one_step: float
    all: float


@dataclass(frozen=True, eq=False)
class Comparison(Report, Pictured):
    """Models on one recording, the best first.

    Attributes
    ----------
    rows : tuple of Compared
        Sorted by their fit on ordinary samples.
    measured : ndarray, shape (N,) or (N, n_outputs)
        Measured output; NaN where it is missing.
    outputs : dict of str to ndarray, of the shape of `measured`
        Output of each model that its fit is of, the best first.
    samples : int
        How many measured samples all of them predict.
    ordinary : int
        How many of these are ordinary: within three standard deviations of the noise of the model with the least.
    index : pandas.Index or None
        When the samples were taken, if the recording was a pandas object.
    """

    picture, row = "models.plot_comparison", "model"

    rows: tuple[Compared, ...]
    measured: Array
    outputs: dict[str, Array]
    samples: int
    ordinary: int
    index: Any = None

    def to_text(self) -> str:
        """Return the table.

        Returns
        -------
        str
        """
        heads = {"model": -max(10, *(len(row.name) for row in self.rows)) - 2, "fit, %": 10, "1 step": 10, "all": 10}
        rows = [(row.name, *(f"{fit:.2f}" for fit in row[1:])) for row in self.rows]
        return tabulated(heads, rows, f"fits on {self.ordinary} ordinary samples, and on all {self.samples}")


def compare(
    models: Mapping[str, Model | StateSpaceModel | GreyBoxModel | control.TransferFunction],
    y: ArrayLike,
    u: ArrayLike | None = None,
    t: ArrayLike | None = None,
) -> Comparison:
    """Rank models by their fit on the ordinary samples of one recording.

    Parameters
    ----------
    models : mapping of str to Model, StateSpaceModel, GreyBoxModel or control.TransferFunction
        Models by name, all of the same outputs; transfer functions as `validate` takes them.
    y : array_like, shape (N,) or (N, n_outputs)
        Measured output; NaN where it is missing.
    u : array_like, shape (N,) or (N, n_inputs), optional
        Input.
    t : array_like, shape (N,), optional
        Times in s, for a `GreyBoxModel`; with a model in discrete time their steps are equal. Default: those of the
        index.

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError
        If there is no model, or y, u or t does not fit one of them.
    TypeError
        If models is no mapping to such models.

    Notes
    -----
    Every model is judged on the same samples: those that all predict, and of these the ones that are ordinary to the
    model whose residuals have the least median size.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.identification import FIR, identify
    >>> rng = np.random.default_rng(1)
    >>> u = rng.choice([-1.0, 1.0], 300)
    >>> y = np.concatenate(([0.0], 2.0 * u[:-1])) + 0.1 * rng.normal(size=300)
    >>> y[::20] += 30.0
    >>> found = compare({"right": identify(y, u, FIR(1)), "late": identify(y, u, FIR(1, nk=2))}, y, u)
    >>> [row.name for row in found.rows]
    ['right', 'late']
    """
    if not isinstance(models, Mapping):
        raise TypeError(f'models: expected {{"name": model, ..}}, got {_checks.shown(models)}')
    if not models:
        raise ValueError("models: expected at least one model, got none")
    candidates = {str(name): any_model(f"models[{name!r}]", model, y, u) for name, model in models.items()}
    given = np.shape(y)
    counts, asked = {name: np.size(model.R) for name, model in candidates.items()}, given[1] if len(given) == 2 else 1
    if set(counts.values()) != {asked} and given[:1] != (1,):
        each = ", ".join(f"models[{name!r}] of {count}" for name, count in counts.items())
        raise ValueError(
            f"models: expected models of as many outputs as y has, {asked}, got {each}; compare the models of the same "
            "outputs, and of y those columns"
        )
    index, residuals, outputs = recording(ANY_TIMES, y=y, u=u)[0].index, {}, {}
    measured = np.column_stack([recorded_output(column) for column in _columns(_checks.numbers("y", y)).T])
    for name, model in candidates.items():
        residuals[name] = _columns(model.residuals(y, u, t))
        alone = not isinstance(model, Model) or model.structure.n_inputs
        outputs[name] = _columns(model.free_run(y, u, t)) if alone else measured - residuals[name]
    shared = ~np.any(np.isnan(list(residuals.values())), axis=0)
    if not shared.any(axis=0).all():
        raise ValueError("y: expected measured samples that all models predict, got none; record more")
    ordinary = np.zeros(shared.shape, dtype=bool)
    for j, (own, good) in enumerate(zip(measured.T, shared.T, strict=True)):
        if np.ptp(own[good]) == 0.0:
            which = f" of output {j}" if measured.shape[1] > 1 else ""
            raise ValueError(f"y: expected samples{which} that differ, found a constant: its fit is undefined")
        closest = min(residuals.values(), key=lambda left: float(np.median(np.abs(left[good, j]))))
        ordinary[:, j] = ordinary_samples(np.where(good, closest[:, j], np.nan), own)
    rows = []
    for name, output in outputs.items():
        pairs = ((output, ordinary), (measured - residuals[name], ordinary), (output, shared))
        rows.append(Compared(name, *(_fit(measured, *pair) for pair in pairs)))
    rows.sort(key=lambda row: -row.fit if np.isfinite(row.fit) else np.inf)
    one = measured.shape[1] == 1
    shown = {row.name: outputs[row.name][:, 0] if one else outputs[row.name] for row in rows}
    measured = measured[:, 0] if one else measured
    return Comparison(tuple(rows), measured, shown, int(shared.sum()), int(ordinary.sum()), index)


def _columns(signal: Any) -> Array:
    """Return signals of outputs as columns."""
    values = np.asarray(signal, dtype=float)
    return values.reshape(-1, 1) if values.ndim == 1 or values.shape[0] == 1 else values


def _fit(measured: Array, output: Array, counts: Any) -> float:
    """Return the mean over the outputs of the fit on the samples that count."""
    return float(np.mean([ordinary_fit(*columns) for columns in zip(measured.T, output.T, counts.T, strict=True)]))
