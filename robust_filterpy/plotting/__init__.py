"""Pictures of what a filter did.

* `figures`: one function a picture.
* `sources`: batch results, a Saver or a tracker's run as arrays.

matplotlib is imported when something is drawn.
"""

from __future__ import annotations

from robust_filterpy.plotting.figures import (
    plot_fit,
    plot_innovations,
    plot_parameters,
    plot_states,
    plot_weights,
)

__all__ = [
    "plot_fit",
    "plot_innovations",
    "plot_parameters",
    "plot_states",
    "plot_weights",
]
