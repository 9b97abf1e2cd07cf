"""identify for `StateSpace`: starts, the least robust loss with a noise for each output, and the order by evidence."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.signal import dlsim

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.identification.estimation.disturbances import Explanation, Search, of_impulses
from robust_filterpy.identification.estimation.estimate import Units
from robust_filterpy.identification.estimation.prediction_error import (
    Limits,
    evidence_of_outputs,
    minimised,
    one_thread,
    sandwich,
)
from robust_filterpy.identification.estimation.starts import predictor_start
from robust_filterpy.identification.models.noise import Noise, Noises, least_variance
from robust_filterpy.identification.models.recording import ANY_COLUMNS, Recording, recorded, require_motion
from robust_filterpy.identification.models.responses import balancing
from robust_filterpy.identification.models.signals import fingerprint, operating_point
from robust_filterpy.identification.models.state_space import Matrices, StateSpace, StateSpaceModel, StateSpaceResiduals
from robust_filterpy.influence.functions import Huber, Influence

_REACHES: Final = (3, 6, 15)
_FIRST_STEPS: Final = 12
_TURNS: Final = 4
# Orders tried after the best one.
_PATIENCE: Final = 2
_BELIEVED: Final = 0.5
_RANK: Final = 1e-9


class _Found(NamedTuple):
    """Where the search for one order ended, in units of the recordings' scales."""

    model: StateSpaceResiduals
    q: Array
    noise: Noises
    rows: Any
    converged: bool

    @property
    def log_likelihood(self) -> float:
        """Of the outputs that are measured."""
        return self.noise.log_likelihood(self.model.residuals(self.q)[self.rows])

    @property
    def free(self) -> int:
        """Parameters that a change of basis leaves, without the starts."""
        return self.model.shared - self.model.order**2 + len(self.model.recordings) * self.model.outputs

    @property
    def criterion(self) -> float:
        """Its information criterion."""
        return -2.0 * self.log_likelihood + np.log(self.rows.sum()) * self.free


def identified_state_space(
    y: Any, u: Any, structure: StateSpace, influence: Influence | None = None, groups: Any = None, trend: str = "breaks"
) -> StateSpaceModel:
    """Find a state-space model of recordings of several outputs."""
    if u is None:
        raise ValueError("u: expected a recording of the inputs for a state-space model, got None")
    recording = recorded(ANY_COLUMNS, y, u, groups)
    require_motion(recording.y, recording.u)
    spans = recording.spans

    def each(y: Array, u: Array, of: Any) -> Array:
        return np.concatenate([of(y[part], u[part]) for part in spans])

    def find(u: Array, levels: Array, columns: Any, end: Any) -> Explanation:
        model = _modelled(recording._replace(y=recording.y - levels, u=u), spans, structure, influence)
        left = each(recording.y - levels, u, model.residuals)
        return Explanation(model, levels, u, evidence_of_outputs(model.noise, left, spans))

    search = Search(
        recording.y, recording.u, spans, find, lambda model, y, u: each(y, u, model.free_run),
        lambda u, plain: [of_impulses(recording.y, u, spans)], index=recording.axis.index,
    )  # fmt: skip
    with one_thread():
        best = search.best(trend)
        model, y, u = best.model, recording.y - best.levels, best.u
        output = each(y, u, model.free_run)
        left = search.left(
            best, output, each(y, u, model.residuals), model.operating_point, structure.feedthrough,
            "K is unbiased only as far as it is right about the noise" if structure.disturbance
            else "it is biased by that unless the noise is white: disturbance=True models the noise",
            _driven(model, output),
        )  # fmt: skip
    trends = tuple((fingerprint(recording.y[part]), best.levels[part]) for part in spans if best.levels[part].any())
    return replace(model, findings=(*recording.findings, *best.findings, *left), trends=trends)


def _modelled(
    recording: Recording, spans: tuple[slice, ...], structure: StateSpace, influence: Influence | None
) -> StateSpaceModel:
    """Return the model of recordings as they are."""
    rest, units, parts, measured = _scaled(recording, spans)
    orders = structure.orders
    _require_informative(structure, parts, measured, min(orders))
    tried: list[_Found] = []
    for n in orders:
        if tried and not _enough(structure, parts, measured, n):
            break
        tried.append(_searched(structure, n, parts, measured, influence))
        best = int(np.argmin([fit.criterion for fit in tried]))
        if len(tried) - 1 - best == _PATIENCE:
            break
    one = tried[best].model.matrices(tried[best].q)
    T = balancing(one.A, one.B, one.C)
    model = _in_units(tried[best], T, units, recording, spans, measured, rest, structure)
    return replace(model, orders=tuple((n, fit.criterion) for n, fit in zip(orders, tried, strict=False)))


def _driven(model: StateSpaceModel, output: Array) -> Array:
    """Return an output's deviations as they stand in the innovations, shape (N, p)."""
    deviation = output - output.mean(axis=0)
    if not model.structure.disturbance:
        return deviation
    system = (model.A - model.K @ model.C, model.K, -model.C, np.eye(deviation.shape[1]), 1.0)
    return np.asarray(dlsim(system, deviation)[1])


def _scaled(recording: Recording, spans: Any) -> tuple[Array, Units, list[tuple[Array, Array]], list[Any]]:
    """Return where inputs rest, the units, recordings in these, and what of them is measured; outputs must vary."""
    rest = operating_point(recording.u)
    for i, part in enumerate(spans):
        for j in np.flatnonzero(np.isnan(recording.y[part]).all(axis=0)):
            raise ValueError(f"y: expected some measured samples of output {j} in recording {i}, got none")
    units = Units.of(recording.y, recording.u - rest, spans)
    for j in np.flatnonzero(units.y <= 1e-12 * np.abs(units.centre).max(axis=0)):
        raise ValueError(f"y: expected outputs that vary, got the same value throughout in output {j}")
    y, u = units.normal(recording.y), (recording.u - rest) / units.u
    return rest, units, [(y[part], u[part]) for part in spans], [~np.isnan(recording.y[part]) for part in spans]


def _first_noise(model: StateSpaceResiduals, rows: Any, influence: Influence | None) -> Noises:
    """Return the noise of each residual that counts to begin with."""
    which = np.concatenate([np.tile(np.arange(model.outputs), len(y)) for y, _ in model.recordings])[rows]
    outputs = np.concatenate([y for y, _ in model.recordings]).T
    return Noises(tuple(Noise(influence or Huber(), 1.0, False, least_variance(y, 1.0)) for y in outputs), which)


def _enough(structure: StateSpace, parts: Any, measured: Any, n: int) -> bool:
    """Tell whether there are twice as many measured outputs as free parameters."""
    p, m = parts[0][0].shape[1], parts[0][1].shape[1]
    free = n * (m + p + p * structure.disturbance) + p * m * structure.feedthrough + len(parts) * (p + n)
    return min(sum(int(good[:, j].sum()) for good in measured) for j in range(p)) * p >= 2 * free


def _require_informative(structure: StateSpace, parts: Any, measured: Any, n: int) -> None:
    """Raise unless the recordings are long enough and the inputs excite them."""
    samples = sum(len(y) for y, _ in parts)
    if not _enough(structure, parts, measured, n):
        raise ValueError(
            f"y: expected more samples for {structure} with {parts[0][0].shape[1]} outputs and {parts[0][1].shape[1]} "
            f"inputs, got {samples}; record more, or take a smaller order"
        )
    for i, (y, _) in enumerate(parts):
        if len(y) <= n + 1:
            raise ValueError(f"y: expected more than {n + 1} samples in each recording, got {len(y)} in recording {i}")
    lags = n + 1
    rows = [np.hstack([u[lags - 1 - j : len(u) - j] for j in range(lags)]) for _, u in parts if len(u) > lags]
    X = np.concatenate(rows)
    for i, column in enumerate(parts[0][1].T):
        if not any(part[1][:, i].any() for part in parts) or all(np.ptp(part[1][:, i]) == 0.0 for part in parts):
            raise ValueError(f"u: expected inputs that move the outputs, got input {i} constant: {column[0]:.6g}")
    X = X - X.mean(axis=0)
    values = np.linalg.svd(X / np.maximum(np.linalg.norm(X, axis=0), np.finfo(float).tiny), compute_uv=False)
    if values[-1] <= _RANK * values[0] or values.size < X.shape[1]:
        raise ValueError(
            f"u: expected inputs that together excite {structure} with order {lags}, got some that others explain; "
            "leave out an input that is a combination of others, vary them more, or take a smaller order"
        )


def _searched(structure: StateSpace, n: int, parts: Any, measured: Any, influence: Influence | None) -> _Found:
    """Search from every start."""
    model = StateSpaceResiduals(n, parts, structure.feedthrough, False)
    rows = np.concatenate([good.ravel() for good in measured])
    first = _first_noise(model, rows, influence)
    ends: list[_Found] = []
    cleaned = [y for y, _ in parts]
    for turn in ("as they are", "without outliers"):
        stage(f"{n} states, search from long autoregressions, outputs {turn}")
        starts = [predictor_start(model, measured, cleaned, reach) for reach in _REACHES]
        ends += [_descended(model, start, first, rows) for start in starts if start is not None]
        if not ends:
            raise ValueError(f"y: expected a recording long enough for a start of order {n}; record more")
        cleaned = _cleaned(max(ends, key=lambda end: end.log_likelihood), measured)
    best = max(ends, key=lambda end: end.log_likelihood)
    fit = _settled(best, influence)
    if not structure.disturbance:
        return fit
    return _with_disturbance(structure, fit, measured, influence)


def _descended(
    model: StateSpaceResiduals, start: Array, noise: Noises, rows: Any, limits: Limits | None = None
) -> _Found:
    """Return where a few steps from a start lead."""
    end = minimised(model, start, noise, rows, rows, _FIRST_STEPS, limits)
    return _Found(model, end.p, end.noise.learnt().refitted(end.residual[rows], 30), rows, end.converged)


def _settled(fit: _Found, influence: Influence | None, limits: Limits | None = None) -> _Found:
    """Return where the search ends with the noise learned, or with the loss that was asked for."""
    noise = fit.noise
    if influence is not None:
        noise = noise._replace(parts=tuple(replace(one, influence=influence) for one in noise.parts))
    end = minimised(fit.model, fit.q, noise, fit.rows, fit.rows, limits=limits)
    return fit._replace(q=end.p, noise=end.noise, converged=end.converged)


def _cleaned(fit: _Found, measured: Any) -> list[Array]:
    """Return outputs with what the model says in the place of outliers and gaps."""
    residual, outputs, begin = fit.model.residuals(fit.q), [], 0
    weights = np.zeros(residual.size)
    weights[fit.rows] = fit.noise.weights(residual[fit.rows])
    for y, _ in fit.model.recordings:
        part = slice(begin, begin + y.size)
        begin += y.size
        own = residual[part].reshape(y.shape)
        outputs.append(np.where(weights[part].reshape(y.shape) > _BELIEVED, y, y - own))
    return outputs


def _with_disturbance(structure: StateSpace, fit: _Found, measured: Any, influence: Influence | None) -> _Found:
    """Return the end of the search with a K, the weights of the innovations in turns with the parameters."""
    n, parts = fit.model.order, fit.model.recordings
    model = StateSpaceResiduals(n, parts, structure.feedthrough, True)
    one = fit.model.matrices(fit.q)
    own = fit.q[fit.model.shared :].reshape(len(parts), -1)
    zero = model.packed(one, own[:, : model.outputs], own[:, model.outputs :])
    cleaned = _cleaned(fit, measured)
    starts = [zero] + [s for reach in _REACHES if (s := predictor_start(model, measured, cleaned, reach)) is not None]
    ends = []
    for start in starts:
        model = StateSpaceResiduals(n, parts, structure.feedthrough, True)
        model.weights = [good.astype(float) for good in measured]
        end = fit._replace(model=model, q=start)
        for _ in range(_TURNS):
            _weigh(end, measured)
            done = minimised(model, end.q, end.noise, end.rows, end.rows, _FIRST_STEPS)
            end = end._replace(q=done.p, noise=done.noise, converged=done.converged)
        ends.append(end)
    best = max(ends, key=lambda end: end.log_likelihood)
    for _ in range(2 * _TURNS):
        _weigh(best, measured)
        before = best.log_likelihood
        done = minimised(best.model, best.q, best.noise, best.rows, best.rows)
        best = best._replace(q=done.p, noise=done.noise, converged=done.converged)
        if abs(best.log_likelihood - before) < 1e-3:
            break
    return best


def _weigh(fit: _Found, measured: Any) -> None:
    """Let outliers and gaps not enter the states."""
    for _ in range(2):
        residual = fit.model.residuals(fit.q)
        weights = np.zeros(residual.size)
        weights[fit.rows] = fit.noise.weights(residual[fit.rows])
        ends = np.cumsum([good.size for good in measured])[:-1]
        fit.model.weights = [w.reshape(good.shape) for w, good in zip(np.split(weights, ends), measured, strict=True)]


def _in_units(
    fit: _Found, T: Array, units: Units, recording: Recording, spans: Any, measured: Any, rest: Array,
    structure: StateSpace,
) -> StateSpaceModel:  # fmt: skip
    """Return the model in another basis, for the recordings as they were measured."""
    one, n, p = fit.model.matrices(fit.q), fit.model.order, fit.model.outputs
    inverse = np.linalg.inv(T)
    own = fit.q[fit.model.shared :].reshape(len(spans), -1)
    Sy, Su = units.y, 1.0 / units.u
    matrices = Matrices(
        inverse @ one.A @ T, inverse @ one.B * Su, Sy[:, None] * (one.C @ T), Sy[:, None] * one.D * Su,
        inverse @ one.K / Sy, one.start, one.level,
    )  # fmt: skip
    levels = own[:, :p] * Sy + units.levels()
    starts = own[:, p:] @ inverse.T
    parts = [(np.nan_to_num(recording.y[part]), recording.u[part] - rest) for part in spans]
    model = StateSpaceResiduals(n, parts, structure.feedthrough, structure.disturbance)
    model.weights = fit.model.weights
    q, rows = model.packed(matrices, levels, starts), fit.rows
    residual = model.residuals(q)
    scaled = tuple(one.times(size) for one, size in zip(fit.noise.parts, Sy, strict=True))
    noise = fit.noise._replace(parts=scaled)
    P, colour = sandwich(model.jacobian(q)[rows], residual[rows], noise, model.shared)
    weights = np.full(residual.size, np.nan)
    weights[rows] = noise.weights(residual[rows])
    total = rows.sum() / max(rows.sum() - fit.free, 1)
    s, last = model.shared, slice(model.n - n - p, model.n - n)
    final = model.matrices(q)
    return StateSpaceModel(
        structure=replace(structure, n=n), A=final.A, B=final.B, C=final.C, D=final.D, K=final.K, level=final.level,
        P=P[:s, :s], level_std=np.sqrt(np.maximum(P.diagonal()[last], 0.0)),
        noise=tuple(replace(one, R=one.R * total) for one in scaled), weights=weights.reshape(-1, p),
        log_likelihood=noise.log_likelihood(residual[rows]), warning=_doubt(fit), end=model.states(q, -1)[-1],
        operating_point=rest, dt=recording.axis.dt, levels=levels, colour=colour,
    )  # fmt: skip


def _doubt(fit: _Found) -> str:
    """Say what makes the estimate doubtful, or nothing."""
    root = np.sqrt(fit.noise.weights(fit.model.residuals(fit.q)[fit.rows]) / fit.noise.variance)
    J = fit.model.jacobian(fit.q)[fit.rows] * root[:, None]
    size = np.linalg.norm(J, axis=0)
    values = np.linalg.svd(J / np.where(size > 0.0, size, 1.0), compute_uv=False)
    rank = int((values > 1e-6 * values[0]).sum())
    expected = fit.model.n - fit.model.order**2
    if rank < expected:
        return (
            f"the recording tells {rank} of {expected} parameters: the order {fit.model.order} may be more than it "
            'shows, StateSpace("auto") finds one'
        )
    if not (fit.converged or all(one.is_rounding for one in fit.noise.parts)):
        return "the search did not settle; the order may be more than the recording tells of"
    return ""
