"""The one driver of `identify`: a model of p outputs in k recordings, with the disturbances that these have.

Steps and ramps of the level are taken off where the likelihood says so; inputs that are far outside the others are held
back where the model is much likelier then; another plant, a closed loop and an output that wraps round are said.

A wrong level bends the dynamics before it shows in their residual. So the output without a level comes from a model
that no level disturbs: a long impulse response by robust regression, or a model of the differences. In what is left of
y the step or ramp with the largest score is added, with what a slow input could do, until there are four. Those stay
without which the residuals, with the color that they have then (`colour`), are less likely by 3 log N each, and which
are larger than a step of the sensor.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.stats import norm

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.correction.contaminated import START
from robust_filterpy.identification.estimation.prediction_error import evidence
from robust_filterpy.identification.estimation.starts import robust_regression
from robust_filterpy.identification.models.dependence import another_gain, feedback, slow_inputs, uneven, unlike, wraps
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.results import Finding
from robust_filterpy.identification.models.signals import fingerprint, held
from robust_filterpy.influence.functions import Huber
from robust_filterpy.influence.regression import mad_scale, resolution

#: A break must explain so many times log N, in units of twice the log-likelihood.
PRICE: Final = 6.0
_MOST_BREAKS: Final = 4
# Huber's threshold, in robust standard deviations.
_K: Final = 1.345
# A break is not looked for nearer to an end than this share of the recording, and so many samples.
_EDGE: Final = 0.02
_LEAST_EDGE: Final = 10
# What was in motion in the beginning looks like a step: so much is left out.
_BEGINNING: Final = 0.03
#: The longest impulse response.
LAGS_OF_IMPULSES: Final = 60


class Break(NamedTuple):
    """One change of the level.

    Attributes
    ----------
    kind : str
        "step" or "ramp".
    time : int
        First sample after it.
    size : float
        Of a step, in the unit of y; of a ramp, what it adds in each sample from there on.
    evidence : float
        Twice the log-likelihood that it explains.
    """

    kind: str
    time: int
    size: float = 0.0
    evidence: float = 0.0

    def column(self, samples: int) -> Array:
        """Return what a step of 1, or a ramp of 1 a sample, adds to the level, 0 in the last sample, shape (N,)."""
        t = np.arange(samples) - self.time
        shown = (t >= 0).astype(float) if self.kind == "step" else np.maximum(t, 0.0)
        return np.asarray(shown - shown[-1])


class Trend(NamedTuple):
    """What an output has besides what its inputs do.

    Attributes
    ----------
    values : ndarray, shape (N,)
        0 in the last sample: the level of the model is that at the end of the recording.
    breaks : tuple of Break
        Sorted by time.
    """

    values: Array
    breaks: tuple[Break, ...]


def piecewise_level(r: Array, u: Array, line: bool = False) -> Trend:
    """Find the steps and ramps of a signal that is noise otherwise."""
    N = r.size
    if line:
        fit = _Fit.of(r, ~np.isnan(r), u, [Break("ramp", 0)])
        return fit.trend([np.inf])
    skipped = min(int(_BEGINNING * N) + _LEAST_EDGE, N // 4)
    rows = ~np.isnan(r) & (np.arange(N) >= skipped)
    edge = max(_LEAST_EDGE, int(_EDGE * (N - skipped)))
    times = np.arange(skipped + edge, N - edge)
    fit = _Fit.of(r, rows, u, [])
    for _ in range(_MOST_BREAKS):
        # A ramp may begin with the recording.
        places = (("step", times), ("ramp", np.concatenate(([0], times))))
        scores = [fit.scores(kind, at) for kind, at in places]
        # White residuals make the most of a break: what is little of that is less with a color.
        if max(score.max() for score in scores) < 0.5 * PRICE * np.log(N):
            break
        candidates = [Break(kind, int(at[score.argmax()])) for (kind, at), score in zip(places, scores, strict=True)]
        tried = [_Fit.of(r, rows, u, [*fit.breaks, one]) for one in candidates]
        least = min(one.scale for one in tried)
        fit = min(tried, key=lambda one: float(Huber(_K).rho(one.residual[rows] / least).sum()))
    steps = resolution(r[rows])
    while fit.breaks:
        count = len(fit.breaks)
        small = np.ptp(fit.X[:, -count:], axis=0) * np.abs(fit.theta[-count:]) <= steps
        without = [_Fit.of(r, rows, u, [*fit.breaks[:i], *fit.breaks[i + 1 :]]) for i in range(count)]
        gains = [2.0 * (fit.evidence - one.evidence) for one in without]
        least = int(np.where(small, -np.inf, gains).argmin())
        if not small[least] and gains[least] >= PRICE * np.log(N):
            return fit.trend(gains)
        fit = without[least]
    return Trend(np.zeros(N), ())


class _Fit(NamedTuple):
    """Huber's regression of a signal on a constant, on what slow inputs may do, and on breaks, these last."""

    breaks: list[Break]
    X: Array
    theta: Array
    residual: Array
    scale: float
    rows: Any

    @classmethod
    def of(cls, r: Array, rows: Any, u: Array, breaks: list[Break]) -> _Fit:
        """Return the regression."""
        X = np.column_stack((np.ones(r.size), *slow_inputs(u), *(one.column(r.size) for one in breaks)))
        size = np.abs(X[rows]).max(axis=0, initial=0.0)
        size[size == 0.0] = 1.0
        theta = robust_regression(X[rows] / size, r[rows], 30) / size
        residual = r - X @ theta
        return cls(breaks, X, theta, residual, max(mad_scale(residual[rows]), np.finfo(float).tiny), rows)

    @property
    def evidence(self) -> float:
        """The log-likelihood of what is left, with its color."""
        e = self.residual[self.rows]
        noise = Noise(START, self.scale**2).settled(e)
        return evidence(noise, np.where(self.rows, self.residual, 0.0), self.rows)

    def trend(self, gains: Any) -> Trend:
        """Return its breaks, with the evidence of each."""
        sizes = self.theta[-len(self.breaks) :]
        breaks = [b._replace(size=float(s), evidence=g) for b, s, g in zip(self.breaks, sizes, gains, strict=True)]
        values = self.X[:, -len(self.breaks) :] @ sizes
        return Trend(values, tuple(sorted(breaks, key=lambda one: one.time)))

    def scores(self, kind: str, places: Any) -> Array:
        """Return the score statistic of one break more at each place: (c'psi)^2/(c'Wc - c'WX (X'WX)^-1 X'Wc)."""
        e, N = np.where(self.rows, self.residual / self.scale, np.inf), self.residual.size
        psi = np.where(self.rows, np.clip(e, -_K, _K), 0.0)
        # A sample that Huber's loss clips tells little of a level, not nothing.
        W, t = np.where(self.rows, np.maximum(np.abs(e) < _K, 0.05), 0.0), np.arange(N) / N
        WX = self.X * W[:, None]
        after = lambda v: np.cumsum(v[::-1], axis=0)[::-1][places]  # noqa: E731
        pull, square, cross = after(psi), after(W), after(WX)
        if kind == "ramp":
            at = places / N
            pull = after(t * psi) - at * pull
            square = after(t * t * W) - 2.0 * at * after(t * W) + at * at * square
            cross = after(t[:, None] * WX) - at[:, None] * cross
        left = square - ((cross @ np.linalg.pinv(self.X.T @ WX)) * cross).sum(axis=1)
        return np.where(left > 1e-3 * square, pull**2 / np.maximum(left, 1e-9), 0.0)


TRENDS: Final = ("none", "constant", "line", "breaks")
# In fewer samples a step and the dynamics cannot be distinguished.
_LEAST_SAMPLES: Final = 200
# Turns of levels and model.
_ROUNDS: Final = 3
# An input is far outside beyond so many half widths of four fifths of its values, or off the levels that nine tenths of
# them have, of which there are at most so many, each with more samples than these.
_FAR_INPUT: Final = 3.2
_MOST_LEVELS: Final = 20
_FEWEST: Final = 4
# So many normal ones may be as far out, on each side.
_FARTHEST: Final = 0.05
# An input so many deviations from 0 stays there.
_STAYS: Final = 5.0


class Explanation(NamedTuple):
    """A model, with whatever else a recording has.

    Attributes
    ----------
    model : Model, StateSpaceModel or GreyBoxModel
        The model.
    levels : ndarray, shape (N, p)
        What was taken off the outputs.
    u : ndarray, shape (N, n_inputs)
        Inputs that it is of.
    evidence : float
        Log-likelihood with the color of the residuals.
    findings : tuple of Finding
        Of what the recordings have besides.
    end : ndarray or None
        Where the search for another such model may begin.
    """

    model: Any
    levels: Array
    u: Array
    evidence: float = float("nan")
    findings: tuple[Finding, ...] = ()
    end: Any = None

    @property
    def noises(self) -> tuple[Any, ...]:
        """The noise of each output."""
        return self.model.noise if isinstance(self.model.noise, tuple) else (self.model.noise,)


class Settled(NamedTuple):
    """What a recording of one output has besides one model of it, for others of the same recording.

    Attributes
    ----------
    values : ndarray, shape (N,)
        Steps and ramps of its level; empty: they are looked for.
    findings : tuple of Finding
        These in words, and that outliers of its inputs are held back.
    begin : ndarray or None
        Free parameters of a model near by, from which alone the search begins.
    draws : bool
        Whether outliers of a regressor are drawn, for parameters and intervals that depend on no choice of them; it
        takes as long as the search.
    """

    values: Array
    findings: tuple[Finding, ...] = ()
    begin: Array | None = None
    draws: bool = True

    @classmethod
    def of(cls, model: Any, samples: int) -> Settled:
        """Return what the recording of a model has besides."""
        findings = tuple(one for one in model.findings if one.kind in ("step", "ramp", "input outliers"))
        return cls(model.trend if model.trend.size else np.zeros(samples), findings)

    @property
    def trend(self) -> Trend:
        """Its level."""
        breaks = [Break(one.kind, one.place[0]) for one in self.findings if one.kind != "input outliers"]
        return Trend(self.values, tuple(breaks))

    def after(self, first: int) -> Settled:
        """Return the same for the recording from a sample on."""
        places = [(max(one.place[0] - first, 0), one.place[1] - first) for one in self.findings]
        later = [one._replace(place=place) for one, place in zip(self.findings, places, strict=True)]
        remaining = tuple(one for one in later if one.kind != "step" or one.place[0])
        return self._replace(values=self.values[first:], findings=remaining)


class Search(NamedTuple):
    """Recordings of several outputs, one after the other, and how a model of them is found.

    Attributes
    ----------
    y : ndarray, shape (N, p)
        Outputs, NaN where one is missing.
    u : ndarray, shape (N, m)
        Inputs.
    spans : sequence of slice
        Samples of each recording.
    find : callable
        find(u, levels, columns, end) gives the model with levels; where it fits their sizes, these are moved by what
        the columns, shape (N, p) each, add, from where another such search ended.
    alone : callable
        alone(model, y, u) gives its outputs from inputs alone, shape (N, p).
    starts : callable
        starts(u, model) gives outputs that no level disturbs, shape (N, p), NaN where nothing tells them, from the
        model with constant levels.
    fits_sizes : bool
        Whether sizes of levels are found with the model; else they stay.
    settled : callable
        settled(best) gives a model with levels, without what no recording can tell.
    index : pandas.Index or None
        Times of the samples of a single recording.
    """

    y: Array
    u: Array
    spans: Any
    find: Callable[..., Explanation]
    alone: Callable[[Any, Array, Array], Array]
    starts: Callable[[Array, Any], Iterable[Array]]
    fits_sizes: bool = False
    settled: Callable[[Explanation], Explanation] = lambda best: best
    index: Any = None

    def best(self, trend: str | Settled) -> Explanation:
        """Find the model with levels that break, and that with outliers of u held back; take it if much likelier."""
        # Both ways from the beginning: what an outlier of u leaves looks like steps of the level, or like slow motion.
        other, places = _held_back(self.u)
        if isinstance(trend, Settled):
            acts = self.u if all(one.kind != "input outliers" for one in trend.findings) else other
            settled = self._replace(u=acts)._with_levels(trend)
            return settled._replace(findings=(*trend.findings, *settled.findings))
        nominal = self._with_levels(trend)
        if not places.size:
            return nominal
        stage("the model without outliers of u")
        try:
            held = self._replace(u=other)._with_levels(trend)
        except ValueError:
            return nominal
        gain = 2.0 * (held.evidence - nominal.evidence)
        breaks = [sum(one.kind in ("step", "ramp") for one in each.findings) for each in (held, nominal)]
        if gain < PRICE * np.log(len(self.u)) * (1 + breaks[0] - breaks[1]):
            return nominal
        text = (
            f"u has {places.size} values unlike the others that y does not follow: the model is of the values before "
            "them, held; give u as it acted"
        )
        finding = Finding("input outliers", text, gain, (int(places[0]), int(places[-1]) + 1))
        return held._replace(findings=(*held.findings, finding))

    def left(
        self, best: Explanation, output: Array, residual: Array, rest: Array, direct: bool, meaning: str,
        driven: Array | None = None, clear: Array | None = None,
    ) -> tuple[Finding, ...]:  # fmt: skip
        """Find what a model leaves: another plant, wraps, feedback; from residuals that no outlier touches, if any."""
        findings: list[Finding] = []
        several, shown = len(self.spans) > 1, residual if clear is None else clear
        for i, part in enumerate(self.spans):
            for j, noise in enumerate(best.noises):
                own, more = output[part, j], wraps(self.y[part, j], residual[part, j])
                if not noise.is_rounding:
                    signals = np.column_stack((own - own.mean(), best.u[part] - rest))
                    other = unlike(shown[part, j], signals, several)
                    if not (other or several):
                        other = another_gain(shown[part, j], own if driven is None else driven[:, j])
                    more += other or uneven(shown[part, j], best.u[part] - rest)
                findings += self._named(i, j, more)
        # Of what is rounding alone nothing went back to the input.
        if best.u.shape[1] and not all(one.is_rounding for one in best.noises):
            findings += feedback([(best.u[part] - rest, residual[part]) for part in self.spans], direct, meaning)
        return tuple(findings)

    def concluded(self, best: Explanation, findings: tuple[Finding, ...]) -> Any:
        """Return the model with what was found, and with the levels that its methods take off the same recordings."""
        shape = best.model.weights.shape
        before = [trend for _, trend in best.model.trends] or [0.0] * len(self.spans)
        parts = [(self.y[part], best.levels.reshape(shape)[part]) for part in self.spans]
        trends = ((fingerprint(y), level + one) for (y, level), one in zip(parts, before, strict=True))
        return replace(best.model, findings=findings, trends=tuple(one for one in trends if one[1].any()))

    def _with_levels(self, trend: str | Settled) -> Explanation:
        """Find the model with levels that break."""
        if isinstance(trend, Settled) and trend.trend.breaks:
            return self.settled(self._fitted({(0, 0): trend.trend}))
        plain = self.settled(self.find(self.u, np.zeros(self.y.shape), [], None))
        line = trend == "line"
        rounding = all(one.is_rounding for one in plain.noises)
        if trend not in ("line", "breaks") or not self.u.shape[1] or (rounding and not line):
            return plain
        stage("steps and ramps of the levels of y")
        best, best_worth = plain, -np.inf
        for output in self.starts(self.u, plain.model):
            fitted, breaks = self._alternated(output, line)
            if fitted is None:
                continue
            fitted = self.settled(fitted)
            count = sum(len(one.breaks) for one in breaks.values())
            gain = 2.0 * (fitted.evidence - plain.evidence)
            worth = gain - PRICE * np.log(len(self.y)) * count
            if worth > (best_worth if line else max(best_worth, 0.0)):
                best, best_worth = fitted if line else self._with_breaks(fitted, breaks, gain), worth
        return best

    def _alternated(self, output: Array, line: bool) -> tuple[Explanation | None, dict[tuple[int, int], Trend]]:
        """Find levels and model in turns until the breaks stay where they are."""
        before: Any = None
        fitted, levels = None, {}
        for _ in range(1 if line and self.fits_sizes else _ROUNDS):
            breaks = self._levels(self.y - output, line)
            times = [(*place, each.kind, each.time) for place, one in breaks.items() for each in one.breaks]
            if not times:
                return None, {}
            if times == before and self.fits_sizes:
                return fitted, breaks
            before, levels = times, breaks
            fitted = self._fitted(breaks, None if fitted is None else fitted.end)
            output = self.alone(fitted.model, self.y - fitted.levels, self.u)
        return fitted, levels

    def _fitted(self, breaks: dict[tuple[int, int], Trend], end: Any = None) -> Explanation:
        """Find the model with breaks at given places."""
        levels, columns = np.zeros(self.y.shape), []
        for (i, j), one in breaks.items():
            part = self.spans[i]
            levels[part, j] = one.values
            for each in one.breaks:
                column = np.zeros(self.y.shape)
                column[part, j] = each.column(part.stop - part.start)
                columns.append(column)
        return self.find(self.u, levels, columns, end)

    def _levels(self, left: Array, line: bool) -> dict[tuple[int, int], Trend]:
        """Return the levels of each output in each recording, by their numbers."""
        levels = {}
        for i, part in enumerate(self.spans):
            for j, own in enumerate(left[part].T):
                if np.count_nonzero(~np.isnan(own)) >= _LEAST_SAMPLES:
                    levels[i, j] = piecewise_level(own, self.u[part], line)
                elif line and self.fits_sizes:
                    levels[i, j] = Trend(np.zeros(own.size), (Break("ramp", 0),))
        return levels

    def _with_breaks(self, best: Explanation, breaks: dict[tuple[int, int], Trend], gain: float) -> Explanation:
        """Return a model with its breaks in words."""
        findings: list[Finding] = []
        for (i, j), one in breaks.items():
            part = self.spans[i]
            said = [break_finding(b, self.index, gain, part.stop - part.start, self.u[part]) for b in one.breaks]
            findings += self._named(i, j, said)
        return best._replace(findings=(*findings, *best.findings))

    def _named(self, i: int, j: int, findings: Iterable[Finding]) -> list[Finding]:
        """Return findings that name their recording and output, where there are several."""
        name = f"recording {i}: " * (len(self.spans) > 1) + f"output {j}: " * (self.y.shape[1] > 1)
        return [one._replace(text=name + one.text) for one in findings]


def of_impulses(y: Array, u: Array, spans: Any) -> Array:
    """Return what robust long impulse responses make of the inputs, NaN where a recording is too short to tell."""
    output = np.full(y.shape, np.nan)
    for part in spans if u.shape[1] else ():
        size, deviations = part.stop - part.start, u[part] - u[part].mean(axis=0)
        lags = max(min(LAGS_OF_IMPULSES, size // (8 * u.shape[1])), 2)
        earlier = np.maximum(np.arange(size)[:, None] - np.arange(lags), 0)
        X = np.hstack((*deviations.T[:, earlier], np.ones((size, 1))))
        for j, own in enumerate(y[part].T):
            measured = ~np.isnan(own)
            if measured.sum() >= _LEAST_SAMPLES:
                output[part, j] = X[:, :-1] @ robust_regression(X[measured], own[measured])[:-1]
    return output


def far_outside(u: Array) -> Any:
    """Return which values of an input are far outside the others, of many of which some are further out."""
    low, middle, high = np.quantile(u, [0.1, 0.5, 0.9])
    far = max(_FAR_INPUT, float(norm.isf(_FARTHEST / u.size) / norm.isf(0.1)))
    return (np.abs(u - middle) > far * max(high - middle, middle - low)) & (high > low)


def break_finding(change: Any, index: Any, gain: float, samples: int, u: Array) -> Finding:
    """Return a break in words."""
    when = f"sample {change.time}" + ("" if index is None else f" ({index[change.time]})")
    if change.kind == "step":
        text = f"the level of y steps by {change.size:.4g} at {when}"
    else:
        text = f"the level of y changes by {change.size:.4g} a sample from {when} on"
    for column in u.reshape(len(u), -1).T:
        level = float(np.nanmedian(column))
        if abs(level) > _STAYS * mad_scale(column[~np.isnan(column)] - level):
            text += f", or a gain does, since u stays near {level:.3g}"
            break
    return Finding(change.kind, f"{text}; taken off", min(change.evidence, gain), (change.time, samples))


def _held_back(u: Array) -> tuple[Array, Any]:
    """Return inputs with the value before in the place of each that is unlike the others, and in which samples."""
    far: Any = np.column_stack([u[:, :0], *(_odd(column) for column in u.T)]).astype(bool)
    ordinary = np.take_along_axis(u, far.argmin(axis=0)[None], axis=0)
    return held(np.where(far, np.nan, u), ordinary), np.flatnonzero(far.any(axis=1))


def _odd(u: Array) -> Any:
    """Return which values of an input are unlike the others: far outside, or off the levels that it has otherwise."""
    odd = far_outside(u)
    _, which, counts = np.unique(u, return_inverse=True, return_counts=True)
    common = counts > max(_FEWEST, u.size // 200)
    if common.sum() <= _MOST_LEVELS and counts[common].sum() >= 0.9 * u.size:
        odd |= ~common[which]
    return odd & (np.ptp(np.quantile(u, [0.1, 0.9])) > 0.0)
