"""Theorems about estimators, as assertions whose failures say in figures and words what is wrong.

* `consistency`: NIS, NEES, bias, whiteness, a covariance that stays one; parameters found, followed, honest intervals.
* `robustness`: bounded influence, the way back from a jump, efficiency; units, order, missing samples.
* `contracts`: refused calls, copies, two filters that are the same.
"""

from __future__ import annotations

from robust_filterpy._lazy import elsewhere
from robust_filterpy.testing.assertions.consistency import (
    assert_consistent,
    assert_innovations_white,
    assert_recovers_parameters,
    assert_tracks,
    assert_unbiased,
)  # fmt: skip

__all__ = [
    "assert_consistent", "assert_innovations_white", "assert_recovers_parameters", "assert_tracks", "assert_unbiased",
]  # fmt: skip

__getattr__ = elsewhere(__name__)
