"""The pneumatic servo of the paper's section 2: its equations, linear models of it, and experiments with it.

* `equations`: equations (1)-(7) as functions of floats, and as a python-control system; its constants, its uncertain
  alpha and beta.
* `linearization`: its steady motions, linear models about them, gains by which its loop is stable.
* `position_loop`: the loop simulated: what drives it, its recording.
"""

from __future__ import annotations

from robust_filterpy.plants.servo.equations import PneumaticParameters, pneumatic_servo
from robust_filterpy.plants.servo.position_loop import simulate_servo

__all__ = ["PneumaticParameters", "pneumatic_servo", "simulate_servo"]
