"""The pneumatic servo of the paper's section 2: its equations, linear models of it, and experiments with it.

* `parameters`: its constants, its uncertain alpha and beta.
* `equations`: equations (1)-(7) as functions of floats, and as a python-control system.
* `linearization`: its steady motions, linear models about them, gains by which its loop is stable.
* `position_loop`: the loop simulated: what drives it, its recording, with files of it for other tools.
* `observer`: estimates the motion in the loop from sensors that err.
"""

from __future__ import annotations

from robust_filterpy._lazy import elsewhere
from robust_filterpy.plants.servo.equations import pneumatic_servo
from robust_filterpy.plants.servo.observer import ServoObserver
from robust_filterpy.plants.servo.parameters import PneumaticParameters, random_coefficient
from robust_filterpy.plants.servo.position_loop import simulate_servo

__all__ = ["PneumaticParameters", "ServoObserver", "pneumatic_servo", "random_coefficient", "simulate_servo"]

__getattr__ = elsewhere(__name__)
