"""From checked arrays to one model: units, starts, search, and what was found in the units of the recording.

Its covariance holds two standard deviations away, where the loss is not quadratic so far from its least. Where a zero
nearly cancels a pole, theta +- 2 std by linearization holds the truth in four recordings of five instead of nineteen of
twenty. So the loss is looked at along each principal axis of the covariance of C, D and F, with all that is linear in
the residuals (B, A, the constant, the start) at its best there: the profile of the likelihood. Where it rises more
slowly than a quadratic, the axis becomes as long as the farther of the two places at which it has risen by 2.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.signal import lfilter

from robust_filterpy._checks import Array
from robust_filterpy.identification.estimation.outliers import End, drawn
from robust_filterpy.identification.estimation.prediction_error import Limits, evidence, one_thread, sandwich
from robust_filterpy.identification.estimation.search import ends, searched
from robust_filterpy.identification.estimation.starts import require_informative
from robust_filterpy.identification.models.model import Ending, Model, filled_memory, resting_level
from robust_filterpy.identification.models.noise import Noise, least_variance, ordinary_fit, ordinary_samples
from robust_filterpy.identification.models.polynomial_model import PolynomialModel, spans_of
from robust_filterpy.identification.models.responses import principal_axes
from robust_filterpy.identification.models.signals import fingerprint, operating_point
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.influence.functions import Influence
from robust_filterpy.influence.regression import in_directions, size_of

# Two standard deviations away the loss has risen by 2, or is bent if it is off by more than this share of it.
_FAR: Final = 2.0
_BENT: Final = 0.2
# So many standard deviations are the most that an axis has, and it is found to two or three digits.
_FARTHEST: Final = 16.0
_HALVINGS: Final = 6
# Weights of the residuals and what is linear take turns.
_TURNS: Final = 2


def profiled(
    model: PolynomialModel, p: Array, noise: Noise, rows: Any, P: Array, held: Any, colour: float = 1.0
) -> tuple[Array, bool]:  # fmt: skip
    """Return the covariance of the free parameters, wider where the loss bends, and whether it does."""
    loss = _Loss.of(model, p, noise, rows, held, colour)
    places = np.flatnonzero(loss.bent)
    if not places.size:
        return P, False
    own = P[np.ix_(places, places)]
    axes, least = principal_axes(own), loss.at(p[places])
    reach = np.array([max(_reach(loss, p[places], sign * axis, least) for sign in (-1.0, 1.0)) for axis in axes])
    if (reach <= 1.0).all():
        return P, False
    longer = axes * np.maximum(reach, 1.0)[:, None]
    wider = longer.T @ longer
    # What is linear follows as the linearization says.
    follows = P[:, places] @ np.linalg.pinv(own)
    return P + follows @ (wider - own) @ follows.T, True


def _reach(loss: _Loss, center: Array, axis: Array, least: float) -> float:
    """Return where the loss along an axis has risen as a quadratic would have in two standard deviations, over that."""

    def rise(t: float) -> float:
        return (loss.at(center + t * axis) - least) / (0.5 * _FAR**2)

    low, high = 0.0, _FAR
    if abs(rise(_FAR) - 1.0) < _BENT:
        return 1.0
    while high < _FARTHEST and rise(high) < 1.0:
        low, high = high, 2.0 * high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rise(middle) < 1.0 else (low, middle)
    return 0.5 * (low + high) / _FAR


class _Loss(NamedTuple):
    """What the residuals say of C, D and F, all that is linear at its best."""

    model: PolynomialModel
    p: Array
    noise: Noise
    rows: Any
    weights: Array
    counted: float
    bent: Any
    linear: Any

    @classmethod
    def of(cls, model: PolynomialModel, p: Array, noise: Noise, rows: Any, held: Any, colour: float) -> _Loss:
        """Return it, of which as much counts as the sandwich says."""
        places, bent = model.structure.polynomials, np.zeros(model.n, dtype=bool)
        for place in (places.f, places.c, places.d):
            bent[place] = True
        residual = model.residuals(p)[rows]
        square = max(float(np.mean(noise.psi(residual) ** 2)), np.finfo(float).tiny)
        counted = noise.slope(residual) / square * (1.0 - model.n / residual.size) / colour**2
        return cls(model, p, noise, rows, noise.weights(residual), counted, bent & ~held, ~bent & ~held)

    def at(self, bent: Array) -> float:
        """Return the least loss for these C, D and F, infinite where they are not stable."""
        p = self.p.copy()
        p[self.bent] = bent
        if not self.model.is_stable(p):
            return np.inf
        residual, X = self.model.residuals(p)[self.rows], self.model.jacobian(p).T[self.linear][:, self.rows]
        size = np.linalg.norm(X, axis=1)
        X = X / np.where(size > 0.0, size, 1.0)[:, None]
        for turn in range(_TURNS):
            weighted = X * (self.noise.weights(residual) if turn else self.weights)
            square = weighted @ X.T + 1e-12 * np.eye(size.size)
            residual = residual - np.linalg.solve(square, weighted @ residual) @ X
        return self.counted * self.noise.cost(residual)


# Two ends as close in log-likelihood, and so far apart in output (percent, and twice what the noise explains), leave
# the model open.
_CLOSE: Final = 3.0
_APART: Final = 5.0

# A direction of theta that moves no residual by more than this share of the others is not determined, nor is a
# parameter of which it is more than this.
_FLAT: Final = 1e-10
_PART: Final = 0.1

# Residuals of a sensor that rounds are not smaller than this share of what its steps make of them: y has few values.
_EXACT: Final = 0.01

# In units of its scale, a larger output is as wild as this one; its loss would hide all others in rounding.
_LARGEST: Final = 1e10


class Problem(NamedTuple):
    """What is to be found, but for the output.

    Attributes
    ----------
    structure : Structure
        Which polynomials there are.
    u : ndarray, shape (N, n_inputs)
        Input, as measured.
    influence : Influence or None
        Loss; None: learned.
    offset : bool
        Whether there is a constant.
    R : float or None
        Variance of the noise, if it is known.
    dt : float or None
        Sampling period in s.
    moving : bool
        Whether something may have been in motion when the recording began.
    begins : tuple of int
        First sample of each recording, for several that follow each other.
    limits : Limits or None
        Where theta may be.
    draws : bool
        Whether outliers of a regressor are drawn.
    """

    structure: Structure
    u: Array
    influence: Influence | None
    offset: bool
    R: float | None
    dt: float | None
    moving: bool = True
    begins: tuple[int, ...] = (0,)
    limits: Limits | None = None
    draws: bool = True

    @property
    def spans(self) -> tuple[slice, ...]:
        """The samples of each recording."""
        return spans_of(self.begins, len(self.u))

    @property
    def rest(self) -> Array:
        """The operating point of the inputs."""
        moves = self.offset and not self.structure.takes_phi
        return operating_point(self.u) if moves else np.zeros(self.u.shape[1])

    @property
    def zero(self) -> Array:
        """Where inputs have their zero in the search: at rest, or in their mean where the constant alone changes."""
        return self.rest if self.structure.nf or self.structure.takes_phi or not self.offset else self.u.mean(axis=0)

    def residuals_of(self, y: Array, u: Array) -> PolynomialModel:
        """Return what gives the residuals of these signals."""
        return PolynomialModel(self.structure, y, u, self.offset, self.moving, self.begins)


class Estimated(NamedTuple):
    """A model, and where the search ended.

    Attributes
    ----------
    model : Model
        For the recording as it was measured.
    p : ndarray, shape (n,)
        Free parameters, of inputs from their zero.
    sizes : ndarray, shape (k,)
        Of the levels that were found with it.
    """

    model: Model
    p: Array
    sizes: Array


def near(ours: Structure, theta: Array, offset: float, theirs: Structure, u: Array) -> Array:
    """Return free parameters of a structure, inputs from their zero, that make it a model of another, or nearly."""
    own, places, p = ours.polynomials, theirs.polynomials, np.zeros(theirs.n_theta + 1 + theirs.nf)
    for part, place in ((own.a, places.a), (own.f, places.f), (own.c, places.c), (own.d, places.d)):
        p[place.start : place.start + part.stop - part.start] = theta[part]
    gain, zero = 0.0, Problem(theirs, u, None, True, None, None).zero
    for part, place, (nb, nk), (count, lag), at in zip(own.b, places.b, ours.inputs, theirs.inputs, zero, strict=True):
        for j in range(max(nk, lag), min(nk + nb, lag + count)):
            p[place.start + j - lag] = theta[part.start + j - nk]
        gain += at * theta[part].sum()
    p[theirs.n_theta] = offset + gain / (1.0 + theta[own.f].sum())
    return p


def estimated(problem: Problem, y: Array, columns: Array | None = None, begin: Array | None = None) -> Estimated:
    """Find the model of an output; its ``warning`` says what is doubtful."""
    structure, offset, variance = problem.structure, problem.offset, problem.R
    signal, missing = problem.u - problem.zero, np.isnan(y)
    units = Units.of(y[:, None], signal, problem.spans, offset)
    units = units._replace(y=np.where(units.y > 0.0, units.y, 1.0))
    unit = float(units.y[0])
    model = problem.residuals_of(np.nan_to_num(units.normal(y[:, None])[:, 0]), signal / units.u)
    _require_samples(problem, missing, model.first)
    require_informative(model, missing)
    with one_thread():
        given = problem.limits
        limits = None if given is None else given.times(1.0 / units.factor(model)[: structure.n_theta])
        R, least = None if variance is None else variance / unit**2, least_variance(y, unit)
        at = None if begin is None else units.forth(model, begin)
        ranked = ends(model, missing, problem.influence, R, limits, least, at)
        model, ranked = _with_levels(model, missing, ranked, columns, limits)
        best = _exact(ranked[0], least_variance(y, unit, in_steps=False))
        if best.P is not None and problem.draws:
            best = drawn(model, best, missing, limits) or best
    output = _output(model, ranked[0])
    endings = tuple(Ending(end.starts, end.excess, _apart(output, _output(model, end))) for end in ranked)
    # What the noise makes of the output of any model with so many parameters.
    unsure = 100.0 * np.sqrt(structure.n_theta * best.noise.R / best.rows.sum()) / np.std(output)
    doubt = _without_noise(model, best) or _doubt(best, endings, max(_APART, 2.0 * unsure))
    recorded = problem.residuals_of(best.y * unit + units.centre[:, 0], signal)
    recorded = recorded.with_output(recorded.y, columns)
    # Where an outlier stood in the regressor: what was measured, less what stands there now.
    replaced = np.where(best.wrong & ~missing, y - recorded.y, 0.0)
    p, held = units.back(model, best.p), np.zeros(model.n, dtype=bool)
    if given is not None and limits is not None:
        # Exactly as given, not as units have rounded it.
        p = given.inside(p)
        held = limits.held(best.p, model.jacobian(best.p)[best.rows].T @ best.noise.psi(best.residual[best.rows]))
        doubt = "; ".join(words for words in (doubt, _at_limits(structure, held, limits)) if words)
    P = None if best.P is None else best.P * np.outer(units.factor(model), units.factor(model))
    estimate = _as_model(problem, recorded, best._replace(p=p, P=P), unit, missing, replaced, held)
    estimate, split = replace(estimate, endings=endings, warning=doubt), p.size - recorded.columns.shape[1]
    if len(recorded.spans) == 1:
        return Estimated(estimate, p[:split], p[split:])
    each = (recorded.of(i, p) for i in range(len(problem.begins)))
    levels = np.array([resting_level(one.parts(q)) for one, q in each])
    apart = [np.full(y[part].size, level - levels[-1]) for part, level in zip(problem.spans, levels, strict=True)]
    known_again = tuple((fingerprint(y[part]), trend) for part, trend in zip(problem.spans, apart, strict=True))
    estimate = replace(estimate, levels=levels + (estimate.level - levels[-1]), trends=known_again)
    return Estimated(estimate, p[:split], p[split:])


def _with_levels(
    model: PolynomialModel, missing: Any, ranked: list[End], columns: Array | None, limits: Limits | None
) -> tuple[PolynomialModel, list[End]]:
    """Return the model and the ends of its search with the sizes of levels among the free parameters, from 0 on."""
    if columns is None:
        return model, ranked
    whole, sizes = model.with_output(model.y, columns), np.zeros(columns.shape[1])
    best, *others = [end._replace(p=np.concatenate((end.p, sizes))) for end in ranked]
    return whole, [searched(whole, best, missing, limits), *others]


class Units(NamedTuple):
    """Where outputs have their zero, shape (N, p), and how large each of them and each input is."""

    centre: Array
    y: Array
    u: Array
    begins: tuple[int, ...]

    @classmethod
    def of(cls, y: Array, u: Array, spans: tuple[slice, ...], offset: bool = True) -> Units:
        """Return the units of recordings, each with its own zero; an output that is always there has the size 0."""
        centre = np.zeros(y.shape)
        for part in spans if offset else ():
            for j, own in enumerate(y[part].T):
                if not np.isnan(own).all():
                    centre[part, j] = np.nanmedian(own)
        sizes = [size_of(own[~np.isnan(own)]) if not np.isnan(own).all() else 0.0 for own in (y - centre).T]
        rms = np.sqrt(np.mean(np.square(u), axis=0))
        return cls(centre, np.array(sizes), np.where(rms > 0.0, rms, 1.0), tuple(part.start for part in spans))

    def normal(self, y: Array) -> Array:
        """Return outputs from their centers in their scales."""
        return np.clip((y - self.centre) / self.y, -_LARGEST, _LARGEST)

    def levels(self) -> Array:
        """Return the centers of each recording, shape (k, p)."""
        return self.centre[list(self.begins)]

    def factor(self, model: PolynomialModel) -> Array:
        """Return what makes free parameters those of the recording as it was measured, but for its level."""
        factor = np.full(model.n, self.y[0])
        factor[: model.structure.n_theta] = 1.0
        for place, size in zip(model.structure.polynomials.b, self.u, strict=True):
            factor[place] = self.y[0] / size
        return factor

    def constants(self, model: PolynomialModel, p: Array) -> Array:
        """Return what the centers add to the free parameters."""
        more, n = np.zeros(p.size), model.structure.n_theta
        if model.offset:
            more[n : n + len(self.begins)] = self.levels()[:, 0] * (1.0 + p[model.structure.polynomials.a].sum())
        return more

    def back(self, model: PolynomialModel, p: Array) -> Array:
        """Return the free parameters for the recording as it was measured."""
        return p * self.factor(model) + self.constants(model, p)

    def forth(self, model: PolynomialModel, p: Array) -> Array:
        """Return the free parameters in these units for those of the recording as it was measured."""
        return (p - self.constants(model, p)) / self.factor(model)


def _as_model(
    problem: Problem, model: PolynomialModel, end: End, unit: float, missing: Any, replaced: Array, held: Any
) -> Model:  # fmt: skip
    """Return what was found, for the recording as it was measured, its outliers and gaps interpolated."""
    # The end's parameters are those of this recording, its noise is that of an output in the unit.
    structure, n, p, rows = model.structure, model.structure.n_theta, end.p, end.rows
    # Of several recordings the constant is that of the last.
    at, residual, y = n + len(model.pieces) - 1, model.residuals(p), model.levelled(p).y[model.first :]
    # One parameter more is one residual less to tell of the noise.
    samples = int(rows.sum())
    noise = end.noise.times(unit)
    jacobian, shown = model.jacobian(p)[rows], residual[rows]
    # What is held has no variance, and what the others then have.
    jacobian[:, held] = 0.0
    P, colour = sandwich(jacobian, shown, noise, n)
    P = np.where(held | held[:, None], 0.0, P if end.P is None else end.P * colour**2)
    bent = False
    if end.P is None:
        P, bent = profiled(model, p, noise, rows, P, held, colour)
    weights = np.full(missing.size, np.nan)
    weights[model.first :] = noise.weights(residual)
    weights[end.wrong] = 0.0
    weights[missing] = np.nan
    recorded, q, slope = _from_zero(*model.of(-1, p), problem.zero)
    offset, square, cross = 0.0, 0.0, np.zeros(n)
    if model.offset:
        offset, cross = float(q[n]), P[:n, at] - P[:n, :n] @ slope
        # Differences show nothing of the constant.
        square = float(P[at, at] if jacobian[:, at].any() else np.inf) - float(slope @ (P[:n, at] + cross))
    total = problem.R or noise.R * samples / (samples - model.n + held.sum())
    return Model(
        structure=structure, theta=p[:n], offset=offset, P=P[:n, :n], offset_std=float(np.sqrt(max(square, 0.0))),
        offset_covariance=cross, has_offset=model.offset, dt=problem.dt, operating_point=problem.rest,
        own_fit=ordinary_fit(y, y - residual, ordinary_samples(np.where(rows, residual, np.nan), y)),
        noise=_as_measured(replace(noise, R=total), residual, replaced[model.first :], ~missing[model.first :]),
        weights=weights, log_likelihood=noise.log_likelihood(residual[rows]), endings=(), warning="",
        memory=filled_memory(recorded, q), profiled=bent, colour=colour, evidence=evidence(noise, residual, rows),
    )  # fmt: skip


def _at_limits(structure: Structure, held: Any, limits: Limits) -> str:
    """Say which parameters ended at a limit, or nothing."""
    names = [name for name, at, fixed in zip(structure.names, held, limits.fixed, strict=False) if at and not fixed]
    if not names:
        return ""
    return f"{', '.join(names)} ended at a bound; standard deviations are those of a model in which they stay there"


def _require_samples(problem: Problem, missing: Any, first: int) -> None:
    """Raise if one of several recordings is too short to tell its own level and start."""
    least = first + (problem.structure.nf if problem.moving else 0) + problem.offset + 1
    for i, part in enumerate(problem.spans if len(problem.begins) > 1 else ()):
        measured = int((~missing[part]).sum())
        if measured < least:
            raise ValueError(
                f"y: expected at least {least} measured samples in each recording for {problem.structure}, got "
                f"{measured} in recording {i}; leave it out, or take a smaller structure"
            )


def _from_zero(model: PolynomialModel, p: Array, zero: Array) -> tuple[PolynomialModel, Array, Array]:
    """Return a recording with its inputs as measured, its free parameters, and what theta takes off the constant."""
    places, parts, n = model.structure.polynomials, model.parts(p), model.structure.n_theta
    slope, F = np.zeros(n), float(parts.f.sum())
    if not zero.any():
        return model, p, slope
    # What an input at that zero adds to the constant: gain = B(1)/F(1).
    for place, at in zip(places.b, zero.tolist(), strict=True):
        slope[place] = at / F
    total = float(slope @ p[:n])
    slope[places.f] = -total / F
    # In the first samples 1/F has not yet brought the input there.
    q = np.concatenate((p[:n], [p[n] - total], total * (np.cumsum(parts.f)[: model.nf] - F)))
    q[n + 1 : p.size] += p[n + 1 :]
    return PolynomialModel(model.structure, model.y, model.u + zero, True), q, slope


def _as_measured(noise: Noise, residual: Array, replaced: Array, measured: Any) -> Noise:
    """Return the noise that the prediction will meet: of y as it was measured, outliers and all."""
    if not replaced.any():
        return noise
    learnt = replace(noise, given=True).settled((residual + replaced)[measured])
    return replace(learnt, given=noise.given)


def _apart(best: Array, other: Array) -> float:
    """Return how far another output is from the best one, in percent of that one's variation."""
    with np.errstate(over="ignore", invalid="ignore"):
        difference = float(100.0 * np.std(other - best) / np.std(best))
    return difference if np.isfinite(difference) else np.inf


def _output(model: PolynomialModel, end: End) -> Array:
    """Return what a model makes of the inputs alone, or without any what it predicts."""
    if not model.inputs:
        return end.y[model.first :] - end.residual
    p = end.p.copy()
    p[model.structure.n_theta :] = 0.0
    return np.asarray(lfilter([1.0], model.parts(p).a, model.undisturbed(p)))


def _exact(best: End, least: float) -> End:
    """Return the end with the noise that it shows, if the recording has few values and all of them are explained."""
    left = best.residual[best.rows]
    if np.square(left).max() > _EXACT * best.noise.least:
        return best
    return best._replace(noise=replace(best.noise, least=least).settled(left))


def _without_noise(model: PolynomialModel, best: End) -> str:
    """Say which parameters a recording that the model explains to rounding does not tell, or nothing."""
    structure = model.structure
    if not best.noise.is_rounding:
        return ""
    jacobian = model.jacobian(best.p)[best.rows]
    _, values, directions, _ = in_directions(jacobian)
    free = np.abs(directions[values < _FLAT * values[0]]).max(axis=0, initial=0.0) > _PART
    places = np.flatnonzero((free & jacobian.any(axis=0))[: structure.n_theta])
    said = []
    if places.size:
        names = ", ".join(structure.names[i] for i in places)
        said.append(
            f"{names} are not determined by a recording without noise: what the polynomials have in common changes no "
            "output; take a smaller structure"
        )
    if structure.nc + structure.nd:
        said.append("y has no noise but rounding: the coefficients of C and D are its")
    return "; ".join(said)


def _doubt(best: End, endings: tuple[Ending, ...], apart: float) -> str:
    """Say what makes the estimate doubtful, or nothing."""
    for starts, excess, difference in endings[1:]:
        if excess < _CLOSE and difference > apart:
            return (
                f"two models explain the recording almost equally well (log-likelihoods {excess:.1f} apart), and their "
                f"outputs differ by {difference:.0f} %; a longer recording, a more exciting input or a smaller "
                f"structure would decide. The other was found from: {', '.join(starts)}"
            )
    if not (best.converged or best.noise.is_rounding):
        return "the search did not settle; the structure may have more parameters than the recording tells of"
    return ""
