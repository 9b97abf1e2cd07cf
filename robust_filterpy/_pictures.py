"""`plot()` of a result: its picture is drawn by the room `plotting`, which stands above all others.

Imports between rooms point down, so a result knows the name of its picture and nothing of how it is drawn. `plotting`,
and with it matplotlib, is imported here, by name, when a picture is asked for.
"""

from __future__ import annotations

import importlib
from typing import Any


def drawn(picture: str, result: Any, options: dict[str, Any]) -> Any:
    """Return the axes that a function of `robust_filterpy.plotting`, such as "plot_bode", makes of a result."""
    return getattr(importlib.import_module("robust_filterpy.plotting"), picture)(result, **options)
