"""What a filter holds besides its recursion, read and put back: its settings in a state, all of it after a refusal."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy._checks import Array
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.mixin import RobustFilterMixin
from robust_filterpy.filters.snapshot import put_back, snapshot

# What a sample moves in a filter, besides what only shows its last correction.
_MOVING = ("x", "P", "H", "R", "x_prior", "P_prior")

# What a filter's behaviour depends on besides x and P: name in a state, attribute.
_SETTINGS = {"Q": "Q", "R": "R", "F": "F", "alpha_sq": "_alpha_sq"}


def settings(kf: Any) -> dict[str, Array]:
    """Return what else a filter's behaviour depends on, as arrays."""
    found = {key: getattr(kf, name) for key, name in _SETTINGS.items() if hasattr(kf, name)}
    return {key: np.array(value, dtype=float) for key, value in found.items() if value is not None}


def apply_settings(kf: Any, state: dict[str, Array]) -> None:
    """Write them back where they differ."""
    for key, value in settings(kf).items():
        if key in state and not np.array_equal(state[key], value):
            setattr(kf, _SETTINGS[key], state[key].item() if state[key].ndim == 0 else state[key])


class Kept:
    """What a filter holds, to put it back."""

    def __init__(self, kf: Any) -> None:
        """Keep what a sample moves: arrays are replaced, never written into; all else that a filter may keep, too."""
        self._moving = {name: getattr(kf, name) for name in _MOVING if hasattr(kf, name)}
        self._put_other_back: Callable[[Any], None] | None = None
        if isinstance(kf, RobustFilterMixin) and type(kf) is not RobustKalmanFilter:
            self._put_other_back = partial(put_back, held=snapshot(kf))
        elif type(kf) not in (RobustKalmanFilter, KalmanFilter):
            self._put_other_back = _Contents(kf).put_back

    def put_back(self, kf: Any) -> None:
        """Put the filter back as it was."""
        for name, value in self._moving.items():
            setattr(kf, name, value)
        if self._put_other_back is not None:
            self._put_other_back(kf)


class _Contents:
    """Everything that a filter of the user's holds, to the depth of the filters that it may be made of."""

    def __init__(self, kf: Any) -> None:
        """Copy it; of a filter that cannot be copied, with a lock in it, the attributes alone."""
        attributes = getattr(kf, "__dict__", {})
        try:
            self._attributes = copy.deepcopy(attributes)
        except TypeError:
            self._attributes = dict(attributes)

    def put_back(self, kf: Any) -> None:
        """Put the filter back as it was."""
        vars(kf).update(self._attributes)
