"""Which policy a fusion's arguments ask for."""

from __future__ import annotations

from typing import Any

from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.policies import (
    Contaminated,
    Learnt,
    Scales,
    noise_policy,
    process_policy,
)
from robust_filterpy.filters._bounded import Bounded
from robust_filterpy.filters._mixture import Mixture
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
            _require_told(layout, "noise that is told")
        # All sensors stand in one vector, in which each fails on its own, or a group together.
        told = Learnt() if noise is None else noise
        return LearntNoise(Mixture(told, Scales() if process is None else process, layout.grouping))
    if noise is not None or process is not None:
        raise ValueError("influence: expected neither noise nor process beside it")
    _require_told(layout, "influence")
    return BoundedInfluence(Bounded(Choices(influence, grouping=layout.grouping)))


def _require_told(layout: Layout, why: str) -> None:
    """Raise if the size of a noise is neither told nor learnt."""
    for name, sensor in layout.sensors.items():
        if sensor.R is None:
            raise ValueError(f"sensor {name!r}: expected R, since with {why} nobody learns it")
