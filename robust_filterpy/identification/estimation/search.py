"""From several starts to one estimate: the search from each, and which end to believe."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import compress
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.signal import lfilter

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.correction.contaminated import START, Contaminated
from robust_filterpy.identification.estimation.missing import (
    CompletedModel,
    Outliers,
    Unknowns,
    found_outliers,
    response,
    touched,
)
from robust_filterpy.identification.estimation.prediction_error import Limits, Optimum, minimised
from robust_filterpy.identification.estimation.starts import (
    Start,
    autocorrelation_start,
    bounded_mean,
    disturbance_start,
    output_error_starts,
    regression_start,
    require_informative,
    whitened,
)
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.structures import OutputError
from robust_filterpy.influence.functions import Huber, Influence
from robust_filterpy.influence.regression import mad_scale

# An outlier in the regressor changes the residuals, and these show which samples are outliers.
# Where few of them are estimated yet, parameters that follow the others go astray: the first steps are few.
# Residuals may move by less than this share between two turns of weights and parameters.
_SETTLED: Final = 1e-5
# Parameters within so many standard deviations of the optimum tell which samples are outliers.
_NEAR: Final = 0.1
# Ends whose residuals differ by less than this share of their size are the same.
_SAME: Final = 1e-3
# Residuals for each parameter that must show the noise.
_SHOWN: Final = 5

# A recording with measured outputs in its regressor, where each cleaning takes its time, is searched in so many samples
# of its middle; ends so much less likely there are not followed in the whole.
_MOST_SEARCHED: Final = 4000
_HOPELESS: Final = 30.0
# Residuals that differ by no more of their scale show the same outliers, and lead to the same end.
_UNMOVED: Final = 0.2


class _Effort(NamedTuple):
    """How often outliers are looked for, steps of the parameters in between, turns of weights and steps at the end."""

    # Where no outlier is in a regressor, a step of so many standard deviations ends the search.

    cleanings: int
    steps: int
    turns: int
    near: float = 0.0


_ROUGH: Final = _Effort(4, 2, 1, _NEAR)
_FULL: Final = _Effort(10, 10, 10)
# From where the search in a part of the recording ended.
_AGAIN: Final = _Effort(1, 10, 10)


class End(NamedTuple):
    """Where the search ended.

    Attributes
    ----------
    starts : tuple of str
        The starts that led here.
    p : ndarray, shape (n,)
        Free parameters.
    noise : Noise
        Noise of the residuals.
    y : ndarray, shape (N,)
        Output with wrong and missing samples interpolated.
    outliers : Outliers
        Which samples these are.
    rows : ndarray of bool, shape (N - first,)
        Which residuals count.
    residual : ndarray, shape (N - first,)
        Residuals of ``y``.
    converged : bool
        Whether the search ended by itself.
    P : ndarray, shape (n, n), or None
        Covariance of the parameters, where outliers were drawn.
    """

    starts: tuple[str, ...]
    p: Array
    noise: Noise
    y: Array
    outliers: Outliers
    rows: Any
    residual: Array
    converged: bool
    P: Array | None = None


class Ranked(NamedTuple):
    """An end, and how much worse than the best it is, in units of log-likelihood."""

    end: End
    excess: float


def ends(
    model: PolynomialModel, missing: Any, influence: Influence | None, R: float | None, limits: Limits | None,
    least: float, begin: Array | None = None,
) -> list[Ranked]:  # fmt: skip
    """Search from every start."""
    loss = START if influence is None else influence
    noise = Noise(Huber() if influence is None else influence, 1.0 if R is None else R, R is not None, least)

    if begin is not None:
        # A start that is near the end shows how large the noise is; a rough search would lead away from it.
        shown = model.residuals(begin)[_counting(model, True, missing)]
        near = replace(noise, influence=loss, R=noise.R if noise.given else max(mad_scale(shown) ** 2, least))
        end = _searched(model, begin, near, missing, ("one start",), _FULL, limits)
        return _best_first(model, missing, [end], limits)
    inner, part = _middle(model, missing)
    if inner is not None:
        # From every start in the middle of a long recording, and from what is found there in all of it.
        chosen: list[End] = []
        for end, excess in ends(inner, missing[part], influence, R, limits, least):
            apart = [mad_scale(end.residual - other.residual) > _UNMOVED * other.noise.R**0.5 for other in chosen]
            if excess < _HOPELESS and all(apart):
                chosen.append(end)
        rows = np.ones(model.y.size - model.first, dtype=bool)
        again = [end._replace(outliers=end.outliers._replace(wrong=missing, counts=rows)) for end in chosen]
        return _best_first(model, missing, [searched_again(model, end, missing, limits) for end in again], limits)
    results = [_searched(model, s.p, noise, missing, (s.name,), _ROUGH, limits) for s in _starts(model, missing)]
    same, hopeless = _SAME, np.inf
    if not (model.na or model.structure.nc or model.structure.nd):
        # No outlier is in a regressor: all that is left to find is within the precision of the search.
        same, hopeless = max(same, _NEAR * (model.n / model.y.size) ** 0.5), _HOPELESS
    rough = [end for end, excess in _best_first(model, missing, results, limits, same) if not excess > hopeless]
    learnt = [end._replace(noise=replace(end.noise, influence=loss)) for end in rough]
    followed = [
        _searched(model, end.p, end.noise, missing, end.starts, _FULL, limits, sure=end.outliers) for end in learnt
    ]
    return _best_first(model, missing, followed, limits)


def _middle(model: PolynomialModel, missing: Any) -> tuple[PolynomialModel | None, slice]:
    """Return a model of the middle of a long recording, if it tells all of it, and which samples that is."""
    begin = (model.y.size - _MOST_SEARCHED) // 2
    part = slice(begin, begin + _MOST_SEARCHED)
    if not model.na or model.nf or begin <= _MOST_SEARCHED // 2 or len(model.pieces) > 1:
        return None, part
    inner = PolynomialModel(model.structure, model.y[part], model.u[part], model.offset, model.moving)
    try:
        require_informative(inner, missing[part])
    except ValueError:
        # An input that stood still there, or a gap.
        return None, part
    return inner, part


def searched_again(model: Any, end: End, missing: Any, limits: Limits | None) -> End:
    """Return where the search goes on to from an end, for a model with more free parameters."""
    return _searched(model, end.p, end.noise, missing, end.starts, _AGAIN, limits, end.outliers)


def known_part(model: PolynomialModel, end: End) -> tuple[Array, Array]:
    """Return the derivatives of the residuals that count less what unknown outputs may make of them, and residuals."""
    derivatives, residual, h = model.jacobian(end.p), model.residuals(end.p), response(model, end.p)
    if h.size > 1 and end.outliers.wrong.any():
        weights = end.noise.weights(end.residual)
        for rows, samples in model.pieces:
            unknowns = Unknowns(residual[rows], h, end.outliers.wrong[samples], weights[rows], model.first)
            derivatives[rows] = unknowns.within(derivatives[rows])
            residual[rows] /= np.sqrt(np.maximum(1.0 - unknowns.leverages(), 1e-3))
    return derivatives[end.rows], residual[end.rows]


def _searched(
    model: PolynomialModel, p: Array, noise: Noise, missing: Any, starts: tuple[str, ...], effort: _Effort,
    limits: Limits | None = None, before: Outliers | None = None, sure: Outliers | None = None,
) -> End:  # fmt: skip
    """Minimise the loss from p on, looking for outliers again as often as the parameters change what is one."""
    stage(f"search from: {starts[0]}")
    p = p if limits is None else limits.start(model, p)
    sure = previous = sure or Outliers(missing, np.ones(model.y.size - model.first, dtype=bool))
    outliers = found_outliers(model, p, missing, noise, before)
    for turn in range(effort.cleanings):
        if turn:
            stage(f"{int((outliers.wrong & ~missing).sum())} outliers taken for missing, search again")
        optimum, _ = _maximised(model, p, noise, outliers, 1, effort, limits)
        if np.isnan(optimum.noise.R):
            # Outliers are in every residual, and nothing shows the noise: there were too many.
            outliers = previous
            break
        moved = np.inf if before is None else mad_scale(model.residuals(optimum.p) - model.residuals(p))
        p, noise = optimum.p, optimum.noise
        if moved < _UNMOVED * noise.R**0.5:
            break
        previous, outliers = outliers, found_outliers(model, p, missing, noise, outliers)
        if np.array_equal(outliers.wrong, previous.wrong):
            break
    optimum, full = _maximised(model, p, noise, outliers, effort.turns, effort, limits)
    if np.isnan(optimum.noise.R):
        outliers = sure
        optimum, full = _maximised(model, p, noise, sure, effort.turns, effort, limits, anyhow=True)
    rows = _counting(full, full is model, outliers.wrong)
    y = full.output(optimum.p) if isinstance(full, CompletedModel) else full.y
    return End(starts, optimum.p, optimum.noise, y, outliers, rows, optimum.residual, optimum.converged)


def _maximised(
    model: PolynomialModel, p: Array, noise: Noise, outliers: Outliers, turns: int, effort: _Effort,
    limits: Limits | None = None, anyhow: bool = False,
) -> tuple[Optimum, PolynomialModel | CompletedModel]:  # fmt: skip
    """Minimise the loss with outliers in the regressor as unknowns; weights of residuals take turns with the rest."""
    if not (outliers.wrong.any() and response(model, p).size > 1):
        rows = _counting(model, True, outliers.wrong)
        near = 0.0 if model.na or model.structure.nc or model.structure.nd else effort.near
        return minimised(model, p, noise, rows, rows, limits=limits, precision=near), model
    weights = outliers.counts.astype(float)
    for _ in range(turns):
        full = CompletedModel(model, outliers.wrong, weights)
        clear = full.conditioned & ~touched(outliers.wrong, response(model, p), model.first)
        if anyhow and not clear.any():
            clear = full.conditioned
        if not (clear.any() or (noise.given and not isinstance(noise.influence, Contaminated))):
            # Outliers are in every residual: nothing shows the noise.
            return Optimum(p, replace(noise, R=np.nan), full.residuals(p), False), full
        before = full.residuals(p)
        optimum = minimised(full, p, noise, full.conditioned, clear, effort.steps, limits, _NEAR if turns == 1 else 0.0)
        moved = np.linalg.norm(optimum.residual - before)
        p, noise, weights = optimum.p, optimum.noise, optimum.noise.weights(optimum.residual)
        if moved <= _SETTLED * np.linalg.norm(optimum.residual):
            break
    return optimum._replace(converged=True), full


def _counting(model: Any, measured: bool, unknown: Any) -> Any:
    """Return which residuals count: all of an interpolated output, else those of samples that are measured."""
    return model.conditioned & ~unknown[model.first :] if measured else model.conditioned


def _best_first(
    model: PolynomialModel, missing: Any, ends: list[End], limits: Limits | None = None, same: float = _SAME
) -> list[Ranked]:
    """Sort ends by what the data say for them, and join those that are the same."""
    # Of two optima with the same loss the wider one is the likelier (Laplace's approximation of the evidence): a narrow
    # one fits this recording with a pole next to the unit circle that no other recording shows. Where two optima are
    # nearly as good for a robust loss, the noise that their residuals show still tells them apart.
    # A start that takes many good samples for outliers may end where the noise cannot be computed.
    ends = [end for end in ends if np.isfinite(end.noise.R) and np.isfinite(end.residual).all()]
    if not ends:
        raise ValueError(
            f"y: expected a recording that {model.structure!r} explains, got numbers that are not finite from every "
            "start of the search; take fewer parameters, or make NaN of values that are no measurements"
        )
    # Where unknown outputs enter nearly every residual, they explain what they like, and the noise looks small.
    shown = [_showing(model, end) for end in ends]
    enough = [n >= _SHOWN * model.n for n in shown]
    ends = list(compress(ends, enough if any(enough) else [n > model.n for n in shown])) or ends
    likeliest = min(ends, key=lambda end: end.noise.R)
    noise = likeliest.noise
    if noise.has_outliers and not isinstance(noise.influence, Contaminated):
        shown = likeliest.residual[likeliest.rows]
        noise = replace(noise, influence=START).settled(shown)
    threshold = min(end.outliers.threshold for end in ends)
    losses, n = [], model.structure.n_theta
    free = np.arange(model.n) if limits is None else np.flatnonzero(np.append(~limits.fixed, np.ones(model.n - n)))
    for end in ends:
        jacobian, _ = known_part(model.with_output(end.y), end)
        root = np.sqrt(noise.weights(end.residual[end.rows]) / noise.R)
        # Offset and start first: what follows on the diagonal is what the data tell of theta without knowing them.
        backwards = np.asarray(np.linalg.qr(jacobian[:, free[::-1]] * root[:, None], mode="r"))
        diagonal = np.abs(np.diag(backwards))[-np.count_nonzero(free < n) :]
        information = np.log(np.maximum(diagonal, np.finfo(float).tiny)).sum()
        price = 0.5 * threshold**2 * (end.outliers.wrong.sum() - missing.sum())
        losses.append(noise.cost(end.residual[end.rows]) + price + information)
    ranked: list[Ranked] = []
    for i in np.argsort(losses, kind="stable"):
        for j, (end, excess) in enumerate(ranked):
            if mad_scale(end.residual - ends[i].residual) < same * np.sqrt(noise.R):
                ranked[j] = Ranked(end._replace(starts=(*end.starts, *ends[i].starts)), excess)
                break
        else:
            ranked.append(Ranked(ends[i], float(losses[i] - min(losses))))
    return ranked


def _showing(model: PolynomialModel, end: End) -> int:
    """Return how many residuals no unknown output enters: these alone show the noise."""
    h = response(model, end.p)
    if h.size == 1 or not end.outliers.wrong.any():
        return int(end.rows.sum())
    return int((model.conditioned & ~touched(end.outliers.wrong, h, model.first)).sum())


def _starts(model: PolynomialModel, missing: Any) -> Iterator[Start]:
    """Yield the starts that suit the structure."""
    if len(model.spans) > 1:
        joined, gaps = model.joined(missing)
        for start in _starts(joined, gaps):
            yield Start(start.name, model.shared(start.p))
        return
    order = max(model.na, model.nf)
    rows = ~np.convolve(missing, np.ones(model.na + 1))[model.first : missing.size].astype(bool)
    if model.na and not rows.any():
        raise ValueError(
            f"y: expected somewhere {model.na + 1} measured samples in a row for {model.structure!r}, got gaps in "
            "all of them, so that nothing shows the noise; identify an OutputError, which needs no outputs in a row"
        )
    if not model.nf:
        yield regression_start(model, rows)
    if not order:
        return
    if not model.inputs:
        yield autocorrelation_start(model)
        return
    nb, nk = zip(*model.structure.inputs, strict=True)
    simple = PolynomialModel(OutputError(order, nb, nk), model.y, model.u, model.offset, model.moving)
    starts = output_error_starts(simple, ~missing[simple.first :])
    if model.structure.polynomials == simple.structure.polynomials:
        yield from starts
        return
    best = _best_of(simple, missing, starts)
    yield Start("output-error model", model.from_output_error(simple.parts(best)))
    if model.nf + model.nd:
        yield from _whitened_starts(model, simple, best, missing)


def _whitened_starts(model: PolynomialModel, simple: PolynomialModel, p: Array, missing: Any) -> Iterator[Start]:
    """Yield starts of a model with a disturbance, from output-error models of whitened signals."""
    rows = ~missing[simple.first :]
    q = model.from_output_error(simple.parts(p))
    yield disturbance_start("output-error model and its disturbance", model, q, rows)
    order = model.structure.nd + 2 * model.structure.nc
    for name, polynomial in (
        ("whitened by the disturbance", whitened(simple, p, rows, order)),
        ("differences", np.array([1.0, -1.0])),
    ):
        first = polynomial.size - 1
        y, u = (lfilter(polynomial, [1.0], signal, axis=0)[first:] for signal in (simple.y, simple.u))
        gaps = np.convolve(missing, np.ones(first + 1))[first : missing.size] > 0.5
        filtered = PolynomialModel(simple.structure, y, u, simple.offset, simple.moving)
        q = _best_of(filtered, gaps, output_error_starts(filtered, ~gaps[filtered.first :]))
        q[simple.structure.n_theta :] = 0.0
        if model.offset:
            q[simple.structure.n_theta] = np.median(simple.equation_error(q)[rows])
        yield disturbance_start(name, model, model.from_output_error(simple.parts(q)), rows)


def _best_of(model: PolynomialModel, missing: Any, starts: Iterator[Start]) -> Array:
    """Return the free parameters of the best start as it is."""
    rows = ~missing[model.first :]
    return min((start.p for start in starts), key=lambda p: bounded_mean(model.residuals(p)[rows]))
