"""Which outputs in a regressor are outliers, drawn: parameters that depend on no choice of them.

In A(q) y = B(q) u + C(q)/D(q) v a wild y(k) is in na + 1 rows of the regression, and no weight for one row mends that:
it leaves the pattern of h = A D/C in the residuals, where an outlier of v leaves one large residual. To take each
sample for one or the other leaves small outliers in the regressor, which bias A, and a covariance that takes the choice
for certain is too small. So all of it is drawn in turns, each given the rest (Gibbs sampling; McCulloch and Tsay,
Journal of Time Series Analysis 15, 1994):

* the free parameters, from the residuals of the output without its outliers, and R;
* whether each v is of the wider normal distribution;
* for each sample of y whether it is an outlier, and how large: from N(0, V), else 0; samples whose patterns have no
  residual in common at once, for given the others they know nothing of each other;
* how large all outliers are, and what is missing, jointly;
* the shares of both, V, and how much wider outliers of v are, with the weak priors of `Contaminated`.

From a start, to begin with, the parameters stay and v has no outliers: a few residuals that are large in a row are
explained by outliers of v as well as by one of y, which is likelier but far from that. The estimate is the mean of the
parameters, its covariance that within the draws and that between them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.linalg.blas import dtbsv
from scipy.linalg.lapack import dpbtrf, dpbtrs
from scipy.signal import lfilter
from scipy.special import expit, logit

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.correction.contaminated import CONTAMINATIONS, START, START_SAMPLES, Contaminated
from robust_filterpy.correction.spread import FAR, FEW
from robust_filterpy.identification.estimation.prediction_error import Limits
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.influence.regression import in_directions, mad_scale

#: So many draws of everything count, after so many that forget where they began. Where three samples in ten are
#: outliers, the mean of 200 is off by .3 standard deviations, that of 500 by .2; so many parts tell by how much.
DRAWS: Final = 300
FORGOTTEN: Final = 50
_PARTS: Final = 10
# A direction of the parameters that moves the residuals by less than this share of the others stays as it is.
_FLAT: Final = 1e-10
# The variance of a missing sample of an output of unit size.
_ANYWHERE: Final = 1e12
# A pattern is so long at the most, and ends where it is small.
_LONGEST: Final = 200
_SMALL: Final = 1e-3
# What an unknown sample may add to a residual that still shows the noise, as a share.
_LEAST_TOUCH: Final = 0.2
# If no wrong sample touches at least this share of the residuals, these show the noise.
_LEAST_CLEAR: Final = 0.1


class End(NamedTuple):
    """Where a search ended.

    Attributes
    ----------
    starts : tuple of str
        The starts that led here.
    p : ndarray, shape (n,)
        Free parameters.
    noise : Noise
        Noise of the residuals.
    y : ndarray, shape (N,)
        Output with wrong and missing samples interpolated, if it stands in the regressor.
    wrong : ndarray of bool, shape (N,)
        Which samples these are.
    rows : ndarray of bool, shape (N - first,)
        Which residuals count.
    residual : ndarray, shape (N - first,)
        Residuals of ``y``.
    converged : bool
        Whether the search ended by itself.
    P : ndarray, shape (n, n), or None
        Covariance of the parameters, where outliers were drawn.
    excess : float
        How much worse than the best end it is, in units of log-likelihood.
    """

    starts: tuple[str, ...]
    p: Array
    noise: Noise
    y: Array
    wrong: Any
    rows: Any
    residual: Array
    converged: bool
    P: Array | None = None
    excess: float = 0.0


def response(model: PolynomialModel, p: Array) -> Array:
    """Return h, the pattern of one unit more in an output, until it is small."""
    h = model.parts(p).pattern(min(_LONGEST, model.y.size))
    return h[: np.flatnonzero(np.abs(h) > _SMALL)[-1] + 1]


class _Wide(NamedTuple):
    """Outliers of one kind: their share, and their variance."""

    share: float
    variance: float

    def odds(self, precision: Array, pull: Array) -> Array:
        """Return log-odds of outliers where the rest says pull/precision with this precision."""
        known = 1.0 / (1.0 + precision * self.variance)
        return logit(self.share) + 0.5 * (np.log(known) + pull**2 * self.variance * known)

    def drawn(self, rng: Any, outliers: Array, ordinary: int, R: float) -> _Wide:
        """Return another one, from outliers and how many samples are none."""
        energy = np.minimum(outliers**2, FAR**2 * self.variance).sum() + START_SAMPLES * START.scale_ratio**2 * R
        share = rng.beta(START.contamination * FEW + outliers.size, (1.0 - START.contamination) * FEW + ordinary)
        return _Wide(share, max(energy / rng.chisquare(START_SAMPLES + outliers.size), FAR**2 * R))


class Draws(NamedTuple):
    """What was drawn, a row for each turn.

    Attributes
    ----------
    means, within : ndarray, shape (draws, n) and (draws, n, n)
        Mean and covariance of the free parameters given the rest.
    wrong, wide : ndarray of bool, shape (draws, N) and (draws, N - first)
        Which samples of y are outliers or missing, and which residuals are outliers of v.
    R, share, variance : ndarray, shape (draws,)
        Variance of the ordinary v, the share of its outliers, and their variance.
    """

    means: Array
    within: Array
    wrong: Any
    wide: Any
    R: Array
    share: Array
    variance: Array


class _Line(NamedTuple):
    """The normal distribution that derivatives of the residuals make of the free parameters.

    Attributes
    ----------
    effect, inverse : ndarray, shape (n, k) and (k, n)
        What a deviation in each direction does to the parameters, and the other way round.
    step : ndarray, shape (n,)
        To its mean.
    cost : float
        Sum of the squares of the residuals in units of their deviations.
    volume : float
        Log of the product of all deviations.
    """

    effect: Array
    inverse: Array
    step: Array
    cost: float
    volume: float


class Chain:
    """What is drawn."""

    def __init__(self, model: PolynomialModel, end: End, missing: Any, free: Any, limits: Limits | None) -> None:
        """Begin where a search ended, or with nothing but what is missing."""
        self.model, self.free, self.limits, self.rng = model, free, limits, np.random.default_rng(0)
        self.p, self.R, self.given, self.least = end.p, end.noise.R, end.noise.given, end.noise.least
        self.counts, self.wide, self.reach = model.conditioned, np.zeros(model.conditioned.size, dtype=bool), 1.0
        self.recording = np.repeat(np.arange(len(model.spans)), [part.stop - part.start for part in model.spans])
        # What of each sample is added to y, whether it is an outlier, and whether it may be one.
        self.correction, self.wrong = end.y - model.y, end.wrong.copy()
        self.possible, self.missing = ~missing & end.noise.has_outliers, missing
        self.of_y = self.of_v = _Wide(START.contamination, START.scale_ratio**2 * self.R)
        self._redraw_shares(end.residual)

    def draws(self, count: int, afresh: bool) -> Draws:
        """Draw everything so many times, after some turns that forget where it began; fewer where nothing is wrong."""
        turns: list[tuple[Any, ...]] = []
        for turn in range(FORGOTTEN * (1 + afresh) + count):
            turns.append(self._turn(afresh and turn < FORGOTTEN))
            if turn < FORGOTTEN * afresh + _PARTS:
                continue
            late = Draws(*(np.array(each) for each in zip(*turns[-_PARTS:], strict=True)))
            # As long as v has an outlier, it may be one of y yet.
            if not any((part.mean(axis=0) > 0.5).any() for part in (late.wrong, late.wide)):
                return late
        return Draws(*(np.array(each) for each in zip(*turns[-count:], strict=True)))

    def _turn(self, first: bool) -> tuple[Any, ...]:
        """Draw everything once."""
        model, moved = self.completed(), (self.p, np.zeros(2 * self.p.shape))
        if self.free.size and not first:
            moved = self._redraw_parameters(model)
        residual = model.residuals(self.p)
        ordinary = residual[self.counts & ~self.wide]
        if not self.given:
            self.R = max(float(ordinary @ ordinary) / self.rng.chisquare(ordinary.size), self.least)
        if not first and self.possible.any():
            narrow = 1.0 / self.R - 1.0 / self.of_v.variance
            odds = logit(self.of_v.share) + 0.5 * (np.log(self.R / self.of_v.variance) + narrow * residual**2)
            self.wide = self.counts & (self.rng.random(residual.size) < expit(odds))
        self._redraw_outliers(residual)
        self.redraw_sizes(residual, self.rng)
        self._redraw_shares(residual)
        return *moved, self.wrong, self.wide, self.R, *self.of_v

    def completed(self) -> PolynomialModel:
        """Return the model of the output without its outliers."""
        return self.model.with_output(self.model.y + self.correction)

    def settled(self, p: Array, draws: Draws) -> tuple[Array, Array]:
        """Return the output without what is an outlier in most draws, and its residuals."""
        self.p, self.wide, self.wrong = p, draws.wide.mean(axis=0) > 0.5, draws.wrong.mean(axis=0) > 0.5
        self.correction[~self.wrong] = 0.0
        residual = self.completed().residuals(p)
        self.redraw_sizes(residual)
        return self.completed().y, residual

    def _redraw_shares(self, residual: Array) -> None:
        """Draw how many outliers there are, and how wide they are."""
        outliers = self.correction[self.wrong & self.possible]
        self.of_y = self.of_y.drawn(self.rng, outliers, int(self.possible.sum()) - outliers.size, self.R)
        wide = residual[self.wide]
        self.of_v = self.of_v.drawn(self.rng, wide, int(self.counts.sum()) - wide.size, self.R)

    @property
    def precision(self) -> Array:
        """One over the variance of each residual."""
        return np.where(self.wide, 1.0 / self.of_v.variance, 1.0 / self.R) * self.counts

    def _redraw_parameters(self, model: PolynomialModel) -> tuple[Array, Array]:
        """Draw the parameters; where residuals are not linear in them, take the draw as often as it is as likely."""
        # Metropolis and Hastings' rule, from the normal distribution that derivatives make at either end. Part of the
        # way, where these do not hold all the way; what is drawn is the same.
        here, spread = self._line(model, self.p), np.sqrt(self.reach * (2.0 - self.reach))
        noise = self.rng.normal(size=here.effect.shape[1])
        change = self.reach * here.step + spread * (here.effect @ noise)
        mean, trial, P = self.p.copy(), self.p.copy(), np.zeros((self.p.size, self.p.size))
        mean[self.free] += here.step
        trial[self.free] += change
        P[np.ix_(self.free, self.free)] = here.effect @ here.effect.T
        taken = model.is_stable(trial) and (self.limits is None or np.array_equal(self.limits.inside(trial), trial))
        if taken and not model.is_linear:
            there = self._line(model, trial)
            back = there.inverse @ (-change - self.reach * there.step) / spread
            odds = here.cost - there.cost + np.square(noise).sum() - np.square(back).sum()
            taken = bool(2.0 * np.log(self.rng.random()) < odds + 2.0 * (here.volume - there.volume))
        self.p = trial if taken else self.p
        self.reach = min(1.25 * self.reach, 1.0) if taken else 0.5 * self.reach
        return mean, P

    def _line(self, model: PolynomialModel, p: Array) -> _Line:
        """Return what derivatives of the residuals say of the free parameters."""
        columns = np.column_stack((model.jacobian(p)[:, self.free], model.residuals(p)))
        triangle = np.asarray(np.linalg.qr(columns * np.sqrt(self.precision)[:, None], mode="r"))
        left, values, right, size = in_directions(triangle[:-1, :-1])
        shown = values > _FLAT * values[0]
        effect = right[shown].T / values[shown] / size[:, None]
        step = -effect @ (left[:, shown].T @ triangle[:-1, -1])
        volume = -float(np.log(values[shown]).sum() + np.log(size).sum())
        inverse = values[shown, None] * right[shown] * size
        return _Line(effect, inverse, step, float(np.sum(triangle[:, -1] ** 2)), volume)

    def _redraw_outliers(self, residual: Array) -> None:
        """Draw which samples are outliers, and how large; samples with no residual in common at once."""
        h, places, after = self._laid_out()
        blocks = -(-(places[-1] + 1) // h.size)
        left, precision, before = np.zeros((3, (blocks + 1) * h.size))
        wrong, possible = np.zeros((2, before.size), dtype=bool)
        left[after], precision[after], before[places] = residual, self.precision, self.correction
        possible[places] = self.possible
        correction = before.copy()
        for begin in self.rng.permutation(h.size):
            part, each = slice(begin, begin + blocks * h.size), slice(begin, begin + blocks * h.size, h.size)
            own, weights, old = left[part].reshape(-1, h.size), precision[part].reshape(-1, h.size), before[each]
            sure = weights @ h**2
            pull = sure * old - (weights * own) @ h
            wrong[each] = self.rng.random(old.size) < expit(self.of_y.odds(sure, pull))
            variance = 1.0 / (sure + 1.0 / self.of_y.variance)
            new = np.where(wrong[each], variance * pull + np.sqrt(variance) * self.rng.normal(size=old.size), 0.0)
            correction[each] = np.where(possible[each], new, old)
            own += (correction[each] - old)[:, None] * h
        self.correction, self.wrong = correction[places], self.missing | (wrong & possible)[places]
        residual[:] = left[after]

    def redraw_sizes(self, residual: Array, rng: Any = None) -> None:
        """Draw how large outliers are and what is missing, jointly normal given all else; or take their mean."""
        h, places, after = self._laid_out()
        left, precision = np.zeros((2, places[-1] + h.size))
        left[after], precision[after] = residual, self.precision
        at = places[self.wrong]
        if not at.size:
            return
        prior = 1.0 / np.where(self.missing[self.wrong], _ANYWHERE, self.of_y.variance)
        # What couples two of them less than a pattern apart: sums of precisions with h times itself, by delay.
        products = sliding_window_view(np.concatenate((h, np.zeros(h.size))), h.size)[:-1] * h
        coupled = sliding_window_view(precision, h.size)[at] @ products.T
        most = int((np.searchsorted(at, at + h.size) - np.arange(at.size)).max())
        band = np.zeros((most, at.size))
        for d in range(most):
            apart = at[d:] - at[: at.size - d]
            near = np.flatnonzero(apart < h.size)
            band[d, near] = coupled[near + d, apart[near]]
        band[0] += prior
        factor, failed = dpbtrf(band, lower=1)
        pull = sliding_window_view(precision * left, h.size)[at] @ h + prior * self.correction[self.wrong]
        change = -dpbtrs(factor, pull[:, None], lower=1)[0][:, 0]
        if rng is not None:
            change += dtbsv(most - 1, factor, rng.normal(size=at.size), lower=1, trans=1)
        if failed or not np.isfinite(change).all():
            return
        self.correction[self.wrong] += change
        moved = np.zeros(left.size)
        moved[at] = change
        residual += lfilter(h, [1.0], moved)[after]

    def _laid_out(self) -> tuple[Array, Any, Any]:
        """Return the pattern of a sample, and the places of samples and residuals, of recordings a pattern apart."""
        h = response(self.model, self.p)
        places = np.arange(self.wrong.size) + self.recording * h.size
        return h, places, places[self.model.first :]


def begun(model: PolynomialModel, p: Array, noise: Noise, missing: Any, name: str) -> End:
    """Return a start, with the noise that its residuals show."""
    rows = model.conditioned & ~missing[model.first :]
    residual = model.residuals(p)
    R = noise.R if noise.given else max(mad_scale(residual[rows]) ** 2, noise.least)
    return End((name,), p, replace(noise, R=R), model.y, missing, rows, residual, False)


def drawn(
    model: PolynomialModel, end: End, missing: Any, limits: Limits | None, count: int = DRAWS, afresh: bool = False,
    robust: bool = True,
) -> End | None:  # fmt: skip
    """Return where a search goes on to: the mean of what is drawn and its covariance; None if no outliers explain y."""
    free = np.arange(model.n)
    if limits is not None:
        pull = model.with_output(end.y).jacobian(end.p)[end.rows].T @ end.noise.psi(end.residual[end.rows])
        free = np.flatnonzero(~limits.held(end.p, 0.0 * pull if afresh else pull))
    stage(f"outliers are drawn, search from: {end.starts[0]}")
    chain = Chain(model, end, missing, free, limits)
    chain.possible &= robust
    draws = chain.draws(count, afresh)
    means, R = draws.means, float(draws.R.mean())
    p = means.mean(axis=0) if limits is None else limits.inside(means.mean(axis=0))
    if not model.is_stable(p) or draws.wrong[:, ~missing].mean() > 0.5:
        # What most samples have is no outlier but noise of the sensor, of which the model has none.
        return drawn(model, end, missing, limits, count, afresh, False) if robust and missing.any() else None
    share, ratio = np.clip(draws.share.mean(), *CONTAMINATIONS), np.sqrt(draws.variance.mean() / R)
    mixed = isinstance(end.noise.influence, Contaminated)
    influence = Contaminated(float(share), float(ratio)) if mixed else end.noise.influence
    # The draws have counted the parameters already.
    noise = replace(end.noise, influence=influence, R=R * (1.0 - free.size / model.conditioned.sum()))
    partial = means.reshape(_PARTS, -1, model.n).mean(axis=1)
    P = draws.within.mean(axis=0) + np.atleast_2d(np.cov(means.T)) + np.atleast_2d(np.cov(partial.T)) / _PARTS
    y, residual = chain.settled(p, draws)
    return End(end.starts, p, noise, y, chain.wrong, model.conditioned, residual, True, P)


class Cleaned(NamedTuple):
    """What is left of a recording whose wrong outputs are interpolated.

    Attributes
    ----------
    prepared : PolynomialModel
        With these outputs.
    residual : ndarray, shape (N,)
        0 in the first samples, whose regressors lie before the recording.
    clear : ndarray of bool, shape (N,)
        Which residuals no wrong output touches.
    """

    prepared: PolynomialModel
    residual: Array
    clear: Any


def cleaned(model: Model, y: Any, u: Any) -> Cleaned | None:
    """Return what a model with outputs in its regressor leaves of a recording, None for any other."""
    # What comes after an outlier tells whether it was the measurement's, and is interpolated, or the process's, and
    # acts on. A prediction, which must not look ahead, takes something between, and is wrong for a while in either
    # case.
    prepared, measured = model.prepared(y, u)
    if prepared.nf or not prepared.na:
        return None
    p, first = np.concatenate((model.theta, [model.offset])), prepared.first
    chain = Chain(prepared, begun(prepared, p, model.noise, ~measured, ""), ~measured, np.arange(0), None)
    output, residual = chain.settled(p, chain.draws(FORGOTTEN, True))
    reach = np.flatnonzero(np.abs(response(prepared, p)) > _LEAST_TOUCH)[-1] + 1
    clear = np.convolve(chain.wrong, np.ones(reach))[first : measured.size] < 0.5
    clear = clear if (clear & measured[first:]).sum() >= _LEAST_CLEAR * measured.sum() else measured[first:]
    before = np.zeros(first)
    return Cleaned(
        prepared.with_output(output), np.concatenate((before, residual)), np.concatenate((before > 0.0, clear))
    )
