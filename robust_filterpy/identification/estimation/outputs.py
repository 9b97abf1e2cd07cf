"""What recordings of several outputs have beside any model of them: what `level`, `feedback`, `wraps` find of each.

Steps and ramps of the level are taken off where the model can be told so, and the likelihood says so; outliers of the
inputs are held back; a plant that changes, a closed loop and an output that wraps round are said.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.identification.estimation.feedback import feedback
from robust_filterpy.identification.estimation.level import (
    LEAST_SAMPLES,
    Beside,
    Settled,
    another_gain,
    beside_input_outliers,
    break_finding,
    unlike,
)
from robust_filterpy.identification.estimation.trend import PRICE, Break, Trend, piecewise_level
from robust_filterpy.identification.estimation.wraps import wraps
from robust_filterpy.identification.models.results import Finding

__all__ = ["Outputs"]

_ROUNDS: Final = 3


class Outputs(NamedTuple):
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
        find(y, u) gives the model of such signals.
    alone : callable
        alone(model, y, u) gives its outputs from inputs alone, shape (N, p).
    evidence : callable
        evidence(model, y, u) gives the log-likelihood of what it leaves, with its colour.
    starts : callable
        starts(y, u, model) gives outputs that no level disturbs, shape (N, p), NaN where nothing tells them, from the
        model beside constant levels.
    joint : callable, optional
        joint(y, u, levels, columns, begin) gives a model and levels, moved by what the columns add, that are best
        together, and where another such search may begin. Default: the levels stay as they are.
    index : pandas.Index or None
        Times of the samples of a single recording.
    settled : callable, optional
        settled(best) gives a model beside levels without what no recording can tell. Default: as it is.
    """

    y: Array
    u: Array
    spans: Any
    find: Callable[[Array, Array], Any]
    alone: Callable[[Any, Array, Array], Array]
    evidence: Callable[[Any, Array, Array], float]
    starts: Callable[[Array, Array, Any], Any]
    joint: Callable[..., tuple[Any, Array, Any]] | None = None
    index: Any = None
    settled: Callable[[Beside], Beside] = lambda best: best

    def beside(self, trend: str) -> Beside:
        """Find the model beside levels that break and outliers of the inputs."""
        return beside_input_outliers(self.u, lambda u: self._replace(u=u).beside_levels(trend))

    def beside_levels(self, trend: str | Settled) -> Beside:
        """Find the model beside levels that break."""
        if isinstance(trend, Settled) and trend.trend.breaks:
            breaks = {(0, 0): trend.trend}
            return self._named_breaks(self.settled(self._fitted(breaks)[0]), breaks, np.inf)
        plain = self.settled(self._judged(self.find(self.y, self.u), np.zeros(self.y.shape)))
        line = trend == "line"
        rounding = all(one.is_rounding for one in np.atleast_1d(np.array(plain.model.noise, dtype=object)))
        if trend not in ("line", "breaks") or not self.u.shape[1] or (rounding and not line):
            return plain
        stage("steps and ramps of the levels of y")
        best, kept = plain, -np.inf
        for output in self.starts(self.y, self.u, plain.model):
            found, breaks = self._alternated(output, line)
            if found is None:
                continue
            found = self.settled(found)
            count = sum(len(one.breaks) for one in breaks.values())
            gain = 2.0 * (found.evidence - plain.evidence)
            worth = gain - PRICE * np.log(len(self.y)) * count
            if worth > (kept if line else max(kept, 0.0)):
                best, kept = found if line else self._named_breaks(found, breaks, gain), worth
        return best

    def _judged(self, model: Any, levels: Array) -> Beside:
        """Return a model beside levels, with its evidence."""
        return Beside(model, (), levels, self.u, evidence=self.evidence(model, self.y - levels, self.u))

    def _alternated(self, output: Array, line: bool) -> tuple[Beside | None, dict[tuple[int, int], Trend]]:
        """Find levels and model in turns until the breaks stay where they are."""
        before: Any = None
        end: Any = None
        found, kept = None, {}
        for _ in range(1 if line and self.joint is not None else _ROUNDS):
            breaks = self._levels(self.y - output, line)
            times = {place: one.times for place, one in breaks.items() if one.breaks}
            if not times:
                return None, {}
            if times == before and not line:
                break
            before, kept = times, breaks
            found, end = self._fitted(breaks, end)
            output = self.alone(found.model, self.y - found.levels, self.u)
        return found, kept

    def _fitted(self, breaks: dict[tuple[int, int], Trend], begin: Any = None) -> tuple[Beside, Any]:
        """Find the model beside breaks at given places, and where another such search may begin."""
        levels, columns = np.zeros(self.y.shape), []
        for (i, j), one in breaks.items():
            levels[self.spans[i], j] = one.values
            columns += [self._column(i, j, b) for b in one.breaks]
        if self.joint is None:
            model = self.find(self.y - levels, self.u)
        else:
            model, levels, begin = self.joint(self.y, self.u, levels, columns, begin)
        return self._judged(model, levels), begin

    def _column(self, i: int, j: int, one: Break) -> Array:
        """Return what a break of 1 adds to the outputs."""
        part, column = self.spans[i], np.zeros(self.y.shape)
        column[part, j] = one.column(part.stop - part.start)
        return column

    def _named_breaks(self, best: Beside, breaks: dict[tuple[int, int], Trend], gain: float) -> Beside:
        """Return a model with its breaks in words."""
        findings: list[Finding] = []
        for (i, j), one in breaks.items():
            part = self.spans[i]
            said = [break_finding(b, self.index, gain, part.stop - part.start, self.u[part]) for b in one.breaks]
            findings += self._named(i, j, said)
        return best._replace(findings=(*findings, *best.findings))

    def left(
        self,
        best: Beside,
        output: Array,
        residual: Array,
        rest: Array,
        direct: bool,
        meaning: str,
        driven: Array | None = None,
    ) -> tuple[Finding, ...]:
        """Find what a model leaves: another plant, wraps, feedback."""
        found: list[Finding] = []
        for i, part in enumerate(self.spans):
            for j, (own, e) in enumerate(zip(output[part].T, residual[part].T, strict=True)):
                signals = np.column_stack((own - own.mean(), best.u[part] - rest))
                quiet = best.model.noise[j].is_rounding
                more = () if quiet else unlike(e, signals, len(self.spans) > 1)
                if not (more or quiet or len(self.spans) > 1):
                    more = another_gain(e, own if driven is None else driven[:, j])
                found += self._named(i, j, [*wraps(self.y[part, j], e), *more])
        # Of what is rounding alone nothing went back to the input.
        if best.u.shape[1] and not all(one.is_rounding for one in best.model.noise):
            parts = [(best.u[part] - rest, residual[part]) for part in self.spans]
            found += feedback(parts, direct, meaning)
        return tuple(found)

    # Helpers.

    def _levels(self, left: Array, line: bool) -> dict[tuple[int, int], Trend]:
        """Return the levels of each output in each recording, by their numbers."""
        found = {}
        for i, part in enumerate(self.spans):
            for j, own in enumerate(left[part].T):
                if np.count_nonzero(~np.isnan(own)) >= LEAST_SAMPLES:
                    found[i, j] = piecewise_level(own, self.u[part], line)
                elif line and self.joint is not None:
                    found[i, j] = Trend(np.zeros(own.size), (Break("ramp", 0, 0.0, 0.0),))
        return found

    def _named(self, i: int, j: int, findings: list[Finding]) -> list[Finding]:
        """Return findings that name their recording and output, where there are several."""
        name = f"recording {i}: " * (len(self.spans) > 1) + f"output {j}: " * (self.y.shape[1] > 1)
        return [one._replace(text=name + one.text) for one in findings]
