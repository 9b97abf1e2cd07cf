"""Where series stand: arrays of a filter's state with the axis of the series in front."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, numbers
from robust_filterpy._state import widened
from robust_filterpy.batch.arguments import SeriesArguments
from robust_filterpy.correction import copies
from robust_filterpy.correction.learning import NoiseClasses
from robust_filterpy.filters.kalman import RobustKalmanFilter

__all__ = ["began", "continued", "refuse"]

# What becomes NaN where a series is refused; what was learnt of its noise stays.
_LOST = ("x", "P", "means", "covariances")


def began(kf: RobustKalmanFilter, given: SeriesArguments, learnt: ArrayLike | None) -> dict[str, Array]:
    """Return where series stand that begin, or raise."""
    (series, n), m = given.x.shape, given.z.shape[2]
    policy: Any = kf.policy
    stands, is_mixture = {"x": given.x, "P": given.P}, kf.noise is not None
    if learnt is not None and not (is_mixture and policy.learns):
        raise ValueError("learnt: expected none without noise=Learnt(..), got some")
    if policy.learns and not is_mixture:
        stands["spread"] = np.tile(policy.begin(m), (series, 1, 1))
    if is_mixture and policy.scales.count > 1:
        patterns, which = np.unique(given.P != 0.0, axis=0, return_inverse=True)
        beliefs = [copies.start(np.zeros(n), pattern, policy.scales).belief for pattern in patterns]
        stands |= {
            "means": np.repeat(given.x[:, None], policy.scales.count, axis=1),
            "covariances": np.repeat(given.P[:, None], policy.scales.count, axis=1),
            "belief": np.array(beliefs)[which.ravel()],
        }
    if policy.learns and is_mixture:
        stands["learnt"] = _learnt(policy.classes, learnt, series, m)
    return stands


def continued(kf: RobustKalmanFilter, given: SeriesArguments, state: Mapping[str, Any]) -> dict[str, Array]:
    """Return a copy of where an earlier part of the same series has ended, or raise."""
    stands = began(kf, given, None)
    if set(state) != set(stands):
        raise ValueError(
            f"state: expected {', '.join(stands)} in it, got {', '.join(state)}; it goes on with the same noise=, "
            "process= and scaling="
        )
    for name in [name for name in stands if name not in ("x", "P")]:
        value = np.array(numbers(f"state[{name!r}]", state[name]), order="C")
        value = widened(name, value, stands[name].shape[-1])
        if value.shape != stands[name].shape:
            raise ValueError(
                f"state[{name!r}]: expected shape {stands[name].shape}, got {value.shape}; it goes on with the same "
                "series, noise= and process="
            )
        stands[name] = value
    if "belief" in stands:
        copies.require_belief("state['belief']", stands["belief"])
    if "learnt" in stands:
        policy: Any = kf.policy
        stands["learnt"] = _learnt(policy.classes, stands["learnt"], len(given.x), given.z.shape[2])
    if not np.isfinite(stands.get("spread", 0.0)).all():
        raise ValueError("state['spread']: expected finite numbers, got NaN or infinity")
    return stands


def refuse(stands: dict[str, Array], s: int) -> None:
    """Say that a series stands nowhere."""
    for name in _LOST:
        if name in stands:
            stands[name][s] = np.nan


def _learnt(classes: NoiseClasses, learnt: ArrayLike | None, series: int, m: int) -> Array:
    """Return what is known of each series' noise before its first step, or raise."""
    if learnt is None:
        return np.tile(classes.start(m), (series, 1, 1))
    values = numbers("learnt", learnt)
    if values.ndim != 3:
        return np.tile(classes.checked(values, m), (series, 1, 1))
    if len(values) != series:
        raise ValueError(f"learnt: expected an entry for each of the {series} series, got {len(values)}")
    return np.array([classes.checked(one, m) for one in values]).reshape(values.shape)
