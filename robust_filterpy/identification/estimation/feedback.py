"""Whether inputs follow what the output did before: a recording from a closed loop, and what is biased by it.

Given its own past, an input of an open loop tells nothing of the noise before it. So each input is regressed on its
past and then on past residuals of the model too, clipped so that outliers count little; what these explain is feedback.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy.stats import f as fisher

from robust_filterpy._checks import Array
from robust_filterpy.identification.estimation.estimate import Problem
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.results import Finding
from robust_filterpy.influence.regression import mad_scale

__all__ = ["feedback", "with_feedback"]

_PAST: Final = 16
_RESIDUALS: Final = 6
_CLIP: Final = 2.0
_CHANCE: Final = 1e-7
# What the residuals must explain of what the past of the input leaves of it.
_SHARE: Final = 0.02


def with_feedback(problem: Problem, y: Array, model: Model) -> tuple[Finding, ...]:
    """Find out whether a recording comes from a closed loop."""
    structure = model.structure
    # What is rounding alone did not go back to the input.
    if not structure.inputs or structure.takes_phi or model.noise.is_rounding:
        return ()
    parts = []
    for i, part in enumerate(problem.spans):
        u = problem.alone(i).u
        parts.append((u - problem.rest, model.residuals(y[part], u)[:, None]))
    models_noise = structure.na + structure.nc + structure.nd > 0
    meaning = (
        f"{structure} is unbiased only as far as its noise model is right: validate it, and try more c's and d's"
        if models_noise
        else f"{structure} is biased by that unless the noise is white: BoxJenkins or ARMAX model the noise"
    )
    return feedback(parts, min(nk for _, nk in structure.inputs) == 0, meaning)


def feedback(parts: list[tuple[Array, Array]], direct: bool, meaning: str) -> tuple[Finding, ...]:
    """Find out whether inputs follow the residuals of any model."""
    lags = range(int(direct), _RESIDUALS + 1)
    pasts, wanted = [], []
    for u, left in parts:
        if len(u) <= 2 * _PAST:
            continue
        residual = np.column_stack([_ordinary(one) for one in left.T])
        rows = np.arange(_PAST, len(u))
        before = [u[rows - lag] for lag in range(1, _PAST + 1)]
        told = np.hstack([residual[rows - j] for j in lags])
        pasts.append((np.hstack((*before, np.ones((rows.size, 1)))), told))
        wanted.append(u[rows])
    if not pasts:
        return ()
    X, E, U = np.concatenate([x for x, _ in pasts]), np.concatenate([e for _, e in pasts]), np.concatenate(wanted)
    freedom = len(X) - X.shape[1] - E.shape[1]
    if freedom < 2 * X.shape[1]:
        return ()
    basis = _basis(X)
    left, more = U - basis @ (basis.T @ U), E - basis @ (basis.T @ E)
    own = _basis(more)
    total, explained = np.square(left).sum(axis=0), np.square(own.T @ left).sum(axis=0)
    # An input whose past says all of it has nothing left to be explained.
    varies = total > 1e-9 * np.square(U).sum(axis=0)
    share = np.where(varies, explained / np.where(varies, total, 1.0), 0.0)
    chance = fisher.sf(share / E.shape[1] / (np.maximum(1.0 - share, 1e-12) / freedom), E.shape[1], freedom)
    found = (share > _SHARE) & (chance < _CHANCE)
    if not found.any():
        return ()
    which = ", ".join(str(j) for j in np.flatnonzero(found))
    text = (
        f"input {which} follows what y did before, {100 * float(share.max()):.0f} % of what is new in it: the "
        f"recording comes from a closed loop; {meaning}"
    )
    evidence = float(-2.0 * np.log(np.maximum(chance.min(), np.finfo(float).tiny)))
    return (Finding("closed loop", text, evidence, (0, sum(len(u) for u, _ in parts))),)


def _ordinary(residual: Array) -> Array:
    """Return residuals in units of their scale, clipped, 0 where there are none."""
    known = ~np.isnan(residual)
    centre = float(np.median(residual[known])) if known.any() else 0.0
    scale = mad_scale(residual[known] - centre) if known.any() else 0.0
    return np.where(known, np.clip((np.nan_to_num(residual) - centre) / (scale or 1.0), -_CLIP, _CLIP), 0.0)


def _basis(X: Array) -> Any:
    """Return an orthonormal basis of the columns."""
    left, values, _ = np.linalg.svd(X, full_matrices=False)
    return left[:, values > 1e-9 * max(values[0], np.finfo(float).tiny)]
