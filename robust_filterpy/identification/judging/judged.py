"""What is judged of any kind of model on one recording: its residuals, and how the parameters enter them."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.signal import lfilter

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.estimation.cleaning import Cleaned, cleaned
from robust_filterpy.identification.models.grey_box_model import GreyBoxModel
from robust_filterpy.identification.models.grey_box_recording import ANY_TIMES
from robust_filterpy.identification.models.learnt_noise import Noise
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.signals import recorded_output
from robust_filterpy.identification.models.state_space import StateSpaceModel
from robust_filterpy.identification.models.time_axis import TimeAxis, recording
from robust_filterpy.identification.models.transfer_model import as_model

# A residual believed by less than this share left a prediction in its place, which touches those after it where its
# response is above the other; unless that leaves too few of them.
_BELIEVED: Final = 0.5
_TOUCH: Final = 0.1
_LONGEST_REACH: Final = 50
_LEAST_CLEAR: Final = 0.1
# Times whose steps differ by less than this share are equally far apart.
_EQUAL: Final = 0.05


def any_model(name: str, given: Any, y: Any, u: Any) -> Any:
    """Return a model that can be judged, made of a transfer function if it is one, or raise."""
    if isinstance(y, (list, tuple)):
        shapes = {np.shape(row) for row in y}
        if len(shapes) > 1 or any(len(shape) > 1 or 1 < len(y) < shape[0] for shape in shapes if shape):
            raise ValueError("y: expected one recording, got a list of several; judge the model on each")
    return given if isinstance(given, (StateSpaceModel, GreyBoxModel)) else as_model(name, given, y, u)


def signals_for(model: Any, y: Any, u: Any, t: Any) -> tuple[TimeAxis, tuple[Any, ...]]:
    """Return the time axis of a recording, and its signals as the methods of a model take them; or raise."""
    if isinstance(model, GreyBoxModel):
        return recording(ANY_TIMES, y=y, u=u)[0], (y, u, t)
    if t is not None:
        steps = np.diff(_checks.numbers("t", t))
        if steps.shape != (len(y) - 1,):
            raise ValueError(f"t: expected {len(y)} times like y, got shape {np.shape(t)}")
        usual = float(np.median(steps)) if steps.size else 0.0
        if not (usual > 0.0 and (np.abs(steps - usual) <= _EQUAL * usual).all()):
            raise ValueError("t: expected equal steps for a model in discrete time, got others; identify a GreyBox")
        TimeAxis(None, usual).require_period(model.dt)
    axis, y, u = recording(None if isinstance(model, StateSpaceModel) else model.structure, y=y, u=u)
    axis.require_period(model.dt)
    return axis, (y, u)


class Judged(NamedTuple):
    """A model on one recording of N samples with p outputs."""

    y: Array  # Measured outputs, NaN where they are missing, shape (N, p).
    residual: Array  # Less those predicted one step ahead.
    tested: Array  # Residuals whose correlations are judged, NaN where what came before spoils them.
    inputs: Array  # Shape (N, m).
    noise: tuple[Noise, ...]  # Of each output.
    weights: Array  # How much each sample of the model's own recording was believed, shape (.., p).
    J: Array  # Derivatives of the residuals by what was estimated, 0 where there is none, shape (N, p, k).
    P: Array  # Its covariance, infinite for what only this recording tells, as the start.
    levelled: bool  # Whether the model has a level, so that the mean of the residuals says nothing.

    @classmethod
    def of(cls, model: Any, signals: tuple[Any, ...]) -> Judged:
        """Return what is judged of a model, on signals that `signals_for` returned."""
        if isinstance(model, GreyBoxModel):
            return _of_physics(model, *signals)
        return (_of_states if isinstance(model, StateSpaceModel) else _of_one)(model, *signals)


def _of_one(model: Model, y: Any, u: Any) -> Judged:
    """Return what is judged of a model with one output."""
    measured, residual = recorded_output(y), model.residuals(y, u)
    known: Any = ~np.isnan(residual)
    e = np.where(known, residual, 0.0)
    found = cleaned(model, y, u)
    clear = _untouched(_memory(model), known[:, None], model.noise.weights(e)[:, None])[:, 0]
    clear = known & (clear if found is None else found.clear)
    tested = np.where(clear, e if found is None else found.residual, np.nan)
    n = model.theta.size
    P = np.zeros((n + model.has_offset, n + model.has_offset))
    P[:n, :n] = model.P
    if model.has_offset:
        P[:n, n] = P[n, :n] = model.offset_covariance
        P[n, n] = model.offset_std**2
    # The fit has seen those rows too that are not tested.
    J = _derivatives(model, residual, y, u, found) * known[:, None]
    return Judged(
        measured[:, None], residual[:, None], tested[:, None], model.prepared(y, u)[0].u, (model.noise,),
        model.weights[:, None], J[:, None], P, True,
    )  # fmt: skip


def _of_states(model: StateSpaceModel, y: Any, u: Any) -> Judged:
    """Return what is judged of a state-space model."""
    measured, signal = model.checked(y, u)
    told, q = model.started(measured, signal)
    known = ~np.isnan(measured)
    residual = np.where(known, told.residuals(q).reshape(measured.shape), np.nan)
    weights = np.column_stack([one.weights(e) for one, e in zip(model.noise, np.nan_to_num(residual).T, strict=True)])
    J = told.jacobian(q).reshape(*residual.shape, -1) * known[:, :, None]
    P = np.diag(np.full(q.size, np.inf))
    P[: told.shared, : told.shared] = model.P
    tested = np.where(_untouched(_memory_of_states(model), known, weights), residual, np.nan)
    return Judged(measured, residual, tested, signal, model.noise, model.weights, J, P, True)


def _of_physics(model: GreyBoxModel, y: Any, u: Any, t: Any) -> Judged:
    """Return what is judged of a physical model, which predicts from inputs alone however far ahead."""
    told, equations, z = model.started(y, u, t)
    shape, k = told.known.shape, model.theta.size
    measured = np.where(told.known, told.recording.y, np.nan)
    residual = np.where(told.known, equations.residuals(z).reshape(shape), np.nan)
    slope = equations.p.slope(z[:k])
    J = equations.jacobian(z).reshape(*shape, -1) * told.known[:, :, None]
    J[:, :, :k] *= np.divide(1.0, slope, out=np.zeros(k), where=slope != 0.0)
    P = np.diag(np.full(z.size, np.inf))
    P[:k, :k] = model.P
    return Judged(measured, residual, residual, told.recording.u, model.noise, model.weights, J, P, False)


def _memory(model: Model) -> Array:
    """Return what an innovation that is not believed does to the residuals after it, shape (lags, 1, 1)."""
    parts = model.parts
    impulse = np.concatenate(([1.0], np.zeros(_LONGEST_REACH)))
    return np.asarray(lfilter(np.convolve(parts.a, parts.d), parts.c, impulse))[1:, None, None]


def _memory_of_states(model: StateSpaceModel) -> Array:
    """Return the same for several outputs, each in units of its noise, shape (lags, p, p)."""
    size, x, found = np.sqrt(model.R), model.K, []
    for _ in range(_LONGEST_REACH if model.K.any() else 0):
        found.append(model.C @ x * size / size[:, None])
        x = (model.A - model.K @ model.C) @ x
    return np.array(found).reshape(-1, size.size, size.size)


def _untouched(memory: Array, known: Any, weights: Array) -> Any:
    """Return which residuals no outlier or gap before them reaches: what stands in its place is wrong for a while."""
    # Two residuals after the same outlier share that error, and would look as if the noise were not white.
    doubtful = (~known | (weights < _BELIEVED)).astype(float)
    reached = np.zeros(known.shape)
    for i, j in np.ndindex(memory.shape[1:]):
        above = np.flatnonzero(np.abs(memory[:, i, j]) > _TOUCH)
        if above.size:
            window = np.concatenate(([0.0], np.ones(above[-1] + 1)))
            reached[:, i] += np.convolve(doubtful[:, j], window)[: len(known)]
    clear = reached < 0.5
    enough = (clear & known).sum(axis=0) >= _LEAST_CLEAR * known.sum(axis=0)
    return clear | ~enough


def _derivatives(model: Model, residual: Array, y: Any, u: Any, whole: Cleaned | None) -> Array:
    """Return the derivatives of the residuals by theta and offset, outliers in the regressor replaced."""
    prepared, known = model.prepared(y, u)
    n = model.theta.size
    p = np.concatenate((model.theta, [model.offset], np.zeros(prepared.nf)))
    prepared = whole.prepared if whole is not None else model.without_outliers(prepared, known)
    J = np.zeros((residual.size, n + model.has_offset))
    J[prepared.first :] = prepared.jacobian(p)[:, : n + model.has_offset]
    return J
