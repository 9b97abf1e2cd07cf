"""Pictures of what a filter did.

* `figures`: one function a picture of a filter's or a tracker's run.
* `responses`: a model's frequency response, poles and zeros.
* `workbench`: pictures of structures, models and their comparison.
* `sources`: batch results, a Saver or a tracker's run as arrays.

`LOOKS` has colour and line style of the filters that pictures compare: "Kalman", "gate", "Huber", "Tukey", "learnt"
(noise learnt on the way) and "told" (told what nobody can know). ``ax.plot(t, x, **LOOKS["Huber"])``.

matplotlib is imported when something is drawn.
"""

from __future__ import annotations

from robust_filterpy.plotting._style import LOOKS
from robust_filterpy.plotting.figures import (
    plot_fit,
    plot_innovations,
    plot_parameters,
    plot_states,
    plot_weights,
)
from robust_filterpy.plotting.responses import plot_bode, plot_poles

# What the `plot()` of a result draws, which is how these are asked for.
from robust_filterpy.plotting.responses import plot_noise_spectrum as plot_noise_spectrum
from robust_filterpy.plotting.responses import plot_step as plot_step
from robust_filterpy.plotting.workbench import plot_comparison as plot_comparison
from robust_filterpy.plotting.workbench import plot_structure_selection as plot_structure_selection
from robust_filterpy.plotting.workbench import plot_tuning as plot_tuning
from robust_filterpy.plotting.workbench import plot_validation as plot_validation

__all__ = [
    "LOOKS",
    "plot_bode",
    "plot_fit",
    "plot_innovations",
    "plot_parameters",
    "plot_poles",
    "plot_states",
    "plot_weights",
]
