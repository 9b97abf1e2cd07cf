"""What `estimate_noise` makes small: minus a recording's likelihood and priors, as a function of logs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.filters.problem import Problem
from robust_filterpy.noise._likelihood import log_likelihoods
from robust_filterpy.noise._search import Ends, descend, valleys

# Log of the scale factors, logit of the contamination, log of the scale ratio: where the search may go. Outliers are
# the fewer and at least three times as large, otherwise the two parts of the mixture could change their roles.
SCALE_LIMIT = 16.0
LOGIT_LIMITS = (-9.0, float(np.log(0.45 / 0.55)))
RATIO_LIMITS = (np.log(3.0), np.log(1e4))
# Where the search begins: decades of both factors, few and many outliers, and what is left of the best places.
_DECADES, _SHARES, _STARTS = np.log(10.0) * np.arange(-5.0, 6.0), np.array([-7.0, -2.2]), 4
_FIRST_LOOK = 400
# Between the places of a grid of decades.
_FINER = np.log(10.0) * np.linspace(-0.8, 0.8, 9)
# The prior: ten ordinary samples, and outliers of ten times the size within a factor of e.
_PRIOR_ORDINARY, _PRIOR_LOG_RATIO = 10.0, np.log(10.0)


@dataclass(frozen=True)
class NoiseFit:
    """Hold a recording, which variances share a factor, and what the user knows of the outliers.

    A point has the logs of R's factors, those of Q's, the logit of the contamination and the log of the scale ratio.
    """

    data: Problem
    groups_R: Array
    """Factor of each sensor, -1 where there is none."""
    groups_Q: Array
    """The same of each state."""
    known: tuple[float | None, float | None]
    """Contamination and scale ratio, as far as they are known."""

    @property
    def count_R(self) -> int:
        """How many factors R has."""
        return int(self.groups_R.max()) + 1

    @property
    def count_Q(self) -> int:
        """How many factors Q has."""
        return int(self.groups_Q.max()) + 1

    @property
    def names(self) -> list[str]:
        """What the factors are called."""
        return [f"R's factor {k}" for k in range(self.count_R)] + [f"Q's factor {k}" for k in range(self.count_Q)]

    @property
    def limits(self) -> tuple[Array, Array]:
        """Where the search may go."""
        factors = [(-SCALE_LIMIT, SCALE_LIMIT)] * (self.count_R + self.count_Q)
        low, high = np.transpose([*factors, LOGIT_LIMITS, RATIO_LIMITS])
        return low, high

    def unpacked(self, points: Array) -> tuple[Array, Array, Array, Array]:
        """Return log factors of each sensor and of each state, contamination and scale ratio of p points."""
        none, at = np.zeros((len(points), 1)), self.count_R
        logs_R = np.concatenate([points[:, :at], none], axis=1)[:, self.groups_R]
        logs_Q = np.concatenate([points[:, at : at + self.count_Q], none], axis=1)[:, self.groups_Q]
        share, ratio = self.known
        shares = 1 / (1 + np.exp(-points[:, -2])) if share is None else np.full(len(points), share)
        ratios = np.exp(points[:, -1]) if ratio is None else np.full(len(points), ratio)
        return logs_R, logs_Q, shares, ratios

    def cost(self, points: Array, steps: int | None = None) -> Array:
        """Return minus the log-likelihood of the recording, or of its beginning, and of the priors, for p points."""
        logs_R, logs_Q, share, ratio = self.unpacked(points)
        prior = -0.5 * (np.log(ratio) - _PRIOR_LOG_RATIO) ** 2
        if self.known[0] is None:
            prior = prior + _PRIOR_ORDINARY * np.log1p(-share)
        data = self.data if steps is None else self.data.first(steps)
        return -(log_likelihoods(data, logs_R, logs_Q, share, ratio) + prior)

    def ends(self) -> Ends:
        """Return where the search ends from every start, the lowest first."""
        name = f"stage {self._looks + 1} of {self._looks + 2}, the search"
        found = descend(self.cost, self._starts(), *self.limits, name)
        order = np.argsort(found.costs, kind="stable")
        return Ends(*(part[order] for part in found))

    @property
    def _looks(self) -> int:
        """How many looks `_starts` takes; the search is the next stage, what the recording determines the last."""
        return 1 + (self.count_R + self.count_Q if max(self.count_R, self.count_Q) > 1 else 0)

    def _starts(self) -> Array:
        """Return the lowest places of a grid over one factor for R and one for Q, then each factor on its own."""
        steps = min(_FIRST_LOOK, len(self.data.zs))
        stage(f"stage 1 of {self._looks + 2}, where to start")
        log_R, log_Q = (_DECADES if count else np.zeros(1) for count in (self.count_R, self.count_Q))
        places = []
        for share in _SHARES if self.known[0] is None else _SHARES[:1]:
            grid = np.array(
                [[*[r] * self.count_R, *[q] * self.count_Q, share, _PRIOR_LOG_RATIO] for r in log_R for q in log_Q]
            )
            values = self.cost(grid, steps).reshape(len(log_R), len(log_Q))
            grid = grid.reshape(*values.shape, -1)
            places += [grid[at] for at in valleys(values, _STARTS)]
            if self.count_R and self.count_Q:
                grid, values = self._along_ratios(grid, values, steps)
                places += [grid[at] for at in valleys(values, _STARTS)]
        starts = np.array(places)
        if self._looks > 1:
            for i in range(self.count_R + self.count_Q):
                stage(f"stage {2 + i} of {self._looks + 2}, where to start")
                tried = np.repeat(starts[:, None, :], len(_DECADES), axis=1)
                tried[:, :, i] = _DECADES
                values = self.cost(tried.reshape(-1, starts.shape[1]), steps).reshape(len(starts), -1)
                starts = tried[range(len(starts)), values.argmin(axis=1)]
        return np.asarray(starts)

    def _along_ratios(self, grid: Array, values: Array, steps: int) -> tuple[Array, Array]:
        """Return for each ratio of Q to R where the cost is lowest, and the cost.

        The floor of a valley bends round where both noises count alike, and a grid that hits it here and misses it
        there shows hills that are none.
        """
        ratios = range(1 - values.shape[0], values.shape[1])
        lows = [np.diagonal(values, ratio).argmin() for ratio in ratios]
        lines = np.array([np.diagonal(grid, ratio)[:, low] for ratio, low in zip(ratios, lows, strict=True)])
        offsets = np.zeros((len(_FINER), grid.shape[-1]))
        offsets[:, :-2] = _FINER[:, None]
        tried = lines[:, None] + offsets
        found = self.cost(tried.reshape(-1, grid.shape[-1]), steps).reshape(len(lines), -1)
        rows, low = np.arange(len(lines)), np.clip(found.argmin(axis=1), 1, len(_FINER) - 2)
        # The vertex of the parabola through the lowest and its neighbours.
        before, here, after = (found[rows, low + shift] for shift in (-1, 0, 1))
        shift = np.clip(0.5 * (before - after) / np.maximum(before - 2 * here + after, 1e-9), -1.0, 1.0)
        lines = tried[rows, low]
        lines[:, :-2] += ((_FINER[1] - _FINER[0]) * shift)[:, None]
        return lines, here - 0.25 * (before - after) * shift
