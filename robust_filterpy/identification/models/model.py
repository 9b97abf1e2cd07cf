"""Model: what a recording says, as one value: parameters and their uncertainty, the noise, predictions.

Predictions of a model whose regressor holds measured outputs, through outliers and gaps.

The regressor of A(q) y = B(q)/F(q) u + d + C(q)/D(q) v holds past outputs, and a wild one would spoil the predictions
of the samples after it. In its place stands prediction + weight x residual, the filter-cleaner of Martin and Thomson
(Proceedings of the IEEE 70, 1982): weight 1 is the usual predictor, weight 0 (a gap, a gross outlier) the model's own
output. With A D = 1 + g_1 q^-1 + .. the residuals follow from

    r(k) = [D (A y - B/F u - d)](k) - sum_j (g_j (1 - w(k-j)) + c_j w(k-j)) r(k-j).

What was far may have been a wild reading, or a step that lasts. A wild one is followed by readings that the prediction
in its place explains; a step by those that it explains itself, as it was measured,

    r(k) + sum_j (g_j - c_j) (1 - w(k-j)) r(k-j)

being small. Of two that a step explains in a row the second is believed, and so those after it. An outlier repeats the
one before by chance with a share of about contamination/scale ratio: .004 for 7 % of 20 deviations, twice .00001.

A weight depends on its residual and so on the weights before it. Many samples are predicted together with the weights
as they are, these are computed anew, and so on: each turn settles at least one sample more, and usually dozens.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.blas import dtbsv
from scipy.signal import lfilter

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.correction.contaminated import Contaminated
from robust_filterpy.identification.models import regressor, signals
from robust_filterpy.identification.models.noise import Noise, with_linear
from robust_filterpy.identification.models.polynomial_model import Parts, PolynomialModel
from robust_filterpy.identification.models.recording import measurements
from robust_filterpy.identification.models.regressor import Layout, Memory
from robust_filterpy.identification.models.responses import PolynomialSystem
from robust_filterpy.identification.models.results import Identified, coloured, signals_of
from robust_filterpy.identification.models.signals import TimeAxis
from robust_filterpy.identification.models.structures import OutputError
from robust_filterpy.influence.functions import Huber
from robust_filterpy.influence.regression import mad_scale, robust_regression

# Below this share of its coefficients' size A(1) is 0: the model integrates and has no level.
_INTEGRATES: Final = 1e-9
_IMPULSE_SAMPLES: Final = 500
# Samples that are predicted together, and what a weight or a variance may still move by, as a share.
_TOGETHER: Final = 1000
_SETTLED: Final = 1e-12


def motion_after(model: Model, y: Any, u: Any) -> tuple[Any, Array]:
    """Return a recording without gaps and outliers, and the free parameters with what was in motion as it began."""
    recorded, seen = model.prepared(y, u)
    n, cleaned = model.theta.size, model.without_outliers(recorded, seen)
    if cleaned is not recorded:
        recorded, seen = cleaned, np.ones(seen.size, dtype=bool)
    p = np.concatenate((model.theta, [model.offset], np.zeros(recorded.nf)))
    return recorded, with_linear(recorded, p, slice(n + 1, None), seen[recorded.first :])


def resting_level(parts: Parts) -> float:
    """Return what the output of a model is at rest, offset/A(1), or 0 if it integrates and has no rest."""
    total = float(parts.a.sum())
    return parts.offset / total if abs(total) > _INTEGRATES * float(np.abs(parts.a).sum()) else 0.0


def filled_memory(model: PolynomialModel, p: Array) -> Memory:
    """Return what a tracker would remember after a recording."""
    structure, layout = model.structure, Layout(model.structure)
    n, level, disturbance = structure.n_theta, resting_level(model.parts(p)), model.equation_error(p)
    without_noise = p.copy()
    without_noise[layout.c] = without_noise[layout.d] = 0.0
    chi = -model.jacobian(without_noise)[:, :n] * layout.precedes_noise
    rest = Memory.at_rest(layout)
    outputs = np.concatenate((_newest(level - model.y, layout.na), _newest(-disturbance, layout.nd)))
    return Memory(
        outputs=outputs,
        measured=outputs,
        inputs=rest.regressors(layout, model.u)[1],
        residuals=_newest(model.residuals(p), layout.nc),
        undisturbed=_newest(-model.undisturbed(p), layout.nf),
        prefiltered=_newest(chi, len(rest.prefiltered)),
        gradients=_newest(-model.jacobian(p)[:, :n], layout.nc),
    )


def _newest(signal: Array, count: int) -> Array:
    """Return the last samples, the newest first."""
    return np.ascontiguousarray(signal[::-1][:count])


class CleanedResiduals(NamedTuple):
    """What a sample by sample prediction gave.

    Attributes
    ----------
    residual : ndarray, shape (N,)
        Measured less predicted output; less nothing where it is missing.
    weights : ndarray, shape (N,)
        Share of each residual that went into the regressor.
    """

    residual: Array
    weights: Array


def cleaned_residuals(parts: Parts, equation_error: Array, seen: Array, noise: Noise) -> CleanedResiduals:
    """Predict each output from those before it, outliers among them replaced."""
    order = max(parts.a.size + parts.d.size - 1, parts.c.size) - 1
    g, c = (np.pad(p[1:], (1, order + 1 - p.size)) for p in (np.convolve(parts.a, parts.d), parts.c))
    # In units of R, what an innovation that was not believed adds to the variance of the next residuals, and its limit.
    added = (g - c) ** 2
    impulse = np.concatenate(([1.0], np.zeros(_IMPULSE_SAMPLES)))
    limit = float(np.sum(np.square(lfilter(parts.c, np.concatenate(([1.0], g[1:])), impulse))))
    driving, size = lfilter(parts.d, [1.0], equation_error), seen.size
    # With what stands for samples before the first.
    residuals, variances, agreeing = np.zeros(order + size), *np.ones((2, order + size))
    weights = np.concatenate((np.ones(order), seen))
    missing = weights == 0.0
    settled = 0
    while settled < size:
        before, now = slice(settled, settled + order), slice(settled + order, settled + order + _TOGETHER)
        r, w = residuals[before], weights[before]
        here = slice(settled, settled + _TOGETHER)
        target, measured, tried, variance = driving[here].copy(), seen[here], weights[now], variances[now]
        earlier = np.convolve(r * (1.0 - w), g)[order:] + np.convolve(r * w, c)[order:]
        target[:order] -= earlier[: target.size]
        band = np.multiply.outer(g, 1.0 - tried) + np.multiply.outer(c, tried)
        # Of a model far from stable numbers overflow, at times only until weights are settled.
        with np.errstate(over="ignore", invalid="ignore"):
            residual = dtbsv(order, band, target, lower=1, diag=1)
            both = slice(before.start, now.stop)
            doubts = (1.0 - weights[both]) ** 2 * variances[both]
            changed = np.minimum(1.0 + np.convolve(added, doubts)[order : order + target.size], limit)
            doubted = np.where(missing[both], np.nan, (1.0 - weights[both]) * np.concatenate((r, residual)))
            explained = residual + np.convolve(g - c, doubted)[order : order + target.size]
            agreeing[now] = np.nan_to_num(noise.weights(explained))
            lasting = np.minimum(agreeing[now], agreeing[now.start - 1 : now.stop - 1][: target.size])
            alone = np.nan_to_num(noise.weights(residual / np.sqrt(changed)))
            weight = np.where(measured, np.maximum(alone, lasting), 0.0)
        moved = (np.abs(weight - tried) > _SETTLED) | (np.abs(changed - variance) > _SETTLED * changed)
        # The first that moved depends on none that did.
        residuals[now], weights[now], variances[now] = residual, weight, changed
        settled += int(moved.argmax()) + 1 if moved.any() else target.size
    return CleanedResiduals(residuals[order:], weights[order:])


def predicted(parts: Parts, y: Array, cleaned: CleanedResiduals, steps: int) -> Array:
    """Return the output predicted so many samples ahead, from the residuals cleaned one by one."""
    believed = cleaned.weights * cleaned.residual
    impulse = np.concatenate(([1.0], np.zeros(max(steps - 1, 0))))
    h = lfilter(parts.c, np.convolve(parts.a, parts.d), impulse)[:steps]
    # The cleaned output less what the innovations of the last samples did to it.
    return np.asarray(y - cleaned.residual + believed - np.convolve(believed, h)[: y.size])


# So many samples tell where noise that is summed up began.
_FIRST_LEVEL: Final = 5


class Ending(NamedTuple):
    """Where the search from some of the starts ended.

    Attributes
    ----------
    starts : tuple of str
        The starts that led here.
    excess : float
        How much less likely than the best this end is, as a difference of log-likelihoods; 0 for the best.
    difference : float
        How far its output is from the best one's, in percent of that one's variation.
    """

    starts: tuple[str, ...]
    excess: float
    difference: float


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Model(PolynomialSystem, Identified):
    """A(q) y = B(q)/F(q) u + offset + C(q)/D(q) v, as `identify` found it.

    Attributes
    ----------
    structure : Structure
        Which polynomials there are, and their orders.
    theta : ndarray, shape (n,)
        Parameters, in the order of ``structure.names``.
    offset : float
        Constant of the equation: in an OutputError, BoxJenkins, FIR or LinearRegression what is added to the output, in
        an ARX or ARMAX (AR, ARMA) the last coefficient of the regression. `level` is what it means for y.
    P : ndarray, shape (n, n)
        Covariance of theta, in sandwich form: honest whatever the distribution of the noise; see also ``profiled``.
    offset_std : float
        Standard deviation of the offset; 0 if it was not estimated.
    offset_covariance : ndarray, shape (n,)
        Its covariance with theta.
    noise : Noise
        Variance R of the ordinary noise and the influence function, with contamination and scale_ratio if learned.
    weights : ndarray, shape (N,)
        How much each sample of the recording was believed: psi(e)/e of its residual, 0 for an outlier that stood in
        the regressor, NaN where y is missing or the regressor lies before the recording.
    log_likelihood : float
        Of the samples that count, under the density that the influence function is made for.
    endings : tuple of Ending
        Where the search ended from each start, the best first.
    warning : str
        What makes this estimate doubtful, in words; empty if nothing does.
    memory : Memory
        Past signals at the end of the recording, for `tracker`.
    has_offset : bool
        Whether there is a constant.
    dt : float or None
        Sampling period in s, if the index of the recording has it.
    own_fit : float
        Fit of the prediction one step ahead on the ordinary samples of the recording, in percent.
    findings : tuple of Finding
        What the recording has besides the model and its noise: fill values, level steps, .., with the evidence.
    operating_point : ndarray, shape (n_inputs,)
        Inputs at which the plant rests: 0, unless an input is far from 0 in all of the recording, and then its mean.
    trends : tuple of (int, ndarray)
        Fingerprint of each recording whose level moves, and its `trend`: methods that are given the same y take it off
        it, and put it back.
    levels : ndarray, shape (n_recordings,) or (0,)
        `level` of each recording, if there were several; offset and memory are those of the last.
    profiled : bool
        Whether P is that of the likelihood: the loss is not quadratic within two standard deviations, or another end is
        nearly as likely.
    colour : float
        How many times as large standard deviations are as those of white residuals: what is left follows itself, and
        P counts that.
    evidence : float
        Log-likelihood with the color of the residuals.

    Notes
    -----
    `identify` makes it. Recordings may be pandas objects with one uniform index; what is computed of each sample comes
    back as a Series on that index.
    """

    theta: Array
    offset: float
    offset_std: float
    offset_covariance: Array
    endings: tuple[Ending, ...] = ()
    memory: Memory
    has_offset: bool = True
    own_fit: float = float("nan")
    operating_point: Array = field(default_factory=lambda: np.zeros(0))
    levels: Array = field(default_factory=lambda: np.zeros(0))
    profiled: bool = False
    evidence: float = float("nan")

    def __repr__(self) -> str:
        """Show the parameters with their standard deviations."""
        text = f"{self._valued(self.structure.names)}, offset={self.offset:.4g}, R={self.R:.4g}"
        return f"Model({self.structure}, {text}){self._remarks}"

    # The model.

    @property
    def R(self) -> float:
        """Variance of the ordinary noise, in the unit of y squared."""
        return self.noise.R

    @property
    def joint(self) -> Array:
        """Covariance of theta and the offset, shape (n + 1, n + 1)."""
        cross = self.offset_covariance[:, None]
        return np.block([[self.P, cross], [cross.T, np.full((1, 1), self.offset_std**2)]])

    @property
    def parts(self) -> Parts:
        """The polynomials with their leading 1, and the constant."""
        return Parts.of(self.structure, np.append(self.theta, self.offset), True)

    @property
    def level(self) -> float:
        """What the output is at rest with no input, offset/A(1); 0 if the model integrates, which has no rest."""
        return resting_level(self.parts)

    @property
    def trend(self) -> Array:
        """Steps and ramps of the level of a single recording, 0 at its end; ``findings`` say when and how large."""
        return self.trends[0][1] if self.trends and not self.levels.size else np.zeros(0)

    @property
    def _rows(self) -> tuple[tuple[str, ...], Array, Array]:
        """The parameters, and the constant."""
        names, theta, std = super()._rows
        if not self.has_offset:
            return names, theta, std
        return (*names, "offset"), np.append(theta, self.offset), np.append(std, self.offset_std)

    @property
    def _facts(self) -> dict[str, str]:
        """What the table says besides the parameters."""
        count = int((~np.isnan(self.weights)).sum())
        facts = {"Samples": f"{count} of {self.weights.size}", "R": f"{self.R:.4g}"}
        if isinstance(self.noise.influence, Contaminated):
            facts["Contamination"] = f"{self.noise.influence.contamination:.3f}"
            facts["Scale ratio"] = f"{self.noise.influence.scale_ratio:.3g}"
        facts |= {"Log-likelihood": f"{self.log_likelihood:.1f}", "Fit, 1 step": f"{self.own_fit:.2f} %"}
        if self.profiled:
            # Two pairs of poles may cancel zeros at other places too, of which no profile tells.
            more = self.structure.nf + self.structure.nc + self.structure.nd > 2
            facts["Intervals"] = "profile likelihood" + ", at least" * more
        several = {"Recordings": f"{self.levels.size}, each with a level"} if self.levels.size else {}
        return facts | coloured(self.colour) | several

    # Its outputs.

    def simulate(self, u: ArrayLike, start: str | tuple[Any, Any] = "rest") -> Array:
        """Run the model on inputs alone.

        Parameters
        ----------
        u : array_like, shape (N,) or (N, n_inputs)
            Input. Where it is NaN it keeps the value before, and a warning says so.
        start : {"rest", "continued"} or tuple of two recordings (y, u), default "rest"
            From rest, where the output is `level` and each input at its operating point; "continued": from where the
            recording of the model ended; (y, u): from where this recording ended.

        Returns
        -------
        ndarray, shape (N,)

        Raises
        ------
        ValueError
            If u does not fit or is infinite, the output of an unstable model overflows, or start is none of these.

        Warns
        -----
        UserWarning
            If u has gaps.

        Examples
        --------
        >>> import numpy as np
        >>> from robust_filterpy.identification import OutputError, identify
        >>> u = np.random.default_rng(1).choice([-1.0, 1.0], 300)
        >>> y = np.zeros(300)
        >>> for k in range(1, 300):
        ...     y[k] = 0.9 * y[k - 1] + u[k - 1]
        >>> model = identify(y[:200], u[:200], OutputError(1, 1))
        >>> bool(np.allclose(model.simulate(u[200:], start="continued"), y[200:]))
        True
        """
        axis, _, u = signals_of(self, None, u)
        signal, at_point = signals.held_input(self.structure, u, self.operating_point), 0.0
        layout = Layout(self.structure)
        if self.operating_point.any() and isinstance(start, str) and start == "rest":
            # From the start: an input of 1e8 with motion of 1 on it is not switched on in the first sample.
            signal = signal - self.operating_point
            at_point = float(self._ways(self.theta[None], np.ones(1), 0)[0, :, 0] @ self.operating_point)
        y = regressor.simulate(self.structure, layout, self._memory_at(start, layout), self.theta, signal)
        integrates = self.level == 0.0 != self.offset
        rest = lfilter([self.offset], self.parts.a, np.ones(y.size)) if integrates else self.level
        return axis.labelled(y + (rest + at_point), "simulated")

    def _run(self, y: Any, u: Any, t: Any, steps: int) -> tuple[TimeAxis, Any, Any]:
        """Return the time axis, the measured output, and that so many steps ahead, or with 0 from inputs alone."""
        axis, y, u = signals_of(self, y, u, t)
        measured, (recorded, seen) = self._measured(y, u)[0], self.prepared(y, u)
        output = self._predicted(recorded, seen, steps) if steps else self._from_inputs(recorded, seen)
        return axis, measured, output + signals.trend_of(self.trends, measured)

    def _predicted(self, model: PolynomialModel, seen: Any, steps: int) -> Array:
        """Return the prediction of each output of a checked recording."""
        if not model.remembers:
            return self._from_inputs(model, seen)
        ahead = predicted(self.parts, model.y[model.first :], self._cleaned(model, seen), steps)
        return np.concatenate((np.full(model.first, np.nan), ahead))

    def prepared(self, y: Any, u: Any) -> tuple[PolynomialModel, Any]:
        """Return a checked recording without its own trend, ready for what estimates or judges.

        Parameters
        ----------
        y, u
            As in `predict`.

        Returns
        -------
        recorded : PolynomialModel
            The level stands in the place of missing outputs.
        seen : ndarray of bool, shape (N,)
            Where y is measured.

        Raises
        ------
        ValueError, TypeError
            If y or u does not fit, or is too short for one regressor.
        """
        output, signal = self._measured(y, u)
        output = output - signals.trend_of(self.trends, output)
        seen = ~np.isnan(output)
        model = PolynomialModel(self.structure, np.where(seen, output, self.level), signal, True)
        if output.size <= model.first:
            raise ValueError(
                f"y: expected more than the {model.first} samples that the regressor of {self.structure} reaches back, "
                f"got {output.size}"
            )
        return model, seen

    def without_outliers(self, recorded: PolynomialModel, seen: Any) -> PolynomialModel:
        """Return a recording with the model's values for outliers and gaps, if its residuals hold past outputs.

        Parameters
        ----------
        recorded : PolynomialModel
            From `prepared`.
        seen : ndarray of bool, shape (N,)
            From there, too.

        Returns
        -------
        PolynomialModel
            The same one where no residual reaches another.
        """
        if not recorded.remembers:
            return recorded
        cleaned, output = self._cleaned(recorded, seen), recorded.y.copy()
        output[recorded.first :] += (cleaned.weights - 1.0) * cleaned.residual
        return recorded.with_output(output)

    # Helpers.

    def _measured(self, y: Any, u: Any) -> tuple[Array, Array]:
        """Return a checked output, NaN where it is no measurement, and the inputs."""
        output = signals.measured_output(y)
        signal = signals.recorded_input(self.structure, u, output.size)
        return measurements(output, signal)[0], signal

    def _memory_at(self, start: Any, layout: Layout) -> Memory:
        """Return the past signals with which a simulation begins, or raise."""
        if isinstance(start, tuple) and len(start) == 2:
            _, y, u = signals_of(self, *start)
            return filled_memory(*motion_after(self, y, u))
        if _checks.option("start", start, ("rest", "continued")) == "rest":
            return Memory.at_rest(layout)
        if np.isnan(self.weights).all():
            raise ValueError('start: expected a model that has seen a recording for "continued", got one that has none')
        return self.memory

    def _cleaned(self, model: PolynomialModel, seen: Any) -> CleanedResiduals:
        """Return the residuals from the first sample that has a regressor on, one by one."""
        if model.nf:
            disturbance = np.nan_to_num(model.y - self._from_inputs(model, seen))
            error = np.asarray(lfilter(self.parts.a, [1.0], disturbance)[model.first :])
        else:
            error = model.equation_error(np.concatenate((self.theta, [self.offset])))
        if self.structure.integrated:
            # What is summed up may begin anywhere.
            error = error - np.median(error[seen[model.first :]][:_FIRST_LEVEL])
        return cleaned_residuals(self.parts, error, seen[model.first :], self.noise)

    def _from_inputs(self, model: PolynomialModel, seen: Any) -> Array:
        """Return the output from inputs alone, whatever was in motion when the recording began."""
        y = self.simulate(model.u) if model.inputs else np.full(model.y.size, self.level)
        y[: model.first] = np.nan
        parts = self.parts
        dynamics = np.convolve(parts.a, parts.f)
        order = dynamics.size - 1
        rows = seen[model.first :]
        if order and rows.any():
            impulses = np.eye(order, y.size - model.first)
            motion = np.asarray(lfilter([1.0], dynamics, impulses)).T
            X, left = motion[rows], (model.y - y)[model.first :][rows]
            if self.structure.integrated:
                X, left = np.diff(X, axis=0), np.diff(left)
            y[model.first :] += motion @ robust_regression(X, left)
        return y


def as_model(name: str, given: Any, y: Any, u: Any) -> Model:
    """Return a Model as it is, and one of a transfer function whose level and noise the recording tells; or raise."""
    # Its parameters are taken as known for sure. The level is the median of what the transfer function leaves of y.
    if isinstance(given, Model):
        return given
    if not (hasattr(given, "num_list") or hasattr(given, "num")) or not hasattr(given, "isdtime"):
        raise TypeError(
            f"{name}: expected a Model, StateSpaceModel or GreyBoxModel that identify found, or a "
            f"control.TransferFunction, got {_checks.shown(given)}"
        )
    theta, na, nb, nk = regressor.linear_parameters(given, name)
    if not nb:
        raise ValueError(f"{name}: expected a transfer function that is not 0, got {given}")
    structure = OutputError(na, nb, nk)
    axis, y, u = signals.recording(structure, y=y, u=u)
    measured = signals.recorded_output(y)
    n, signal = structure.n_theta, signals.recorded_input(structure, u, measured.size)
    period = None if given.dt is True else float(given.dt)
    axis.require_period(period)
    model = Model(
        structure=structure, theta=theta, offset=0.0, P=np.zeros((n, n)), offset_std=0.0, offset_covariance=np.zeros(n),
        noise=Noise(Huber(), 1.0), weights=np.full(measured.size, np.nan), log_likelihood=np.nan, warning="",
        memory=Memory.at_rest(Layout(structure)), dt=period,
    )  # fmt: skip
    left = measured - model.simulate(signal)
    left = left[~np.isnan(left)]
    if not left.size:
        return model
    level = float(np.median(left))
    R = max(mad_scale(left - level) ** 2, np.finfo(float).tiny)
    return replace(model, offset=level, noise=Noise(Huber(), R))
