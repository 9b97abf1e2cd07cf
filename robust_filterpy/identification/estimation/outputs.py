"""identify for `StateSpace` and `GreyBox`, whose outputs have a noise each: the least robust loss, and how sure it is.

States have starts from long autoregressions and an order by evidence; physics has first guesses, and parameters that
the recording may not tell.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.signal import dlsim

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.identification.estimation import prediction_error
from robust_filterpy.identification.estimation.disturbances import Explanation, Search, of_impulses
from robust_filterpy.identification.estimation.estimate import Units
from robust_filterpy.identification.estimation.prediction_error import Limits, evidence_of_outputs, minimised, sandwich
from robust_filterpy.identification.estimation.starts import predictor_start, rank_of
from robust_filterpy.identification.models.grey_box import GreyBox, GreyBoxModel, GreyResiduals, require_functions
from robust_filterpy.identification.models.noise import ROUNDING, Noise, Noises, least_variance
from robust_filterpy.identification.models.recording import ANY_COLUMNS, ANY_TIMES, Recording, recorded, require_motion
from robust_filterpy.identification.models.responses import balancing
from robust_filterpy.identification.models.signals import operating_point
from robust_filterpy.identification.models.state_space import Matrices, StateSpace, StateSpaceModel, StateSpaceResiduals
from robust_filterpy.influence.functions import Huber, Influence

_REACHES: Final = (3, 6, 15)
_FIRST_STEPS: Final = 12
_TURNS: Final = 4
# Orders tried after the best one.
_PATIENCE: Final = 2
_BELIEVED: Final = 0.5
# A step of so many standard deviations ends the search: with a first loss, and with the noise learned.
_NEAR: Final = 0.1
_NEARER: Final = 1e-4
# A direction along which a standard deviation is this share of the parameters is one that the recording cannot tell.
_UNIDENTIFIABLE: Final = 0.5
# Of a direction that nothing depends on, by this share of the best one, the recording says nothing.
_NOTHING: Final = 1e-8
# What a parameter has of such a direction to be named.
_PART: Final = 0.3


class _Found(NamedTuple):
    """Where the search for one order ended, in units of the recordings' scales."""

    model: StateSpaceResiduals
    q: Array
    noise: Noises
    converged: bool = False

    @property
    def residual(self) -> Array:
        """Of the outputs that are measured."""
        return self.model.residuals(self.q)[self.model.rows]

    @property
    def log_likelihood(self) -> float:
        """Of the outputs that are measured."""
        return self.noise.log_likelihood(self.residual)

    @property
    def free(self) -> int:
        """Parameters that a change of basis leaves, without the starts."""
        return self.model.shared - self.model.order**2 + len(self.model.recordings) * self.model.outputs

    @property
    def criterion(self) -> float:
        """Its information criterion."""
        return -2.0 * self.log_likelihood + np.log(self.model.rows.sum()) * self.free

    def descended(self, most_steps: int = prediction_error.MOST_STEPS) -> _Found:
        """Return where the search goes on to."""
        rows = self.model.rows
        end = minimised(self.model, self.q, self.noise, rows, most_steps)
        return self._replace(q=end.p, noise=end.noise, converged=end.converged)

    def reweighed(self) -> _Found:
        """Return the same with a model in whose states no outlier and no gap enters."""
        one = self._replace(model=copy(self.model))
        for _ in range(2):
            one.model.weights = one.model.believed(one.q, one.noise)
        return one

    def cleaned(self) -> list[Array]:
        """Return outputs with what the model says in the place of outliers and gaps."""
        each = zip(
            self.model.recordings, self.model.believed(self.q, self.noise),
            self.model.split(self.model.residuals(self.q)), strict=True,
        )  # fmt: skip
        return [np.where(weights > _BELIEVED, y, y - left) for (y, _), weights, left in each]


def identified_state_space(
    y: Any, u: Any, structure: StateSpace, influence: Influence | None = None, trend: str = "breaks"
) -> StateSpaceModel:
    """Find a state-space model of recordings of several outputs."""
    if u is None:
        raise ValueError("u: expected a recording of the inputs for a state-space model, got None")
    recording = recorded(ANY_COLUMNS, y, u)
    require_motion(recording.y, recording.u)
    spans = recording.spans

    def each(y: Array, u: Array, of: Any) -> Array:
        return np.concatenate([of(y[part], u[part]) for part in spans])

    def find(u: Array, levels: Array, columns: Any, end: Any) -> Explanation:
        model = _of_states(recording._replace(y=recording.y - levels, u=u), structure, influence)
        left = each(recording.y - levels, u, model.residuals)
        return Explanation(model, levels, u, evidence_of_outputs(model.noise, left, spans))

    search = Search(
        recording.y, recording.u, spans, find, lambda model, y, u: each(y, u, model.free_run),
        lambda u, plain: [of_impulses(recording.y, u, spans)], index=recording.axis.index,
    )  # fmt: skip
    with prediction_error.one_thread():
        best = search.best(trend)
        model, y, u = best.model, recording.y - best.levels, best.u
        output = each(y, u, model.free_run)
        left = search.left(
            best, output, each(y, u, model.residuals), model.operating_point, structure.feedthrough,
            "K is unbiased only as far as it is right about the noise" if structure.disturbance
            else "it is biased by that unless the noise is white: disturbance=True models the noise",
            _driven(model, output),
        )  # fmt: skip
    return search.concluded(best, (*recording.findings, *best.findings, *left))


def _of_states(recording: Recording, structure: StateSpace, influence: Influence | None) -> StateSpaceModel:
    """Return the model of recordings as they are."""
    rest, units, parts = _scaled(recording)
    orders = structure.orders
    models = [StateSpaceResiduals(n, parts, structure.feedthrough, structure.disturbance) for n in orders]
    _require_informative(structure, models[0])
    tried: list[_Found] = []
    for model in models:
        if tried and not _enough(model):
            break
        tried.append(_searched(model, parts, influence))
        best = int(np.argmin([fit.criterion for fit in tried]))
        if len(tried) - 1 - best == _PATIENCE:
            break
    chosen = _in_units(tried[best], units, recording, rest, structure)
    return replace(chosen, orders=tuple((n, fit.criterion) for n, fit in zip(orders, tried, strict=False)))


def _driven(model: StateSpaceModel, output: Array) -> Array:
    """Return an output's deviations as they stand in the innovations, shape (N, p)."""
    deviation = output - output.mean(axis=0)
    if not model.structure.disturbance:
        return deviation
    system = (model.A - model.K @ model.C, model.K, -model.C, np.eye(deviation.shape[1]), 1.0)
    return np.asarray(dlsim(system, deviation)[1])


def _scaled(recording: Recording) -> tuple[Array, Units, list[tuple[Array, Array]]]:
    """Return where inputs rest, the units, and recordings in these; outputs must vary."""
    rest, spans = operating_point(recording.u), recording.spans
    for i, part in enumerate(spans):
        for j in np.flatnonzero(np.isnan(recording.y[part]).all(axis=0)):
            raise ValueError(f"y: expected some measured samples of output {j} in recording {i}, got none")
    units = Units.of(recording.y, recording.u - rest, spans)
    for j in np.flatnonzero(units.y <= 1e-12 * np.abs(units.centre).max(axis=0)):
        raise ValueError(f"y: expected outputs that vary, got the same value throughout in output {j}")
    y, u = units.normal(recording.y), (recording.u - rest) / units.u
    return rest, units, [(y[part], u[part]) for part in spans]


def _enough(model: StateSpaceResiduals) -> bool:
    """Tell whether there are twice as many measured outputs as free parameters."""
    return int(np.bincount(model.which).min()) * model.outputs >= 2 * (model.n - model.order**2)


def _require_informative(structure: StateSpace, model: StateSpaceResiduals) -> None:
    """Raise unless the recordings are long enough and the inputs excite them."""
    parts, n = model.recordings, model.order
    if not _enough(model):
        raise ValueError(
            f"y: expected more samples for {structure} with {model.outputs} outputs and {model.inputs} inputs, got "
            f"{sum(len(y) for y, _ in parts)}; record more, or take a smaller order"
        )
    for i, (y, _) in enumerate(parts):
        if len(y) <= n + 1:
            raise ValueError(f"y: expected more than {n + 1} samples in each recording, got {len(y)} in recording {i}")
    for i, columns in enumerate(zip(*(u.T for _, u in parts), strict=True)):
        if not any(one.any() for one in columns) or all(np.ptp(one) == 0.0 for one in columns):
            raise ValueError(f"u: expected inputs that move the outputs, got input {i} constant: {columns[0][0]:.6g}")
    lags = n + 1
    X = np.concatenate([np.hstack([u[lags - 1 - j : len(u) - j] for j in range(lags)]) for _, u in parts])
    if rank_of(X - X.mean(axis=0)) < X.shape[1]:
        raise ValueError(
            f"u: expected inputs that together excite {structure} with order {lags}, got some that others explain; "
            "leave out an input that is a combination of others, vary them more, or take a smaller order"
        )


def _searched(whole: StateSpaceResiduals, parts: list[tuple[Array, Array]], influence: Influence | None) -> _Found:
    """Search from every start, without a K first."""
    model = StateSpaceResiduals(whole.order, parts, whole.feedthrough, False)
    outputs = np.concatenate([y for y, _ in model.recordings]).T
    first = Noises(tuple(Noise(influence or Huber(), 1.0, False, least_variance(y, 1.0)) for y in outputs), model.which)
    ends: list[_Found] = []
    cleaned = [y for y, _ in model.recordings]
    for turn in ("as they are", "without outliers"):
        stage(f"{model.order} states, search from long autoregressions, outputs {turn}")
        for start in _starts(model, cleaned):
            end = _Found(model, start, first).descended(_FIRST_STEPS)
            ends.append(end._replace(noise=end.noise.learnt().refitted(end.residual, 30)))
        if not ends:
            raise ValueError(f"y: expected a recording long enough for a start of order {model.order}; record more")
        best = max(ends, key=lambda end: end.log_likelihood)
        cleaned = best.cleaned()
    if influence is not None:
        asked = tuple(replace(one, influence=influence) for one in best.noise.parts)
        best = best._replace(noise=best.noise._replace(parts=asked))
    best = best.descended()
    return _with_disturbance(whole, best) if whole.disturbance else best


def _starts(model: StateSpaceResiduals, cleaned: list[Array]) -> list[Array]:
    """Return the starts from long autoregressions that there are."""
    starts = [predictor_start(model, cleaned, reach) for reach in _REACHES]
    return [start for start in starts if start is not None]


def _with_disturbance(model: StateSpaceResiduals, fit: _Found) -> _Found:
    """Return the end of the search with a K, the weights of the innovations in turns with the parameters."""
    zero = model.packed(fit.model.matrices(fit.q), fit.q[fit.model.shared :])
    ends = []
    for start in (zero, *_starts(model, fit.cleaned())):
        end = fit._replace(model=model, q=start)
        for _ in range(_TURNS):
            end = end.reweighed().descended(_FIRST_STEPS)
        ends.append(end)
    best = max(ends, key=lambda end: end.log_likelihood)
    for _ in range(2 * _TURNS):
        best = best.reweighed()
        before, best = best.log_likelihood, best.descended()
        if abs(best.log_likelihood - before) < 1e-3:
            break
    return best


def _in_units(fit: _Found, units: Units, recording: Recording, rest: Array, structure: StateSpace) -> StateSpaceModel:
    """Return the model in a balanced basis, for the recordings as they were measured."""
    one, p = fit.model.matrices(fit.q), fit.model.outputs
    T = balancing(one.A, one.B, one.C)
    inverse = np.linalg.inv(T)
    own = fit.q[fit.model.shared :].reshape(len(recording.spans), -1)
    Sy, Su = units.y, 1.0 / units.u
    matrices = Matrices(
        inverse @ one.A @ T, inverse @ one.B * Su, Sy[:, None] * (one.C @ T), Sy[:, None] * one.D * Su,
        inverse @ one.K / Sy, one.start, one.level,
    )  # fmt: skip
    levels = own[:, :p] * Sy + units.levels()
    parts = [(recording.y[part], recording.u[part] - rest) for part in recording.spans]
    model = StateSpaceResiduals(fit.model.order, parts, structure.feedthrough, structure.disturbance)
    model.weights = fit.model.weights
    q, rows = model.packed(matrices, np.hstack((levels, own[:, p:] @ inverse.T))), model.rows
    scaled = tuple(one.times(size) for one, size in zip(fit.noise.parts, Sy, strict=True))
    noise, residual = fit.noise._replace(parts=scaled), model.residuals(q)[rows]
    P, colour = sandwich(model.jacobian(q)[rows], residual, noise, model.shared)
    total = rows.sum() / max(rows.sum() - fit.free, 1)
    s, last = model.shared, slice(model.n - model.order - p, model.n - model.order)
    final = model.matrices(q)
    return StateSpaceModel(
        structure=replace(structure, n=model.order), A=final.A, B=final.B, C=final.C, D=final.D, K=final.K,
        level=final.level, P=P[:s, :s], level_std=np.sqrt(np.maximum(P.diagonal()[last], 0.0)),
        noise=tuple(replace(one, R=one.R * total) for one in scaled),
        weights=np.vstack(model.believed(q, noise, np.nan)),
        log_likelihood=noise.log_likelihood(residual), warning=_doubt(fit), end=model.states(q, -1)[-1],
        operating_point=rest, dt=recording.axis.dt, levels=levels, colour=colour,
    )  # fmt: skip


def _doubt(fit: _Found) -> str:
    """Say what makes the estimate doubtful, or nothing."""
    root = np.sqrt(fit.noise.weights(fit.residual) / fit.noise.variance)
    J = fit.model.jacobian(fit.q)[fit.model.rows] * root[:, None]
    rank, expected = rank_of(J, 1e-6), fit.model.n - fit.model.order**2
    if rank < expected:
        return (
            f"the recording tells {rank} of {expected} parameters: the order {fit.model.order} may be more than it "
            'shows, StateSpace("auto") finds one'
        )
    if not (fit.converged or all(one.is_rounding for one in fit.noise.parts)):
        return "the search did not settle; the order may be more than the recording tells of"
    return ""


# Physics.


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
            model, residual = _of_physics(structure, recording._replace(y=outputs - own, u=u), influence)
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
    return search.concluded(best, (*recording.findings, *best.findings, *left))


def _of_physics(structure: GreyBox, recording: Recording, influence: Influence | None) -> tuple[GreyBoxModel, Array]:
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
    return _as_physics(structure, model, end, limits), residual


def _as_physics(structure: GreyBox, model: GreyResiduals, end: Any, limits: Limits) -> GreyBoxModel:
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
