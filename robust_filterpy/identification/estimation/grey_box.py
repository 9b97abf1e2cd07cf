"""identify for `GreyBox`: the least robust loss from first guesses, and which parameters the recording cannot tell."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.identification.estimation.disturbances import Explanation, Search, of_impulses
from robust_filterpy.identification.estimation.prediction_error import Limits, evidence_of_outputs, minimised, sandwich
from robust_filterpy.identification.models.grey_box import GreyBox, GreyBoxModel, GreyResiduals, require_functions
from robust_filterpy.identification.models.noise import ROUNDING, Noise, Noises
from robust_filterpy.identification.models.recording import ANY_TIMES, Recording, recorded, require_motion
from robust_filterpy.identification.models.signals import fingerprint, operating_point
from robust_filterpy.influence.functions import Huber, Influence

# A step of so many standard deviations ends the search: with a first loss, and with the noise learned.
_NEAR: Final = 0.1
_NEARER: Final = 1e-4
# A direction along which a standard deviation is this share of the parameters is one that the recording cannot tell.
_UNIDENTIFIABLE: Final = 0.5
# Of a direction that nothing depends on, by this share of the best one, the recording says nothing.
_NOTHING: Final = 1e-8
# What a parameter has of such a direction to be named.
_PART: Final = 0.3


def identified_grey_box(
    y: Any, u: Any, structure: GreyBox, t: Any = None, influence: Influence | None = None, trend: str = "breaks"
) -> GreyBoxModel:
    """Find the parameters of a physical model."""
    recording = recorded(ANY_TIMES, y, u, t=t)
    outputs, inputs, spans = recording.y, recording.u, recording.spans
    require_motion(outputs, inputs)
    require_functions(structure, recording, structure.values)

    def alone(model: GreyBoxModel, y: Array, u: Array) -> Array:
        equations = GreyResiduals(structure, recording._replace(y=y, u=u), model.starts, False)
        equations.settled(model.theta)
        return equations.simulated(model.theta)

    def find(u: Array, levels: Array, columns: Any, end: Any) -> Explanation:
        # Equations have no constant of their own: the level may be theirs before it breaks, or after.
        first = np.concatenate([np.broadcast_to(levels[part.start], levels[part].shape) for part in spans])
        models = []
        for own in (levels, levels - first) if levels.any() else (levels,):
            model, residual = _modelled(structure, recording._replace(y=outputs - own, u=u), influence)
            models.append(Explanation(model, own, u, evidence_of_outputs(model.noise, residual, spans)))
        return max(models, key=lambda one: one.evidence)

    def starts(u: Array, plain: GreyBoxModel) -> list[Array]:
        return [of_impulses(outputs, u, spans) if recording.is_sampled else alone(plain, outputs, u)]

    search = Search(outputs, inputs, spans, find, alone, starts)
    best = search.best(trend)
    levels, output = best.levels, alone(best.model, outputs - best.levels, best.u)
    left = search.left(
        best, output, outputs - levels - output, operating_point(best.u), True, "the parameters are biased by that"
    )
    trends = tuple((fingerprint(outputs[part]), levels[part]) for part in spans if levels[part].any())
    return replace(best.model, findings=(*recording.findings, *best.findings, *left), trends=trends)


def _modelled(structure: GreyBox, recording: Recording, influence: Influence | None) -> tuple[GreyBoxModel, Array]:
    """Return the model of recordings as they are, and its residuals, NaN where an output is missing, shape (N, p)."""
    starts = np.repeat(structure.x0[None], len(recording.spans), axis=0)
    model = GreyResiduals(structure, recording, starts, structure.start == "free")
    if not model.settled(model.first):
        raise ValueError(
            "p0: expected first guesses with which f has finite outputs; the equations are unstable there, or too "
            "stiff for 128 steps between samples"
        )
    rows = model.rows
    if rows.sum() < 2 * model.n:
        raise ValueError(f"y: expected at least {2 * model.n} measured samples, got {int(rows.sum())}")
    # Without noise R would end at 0.
    least = np.maximum(ROUNDING**2 * np.nanstd(recording.y, 0) ** 2, np.finfo(float).tiny)
    noise = Noises(tuple(Noise(influence or Huber(), 1.0, False, float(one)) for one in least), model.which)
    stage("search from the first guesses")
    limits = Limits(model.lower, model.upper)
    end = minimised(model, model.first, noise, rows, limits=limits, precision=_NEAR)
    model.steps = 1
    model.settled(end.p)
    stage("noise learned, search again")
    learnt = end.noise if influence is not None else end.noise.learnt()
    # What the steps of the integration leave wrong is no noise that could be smaller.
    parts = zip(learnt.parts, np.maximum(least, model.error**2).tolist(), strict=True)
    learnt = learnt._replace(parts=tuple(replace(one, least=low) for one, low in parts))
    end = minimised(model, end.p, learnt, rows, limits=limits, precision=_NEARER)
    residual = np.where(rows, end.residual, np.nan).reshape(recording.y.shape)
    return _as_model(structure, model, end, limits), residual


def _as_model(structure: GreyBox, model: GreyResiduals, end: Any, limits: Limits) -> GreyBoxModel:
    """Return what was found, with what the recording cannot tell."""
    z, noise, k, rows = end.p, end.noise, model.k, model.rows
    theta, residual, J = z[:k], model.residuals(z)[rows], model.jacobian(z)[rows]
    unidentifiable, unseen = _unidentifiable(structure, model, J, noise, residual, theta)
    # As of a model of polynomials: what ended at a bound has no variance, and the others then have.
    P, colour = sandwich(np.where(limits.held(z, J.T @ noise.psi(residual)), 0.0, J), residual, noise, k)
    # What the integration leaves wrong follows the signal: many samples tell no more of it than one.
    P = P[:k, :k] * (rows.sum() if all(one.is_rounding for one in noise.parts) else 1.0)
    P[unseen, unseen] = np.inf
    total = rows.sum() / max(rows.sum() - model.n, 1)
    values = structure.p0 | dict(zip(structure.free_names, theta.tolist(), strict=True))
    doubt = [
        f"the recording cannot tell {' and '.join(names)}" + (" apart" if len(names) > 1 else "")
        for names in unidentifiable
    ]
    if not end.converged:
        doubt.append("the search did not settle")
    for name, (low, high) in structure.limits.items():
        near = 1e-3 * (high - low if np.isfinite(high - low) else abs(structure.p0[name]) or 1.0)
        if name in structure.free_names and not low + near < values[name] < high - near:
            doubt.append(f"{name} is at its bound, {values[name]:.4g}")
    return GreyBoxModel(
        structure=structure, p=values, theta=theta, P=P, starts=model.starts_of(z), colour=colour,
        noise=tuple(replace(one, R=one.R * total) for one in noise.parts), warning="; ".join(doubt),
        weights=np.vstack(model.believed(z, noise, np.nan)), log_likelihood=noise.log_likelihood(residual),
        unidentifiable=unidentifiable,
    )  # fmt: skip


def _unidentifiable(
    structure: GreyBox, model: GreyResiduals, J: Array, noise: Noises, residual: Array, theta: Array
) -> tuple[tuple[tuple[str, ...], ...], Any]:
    """Return the parameters along whose directions a standard deviation is large, and where there is nothing."""
    size = np.where(theta == 0.0, model.size[: theta.size], np.abs(theta))
    weighted = J * np.sqrt(noise.slope(residual) / noise.variance)[:, None]
    k = theta.size
    if model.n > k:
        # What the starts explain tells nothing of the parameters.
        basis = np.linalg.qr(weighted[:, k:])[0]
        weighted = weighted[:, :k] - basis @ (basis.T @ weighted[:, :k])
    _, values, right = np.linalg.svd(weighted[:, :k] * size, full_matrices=False)
    groups, unseen = [], np.zeros(k, dtype=bool)
    for value, direction in zip(values, right, strict=True):
        if value * _UNIDENTIFIABLE < 1.0:
            part = np.abs(direction) > _PART
            groups.append(tuple(np.array(structure.free_names)[part].tolist()))
            unseen |= part & (value <= _NOTHING * values[0])
    return tuple(groups), unseen
