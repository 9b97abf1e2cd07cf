"""How a simulation begins: from rest, where the recording of the model ended, or where another recording ends."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._warning import warn
from robust_filterpy.identification.models.prediction import cleaned_residuals
from robust_filterpy.identification.models.signals import recorded_input
from robust_filterpy.identification.models.structures import input_columns
from robust_filterpy.influence.regression import robust_regression

if TYPE_CHECKING:
    from robust_filterpy.identification.models.model import Model

__all__ = ["held_input", "motion_after"]


def motion_after(model: Model, y: Any, u: Any) -> tuple[Any, Array]:
    """Return a recording without gaps and outliers, and the free parameters with what was in motion as it began.

    Parameters
    ----------
    model : Model
        The model.
    y : array_like, shape (N,)
        Output of a recording that ends where the simulation begins.
    u : array_like, shape (N,) or (N, n_inputs)
        Its input.

    Returns
    -------
    recorded : PolynomialModel
    p : ndarray
    """
    recorded, known = model._prepared(y, u)
    parts, first, n = model._parts(), recorded.first, model.theta.size
    if recorded.na or parts.c.size + parts.d.size > 2:
        found = cleaned_residuals(parts, model._equation_error(recorded, known), known[first:], model.noise)
        cleaned = recorded.y.copy()
        cleaned[first:] += (found.weights - 1.0) * found.residual
        recorded = recorded.with_output(cleaned)
        known = np.ones(known.size, dtype=bool)
    p = np.concatenate((model.theta, [model.offset], np.zeros(recorded.nf)))
    rows = known[first:]
    if recorded.nf and rows.any():
        p[n + 1 :] = robust_regression(-recorded.jacobian(p)[rows][:, n + 1 :], recorded.residuals(p)[rows])
    return recorded, p


def held_input(structure: Any, u: Any, rest: Array) -> Array:
    """Return an input whose missing samples have the value before them, with a warning if there are any.

    Parameters
    ----------
    structure : Structure or Signals
        Which inputs there are.
    u : array_like, shape (N,) or (N, n_inputs)
        NaN where it is missing.
    rest : ndarray, shape (n_inputs,) or (0,)
        What stands before the first sample.

    Returns
    -------
    ndarray, shape (N, n_inputs)

    Raises
    ------
    ValueError
        If it does not fit.
    """
    if structure.takes_phi or not structure.inputs or u is None:
        return recorded_input(structure, u, None)
    signal = input_columns("u", u, structure.n_inputs)
    gaps = np.isnan(signal)
    if not gaps.any():
        return recorded_input(structure, u, None)
    last = np.maximum.accumulate(np.where(gaps, -1, np.arange(len(signal))[:, None]), axis=0)
    before = rest if rest.size else np.zeros(structure.n_inputs)
    held = np.where(last < 0, before, np.take_along_axis(np.nan_to_num(signal), np.maximum(last, 0), axis=0))
    warn(
        f"u: missing in {int(gaps.any(axis=1).sum())} of {_checks.count('u', len(signal))} samples, held at the value "
        "before; fill u with what acted, for a valve that stayed where it was u.ffill(), else u.interpolate()",
    )
    return recorded_input(structure, held, None)
