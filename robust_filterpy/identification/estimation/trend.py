"""Steps and ramps of an output: what its inputs do not explain, but lasts.

A wrong level bends the dynamics before it shows in their residual. So the output without a level comes from a model
that no level disturbs: a long impulse response by robust regression, or a model of the differences. What is left of y
has a piecewise level: the step or ramp with the largest gain of the robust score (a score test at every time) is added
until twice the drop of Huber's loss, over the long-run variance of its score, stays below 6 log N; earlier breaks that
a later one has made needless go. Slow noise has a large long-run variance, from the differences of neighbouring block
means, which a few steps do not change.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.estimation.starts import robust_regression
from robust_filterpy.influence.regression import mad_scale

__all__ = ["PRICE", "Break", "Trend", "impulse_output", "piecewise_level"]

#: A break must explain so many times log N, in units of twice the log-likelihood.
PRICE: Final = 6.0
_MOST_BREAKS: Final = 4
# Huber's threshold, in robust standard deviations.
_K: Final = 1.345
# Samples of a block mean; as many blocks at the least tell a long-run variance.
_BLOCK: Final = 25
_LEAST_BLOCKS: Final = 8
# A break is not looked for nearer to an end than this share of the recording, and so many samples.
_EDGE: Final = 0.02
_LEAST_EDGE: Final = 10
# What was in motion in the beginning looks like a step: so much is left out.
_BEGINNING: Final = 0.03
_LAGS: Final = 60
_REFINEMENTS: Final = 2


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


class Trend(NamedTuple):
    """What an output has beside what its inputs do.

    Attributes
    ----------
    values : ndarray, shape (N,)
        0 in the last sample: the level of the model is that at the end of the recording.
    breaks : tuple of Break
        Sorted by time.
    """

    values: Array
    breaks: tuple[Break, ...]


def impulse_output(y: Array, u: Array) -> Array:
    """Return the part of the output that a robust long impulse response explains, without the constant, shape (N,).

    Parameters
    ----------
    y : ndarray, shape (N,)
        Output, NaN where it is missing; levels in it are taken off in a few rounds.
    u : ndarray, shape (N, n_inputs)
        Input.

    Returns
    -------
    ndarray, shape (N,)
    """
    lags = max(min(_LAGS, y.size // (8 * u.shape[1])), 2)
    columns = [np.concatenate((np.full(j, c[0]), c[: c.size - j])) - c.mean() for c in u.T for j in range(lags)]
    X, known = np.column_stack((*columns, np.ones(y.size))), ~np.isnan(y)
    level, before = np.zeros(y.size), None
    output = np.zeros(y.size)
    for _ in range(_MOST_BREAKS):
        theta = robust_regression(X[known], (y - level)[known])
        output = X[:, :-1] @ theta[:-1]
        found = piecewise_level(y - output)
        times = [(b.kind, b.time) for b in found.breaks]
        if not times or times == before:
            break
        level, before = found.values, times
    return output


def piecewise_level(r: Array, line: bool = False) -> Trend:
    """Find the steps and ramps of a signal that is noise otherwise.

    Parameters
    ----------
    r : ndarray, shape (N,)
        Signal, NaN where it is missing.
    line : bool, default False
        One ramp from the beginning to the end, whatever the evidence, and nothing else.

    Returns
    -------
    Trend
    """
    skipped = min(int(_BEGINNING * r.size) + _LEAST_EDGE, r.size // 4)
    late = r[skipped:]
    N, t = late.size, np.arange(late.size, dtype=float)
    columns, found = [np.ones(N)], []
    fit = _Fit.of(np.ones((N, 1)), late)
    edge = max(_LEAST_EDGE, int(_EDGE * N))
    times = np.arange(edge, N - edge)
    for _ in range(1 if line else _MOST_BREAKS):
        tried = []
        for kind in ("ramp",) if line else ("step", "ramp"):
            # A ramp may begin with the recording.
            places = np.concatenate(([0], times)) if kind == "ramp" else times
            tau = 0 if line else int(places[_gains(fit, kind, places).argmax()])
            columns_now = [*columns, _column(kind, t, tau)]
            tried.append((_Fit.of(np.column_stack(columns_now), late), kind, tau, columns_now))
        least = min(one[0].scale for one in tried)
        new, kind, tau, columns_now = min(tried, key=lambda one: one[0].cost_at(least))
        if kind == "step":
            new, tau, columns_now = _refined(new, tau, columns, times, late)
        if not line and new.evidence_against(fit) < PRICE * np.log(N):
            break
        fit, columns = new, columns_now
        found.append((kind, tau))
        fit, columns, found = _pruned(fit, columns, found, late)
    values = np.column_stack(columns)[:, 1:] @ fit.theta[1:]
    evidence = [fit.evidence_against(fit.without(i, late)) for i in range(1, len(columns))]
    return _from_sample(values, found, fit.theta[1:], evidence, skipped)


def _pruned(fit: _Fit, columns: list[Array], found: list[Any], r: Array) -> tuple[_Fit, list[Array], list[Any]]:
    """Leave out earlier breaks that later ones have made needless."""
    while len(found) > 1:
        shorter = [fit.without(i + 1, r) for i in range(len(found))]
        evidence = [fit.evidence_against(one) for one in shorter]
        least = int(np.argmin(evidence))
        if evidence[least] >= PRICE * np.log(r.size):
            break
        fit, columns = shorter[least], columns[: least + 1] + columns[least + 2 :]
        found = found[:least] + found[least + 1 :]
    return fit, columns, found


def _from_sample(
    values: Array, found: list[tuple[str, int]], sizes: Array, evidence: list[float], skipped: int
) -> Trend:
    """Return the trend of the whole recording, from that without its beginning."""
    begins = any(kind == "ramp" and tau == 0 for kind, tau in found)
    slope = values[1] - values[0] if begins else 0.0
    before = values[0] - slope * np.arange(skipped, 0, -1)
    breaks = [
        Break(kind, 0 if kind == "ramp" and tau == 0 else tau + skipped, float(size), float(shown))
        for (kind, tau), size, shown in zip(found, sizes, evidence, strict=True)
    ]
    whole = np.concatenate((before, values))
    return Trend(whole - whole[-1], tuple(sorted(breaks, key=lambda b: b.time)))


class _Fit(NamedTuple):
    """Huber's regression of a signal on levels."""

    X: Array
    theta: Array
    residual: Array
    scale: float

    @classmethod
    def of(cls, X: Array, r: Array) -> _Fit:
        """Return the regression; columns as they come, of moderate number."""
        known = ~np.isnan(r)
        size = np.abs(X).max(axis=0)
        theta = robust_regression(X[known] / size, r[known], 30) / size
        residual = r - X @ theta
        return cls(X, theta, residual, max(mad_scale(residual[known]), np.finfo(float).tiny))

    def without(self, i: int, r: Array) -> _Fit:
        """Return the regression without a column."""
        return _Fit.of(np.delete(self.X, i, axis=1), r)

    def evidence_against(self, shorter: _Fit) -> float:
        """Return how much likelier this regression is than one with fewer columns: chi-squared for given columns."""
        return 2.0 * (shorter.cost_at(self.scale) - self.cost) * self.share / self.long_run_variance

    @property
    def score(self) -> Array:
        """psi of the residual, 0 where it is missing."""
        return np.clip(np.nan_to_num(self.residual / self.scale), -_K, _K)

    @property
    def inside(self) -> Any:
        """Which samples have a residual that Huber's loss takes for ordinary."""
        return np.abs(np.nan_to_num(self.residual / self.scale, nan=np.inf)) < _K

    @property
    def share(self) -> float:
        """The share of these."""
        return float(self.inside.mean())

    @property
    def cost(self) -> float:
        """Huber's loss."""
        return self.cost_at(self.scale)

    def cost_at(self, scale: float) -> float:
        """Return Huber's loss of the residual in units of another scale."""
        return float(_loss(self.residual / scale).sum())

    @property
    def long_run_variance(self) -> float:
        """Variance of a mean of the score, times the number of samples; blind to a few steps."""
        psi, blocks = self.score, self.residual.size // _BLOCK
        variance = float(np.var(psi))
        if blocks <= _LEAST_BLOCKS:
            return variance
        means = psi[: blocks * _BLOCK].reshape(blocks, _BLOCK).mean(axis=1)
        return max(_BLOCK * mad_scale(np.diff(means)) ** 2 / 2.0, variance)


def _loss(e: Array) -> Array:
    """Return Huber's rho, 0 where e is missing."""
    size = np.abs(np.nan_to_num(e))
    return np.where(size < _K, 0.5 * size * size, _K * size - 0.5 * _K * _K)


def _column(kind: str, t: Array, tau: int) -> Array:
    """Return a step of 1, or a ramp of 1 a sample."""
    return (t >= tau).astype(float) if kind == "step" else np.maximum(t - tau, 0.0)


def _gains(fit: _Fit, kind: str, places: Any) -> Array:
    """Return the score statistic of one break more at each place: (c'psi)^2/(c'Wc - c'WX (X'WX)^-1 X'Wc)."""
    # A sample that Huber's loss clips tells little of a level, not nothing.
    W, t = np.maximum(fit.inside.astype(float), 0.05), np.arange(fit.residual.size) / fit.residual.size
    WX = fit.X * W[:, None]
    after = lambda v: np.cumsum(v[::-1], axis=0)[::-1][places]  # noqa: E731
    pull, square, cross = after(fit.score), after(W), after(WX)
    if kind == "ramp":
        at = places / fit.residual.size
        pull = after(t * fit.score) - at * pull
        square = after(t * t * W) - 2.0 * at * after(t * W) + at * at * square
        cross = after(t[:, None] * WX) - at[:, None] * cross
    inverse = np.linalg.pinv(fit.X.T @ WX)
    left = square - np.einsum("ij,jk,ik->i", cross, inverse, cross)
    return np.where(left > 1e-3 * square, pull**2 / np.maximum(left, 1e-9), 0.0)


def _refined(fit: _Fit, tau: int, columns: list[Array], times: Any, r: Array) -> tuple[_Fit, int, list[Array]]:
    """Move the last step to where the loss is least, given its size."""
    t = np.arange(r.size, dtype=float)
    columns_now = [*columns, _column("step", t, tau)]
    for _ in range(_REFINEMENTS):
        without = (r - np.column_stack(columns) @ fit.theta[:-1]) / fit.scale
        change = np.cumsum(_loss(without) - _loss(without - fit.theta[-1] / fit.scale))
        tau = int(times[np.concatenate(([0.0], change))[times].argmin()])
        columns_now = [*columns, _column("step", t, tau)]
        fit = _Fit.of(np.column_stack(columns_now), r)
    return fit, tau, columns_now
