"""Where to begin: parameters found without any, through outliers, for a search that only goes downhill.

* A long impulse response by robust regression, whose regressor holds no outlier; reduced to the order of the model by
  the singular values of its Hankel matrix (Kung 1978).
* For models with the measured output in their regressor: plain regression; without input also the Yule-Walker
  equations with autocorrelations from robust scales (Ma and Genton 2000).
* For Box and Jenkins' model: the same for the disturbance that an output-error model leaves, of signals and of their
  differences.
* For several outputs: a long autoregression, of the outputs as they are and cleaned by the model that this leads to,
  which tells what inputs to come do to them: what is left is regressed on the past, and its principal directions are
  the state (SSARX: Jansson 2003). It serves slow plants, whose impulse responses are too long, and closed loops.

Before that: whether a recording is long enough for a structure, and its input excites it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.linalg import hankel, lstsq, toeplitz

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.noise import with_linear
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.regressor import mirrored, stabilised
from robust_filterpy.identification.models.state_space import Matrices, StateSpaceResiduals
from robust_filterpy.identification.models.structures import OutputError
from robust_filterpy.influence.regression import in_directions, mad_scale, robust_regression

# Singular values below this share of the largest are zero but for rounding.
_RANK: Final = 1e-9
# Lengths of the impulse response that are tried, in samples.
_LENGTHS: Final = (30, 80, 200)
# A model with poles that the data do not show is found from one with fewer, the others at 0.
_FEWER_POLES: Final = 2
# More samples make no better start.
_MOST_ROWS: Final = 20_000


def require_informative(model: PolynomialModel, missing: Any) -> None:
    """Raise unless the recording is long enough for the structure and its input excites it."""
    structure, samples = model.structure, missing.size
    present = samples - int(missing.sum())
    if present == 0:
        raise ValueError("y: expected some measured samples, got NaN in all of them")
    for i, (nb, nk) in enumerate(structure.inputs):
        if nb and nk >= samples:
            raise ValueError(
                f"nk: expected a delay shorter than the recording of {samples} samples, got {nk} for input {i}: "
                "none of it can be seen in y"
            )
    least = 2 * model.n + model.first
    if samples < least or present < 2 * model.n:
        raise ValueError(
            f"y: expected at least {least} samples, {2 * model.n} of them measured, for the {model.n} unknowns of "
            f"{structure}, got {samples} with {present} measured; record more, or take a smaller structure"
        )
    values = model.y[~missing]
    if np.ptp(values) <= 1e-12 * np.abs(values).max():
        raise ValueError("y: expected an output that varies, got the same value throughout")
    if model.inputs:
        _require_excitation(model)


def _require_excitation(model: PolynomialModel) -> None:
    """Raise unless the inputs, delayed as often as the model needs, are linearly independent."""
    structure = model.structure
    for i, (u, _, _, _) in enumerate(model.inputs):
        if not u.any():
            raise ValueError(f"u: expected an input that moves the output, got 0 in every sample of input {i}")
    orders = [acting.nb + model.nf for acting in model.inputs]
    if _rank(model, orders) == sum(orders) + model.offset:
        return
    if structure.takes_phi:
        mend = "; a column of ones is what offset=True adds, use offset=False" if model.offset else ""
        raise ValueError(f"u: expected linearly independent regressors, got some that others explain{mend}")
    count, lags = len(orders), max(orders)
    order = next((n for n in range(lags, 0, -1) if _rank(model, [n] * count) == n * count + model.offset), 0)
    kind = " next to the offset" if model.offset else ""
    several = "inputs that together excite" if count > 1 else "an input that excites"
    raise ValueError(
        f"u: expected {several} {structure} with order {lags}{kind}, got persistent excitation of order {order}; "
        "vary the input more (a random binary signal excites with every order)"
        + (", use offset=False if y has none" if model.offset else "")
        + ", or take a structure with fewer parameters"
    )


def _rank(model: PolynomialModel, delays: list[int]) -> int:
    """Return the rank of so many delays of each input, columns of unit size, and of a constant if the model has one."""
    first = max(delays) - 1
    acting = zip(model.inputs, delays, strict=True)
    columns = [one.u[first - lag : one.u.size - lag] for one, count in acting for lag in range(count)]
    if model.offset:
        columns.append(np.ones(columns[0].size))
    return rank_of(np.column_stack(columns))


def rank_of(X: Array, nothing: float = _RANK) -> int:
    """Return the rank of columns, each taken of unit size."""
    values = in_directions(X)[1]
    return int((values > nothing * values[0]).sum())


class Start(NamedTuple):
    """Parameters to begin with, and how they were found.

    Attributes
    ----------
    name : str
        In words.
    p : ndarray, shape (n,)
        Free parameters of the model.
    """

    name: str
    p: Array


def _bounded_mean(residual: Array) -> float:
    """Return the mean size of residuals, none larger than three standard deviations of ordinary ones."""
    return float(np.minimum(np.abs(residual), 3.0 * mad_scale(residual)).mean())


def _regression_start(model: PolynomialModel, rows: Any) -> Start:
    """Return the robust regression of a model that is linear, or becomes so where C = D = F = 1."""
    places, p = model.structure.polynomials, np.zeros(model.n)
    free = np.ones(model.n, dtype=bool)
    for place in (places.f, places.c, places.d):
        free[place] = False
    if not free.any():
        return Start("regression", p)
    return Start("regression", with_linear(model, p, free, rows))


def _inside(A: Array) -> Array:
    """Return a matrix with its eigenvalues mirrored into a circle."""
    values, vectors = np.linalg.eig(A)
    inside = mirrored(values)
    return A if np.array_equal(inside, values) else np.real(vectors * inside @ np.linalg.inv(vectors))


def _autocorrelation_start(model: PolynomialModel) -> Start:
    """Return the Yule-Walker solution for a model without input, from robust autocorrelations."""
    p = np.zeros(model.n)
    p[model.structure.polynomials.a] = _autoregression(model.y, model.na)[1:]
    return Start("autocorrelations", p)


def _disturbance_start(name: str, model: PolynomialModel, p: Array, rows: Any) -> Start:
    """Return parameters whose D is that of an autoregression of what the inputs do not explain."""
    p, v = p.copy(), model.equation_error(p)
    p[model.structure.polynomials.d] = _autoregression(np.where(rows, v - np.median(v[rows]), 0.0), model.nd)[1:]
    return Start(name, p)


def _autoregression(signal: Array, order: int) -> Array:
    """Return a stable A(q) of a signal with outliers by Yule and Walker's equations, its leading 1 included."""
    correlations = [1.0]
    for lag in range(1, order + 1):
        later, earlier = signal[lag:], signal[:-lag]
        both, apart = mad_scale(later + earlier) ** 2, mad_scale(later - earlier) ** 2
        correlations.append(0.99 * (both - apart) / max(both + apart, np.finfo(float).tiny))
    if not order:
        return np.ones(1)
    a = -lstsq(toeplitz(correlations[:-1]), np.array(correlations[1:]))[0]
    return stabilised(np.concatenate(([1.0], a)))


def _output_error_starts(model: PolynomialModel, rows: Any) -> Iterator[Start]:
    """Yield starts for an output-error model."""
    longest = max(int(rows.sum()) // (3 * len(model.inputs)), model.nf + 2)
    for length in sorted({min(length, longest) for length in _LENGTHS}):
        responses = _impulse_responses(model, rows, length)
        for order in range(model.nf, max(model.nf - _FEWER_POLES, 1) - 1, -1):
            name = f"impulse response of {length} samples, {order} poles"
            yield Start(name, _refitted(model, rows, _reduced(model, responses, order)))


def _impulse_responses(model: PolynomialModel, rows: Any, length: int) -> Array:
    """Return the impulse response to each input from its delay on, shape (n_inputs, length)."""
    count = len(model.inputs)
    first = max(i.nk for i in model.inputs) + length
    samples = np.flatnonzero(rows) + model.first
    samples = samples[samples >= min(first, model.y.size // 2)]
    samples = samples[:: -(-samples.size // _MOST_ROWS)]
    # Inputs before the recording are taken to be that of its first sample.
    earlier = samples[:, None] - np.arange(length)
    delayed = [acting.u[np.maximum(earlier - acting.nk, 0)] for acting in model.inputs]
    theta = robust_regression(np.hstack((*delayed, np.ones((samples.size, int(model.offset))))), model.y[samples])
    return theta[: length * count].reshape(count, length)


def _reduced(model: PolynomialModel, responses: Array, order: int) -> Array:
    """Return the denominator with so many poles that the impulse responses share (Kung 1978), the others at 0."""
    nf, length = model.nf, responses.shape[1]
    parts = []
    for g, acting in zip(responses, model.inputs, strict=True):
        skipped = min(max(acting.nb - nf, 0), length - nf - 2)
        parts.append(hankel(g[skipped:], np.zeros(length - skipped)))
    rows = max(min(len(part) for part in parts) // 2, nf + 1)
    columns = min(len(part) for part in parts) - rows + 1
    left, values, _ = np.linalg.svd(np.hstack([part[:rows, :columns] for part in parts]), full_matrices=False)
    observed = left[:, :order] * np.sqrt(values[:order])
    transition = _inside(lstsq(observed[:-1], observed[1:])[0])
    f = np.zeros(nf + 1)
    f[: len(transition) + 1] = np.real(np.poly(transition))
    return f


def _refitted(model: PolynomialModel, rows: Any, f: Array) -> Array:
    """Return all free parameters for a given F, the rest by robust regression."""
    p, free, place = np.zeros(model.n), np.ones(model.n, dtype=bool), model.structure.polynomials.f
    p[place], free[place] = f[1:], False
    return with_linear(model, p, free, rows)


def starts_of(model: PolynomialModel, missing: Any) -> Iterator[Start]:
    """Yield the starts that suit the structure."""
    if len(model.spans) > 1:
        joined, gaps = model.joined(missing)
        for start in starts_of(joined, gaps):
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
        yield _regression_start(model, rows)
    if not order:
        return
    if not model.inputs:
        yield _autocorrelation_start(model)
        return
    nb, nk = zip(*model.structure.inputs, strict=True)
    simple = PolynomialModel(OutputError(order, nb, nk), model.y, model.u, model.offset, model.moving)
    starts = _output_error_starts(simple, ~missing[simple.first :])
    if model.structure.polynomials == simple.structure.polynomials:
        yield from starts
        return
    best = _best_of(simple, missing, starts)
    p, rows = model.from_output_error(simple.parts(best)), ~missing[model.first :]
    yield Start("output-error model", p)
    if model.nf + model.nd:
        yield _disturbance_start("output-error model and its disturbance", model, p, rows)
        p = model.from_output_error(simple.parts(_of_differences(simple, missing)))
        yield _disturbance_start("differences", model, p, rows)


def _of_differences(model: PolynomialModel, missing: Any) -> Array:
    """Return the free parameters of the best start for differences of the signals: a level that wanders is gone."""
    gaps = missing[1:] | missing[:-1]
    other = PolynomialModel(model.structure, np.diff(model.y), np.diff(model.u, axis=0), model.offset, model.moving)
    p, n = _best_of(other, gaps, _output_error_starts(other, ~gaps[other.first :])), model.structure.n_theta
    p[n:] = 0.0
    if model.offset:
        p[n] = np.median(model.equation_error(p)[~missing[model.first :]])
    return p


def _best_of(model: PolynomialModel, missing: Any, starts: Iterator[Start]) -> Array:
    """Return the free parameters of the best start as it is."""
    rows = ~missing[model.first :]
    return min((start.p for start in starts), key=lambda p: _bounded_mean(model.residuals(p)[rows]))


def predictor_start(model: StateSpaceResiduals, cleaned: list[Array], reach: int) -> Array | None:
    """Return the start from a long autoregression of cleaned outputs."""
    p, m, n, feeds = model.outputs, model.inputs, model.order, model.feedthrough
    reach = max(reach, n // p + 1)
    past, now, ahead = [], [], []
    for (_, u), y in zip(model.recordings, cleaned, strict=True):
        if len(y) <= 2 * reach:
            continue
        # As with a constant among the regressors.
        y, u = y - y.mean(axis=0), u - u.mean(axis=0)
        rows = np.arange(reach, len(y) - reach + 1)
        past.append(np.hstack([np.hstack((y[rows - j], u[rows - j])) for j in range(1, reach + 1)]))
        now.append(np.hstack([y[rows + j] for j in range(reach)]))
        ahead.append(np.hstack([u[rows + j] for j in range(reach)]))
    if not past or sum(map(len, past)) < 2 * reach * (p + m) + 10:
        return None
    Z, F, U = (np.concatenate(part) for part in (past, now, ahead))
    X = np.hstack((Z, U[:, :m])) if feeds else Z
    markov = lstsq(X, F[:, :p])[0]
    residual = F.copy()
    for i in range(reach):
        own = slice(p * i, p * i + p)
        if feeds:
            residual[:, own] -= U[:, m * i : m * i + m] @ markov[reach * (p + m) :]
        for j in range(i):
            block = markov[(i - j - 1) * (p + m) : (i - j) * (p + m)]
            residual[:, own] -= F[:, p * j : p * j + p] @ block[:p] + U[:, m * j : m * j + m] @ block[p:]
    weights = lstsq(Z, residual)[0]
    # Canonical directions: what of the future the past explains, in units of the noise of the future.
    noise = residual - Z @ weights
    ridge = 1e-9 * np.mean(np.square(residual)) + np.finfo(float).tiny
    whitening = np.linalg.inv(np.linalg.cholesky(noise.T @ noise / len(noise) + ridge * np.eye(noise.shape[1]))).T
    _, values, right = np.linalg.svd(np.linalg.qr(Z, mode="r") @ weights @ whitening, full_matrices=False)
    if values.size < n or not np.isfinite(values).all():
        return None
    states = Z @ weights @ whitening @ right[:n].T
    # A row is followed by the next sample, but for the last of each recording.
    inside = np.delete(np.arange(len(states)), np.cumsum([len(part) for part in past]) - 1)
    direct = np.hstack((states, U[:, :m])) if feeds else states
    C = lstsq(direct, F[:, :p])[0]
    e = F[:, :p] - direct @ C
    moved = lstsq(np.hstack((states, U[:, :m], e))[inside], states[inside + 1])[0].T
    K = moved[:, n + m :] if model.disturbance else None
    return _from(model, moved[:, :n], C[:n].T, K)


def _from(model: StateSpaceResiduals, A: Array, C: Array, K: Array | None) -> Array:
    """Return the start with these matrices, and all else by robust regression."""
    n, p, m, zero = model.order, model.outputs, model.inputs, np.zeros
    one = Matrices(_inside(A), zero((n, m)), C, zero((p, m)), zero((n, p)) if K is None else K, zero(n), zero(p))
    q, free = model.packed(one, zero((len(model.recordings), p + n))), np.ones(model.n, dtype=bool)
    gain = q[model.places["K"]].copy() if model.is_stable(q) else 0.0
    q[model.places["K"]] = 0.0
    for name in ("A", "C", "K"):
        free[model.places[name]] = False
    q = with_linear(model, q, free, model.rows)
    q[model.places["K"]] = gain
    return q
