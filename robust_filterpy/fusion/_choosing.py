"""Which policy a fusion's arguments ask for."""

from __future__ import annotations

from typing import Any

from robust_filterpy.correction.policies import (
    Contaminated,
    Learnt,
    Scales,
    noise_policy,
    process_policy,
)
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.fusion._policies import BoundedInfluence, LearntNoise, Policy
from robust_filterpy.fusion.sensors import Layout
from robust_filterpy.influence.functions import Influence

__all__ = ["policy_of"]


def policy_of(layout: Layout, noise: Any, process: Any, influence: Influence | None) -> Policy:
    """Return what predicts and corrects: the one place where a kind of filter is chosen.

    Parameters
    ----------
    layout : Layout
        The sensors.
    noise, process, influence
        As in `Fusion`.

    Returns
    -------
    Policy

    Raises
    ------
    ValueError, TypeError
        If they make no sense together, or a sensor's R is to be told.
    """
    noise, process = noise_policy(noise), process_policy(process)
    if influence is None:
        if isinstance(noise, Contaminated):
            _require_told(layout, "noise that is given")
        # All sensors stand in one vector, in which each fails on its own, or a group together.
        noise, process = Learnt() if noise is None else noise, Scales() if process is None else process
        return LearntNoise(RobustKalmanFilter(1, 1, noise=noise, process=process, grouping=layout.grouping).policy)
    if noise is not None or process is not None:
        raise ValueError("influence: expected neither noise nor process with it")
    _require_told(layout, "influence")
    kf = RobustKalmanFilter(1, 1, influence=influence, scaling="innovation", grouping=layout.grouping)
    return BoundedInfluence(kf.policy)


def _require_told(layout: Layout, why: str) -> None:
    """Raise if the size of a noise is neither told nor learnt."""
    for name, sensor in layout.sensors.items():
        if sensor.R is None:
            raise ValueError(f"sensor {name!r}: expected R, since with {why} nobody learns it")
