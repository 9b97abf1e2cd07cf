"""Which samples are outliers, drawn: parameters that depend on no choice of them, and what this leaves open.

A search takes each sample for ordinary or for an outlier. Small outliers then stay in the regressor and bias A, large
ordinary samples do not count, and a covariance that takes the choice for certain is too small. Here all of it is drawn
in turns, each given the rest (Gibbs sampling; McCulloch and Tsay, Journal of Time Series Analysis 15, 1994):

* the free parameters, from the residuals of the output without its outliers, and R;
* whether each v is of the wider normal distribution;
* for each sample of y whether it is an outlier, and how large: from N(0, V), else 0;
* the shares of both, V, and how much wider outliers of v are, with the weak priors of `Contaminated`.

Samples whose patterns have no residual in common are drawn at once: given the others they know nothing of each other.
The estimate is the mean of the parameters, its covariance that within the draws and that between them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import expit, logit

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.correction.contaminated import CONTAMINATIONS, START, START_SAMPLES, Contaminated
from robust_filterpy.correction.spread import FAR, FEW
from robust_filterpy.identification.estimation.missing import CompletedModel, response
from robust_filterpy.identification.estimation.prediction_error import Limits
from robust_filterpy.identification.estimation.search import End
from robust_filterpy.identification.estimation.starts import in_directions
from robust_filterpy.identification.models.polynomial_model import PolynomialModel

# So many draws of everything count, after so many that forget where the search ended. Where three samples in ten are
# outliers, the mean of 200 is off by .3 standard deviations, that of 500 by .2; so many parts tell by how much.
_DRAWS: Final = 300
_FORGOTTEN: Final = 50
_PARTS: Final = 10
# A direction of the parameters that moves the residuals by less than this share of the others stays as it is.
_FLAT: Final = 1e-10
# The variance of a missing sample of an output of unit size.
_ANYWHERE: Final = 1e12


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


class _Chain:
    """What is drawn; samples and residuals of all recordings in one row, apart by as much as a pattern is long."""

    def __init__(self, model: PolynomialModel, end: End, missing: Any, free: Any, inside: Callable[..., Array]) -> None:
        """Begin where a search ended."""
        self.model, self.free, self.inside, self.rng, self.p = model, free, inside, np.random.default_rng(0), end.p
        self.R, self.given, self.least = end.noise.R, end.noise.given, end.noise.least
        self.length, self.reach = response(model, end.p).size, 1.0
        self.counts = model.conditioned
        space = [np.arange(part.start, part.stop) + i * self.length for i, part in enumerate(model.spans)]
        self.places = np.concatenate(space)
        self.blocks = -(-(self.places[-1] + 1) // self.length)
        whole = (self.blocks + 1) * self.length
        # What of each sample is added to y, whether it is an outlier, and whether it may be one.
        self.correction, (self.wrong, self.possible, self.missing) = np.zeros(whole), np.zeros((3, whole), dtype=bool)
        self.wrong[self.places], self.possible[self.places] = end.outliers.wrong, ~missing
        self.missing[self.places] = missing
        self.correction[self.places] = end.y - model.y
        self.wide = ~end.outliers.counts & self.counts
        self.of_y = _Wide(START.contamination, START.scale_ratio**2 * self.R)
        self.of_v = self.of_y
        self._redraw_shares(end.residual)

    def turn(self) -> tuple[Array, Array]:
        """Draw everything once; return the mean and the covariance of the parameters given the rest."""
        model = self.model.with_output(self.model.y + self.correction[self.places])
        moved, P = self._redraw_parameters(model)
        residual = model.residuals(self.p)
        ordinary = residual[self.counts & ~self.wide]
        if not self.given:
            self.R = max(float(ordinary @ ordinary) / self.rng.chisquare(ordinary.size), self.least)
        narrow = 1.0 / self.R - 1.0 / self.of_v.variance
        odds = logit(self.of_v.share) + 0.5 * (np.log(self.R / self.of_v.variance) + narrow * residual**2)
        self.wide = self.counts & (self.rng.random(residual.size) < expit(odds))
        self._redraw_outliers(residual)
        self._redraw_shares(residual)
        return moved, P

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
        residual, J, root = model.residuals(self.p), model.jacobian(self.p)[:, self.free], np.sqrt(self.precision)
        whole = np.asarray(np.linalg.qr(np.column_stack((J, residual)) * root[:, None], mode="r"))
        triangle, target = whole[:-1, :-1], whole[:-1, -1]
        left, values, right, size = in_directions(triangle)
        shown = values > _FLAT * values[0]
        effect = right[shown].T / values[shown] / size[:, None]
        step = -effect @ (left[:, shown].T @ target)
        # Part of the way, where derivatives do not hold all the way; what is drawn is the same.
        spread = np.sqrt(self.reach * (2.0 - self.reach))
        change = self.reach * step + spread * (effect @ self.rng.normal(size=effect.shape[1]))
        mean, trial, P = self.p.copy(), self.p.copy(), np.zeros((self.p.size, self.p.size))
        mean[self.free] += step
        trial[self.free] += change
        P[np.ix_(self.free, self.free)] = effect @ effect.T
        taken = False
        if model.is_stable(trial):
            rise = np.sum((root * model.residuals(trial)) ** 2) - np.sum((root * residual) ** 2)
            expected = np.sum((triangle @ change + target) ** 2) - target @ target
            trial = self.inside(trial)
            taken = bool(np.log(self.rng.random()) < 0.5 * (expected - rise))
        self.p = trial if taken else self.p
        self.reach = min(1.25 * self.reach, 1.0) if taken else 0.5 * self.reach
        return mean, P

    def _redraw_outliers(self, residual: Array) -> None:
        """Draw which samples are outliers, and how large; samples with no residual in common at once."""
        length, h = self.length, np.zeros(self.length)
        own = response(self.model, self.p)[:length]
        h[: own.size] = own
        left, precision = np.zeros(self.wrong.size), np.zeros(self.wrong.size)
        after = self.places[self.model.first :]
        left[after], precision[after] = residual, self.precision
        for begin in self.rng.permutation(length):
            part, each = slice(begin, begin + self.blocks * length), slice(begin, begin + self.blocks * length, length)
            own, weights = left[part].reshape(-1, length), precision[part].reshape(-1, length)
            old, missing = self.correction[each], self.missing[each]
            sure = weights @ h**2
            pull = sure * old - (weights * own) @ h
            prior = np.where(missing, _ANYWHERE, self.of_y.variance)
            odds = np.where(missing, np.inf, np.where(self.possible[each], self.of_y.odds(sure, pull), -np.inf))
            wrong = self.rng.random(old.size) < expit(odds)
            variance = 1.0 / (sure + 1.0 / prior)
            new = np.where(wrong, variance * pull + np.sqrt(variance) * self.rng.normal(size=old.size), 0.0)
            own += (new - old)[:, None] * h
            self.correction[each], self.wrong[each] = new, wrong
        residual[:] = left[after]


def drawn(model: PolynomialModel, end: End, missing: Any, limits: Limits | None) -> End:
    """Return the end of a search with the mean of what is drawn, and with the covariance of its parameters."""
    found = end.outliers.wrong & ~missing & end.noise.has_outliers
    if not found.any() or end.noise.is_rounding or response(model, end.p).size == 1:
        return end
    stage(f"{int(found.sum())} outliers, drawn again and again")
    pull = model.jacobian(end.p)[end.rows].T @ end.noise.psi(end.residual[end.rows])
    free = np.arange(model.n) if limits is None else np.flatnonzero(~limits.held(end.p, pull))
    if not free.size:
        return end
    chain = _Chain(model, end, missing, free, (lambda p: p) if limits is None else limits.inside)
    means, P, wrong, wide, R, of_v = [], np.zeros((model.n, model.n)), np.zeros(missing.size), 0.0, 0.0, np.zeros(2)
    for turn in range(_FORGOTTEN + _DRAWS):
        mean, within = chain.turn()
        if turn >= _FORGOTTEN:
            means.append(mean)
            P, R, of_v = P + within / _DRAWS, R + chain.R / _DRAWS, of_v + np.array(chain.of_v) / _DRAWS
            wrong, wide = wrong + chain.wrong[chain.places] / _DRAWS, wide + chain.wide / _DRAWS
    p = chain.inside(np.mean(means, axis=0))
    if not model.is_stable(p) or wrong[~missing].mean() > CONTAMINATIONS[1]:
        # What most samples have is no outlier but noise of the sensor, of which the model has none.
        return end
    outliers = end.outliers._replace(wrong=missing | (wrong > 0.5), counts=wide <= 0.5)
    mixture = Contaminated(float(np.clip(of_v[0], *CONTAMINATIONS)), float(np.sqrt(of_v[1] / R)))
    rows = model.conditioned
    # The draws have counted the parameters already.
    influence = mixture if isinstance(end.noise.influence, Contaminated) else end.noise.influence
    noise = replace(end.noise, influence=influence, R=R * (1.0 - free.size / rows.sum()))
    full = CompletedModel(model, outliers.wrong, np.where(outliers.counts, 1.0, 1.0 / mixture.scale_ratio**2))
    partial = np.mean(np.reshape(means, (_PARTS, -1, model.n)), axis=1)
    P += np.atleast_2d(np.cov(np.transpose(means))) + np.atleast_2d(np.cov(partial.T)) / _PARTS
    return end._replace(
        p=p, P=P, noise=noise, y=full.output(p), outliers=outliers,
        rows=rows, residual=full.residuals(p), converged=True,
    )  # fmt: skip
