"""What a robust filter holds, declared once for the mixins that it is made of."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices
from robust_filterpy.filters._correlated import Signs
from robust_filterpy.filters._outlier_share import Share

if TYPE_CHECKING:
    from robust_filterpy._filterpy import Assigned


class Held:
    """Declare the attributes of filterpy's filters that are written to, and those of `snapshot.SLOTS`."""

    # Not a literal: a type checker would then believe that there is no __dict__ at all.
    __slots__ = tuple(())

    dim_x: int
    dim_z: int
    x: Assigned
    P: Assigned
    z: Any
    inv: Any
    x_prior: Array
    P_prior: Array
    x_post: Array
    P_post: Array
    _log_likelihood: float | None
    _likelihood: float | None
    _mahalanobis: float | None

    _policy: Any
    _choices: Choices
    #: What the policy keeps beside x and P.
    _kept: Any
    #: Of the sensors by their places in z, by their rows of an H that was passed, by their names.
    _memory: Array
    _other_sensors: dict[bytes, Array]
    _named_sensors: dict[str, Array]
    #: The last correction, what makes one by `as_arrays`, or the kernel's record.
    _last: Any
    _outlier_probability: float
    #: Made of it when they are asked for.
    _y: Any
    _S: Any
    _SI: Any
    _K: Any
    _share: Share
    _signs: Signs | None
    _updates: int
    #: One number for each step of the last recording, None before one.
    _process_scales: Array | None
