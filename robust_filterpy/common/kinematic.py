"""`filterpy.common.kinematic` with `kinematic_kf` making robust filters."""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.common.kinematic import kinematic_state_transition as kinematic_state_transition

from robust_filterpy import _checks
from robust_filterpy.filters.kalman import RobustKalmanFilter

__all__ = ["kinematic_kf", "kinematic_state_transition"]


def kinematic_kf(
    dim: int, order: int, dt: float = 1.0, dim_z: int = 1, order_by_dim: bool = True, kf: Any = None
) -> Any:
    """Return a filter of Newtonian motion whose sensors see the position of each dimension.

    Parameters
    ----------
    dim : int
        Number of dimensions, >= 1: 2 for motion in a plane.
    order : int
        How many derivatives of the position are states, >= 0: 1 is constant velocity.
    dt : float, default 1
        Sampling period, in seconds.
    dim_z : int, default 1
        Sensors of each dimension. For several dimensions one sensor each; `dim` is taken for that too.
    order_by_dim : bool, default True
        Whether the states are ordered as [x x' y y'], otherwise as [x y x' y'].
    kf : filter, optional
        One that is there already, to fill in place. Default: a new `RobustKalmanFilter`.

    Returns
    -------
    RobustKalmanFilter, or kf
        With F and H set; P, Q and R are as they were, identities in a new one.

    Raises
    ------
    ValueError
        If a number is out of range, or kf has other dimensions.

    Notes
    -----
    H is filterpy 1.4.5's, a row for each dimension. That of 2.0.0, for several dimensions, measures the sum of all
    positions in every row.

    Examples
    --------
    >>> kinematic_kf(dim=2, order=1, dt=0.1).H
    array([[1., 0., 0., 0.],
           [0., 0., 1., 0.]])
    """
    for name, value, least in (("dim", dim, 1), ("order", order, 0), ("dim_z", dim_z, 1)):
        _checks.count(name, value, least)
    if dim > 1 and dim_z not in (1, dim):
        raise ValueError(f"dim_z: expected 1 sensor for each of dim={dim} dimensions, got {dim_z}; set H yourself")
    n, m = dim * (order + 1), dim if dim > 1 else dim_z
    kf = RobustKalmanFilter(n, m) if kf is None else kf
    if (kf.dim_x, kf.dim_z) != (n, m):
        raise ValueError(f"kf: expected dim_x={n} and dim_z={m}, got {kf.dim_x} and {kf.dim_z}")
    F, each = kinematic_state_transition(order, dt), np.eye(dim)
    kf.F = np.kron(each, F) if order_by_dim else np.kron(F, each)
    kf.H = np.zeros((m, n))
    kf.H[np.arange(m), np.arange(m) % dim * ((order + 1) if order_by_dim else 1)] = 1.0
    return kf
