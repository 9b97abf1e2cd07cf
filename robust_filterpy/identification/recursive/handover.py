"""From what a recording says to a recursion that goes on at its end: its model, or that its gain has changed."""

from __future__ import annotations

import math

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.regressor import Memory
from robust_filterpy.identification.recursive.noise_scale import ordinary_mean
from robust_filterpy.identification.recursive.state import WINDUP, Form, State

__all__ = ["gone_on", "with_gain"]


def gone_on(form: Form, now: State, i: int, model: Model) -> State:
    """Return what becomes of actuator i by a model: it goes on at the end of the model's recording."""
    structure, layout, which = form.structure, form.layout, np.array([i])
    row = now.rows(which)
    n, places, place = structure.n_theta, structure.polynomials, structure.constant_place
    x, P, memory, centre = model.theta, model.P, model.memory, float(row.centre[0])
    if form.has_offset:
        # The constant is one more input of B/F, and drives the output from its centre.
        centre = model.level
        a, f = (1.0 + float(model.theta[part].sum()) for part in (places.a, places.f))
        constant, J = (model.offset - centre * a) * f, np.eye(n + 1)
        J[n, places.a], J[n, n] = -centre * f, f
        cross, square = model.offset_covariance[:, None], np.array([[np.nan_to_num(model.offset_std, posinf=0.0) ** 2]])
        joint = np.block([[P, cross], [cross.T, square]])
        order = np.insert(np.arange(n), place, n)
        x, P = np.append(x, constant)[order], (J @ joint @ J.T)[np.ix_(order, order)]
    P, scale = 0.5 * (P + P.T), row.scale[0].copy()
    # Of past outputs in the regressor, too.
    scale[4] = math.sqrt(12.0 * model.noise.least * (1.0 + float(np.square(x[layout.a]).sum())))
    if scale[3]:
        # A recording without noise says nothing of how large it is.
        stands_on = 0.0 if model.noise.is_rounding else float(model.weights.size)
        scale[:3] = model.R, stands_on, ordinary_mean(model.noise.influence)
    if form.has_offset:
        f, c, d = (1.0 + float(x[part].sum()) for part in (layout.f, layout.c, layout.d))
        prefiltered = 1.0 / max(abs(f), 1e-6)
        response = prefiltered * d / max(abs(c), 1e-6)
        memory = memory._replace(
            inputs=np.append(memory.inputs, 1.0),
            gradients=np.insert(memory.gradients, place, response, axis=1),
            prefiltered=np.insert(memory.prefiltered, place, prefiltered, axis=1),
        )
    windup = WINDUP * max(float(np.trace(P)), 1e-300)
    begun = row._replace(
        theta=x[None], P=P[None], past=Memory(*(a[None] for a in memory)), scale=scale[None],
        centre=np.array([centre]), windup=np.array([windup]), begun=np.array([True]), restarts=np.array([True]),
    )  # fmt: skip
    return now.with_rows(which, begun)


def with_gain(form: Form, now: State, i: int, g: float, u: Array) -> State:
    """Return what becomes of actuator i by a gain that has changed: theta moves by it, and P says how surely."""
    theta, P = now.theta.copy(), now.P.copy()
    along, places = np.zeros(theta.shape[1]), form.structure.polynomials
    for j, b in enumerate(places.b):
        along[form.own[b]] = theta[i, form.own[b]]
        if form.has_offset:
            along[form.structure.constant_place] -= theta[i, form.own[b]].sum() * u[j]
    theta[i] += g * along
    P[i] += g**2 * np.outer(along, along)
    return now._replace(theta=theta, P=P)
