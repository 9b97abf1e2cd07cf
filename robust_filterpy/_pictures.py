"""`plot()` of a result: its picture is drawn by the package `plotting`, which stands above all others.

Imports between packages point down, so a result knows the name of its picture and nothing of how it is drawn.
`plotting`, and with it matplotlib, is imported here, by name, when a picture is asked for.
"""

from __future__ import annotations

import importlib
from typing import Any, ClassVar


class Pictured:
    """A result that can be drawn."""

    __slots__ = ()

    #: Module and name of the function of `robust_filterpy.plotting` that draws it.
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
        module, _, name = self.picture.partition(".")
        return getattr(importlib.import_module(f"robust_filterpy.plotting.{module}"), name)(self, **options)
