"""`plot()` of a result: the picture that the room above all others draws of it, loaded when it is asked for.

A result knows the name of its picture and nothing of how it is drawn.
"""

from __future__ import annotations

import importlib
from typing import Any


def drawn(picture: str, result: Any, options: dict[str, Any]) -> Any:
    """Return the axes of a picture of a result."""
    return getattr(importlib.import_module("robust_filterpy.plotting"), picture)(result, **options)
