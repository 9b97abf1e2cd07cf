"""From several starts to one estimate: the search from each, and which end to believe."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.correction.contaminated import START, Contaminated
from robust_filterpy.identification.estimation.outliers import FORGOTTEN, End, begun, drawn
from robust_filterpy.identification.estimation.prediction_error import MOST_STEPS, Limits, minimised
from robust_filterpy.identification.estimation.starts import require_informative, starts_of
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.influence.functions import Huber, Influence
from robust_filterpy.influence.regression import mad_scale

# Ends whose residuals differ by less than this share of their size are the same.
_SAME: Final = 1e-3
# The same where nothing measured is in a regressor: within so many standard deviations of the optimum.
_NEAR: Final = 0.1
#: Standard deviations that each outlier of an output in its regressor costs.
THRESHOLD: Final = 3.6
# A recording with measured outputs in its regressor, where draws take their time, is searched in so many samples of its
# middle; ends so much less likely there are not followed in the whole.
_MOST_SEARCHED: Final = 4000
_HOPELESS: Final = 30.0
# Residuals that differ by no more of their scale show the same outliers, and lead to the same end.
_UNMOVED: Final = 0.2


def ends(
    model: PolynomialModel, missing: Any, influence: Influence | None, R: float | None, limits: Limits | None,
    least: float, begin: Array | None = None,
) -> list[End]:  # fmt: skip
    """Search from every start."""
    loss = START if influence is None else influence
    noise = Noise(Huber() if influence is None else influence, 1.0 if R is None else R, R is not None, least)
    if begin is not None:
        # A start that is near the end shows how large the noise is; a rough search would lead away from it.
        near = begun(model, begin, replace(noise, influence=loss), missing, "one start")
        return _best_first(model, missing, [searched(model, near, missing, limits)], limits)
    inner, part = _middle(model, missing)
    if inner is not None:
        # From every start in the middle of a long recording, and from what is found there in all of it.
        inside = [one for one in ends(inner, missing[part], influence, R, limits, least) if one.excess < _HOPELESS]
        chosen = _apart(inside, _UNMOVED)
        again = [end._replace(y=model.y, wrong=missing, residual=model.residuals(end.p)) for end in chosen]
        return _best_first(model, missing, [searched(model, end, missing, limits) for end in again], limits)
    starts = [begun(model, s.p, noise, missing, s.name) for s in starts_of(model, missing)]
    if model.remembers:
        first = [one._replace(noise=replace(one.noise, influence=loss)) for one in starts]
        followed = [searched(model, one, missing, limits, True) for one in _apart(first, _UNMOVED)]
        return _best_first(model, missing, followed, limits, _UNMOVED)
    # All that is left to find is within the precision of the search.
    rough = [_minimised(model, one, missing, limits, _NEAR) for one in starts]
    ranked = _best_first(model, missing, rough, limits, max(_SAME, _NEAR * (model.n / model.y.size) ** 0.5))
    likely = [end for end in ranked if not end.excess > _HOPELESS]
    learnt = [end._replace(noise=replace(end.noise, influence=loss)) for end in likely]
    return _best_first(model, missing, [_minimised(model, end, missing, limits) for end in learnt], limits)


def _apart(ends: list[End], same: float) -> list[End]:
    """Return ends whose residuals differ by more than a share of their size, with the starts of those that do not."""
    chosen: list[End] = []
    for end in ends:
        for i, other in enumerate(chosen):
            if mad_scale(end.residual - other.residual) <= same * other.noise.R**0.5:
                chosen[i] = other._replace(starts=(*other.starts, *end.starts))
                break
        else:
            chosen.append(end)
    return chosen


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


def searched(model: PolynomialModel, end: End, missing: Any, limits: Limits | None, afresh: bool = False) -> End:
    """Return where the search goes on to; afresh: from parameters that no outlier has been seen with."""
    if limits is not None:
        end = end._replace(p=limits.start(model, end.p))
    if model.remembers and (missing.any() or end.noise.has_outliers) and np.isfinite(end.residual).all():
        further = drawn(model, end, missing, limits, FORGOTTEN, afresh)
        if further is not None and further.wrong.any():
            return further
    return _minimised(model, end, missing, limits)


def _minimised(
    model: PolynomialModel, end: End, missing: Any, limits: Limits | None, precision: float = 0.0
) -> End:  # fmt: skip
    """Return the least loss of the residuals that hold nothing missing, from an end on."""
    stage(f"search from: {end.starts[0]}")
    rows = model.conditioned & ~missing[model.first :]
    p = end.p if limits is None else limits.start(model, end.p)
    optimum = minimised(model, p, end.noise, rows, 2 * MOST_STEPS, limits, precision)
    return End(end.starts, optimum.p, optimum.noise, model.y, missing, rows, optimum.residual, optimum.converged)


def _best_first(
    model: PolynomialModel, missing: Any, ends: list[End], limits: Limits | None = None, same: float = _SAME
) -> list[End]:
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
    likeliest = min(ends, key=lambda end: end.noise.R)
    noise = likeliest.noise
    if noise.has_outliers and not isinstance(noise.influence, Contaminated):
        shown = likeliest.residual[likeliest.rows]
        noise = replace(noise, influence=START).settled(shown)
    losses, n = [], model.structure.n_theta
    free = np.arange(model.n) if limits is None else np.flatnonzero(np.append(~limits.fixed, np.ones(model.n - n)))
    for end in ends:
        jacobian = model.with_output(end.y).jacobian(end.p)[end.rows]
        root = np.sqrt(noise.weights(end.residual[end.rows]) / noise.R)
        # Offset and start first: what follows on the diagonal is what the data tell of theta without knowing them.
        backwards = np.asarray(np.linalg.qr(jacobian[:, free[::-1]] * root[:, None], mode="r"))
        diagonal = np.abs(np.diag(backwards))[-np.count_nonzero(free < n) :]
        information = np.log(np.maximum(diagonal, np.finfo(float).tiny)).sum()
        price = 0.5 * THRESHOLD**2 * (end.wrong.sum() - missing.sum())
        losses.append(noise.cost(end.residual[end.rows]) + price + information)
    excess = [float(loss - min(losses)) for loss in losses]
    return _apart([ends[i]._replace(excess=excess[i]) for i in np.argsort(losses, kind="stable")], same)
