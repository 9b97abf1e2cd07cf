"""Plants to test estimators on, and what drives them: linear ones that may drift, inputs, a pneumatic servo.

* `linear`: ARX and output-error data from a transfer function or parameters, which may drift and stay stable.
* `excitation`: inputs with a prescribed spectrum.
* `servo`: the pneumatic servo of the paper's section 2.

python-control is imported when a plant asks for it. Imports from below: `identification`, for the
test of stability.
"""

from __future__ import annotations

from robust_filterpy.plants.linear import THETA_BAR, simulate_arx, simulate_output_error

__all__ = ["THETA_BAR", "simulate_arx", "simulate_output_error"]
