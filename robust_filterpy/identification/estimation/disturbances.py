"""The one driver of `identify`: a model of p outputs in k recordings, with the disturbances that these have.

Steps and ramps of the level are taken off where the likelihood says so; inputs that are far outside the others are held
back where the model is much likelier then; another plant, a closed loop and an output that wraps round are said.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.stats import norm

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.identification.estimation.trend import PRICE, Break, Trend, impulse_output, piecewise_level
from robust_filterpy.identification.models.dependence import another_gain, feedback, unlike, wraps
from robust_filterpy.identification.models.results import Finding
from robust_filterpy.identification.models.signals import held
from robust_filterpy.influence.regression import mad_scale

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
    held : bool
        Whether some of the inputs are held back.
    """

    model: Any
    levels: Array
    u: Array
    evidence: float = float("nan")
    findings: tuple[Finding, ...] = ()
    end: Any = None
    held: bool = False

    @property
    def noises(self) -> tuple[Any, ...]:
        """The noise of each output."""
        return self.model.noise if isinstance(self.model.noise, tuple) else (self.model.noise,)


class Settled(NamedTuple):
    """What a recording of one output has besides one model of it, for others of the same recording.

    Attributes
    ----------
    trend : Trend
        Steps and ramps of its level; one without values: they are looked for.
    input : Finding or None
        Says that outliers of its inputs are held back.
    begin : ndarray or None
        Free parameters of a model near by, from which alone the search begins.
    """

    trend: Trend = Trend(np.zeros(0), ())
    input: Finding | None = None
    begin: Array | None = None

    @classmethod
    def of(cls, model: Any, samples: int) -> Settled:
        """Return what the recording of a model has besides."""
        values = model.trend if model.trend.size else np.zeros(samples)
        input = next((one for one in model.findings if one.kind == "input outliers"), None)
        breaks = [
            Break(one.kind, one.place[0], 0.0, one.evidence) for one in model.findings if one.kind in ("step", "ramp")
        ]
        if breaks:
            sizes = np.linalg.lstsq(np.column_stack([one.column(samples) for one in breaks]), values, rcond=None)[0]
            breaks = [one._replace(size=float(size)) for one, size in zip(breaks, sizes, strict=True)]
        return cls(Trend(values, tuple(breaks)), input)

    def after(self, first: int) -> Settled:
        """Return the same for the recording from a sample on."""
        breaks = [one._replace(time=max(one.time - first, 0)) for one in self.trend.breaks]
        remaining = tuple(one for one in breaks if one.kind == "ramp" or one.time)
        return self._replace(trend=Trend(self.trend.values[first:], remaining))


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
            if trend.input is None:
                return self._with_levels(trend)
            held = self._replace(u=other)._with_levels(trend)
            return held._replace(held=True, findings=(*held.findings, trend.input))
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
        return held._replace(held=True, findings=(*held.findings, finding))

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
                    more += other
                findings += self._named(i, j, more)
        # Of what is rounding alone nothing went back to the input.
        if best.u.shape[1] and not all(one.is_rounding for one in best.noises):
            findings += feedback([(best.u[part] - rest, residual[part]) for part in self.spans], direct, meaning)
        return tuple(findings)

    def _with_levels(self, trend: str | Settled) -> Explanation:
        """Find the model with levels that break."""
        if isinstance(trend, Settled) and trend.trend.breaks:
            breaks = {(0, 0): trend.trend}
            return self._with_breaks(self.settled(self._fitted(breaks)), breaks, np.inf)
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
            times = {place: one.times for place, one in breaks.items() if one.breaks}
            if not times:
                return None, {}
            if times == before and not line:
                break
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
                    levels[i, j] = Trend(np.zeros(own.size), (Break("ramp", 0, 0.0, 0.0),))
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
    """Return what long impulse responses make of the inputs, NaN where a recording is too short to tell."""
    output = np.full(y.shape, np.nan)
    for part in spans:
        for j, own in enumerate(y[part].T):
            if u.shape[1] and np.count_nonzero(~np.isnan(own)) >= _LEAST_SAMPLES:
                output[part, j] = impulse_output(own, u[part])
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
