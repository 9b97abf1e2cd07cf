"""What judges a filter's measurements: one of two policies, and which of them was asked for.

`Bounded` lets psi bound what an innovation does; `Mixture` weighs what noise may have been, told or learnt. A policy
never changes. What it knows is the filter's, arrays and tuples that are never written to: a memory, one row for each
sensor, and what it keeps besides (copies of the state, a count). It is handed to every call, and what comes back takes
its place when the whole call has gone well: so a refused call changes nothing, and a filter is copied, stored and put
back without asking the policy. A correction is a `Correction`, or has its x, P, memory and log_density and makes one by
``as_arrays``; that of `corrected` is by a linear sensor, z of shape (m,) with NaN where missing.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices, Grouping, Information, Scaling
from robust_filterpy.correction.policies import noise_policy, process_policy
from robust_filterpy.filters._bounded import Bounded
from robust_filterpy.filters._mixture import Mixture
from robust_filterpy.influence.functions import Huber, Influence

__all__ = ["Known", "Policy", "policy_of"]


class Known(NamedTuple):
    """What a policy knows before a correction."""

    memory: Array
    """Of the sensors of this measurement, a row each (one for all that fail together)."""
    kept: Any
    """What it keeps besides."""


#: What judges a filter's measurements. Both have the attributes and methods that `Bounded` has.
Policy: TypeAlias = Bounded | Mixture


def policy_of(
    influence: Influence = Huber(),
    scaling: Scaling | None = None,
    information: Information = "realized",
    grouping: Grouping = "component",
    noise: Any = None,
    process: Any = None,
    patience: int | None = None,
) -> Policy:
    """Return the policy that a filter's arguments ask for, or raise where they make no sense together.

    Parameters
    ----------
    influence, scaling, information, grouping, noise, process, patience
        As in `robust_filterpy.RobustKalmanFilter`.

    Returns
    -------
    Policy

    Raises
    ------
    ValueError, TypeError
        If one is out of range or stands against another one.
    """
    noise, process = noise_policy(noise), process_policy(process)
    if noise is None:
        if process is not None:
            raise ValueError(
                f"process: expected None without noise=, got {process!r}; how likely a measurement is under each "
                "process follows from its noise: say noise='learnt' or noise=Contaminated(..), Contaminated(0) for "
                "noise without outliers"
            )
        usual: Scaling = "learnt" if patience is None else "innovation"
        return Bounded(Choices(influence, usual if scaling is None else scaling, information, grouping), patience)
    if patience is not None:
        raise ValueError(
            f"patience: expected None with noise=, got {patience!r}; there a jump is believed by its probability: say "
            "process=Scales(jump=..)"
        )
    for name, value, usual_ones in (
        ("influence", influence, (Huber(),)),
        ("scaling", scaling, (None, "innovation")),
        ("information", information, ("realized",)),
    ):
        if value not in usual_ones:
            raise ValueError(f"{name}: expected none with noise=, got {value!r}; psi follows from the noise there")
    return Mixture(noise, process, grouping)
