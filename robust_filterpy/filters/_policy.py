"""The contract between a filter and what judges its measurements, and which of the two ways to judge was asked for.

`Bounded` lets psi bound what an innovation does; `Mixture` weighs what noise may have been, told or learnt. A policy
never changes. What it knows is the filter's, arrays and tuples that are never written to: a memory, one row for each
sensor, and what it keeps besides (copies of the state, a count). It is handed to every call, and what comes back takes
its place when the whole call has gone well: so a refused call changes nothing, and a filter is copied, stored and put
back without asking the policy.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._state import Shape
from robust_filterpy.correction.definition import Innovation
from robust_filterpy.correction.options import Choices, Grouping, Information, Scaling
from robust_filterpy.correction.policies import noise_policy, process_policy
from robust_filterpy.correction.whitening import Inverse
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


class Policy(Protocol):
    """How a filter predicts its state and corrects it."""

    @property
    def choices(self) -> Choices:
        """Influence, scaling, information, grouping; under a mixture those by which `update_steadystate` clips."""
        ...

    @property
    def noise(self) -> Any:
        """What was told of the measurement noise."""
        ...

    @property
    def process(self) -> Any:
        """What was told of the process noise."""
        ...

    @property
    def patience(self) -> int | None:
        """How many refused measurements that agree are believed."""
        ...

    @property
    def by_kernel(self) -> bool:
        """Whether the kernel's steps of one filter are this policy's."""
        ...

    @property
    def rule(self) -> Array | None:
        """What the kernel's steps under a mixture take, None where they are not this policy's."""
        ...

    @property
    def learns(self) -> bool:
        """Whether anything is learnt of the sensors."""
        ...

    def begin(self, sensors: int) -> Array:
        """Return the memory of sensors of which nothing is known."""
        ...

    def start(self, x: Array, P: Array, sensors: int) -> Any:
        """Return what is kept besides before the first step, x of shape (n,)."""
        ...

    def predicted(
        self, kept: Any, x: Array, P: Array, F: Array, Q: Array, Bu: Array | None, alpha_sq: float
    ) -> tuple[Array, Array, Any]:
        """Return x, P and what is kept after a prediction."""
        ...

    def corrected(
        self, known: Any, x: Array, P: Array, z: Array, H: Array, R: Array, M: Array | None, inv: Inverse | None
    ) -> tuple[Any, Any]:
        """Return the correction by a linear sensor, z of shape (m,) with NaN where missing, and what is kept.

        A correction is a `Correction`, or has its x, P, memory and log_density and makes one by ``as_arrays``.
        """
        ...

    def corrected_by_moments(
        self, known: Any, x: Array, P: Array, innovation: Innovation, inv: Inverse | None,
        difference: Callable[[Array, Array], Array] = np.subtract,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Return the correction by an innovation, and what is kept; `difference` is that of two innovations."""
        ...

    def entries(self, kept: Any, x: Array, P: Array) -> dict[str, Array]:
        """Return what is kept as arrays of a state."""
        ...

    def shapes(self, n: int) -> dict[str, Shape]:
        """Return the shapes of these."""
        ...

    def resumed(self, found: dict[str, Array], x: Array, P: Array) -> Any:
        """Return what a state has kept, or raise if it cannot have been this policy's."""
        ...


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
