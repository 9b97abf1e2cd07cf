"""The check that every signal and parameter vector outside the filter goes through."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy._checks import Array, numbers


def finite_vector(name: str, value: Any) -> Array:
    """Return value as a finite one-dimensional float array of at least one number or raise."""
    found = numbers(name, value)
    if found.ndim != 1 or found.size == 0:
        mend = f"; use {name}.ravel()" if found.ndim == 2 and 1 in found.shape and found.size else ""
        raise ValueError(
            f"{name}: expected a one-dimensional array of at least 1 number, got shape {found.shape}{mend}"
        )
    if not np.isfinite(found).all():
        bad = int(np.argmin(np.isfinite(found)))
        raise ValueError(f"{name}: expected finite numbers, got {found[bad]} at index {bad}")
    return found
