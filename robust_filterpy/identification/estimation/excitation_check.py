"""What a recording must have before a model can be made of it."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.polynomial_model import PolynomialModel

# Singular values below this share of the largest are zero but for rounding.
_RANK: Final = 1e-9


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
    if structure.takes_phi:
        if _rank(model, 0) < structure.n_theta + model.offset:
            mend = "; a column of ones is what offset=True adds, use offset=False" if model.offset else ""
            raise ValueError(f"u: expected linearly independent regressors, got some that others explain{mend}")
        return
    orders = [acting.nb + model.nf for acting in model.inputs]
    full = sum(orders) + model.offset
    if _rank(model, model.nf) == full:
        return
    lags = max(orders)
    order = next((n for n in range(lags, 0, -1) if _independent(model, n)), 0)
    kind = " next to the offset" if model.offset else ""
    several = "inputs that together excite" if len(model.inputs) > 1 else "an input that excites"
    raise ValueError(
        f"u: expected {several} {structure} with order {lags}{kind}, got persistent excitation of order {order}; "
        "vary the input more (a random binary signal excites with every order)"
        + (", use offset=False if y has none" if model.offset else "")
        + ", or take a structure with fewer parameters"
    )


def _independent(model: PolynomialModel, n: int) -> bool:
    """Tell whether n delays of every input are linearly independent."""
    return (
        _rank_of([(u, range(n)) for u, _, _, _ in model.inputs], n - 1, model) == n * len(model.inputs) + model.offset
    )


def _rank(model: PolynomialModel, more: int) -> int:
    """Return the rank of the delayed inputs of the model and so many further delays."""
    delayed = [(acting.u, range(acting.nb + more)) for acting in model.inputs]
    return _rank_of(delayed, max(len(lags) for _, lags in delayed) - 1, model)


def _rank_of(delayed: list[tuple[Array, range]], first: int, model: PolynomialModel) -> int:
    """Return the rank of delayed signals, each column of unit size, and of a constant if the model has one."""
    columns = [u[first - lag : u.size - lag] for u, lags in delayed for lag in lags]
    if model.offset:
        columns.append(np.ones(columns[0].size))
    X = np.column_stack(columns)
    size = np.linalg.norm(X, axis=0)
    X = X / np.where(size > 0.0, size, 1.0)
    values = np.linalg.svd(np.linalg.qr(X, mode="r"), compute_uv=False)
    return int((values > _RANK * values[0]).sum())
