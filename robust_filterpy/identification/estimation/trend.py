"""Steps and ramps of an output: what its inputs do not explain, but lasts.

A wrong level bends the dynamics before it shows in their residual. So the output without a level comes from a model
that no level disturbs: a long impulse response by robust regression, or a model of the differences. In what is left of
y the step or ramp with the largest score is added, with what a slow input could do, until there are four. Those stay
without which the residuals, with the color that they have then (`colour`), are less likely by 3 log N each, and which
are larger than a step of the sensor.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from robust_filterpy._checks import Array
from robust_filterpy.correction.contaminated import START
from robust_filterpy.identification.estimation.prediction_error import evidence
from robust_filterpy.identification.estimation.starts import robust_regression
from robust_filterpy.identification.models.noise import Noise
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
# Means of so many samples of an input are what a plant makes of it where it is slow.
_SLOW: Final = (1, 4, 16, 64)


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
    size: float
    evidence: float

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

    @property
    def times(self) -> list[tuple[str, int]]:
        """Kind and time of each break."""
        return [(one.kind, one.time) for one in self.breaks]


def impulse_output(y: Array, u: Array) -> Array:
    """Return the part of the output that a robust long impulse response explains, without the constant, shape (N,)."""
    lags = max(min(LAGS_OF_IMPULSES, y.size // (8 * u.shape[1])), 2)
    columns = [np.concatenate((np.full(j, c[0]), c[: c.size - j])) - c.mean() for c in u.T for j in range(lags)]
    X, measured = np.column_stack((*columns, np.ones(y.size))), ~np.isnan(y)
    level, before = Trend(np.zeros(y.size), ()), None
    output = np.zeros(y.size)
    for _ in range(_MOST_BREAKS):
        theta = robust_regression(X[measured], (y - level.values)[measured])
        output = X[:, :-1] @ theta[:-1]
        level = piecewise_level(y - output, u)
        if not level.breaks or level.times == before:
            break
        before = level.times
    return output


def piecewise_level(r: Array, u: Array, line: bool = False) -> Trend:
    """Find the steps and ramps of a signal that is noise otherwise."""
    N = r.size
    if line:
        fit = _Fit.of(r, ~np.isnan(r), u, [Break("ramp", 0, 0.0, 0.0)])
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
        candidates = [
            Break(kind, int(at[score.argmax()]), 0.0, 0.0) for (kind, at), score in zip(places, scores, strict=True)
        ]
        tried = [_Fit.of(r, rows, u, [*fit.breaks, one]) for one in candidates]
        least = min(one.scale for one in tried)
        fit = min(tried, key=lambda one: float(_loss(one.residual[rows] / least).sum()))
        if fit.breaks[-1].kind == "step":
            moved = fit.breaks[-1]._replace(time=int(times[fit.change()[times].argmin()]))
            fit = _Fit.of(r, rows, u, [*fit.breaks[:-1], moved])
    steps = resolution(r[rows])
    while fit.breaks:
        count = len(fit.breaks)
        small = np.ptp(fit.X[:, -count:], axis=0) * np.abs(fit.theta[-count:]) <= steps
        without = [fit.without(i, r, u) for i in range(count)]
        without = [one if few else one.moved(r, u, times) for one, few in zip(without, small, strict=True)]
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
        slow = [uniform_filter1d(u, w, axis=0, mode="nearest", origin=(w - 1) // 2) for w in _SLOW if 8 * w < r.size]
        X = np.column_stack((np.ones(r.size), *slow, *(one.column(r.size) for one in breaks)))
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

    def without(self, i: int, r: Array, u: Array) -> _Fit:
        """Return the regression without a break."""
        return _Fit.of(r, self.rows, u, [*self.breaks[:i], *self.breaks[i + 1 :]])

    def moved(self, r: Array, u: Array, times: Any) -> _Fit:
        """Return the regression with each ramp where it leaves least, given the others."""
        best, places = self, np.concatenate(([0], times))
        for i, one in enumerate(self.breaks):
            if one.kind == "ramp":
                # Far from the least loss a score tells the place of a ramp roughly: most begin with the recording.
                for at in (0, int(places[best.without(i, r, u).scores("ramp", places).argmax()])):
                    moved = [*best.breaks[:i], one._replace(time=at), *best.breaks[i + 1 :]]
                    best = min(best, _Fit.of(r, self.rows, u, moved), key=lambda fit: fit.scale)
        return best

    def change(self) -> Array:
        """Return what the loss would change by, were the last step at each sample."""
        after = (self.residual + self.X[:, -1] * self.theta[-1]) / self.scale
        before = after + self.theta[-1] / self.scale
        gain = np.where(self.rows, _loss(before) - _loss(after), 0.0)
        return np.concatenate(([0.0], np.cumsum(gain)))

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


def _loss(e: Array) -> Array:
    """Return Huber's rho."""
    size = np.abs(e)
    return np.where(size < _K, 0.5 * size * size, _K * size - 0.5 * _K * _K)
