"""A recording through `RobustKalmanFilter` with F = I: `ParameterTracker.update` without what it costs to call it.

The numbers are those of `update`, to the last bit. It serves where numba is not installed, and short recordings.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.scalar import correct_scalar
from robust_filterpy.identification._conditioning import SHARP, repaired, tempering
from robust_filterpy.identification._regressor import Layout, Memory, bounded, gradient
from robust_filterpy.identification.guard import is_stable, restrained


class Rules(NamedTuple):
    """What a tracker does to each sample, fixed for a recording."""

    uses_model_output: bool
    filtered: bool
    guard: str
    windup: float


class Columns(NamedTuple):
    """The columns of a `TrackingResult` while they are being filled; variance is diag P."""

    theta: Array
    variance: Array
    prediction: Array
    residual: Array
    weights: Array
    guard: np.ndarray

    @classmethod
    def empty(cls, length: int, n: int) -> Columns:
        """Return columns for a recording."""
        theta, variance = np.empty((length, n)), np.empty((length, n))
        prediction, residual, weights = np.full((3, length), np.nan)
        return cls(theta, variance, prediction, residual, weights, np.zeros(length, dtype=np.int64))


class Noise(NamedTuple):
    """Covariances of a filter: of a step of theta, of the measurements, (1,) or (N,); and the factor that forgets."""

    Q: Any
    r: Array
    alpha_sq: float


def run_lean(
    layout: Layout,
    rules: Rules,
    choices: Choices,
    noise: Noise,
    memory: Memory,
    x: Array,
    P: Array,
    y: Array,
    u: Array,
    out: Columns,
) -> tuple[Array, Array]:
    """Advance x, P and the memory through a recording, fill the columns, return x and P."""
    length, na, nc, order, part = len(y), layout.na, layout.nc, layout.order, layout.part
    phi, inputs = memory.regressors(layout, u)
    # Newest first, so that what phi needs is one contiguous piece that moves by one place a sample.
    outputs = np.concatenate((np.zeros(length), memory.outputs))
    residuals = np.concatenate((np.zeros(length), memory.residuals))
    filtered = rules.filtered and part is not None
    gradients = np.concatenate((np.zeros((length, layout.n)), memory.gradients)) if filtered else memory.gradients
    Q, variances, alpha_sq = noise
    # numpy multiplies by a matrix in half the time that it takes to make something of a number.
    growth = np.full(P.shape, alpha_sq)
    # More than the trace of P, which corrections only make smaller; worked out anew where it matters.
    trace, added = 2.0 * P.trace(), 2.0 * np.trace(Q)
    drifts, guarded, model_output = bool(np.any(Q)), rules.guard != "none", rules.uses_model_output
    theta, variance, prediction, residual, weights, guard = out
    first_residual = layout.n - nc
    complete = not np.isnan(y).any()
    if na and complete and not model_output:
        # Nothing of phi's first part waits for the recursion.
        outputs[:length] = -y[::-1]
        phi[:, :na] = sliding_window_view(outputs[1:], na)[::-1][:length]
    waits, column = bool(na) and (model_output or not complete), x.ndim == 2
    known = not (filtered or nc or waits)
    squares = np.einsum("ij,ij->i", phi, phi).tolist() if known else []
    k = 0
    try:
        samples = zip(y.tolist(), phi[:, None, :], np.broadcast_to(variances, length).tolist(), strict=True)
        for k, (measured, H, r) in enumerate(samples):
            at = length - k
            if waits:
                H[0, :na] = outputs[at : at + na]
            if nc:
                H[0, first_residual:] = residuals[at : at + nc]
            if alpha_sq == 1.0:
                if drifts:
                    P = P + Q
                    trace += added
            elif trace <= rules.windup or P.trace() <= rules.windup:
                P = P * growth
                if drifts:
                    P += Q
                trace = trace * alpha_sq + added
            predicted = H.dot(x).item()
            prediction[k] = predicted
            if filtered:
                past = x.ravel()[part]
                psi = H[0]
                if guarded or is_stable(past.tolist()):
                    psi = gradient(psi, past, gradients[at : at + order])
                gradients[at - 1] = psi
            if measured == measured:
                difference = measured - predicted
                G, factor, sharp = H, 1.0, False
                if filtered:
                    G = psi[None, :]
                if (squares[k] if known else G[0].dot(G[0])) * trace > SHARP * r:
                    exact = P.trace()
                    square, trace = G[0].dot(G[0]), 2.0 * exact
                    sharp, factor = square * exact > SHARP * r, tempering(square, exact, r)
                if filtered or factor < 1.0:
                    G = G * factor
                    along = G.dot(x).item()
                    last = correct_scalar(x, P, (difference * factor + along) - along, G, r, choices)
                else:
                    last = correct_scalar(x, P, difference, H, r, choices)
                moved = last.x
                P = repaired(last.P) if sharp else last.P
                residual[k] = difference
                weights[k] = last.psi / last.e if last.e != 0.0 else 1.0
            else:
                moved = x
            if part is not None:
                restricted, guard[k] = restrained(moved.ravel(), x.ravel(), part, rules.guard)
                moved = restricted.reshape(x.shape)
            x = moved
            if waits:
                if model_output:
                    outputs[at - 1] = -bounded(H.dot(x).item())
                else:
                    outputs[at - 1] = -(measured if measured == measured else bounded(predicted))
            if nc and measured == measured:
                residuals[at - 1] = bounded(measured - H.dot(x).item())
            theta[k] = x[:, 0] if column else x
            variance[k] = P.diagonal()
    except (ValueError, np.linalg.LinAlgError) as error:
        error.args = (f"sample {k}: {error}", *error.args[1:])
        raise
    memory.outputs, memory.residuals, memory.inputs = outputs[:na].copy(), residuals[:nc].copy(), inputs
    if filtered:
        memory.gradients = gradients[:order].copy()
    return x, P
