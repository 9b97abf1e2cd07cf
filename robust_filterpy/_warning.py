"""Warnings that point at the user's line, however deep in the package they arise."""

from __future__ import annotations

import inspect
import warnings

__all__ = ["warn"]

# filterpy's loops call the filters' methods.
_PASSED_ON = {"robust_filterpy", "filterpy"}


def warn(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn at the innermost line that is neither this package's nor filterpy's."""
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _PASSED_ON:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)
