"""Pictures of what a filter did.

* `figures`: one function a picture of a filter's or a tracker's run, and what all pictures share.
* `models`: a model's responses, poles and zeros; structures, residuals and models compared.

A result draws its own by ``result.plot()``.

`LOOKS` has color and line style of the filters that pictures compare: "Kalman", "gate", "Huber", "Tukey", "learnt"
(noise learned on the way) and "ideal" (which knows what nobody can). ``ax.plot(t, x, **LOOKS["Huber"])``.

matplotlib is imported when something is drawn.
"""

from __future__ import annotations

from robust_filterpy.plotting.figures import LOOKS, plot_innovations, plot_states
from robust_filterpy.plotting.models import plot_bode, plot_poles

__all__ = ["LOOKS", "plot_bode", "plot_innovations", "plot_poles", "plot_states"]
