"""A transfer function of python-control as a `Model`, to be validated and compared like one that was identified."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy.identification.models.constructors import OutputError
from robust_filterpy.identification.models.learnt_noise import Noise
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.regressor import Layout, Memory
from robust_filterpy.identification.models.signals import recorded_input, recorded_output
from robust_filterpy.identification.models.time_axis import recording
from robust_filterpy.influence.functions import Huber
from robust_filterpy.influence.regression import mad_scale


def as_model(name: str, given: Any, y: Any, u: Any) -> Model:
    """Return a Model as it is, and one of a transfer function whose level and noise the recording tells; or raise."""
    # Its parameters are taken as known for sure. The level is the median of what the transfer function leaves of y.
    if isinstance(given, Model):
        return given
    if not (hasattr(given, "num_list") or hasattr(given, "num")) or not hasattr(given, "isdtime"):
        raise TypeError(
            f"{name}: expected a Model, StateSpaceModel or GreyBoxModel that identify found, or a "
            f"control.TransferFunction, got {_checks.shown(given)}"
        )
    if not given.isdtime(strict=True):
        raise ValueError(f"{name}: expected one in discrete time, got dt={given.dt}; use its sample(dt)")
    if (given.ninputs, given.noutputs) != (1, 1):
        raise ValueError(
            f"{name}: expected a transfer function with one input and one output, got {given.ninputs} and "
            f"{given.noutputs}"
        )
    b, a = (np.trim_zeros(np.asarray(part[0][0], dtype=float), "f") for part in (given.num, given.den))
    if not 0 < b.size <= a.size:
        raise ValueError(f"{name}: expected a transfer function that is proper and not 0, got {given}")
    structure = OutputError(a.size - 1, b.size, a.size - b.size)
    theta = np.concatenate((a[1:], b)) / a[0]
    axis, y, u = recording(structure, y=y, u=u)
    measured = recorded_output(y)
    n, signal = structure.n_theta, recorded_input(structure, u, measured.size)
    period = None if given.dt is True else float(given.dt)
    axis.require_period(period)
    model = Model(
        structure, theta, 0.0, np.zeros((n, n)), 0.0, np.zeros(n), Noise(Huber(), 1.0), np.full(measured.size, np.nan),
        np.nan, (), "", Memory.at_rest(Layout(structure)), True, period,
    )  # fmt: skip
    left = measured - model.simulate(signal)
    left = left[~np.isnan(left)]
    if not left.size:
        return model
    level = float(np.median(left))
    R = max(mad_scale(left - level) ** 2, np.finfo(float).tiny)
    return replace(model, offset=level, noise=Noise(Huber(), R))
