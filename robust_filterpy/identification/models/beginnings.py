"""How a simulation begins: from rest, where the recording of the model ended, or where another recording ends."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._warning import warn
from robust_filterpy.identification.models.polynomial_model import Parts, PolynomialModel
from robust_filterpy.identification.models.regressor import Layout, Memory
from robust_filterpy.identification.models.signals import recorded_input
from robust_filterpy.identification.models.structures import input_columns
from robust_filterpy.influence.regression import robust_regression

if TYPE_CHECKING:
    from robust_filterpy.identification.models.model import Model

__all__ = ["held_input", "motion_after"]

# Below this share of its coefficients' size A(1) is 0: the model integrates and has no level.
_INTEGRATES: Final = 1e-9


def motion_after(model: Model, y: Any, u: Any) -> tuple[Any, Array]:
    """Return a recording without gaps and outliers, and the free parameters with what was in motion as it began."""
    recorded, known = model.prepared(y, u)
    n, cleaned = model.theta.size, model.without_outliers(recorded, known)
    if cleaned is not recorded:
        recorded, known = cleaned, np.ones(known.size, dtype=bool)
    p = np.concatenate((model.theta, [model.offset], np.zeros(recorded.nf)))
    rows = known[recorded.first :]
    if recorded.nf and rows.any():
        p[n + 1 :] = robust_regression(-recorded.jacobian(p)[rows][:, n + 1 :], recorded.residuals(p)[rows])
    return recorded, p


def held_input(structure: Any, u: Any, rest: Array) -> Array:
    """Return an input whose missing samples have the value before them, with a warning if there are any."""
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


def resting_level(parts: Parts) -> float:
    """Return what the output of a model is at rest, offset/A(1), or 0 if it integrates and has no rest."""
    total = float(parts.a.sum())
    return parts.offset / total if abs(total) > _INTEGRATES * float(np.abs(parts.a).sum()) else 0.0


def filled_memory(model: PolynomialModel, p: Array) -> Memory:
    """Return what a tracker would remember after a recording."""
    structure, layout = model.structure, Layout(model.structure)
    n, level, disturbance = structure.n_theta, resting_level(model.parts(p)), model.equation_error(p)
    without_noise = p.copy()
    without_noise[layout.c] = without_noise[layout.d] = 0.0
    chi = -model.jacobian(without_noise)[:, :n] * layout.precedes_noise
    rest = Memory.at_rest(layout)
    outputs = np.concatenate((_newest(level - model.y, layout.na), _newest(-disturbance, layout.nd)))
    return Memory(
        outputs=outputs,
        measured=outputs,
        inputs=rest.regressors(layout, model.u)[1],
        residuals=_newest(model.residuals(p), layout.nc),
        undisturbed=_newest(-model.undisturbed(p), layout.nf),
        prefiltered=_newest(chi, len(rest.prefiltered)),
        gradients=_newest(-model.jacobian(p)[:, :n], layout.nc),
    )


def _newest(signal: Array, count: int) -> Array:
    """Return the last samples, the newest first."""
    return np.ascontiguousarray(signal[::-1][:count])
