"""`plot()` of a result: its picture is drawn by the room `plotting`, which stands above all others.

Imports between rooms point down, so a result knows the name of its picture and nothing of how it is drawn. `plotting`,
and with it matplotlib, is imported here, by name, when a picture is asked for.
"""

from __future__ import annotations

import importlib
from typing import Any, ClassVar


class Pictured:
    """A result that can be drawn."""

    __slots__ = ()

    #: Name of the function of `robust_filterpy.plotting` that draws it.
    picture: ClassVar[str]

    def plot(self, **options: Any) -> Any:
        """Draw it, by that function of `robust_filterpy.plotting` which its ``picture`` names.

        Parameters
        ----------
        **options : dict, optional
            Of that function.

        Returns
        -------
        matplotlib.axes.Axes, or ndarray of them
        """
        return getattr(importlib.import_module("robust_filterpy.plotting"), self.picture)(self, **options)
