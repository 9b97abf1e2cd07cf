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
    Beside,
    another_gain,
    beside_input_outliers,
    break_finding,
    unlike,
)
from robust_filterpy.identification.estimation.trend import PRICE, Trend, impulse_output, piecewise_level
from robust_filterpy.identification.estimation.wraps import wraps
from robust_filterpy.identification.models.findings import Finding

__all__ = ["Outputs"]

# In fewer samples a step and the dynamics cannot be told apart.
_LEAST_SAMPLES: Final = 200
_ROUNDS: Final = 3


class Outputs(NamedTuple):
    """Recordings of several outputs, one after the other, and how a model of them is found.

    Attributes
    ----------
    y : ndarray, shape (N, p)
        Outputs, NaN where one is missing.
    u : ndarray, shape (N, m)
        Inputs.
    spans : list of slice
        Samples of each recording.
    find : callable
        find(y, u) gives the model of such signals, with its ``log_likelihood``.
    alone : callable
        alone(model, y, u) gives its outputs from inputs alone, shape (N, p).
    index : pandas.Index or None
        Times of the samples of a single recording.
    sampled : bool
        Whether the samples are equally far apart.
    """

    y: Array
    u: Array
    spans: list[slice]
    find: Callable[[Array, Array], Any]
    alone: Callable[[Any, Array, Array], Array]
    index: Any = None
    sampled: bool = True

    def beside(self, trend: str) -> Beside:
        """Find the model beside levels that break and outliers of the inputs.

        Parameters
        ----------
        trend : {"none", "constant", "line", "breaks"}
            What each output has beside a model.

        Returns
        -------
        Beside
            Its levels are 0 in the last sample of each recording.
        """
        return beside_input_outliers(self.u, lambda u: self._replace(u=u)._beside_levels(trend))

    def _beside_levels(self, trend: str) -> Beside:
        """Return the model beside levels that break."""
        plain = self.find(self.y, self.u)
        y, line, none = self.y, trend == "line", np.zeros(self.y.shape)
        if trend in ("none", "constant") or (not line and all(one.is_rounding for one in plain.noise)):
            return Beside(plain, (), none)
        stage("steps and ramps of the levels of y")
        model, levels = plain, none
        found = self._levels(self._of_impulses() if self.sampled else y - self.alone(plain, y, self.u), line)
        before = None
        for _ in range(_ROUNDS):
            times = {place: [(b.kind, b.time) for b in one.breaks] for place, one in found.items()}
            if not any(times.values()):
                return Beside(plain, (), none)
            if times == before:
                break
            before, breaks = times, found
            levels = none.copy()
            for (i, j), one in breaks.items():
                levels[self.spans[i], j] = one.values if one.breaks else 0.0
            model = self.find(y - levels, self.u)
            found = self._levels(y - self.alone(model, y - levels, self.u), line)
        count = sum(len(one.breaks) for one in breaks.values())
        gain = 2.0 * (model.log_likelihood - plain.log_likelihood)
        if not line and gain < PRICE * np.log(len(y)) * count:
            return Beside(plain, (), none)
        findings = []
        for (i, j), one in breaks.items():
            part = self.spans[i]
            said = [break_finding(b, self.index, gain, part.stop - part.start, self.u[part]) for b in one.breaks]
            findings += self._named(i, j, said)
        return Beside(model, () if line else tuple(findings), levels)

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
        """Find what a model leaves: another plant, wraps, feedback.

        Parameters
        ----------
        best : Beside
            The model.
        output : ndarray, shape (N, p)
            What it makes of the inputs alone.
        residual : ndarray, shape (N, p)
            What it leaves of the outputs.
        rest : ndarray, shape (m,)
            Where the inputs rest.
        direct : bool
            Whether inputs may move outputs at once.
        meaning : str
            What a closed loop means for the model.
        driven : ndarray, shape (N, p), optional
            What the model makes of the inputs as it stands in the residuals. Default: `output`.

        Returns
        -------
        tuple of Finding
        """
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

    def _of_impulses(self) -> Array:
        """Return what is left of the outputs beside long impulse responses, NaN where that tells nothing."""
        left = np.full(self.y.shape, np.nan)
        for part in self.spans:
            for j, own in enumerate(self.y[part].T):
                if self.u.shape[1] and np.count_nonzero(~np.isnan(own)) >= _LEAST_SAMPLES:
                    left[part, j] = own - impulse_output(own, self.u[part])
        return left

    def _levels(self, left: Array, line: bool) -> dict[tuple[int, int], Trend]:
        """Return the levels of each output in each recording, by their numbers."""
        found = {}
        for i, part in enumerate(self.spans):
            for j, own in enumerate(left[part].T):
                if np.count_nonzero(~np.isnan(own)) >= _LEAST_SAMPLES:
                    found[i, j] = piecewise_level(own, line=line)
        return found

    def _named(self, i: int, j: int, findings: list[Finding]) -> list[Finding]:
        """Return findings that name their recording and output, where there are several."""
        name = f"recording {i}: " * (len(self.spans) > 1) + f"output {j}: " * (self.y.shape[1] > 1)
        return [one._replace(text=name + one.text) for one in findings]
