"""validate: what a model leaves in its residuals, and how well it predicts."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final, NamedTuple, overload

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import norm

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._pictures import Pictured
from robust_filterpy.identification.judging.score import (
    Judged,
    Portmanteau,
    Score,
    any_model,
    covariances,
    delayed,
)
from robust_filterpy.identification.models.grey_box import GreyBoxModel
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.noise import ordinary_fit, ordinary_samples
from robust_filterpy.identification.models.state_space import StateSpaceModel
from robust_filterpy.identification.models.time_axis import table
from robust_filterpy.identification.models.uncertainty import probability

if TYPE_CHECKING:
    import control

_RIGHT: Final = "nothing is left in the residuals"
_DYNAMICS: Final = "right: residuals do not follow the inputs"
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
        the noise. Correlations are those beside it.
    """

    picture = "workbench.plot_validation"

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
            return _DYNAMICS
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
        tests = [("residuals among themselves", self.whiteness), ("residuals and input", self.independence)]
        lines = [self.verdict, f"{'dynamics':<28}{self.dynamics}", f"{'noise':<28}{self.noise}"]
        for name, test in tests:
            if test is not None:
                lines.append(f"{name:<28}chi2({test.degrees}) = {test.statistic:.1f}, p = {test.p_value:.3g}")
        lines.append(f"{'fit, %':<28}{'ordinary':>10}{'all':>10}")
        lines += [f"{fit.kind:<28}{fit.ordinary:>10.2f}{fit.all:>10.2f}" for fit in self.fits]
        return "\n".join(lines)

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


class Validations(Pictured, tuple[Validation, ...]):
    """What a model of several outputs leaves in the residuals of each: a `Validation` for each output."""

    picture = "workbench.plot_validation"

    @property
    def verdict(self) -> str:
        """What is wrong, in words, by output."""
        return self._by_output("verdict", _RIGHT)

    @property
    def dynamics(self) -> str:
        """Whether the model has the dynamics from the inputs, in words, by output; see `Validation.dynamics`."""
        return self._by_output("dynamics", _DYNAMICS)

    @property
    def noise(self) -> str:
        """Whether the model has the color of the noise, in words, by output; see `Validation.noise`."""
        return self._by_output("noise", _WHITE)

    def _by_output(self, name: str, good: str) -> str:
        """Return what is not good of each output."""
        said = [getattr(one, name) for one in self]
        if len(set(said)) == 1 and (len(said) == 1 or said[0] == _NO_INPUT):
            return str(said[0])
        return "; ".join(f"output {j}: {text}" for j, text in enumerate(said) if text != good) or good

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
    model: Model | StateSpaceModel | GreyBoxModel | control.TransferFunction,
    y: ArrayLike,
    u: ArrayLike | None = None,
    lags: int = 20,
    level: float = 0.99,
    steps: int = 10,
    t: ArrayLike | None = None,
) -> Validation | Validations:
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
