"""Moved to `robust_filterpy.testing`: its names are here for one release, with a warning."""

from __future__ import annotations

import warnings
from typing import Any

from robust_filterpy import testing


def __getattr__(name: str) -> Any:
    """Return a name that has moved, and say where it is."""
    if name not in ("bootstrap_interval", "fit_percent", "monte_carlo", "rerun"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    warnings.warn(f"{__name__} has moved: from robust_filterpy.testing import {name}", DeprecationWarning, stacklevel=2)
    return getattr(testing, name)
