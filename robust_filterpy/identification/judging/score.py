"""Correlations of what a model leaves with what it should not depend on, and how large they are by chance.

Residuals e are tested through v = psi(e), which is bounded, so that outliers change neither the correlations nor their
bounds. With the columns of Z the earlier v, or the inputs at each lag, the covariance of Z'v has two parts (v before
the parameters were fitted has the covariance Gamma; J are the derivatives of the prediction, P is the covariance of the
parameters)::

    Z' M Gamma M Z                          for the recording that the model was made from, M = I - J (J'J)^-1 J'
    Z' Gamma Z + E[psi']^2 Z' J P J' Z      for another one

The portmanteau statistic c' Cov(c)^-1 c, c = Z'v, leaves out the directions that the fit has made zero (Ljung, System
Identification, 2nd ed., 1999, section 16.6; Davies, Triggs and Newbold, Biometrika 64, 1977). Where v is not white,
Gamma in the test against the input has its autocorrelations.

Of several outputs the residuals are those of all, each in units of its noise, and Z stands in the rows of one of them.
What every recording tells anew, the start, is in M for another recording too.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.signal import fftconvolve, lfilter
from scipy.stats import chi2, norm

from robust_filterpy._checks import Array
from robust_filterpy.identification.estimation.cleaning import cleaned
from robust_filterpy.identification.models.grey_box import GreyBoxModel
from robust_filterpy.identification.models.model import Model, as_model
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.results import signals_of
from robust_filterpy.identification.models.signals import recorded_output
from robust_filterpy.identification.models.state_space import StateSpaceModel
from robust_filterpy.influence.regression import mad_scale

# A residual believed by less than this share left a prediction in its place, which touches those after it where its
# response is above the other; unless that leaves too few of them.
_BELIEVED: Final = 0.5
_TOUCH: Final = 0.1
_LONGEST_REACH: Final = 50
_LEAST_CLEAR: Final = 0.1
# A direction of which the fit leaves less than this share of the variance is one that it has made zero.
_LEFT: Final = 0.1
# Weights of the samples as alike as this belong to the same recording; those of two recordings have a correlation of 0.
_SAME_RECORDING: Final = 0.7
# A mean residual of more standard deviations than this is a level that the model has not.
_FAR: Final = 3.0
# Directions of the parameters that move no residual by more than this share of the others, as a change of basis.
_NOTHING: Final = 1e-8


def any_model(name: str, given: Any, y: Any, u: Any) -> Any:
    """Return a model that can be judged, made of a transfer function if it is one, or raise."""
    if isinstance(y, (list, tuple)):
        shapes = {np.shape(row) for row in y}
        if len(shapes) > 1 or any(len(shape) > 1 or 1 < len(y) < shape[0] for shape in shapes if shape):
            raise ValueError("y: expected one recording, got a list of several; judge the model on each")
    return given if isinstance(given, (StateSpaceModel, GreyBoxModel)) else as_model(name, given, y, u)


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
    def of(cls, model: Any, y: Any, u: Any, t: Any) -> Judged:
        """Return what is judged of a model on a recording."""
        if not isinstance(model, Model):
            return _of_outputs(model, *model.started(y, u, t))
        return _of_one(model, *signals_of(model, y, u, t)[1:])


def _of_one(model: Model, y: Any, u: Any) -> Judged:
    """Return what is judged of a model with one output."""
    (prepared, measured), residual = model.prepared(y, u), model.residuals(y, u)
    seen: Any = ~np.isnan(residual)
    e, clean = np.where(seen, residual, 0.0), cleaned(model, y, u)
    clear = _untouched(_memory(model), seen[:, None], model.noise.weights(e)[:, None])[:, 0]
    clear = seen & (clear if clean is None else clean.clear)
    tested = np.where(clear, e if clean is None else clean.residual, np.nan)
    n, P = model.theta.size + model.has_offset, model.P
    if model.has_offset:
        cross = model.offset_covariance[:, None]
        P = np.block([[P, cross], [cross.T, np.full((1, 1), model.offset_std**2)]])
    # The fit has seen those rows too that are not tested; outliers in the regressor are replaced.
    whole = model.without_outliers(prepared, measured) if clean is None else clean.prepared
    J = np.zeros((residual.size, n))
    J[whole.first :] = whole.jacobian(np.concatenate((model.theta, [model.offset], np.zeros(whole.nf))))[:, :n]
    J *= seen[:, None]
    return Judged(
        recorded_output(y)[:, None], residual[:, None], tested[:, None], prepared.u, (model.noise,),
        model.weights[:, None], J[:, None], P, True,
    )  # fmt: skip


def _of_outputs(model: Any, measured: Array, signal: Array, predictor: Any, q: Array) -> Judged:
    """Return what is judged of states, or of physics, which predict from inputs alone however far ahead."""
    seen, k = ~np.isnan(measured), model.theta.size
    residual = np.where(seen, predictor.residuals(q).reshape(measured.shape), np.nan)
    weights = np.column_stack([one.weights(e) for one, e in zip(model.noise, np.nan_to_num(residual).T, strict=True)])
    J = predictor.jacobian(q).reshape(*residual.shape, -1) * seen[:, :, None]
    P = np.diag(np.full(q.size, np.inf))
    P[:k, :k] = model.P
    levelled = isinstance(model, StateSpaceModel)
    if not levelled:
        slope = predictor.p.slope(q[:k])
        J[:, :, :k] *= np.divide(1.0, slope, out=np.zeros(k), where=slope != 0.0)
    memory = _memory_of_states(model) if levelled else np.zeros((0, 1, 1))
    tested = np.where(_untouched(memory, seen, weights), residual, np.nan)
    return Judged(measured, residual, tested, signal, model.noise, model.weights, J, P, levelled)


def _memory(model: Model) -> Array:
    """Return what an innovation that is not believed does to the residuals after it, shape (lags, 1, 1)."""
    parts = model.parts
    impulse = np.concatenate(([1.0], np.zeros(_LONGEST_REACH)))
    return np.asarray(lfilter(np.convolve(parts.a, parts.d), parts.c, impulse))[1:, None, None]


def _memory_of_states(model: StateSpaceModel) -> Array:
    """Return the same for several outputs, each in units of its noise, shape (lags, p, p)."""
    size, x, responses = np.sqrt(model.R), model.K, []
    for _ in range(_LONGEST_REACH if model.K.any() else 0):
        responses.append(model.C @ x * size / size[:, None])
        x = (model.A - model.K @ model.C) @ x
    return np.array(responses).reshape(-1, size.size, size.size)


def _untouched(memory: Array, seen: Any, weights: Array) -> Any:
    """Return which residuals no outlier or gap before them reaches: what stands in its place is wrong for a while."""
    # Two residuals after the same outlier share that error, and would look as if the noise were not white.
    doubtful = (~seen | (weights < _BELIEVED)).astype(float)
    reached = np.zeros(seen.shape)
    for i, j in np.ndindex(memory.shape[1:]):
        above = np.flatnonzero(np.abs(memory[:, i, j]) > _TOUCH)
        if above.size:
            window = np.concatenate(([0.0], np.ones(above[-1] + 1)))
            reached[:, i] += np.convolve(doubtful[:, j], window)[: len(seen)]
    clear = reached < 0.5
    enough = (clear & seen).sum(axis=0) >= _LEAST_CLEAR * seen.sum(axis=0)
    return clear | ~enough


class Portmanteau(NamedTuple):
    """All correlations in one number.

    Attributes
    ----------
    statistic : float
        Chi-squared distributed if the model is right.
    degrees : int
        Its degrees of freedom; 0 if the fit has used all of them.
    p_value : float
        Probability of a statistic as large, if the model is right.
    """

    statistic: float
    degrees: int
    p_value: float


class Score(NamedTuple):
    """psi of the residuals of N samples of p outputs, and how the parameters enter."""

    v: Array  # psi in units of the noise, 0 where there is none, shape (N, p).
    seen: Any  # Where there is one.
    J: Array  # Derivatives of the residuals in the same units, shape (N, p, k).
    slope: Array  # E[psi'] of each output.
    P: Array  # Covariance of the parameters that this recording does not estimate.
    basis: Array  # Directions of the residuals that were fitted to it, shape (N, p, r).
    same_recording: bool  # Whether it is the one that the model was made from.
    shift: Array  # How far the level of each output is from the model's, 0 if it may be the same.

    @classmethod
    def of(cls, judged: Judged) -> Score:
        """Return the score of a model on a recording."""
        seen: Any = ~np.isnan(judged.tested)
        v, slope, J = np.zeros(seen.shape), np.ones(seen.shape[1]), judged.J.copy()
        shift, e = np.zeros(seen.shape[1]), judged.tested.copy()
        believed = np.column_stack(
            [one.weights(left) for one, left in zip(judged.noise, judged.residual.T, strict=True)]
        )
        same = judged.weights.shape == believed.shape and _alike(judged.weights, believed)
        for j, (noise, rows) in enumerate(zip(judged.noise, seen.T, strict=True)):
            middle = float(np.median(e[rows, j]))
            if judged.levelled and abs(middle) > _FAR * np.sqrt(noise.R):
                shift[j], e[:, j] = middle, e[:, j] - middle
            if not same:
                noise = _of_recording(noise, e[rows, j])
            # What is left of a recording without noise is rounding, which is alike from sample to sample.
            v[rows, j] = 0.0 if noise.is_rounding else noise.psi(e[rows, j])
            v[rows, j] -= v[rows, j].mean() if judged.levelled else 0.0
            slope[j] = noise.slope(e[rows, j])
            J[:, j] /= np.sqrt(noise.R)
        estimated = np.isinf(judged.P.diagonal()) | same
        basis = _directions(J[:, :, estimated] * np.sqrt(slope)[:, None])
        return cls(v, seen, J, slope, np.where(np.outer(~estimated, ~estimated), judged.P, 0.0), basis, same, shift)

    def tested(self, j: int, Z: Array, kernel: Array, level: float) -> tuple[Array, Array, Portmanteau]:
        """Return correlations of v of an output with the columns of Z, their bounds, and all of them in one number."""
        seen, v = self.seen[:, j], self.v[:, j]
        Z = np.where(seen[:, None], Z, 0.0)
        c, gram = Z.T @ v, Z.T @ Z
        variances = np.square(self.v).sum(axis=0) / np.maximum(self.seen.sum(axis=0), 1)
        shadow = self.basis[:, j].T @ Z
        covariance, entering = np.zeros(gram.shape), np.zeros((Z.shape[1], self.J.shape[2]))
        for i, ratio in enumerate(self.slope[j] / self.slope):
            W = (Z if i == j else 0.0) - np.sqrt(ratio) * (self.basis[:, i] @ shadow)
            covariance += variances[i] * (W.T @ (W if i != j or kernel.size == 1 else _smeared(W, kernel)))
            entering += self.slope[i] * (W.T @ self.J[:, i])
        covariance += entering @ self.P @ entering.T
        variance = variances[j]
        size = np.sqrt(np.maximum(variance * seen.sum() * gram.diagonal(), np.finfo(float).tiny))
        share = np.maximum(covariance.diagonal(), _LEFT * variance * gram.diagonal())
        bound = float(norm.ppf(0.5 + 0.5 * level)) * np.sqrt(share) / size
        return c / size, bound, _portmanteau(c, covariance, variance * gram)


def _of_recording(noise: Noise, e: Array) -> Noise:
    """Return the noise that these residuals show: to the model's all that a wrong one leaves is wild."""
    return noise if noise.known else replace(noise, R=max(mad_scale(e) ** 2, noise.least)).settled(e)


def _portmanteau(c: Array, covariance: Array, full: Array) -> Portmanteau:
    """Return c' Cov(c)^-1 c in the directions of which the fit has left enough."""
    size = float(np.trace(full)) / len(full)
    # Residuals that are rounding have no correlations.
    if not size > np.finfo(float).tiny:
        return Portmanteau(0.0, 0, 1.0)
    c, covariance, full = c / np.sqrt(size), covariance / size, full / size
    left, directions = eigh(covariance, full + 1e-10 * np.eye(len(full)))
    enough = left > _LEFT
    statistic = float(np.sum((directions.T @ c)[enough] ** 2 / left[enough]))
    degrees = int(enough.sum())
    return Portmanteau(statistic, degrees, float(chi2.sf(statistic, degrees)) if degrees else 1.0)


def delayed(signals: Array, lags: range) -> Array:
    """Return each signal delayed by each lag, 0 before its start; the lags of the first signal first."""
    columns = np.zeros((len(signals), signals.shape[1] * len(lags)))
    for i, signal in enumerate(signals.T):
        for j, lag in enumerate(lags):
            columns[lag:, i * len(lags) + j] = signal[: len(signal) - lag]
    return columns


def covariances(v: Array, lags: int) -> Array:
    """Return the autocorrelations of v at -lags .. lags with Bartlett's taper, which keeps them positive definite."""
    rho = np.array([v[lag:] @ v[: v.size - lag] for lag in range(lags + 1)]) / max(v @ v, np.finfo(float).tiny)
    rho *= 1.0 - np.arange(lags + 1) / (lags + 1)
    return np.concatenate((rho[:0:-1], rho))


def _smeared(W: Array, kernel: Array) -> Array:
    """Return Gamma W for noise with these autocorrelations."""
    return np.asarray(fftconvolve(W, kernel[:, None], mode="same", axes=0))


def _directions(J: Array) -> Array:
    """Return orthonormal directions that derivatives of all outputs together span, shape (N, p, r)."""
    flat = J.reshape(J.shape[0] * J.shape[1], J.shape[2])
    size = np.linalg.norm(flat, axis=0)
    left, values, _ = np.linalg.svd(flat / np.where(size == 0.0, 1.0, size), full_matrices=False)
    return np.asarray(left[:, values > _NOTHING * values.max(initial=0.0)].reshape(*J.shape[:2], -1))


def _alike(weights: Array, others: Array) -> bool:
    """Tell whether these are the weights of the same samples."""
    both = ~np.isnan(weights) & ~np.isnan(others)
    a, b = weights[both], others[both]
    if a.size < 2 or np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return False
    return bool(np.corrcoef(a, b)[0, 1] > _SAME_RECORDING)
