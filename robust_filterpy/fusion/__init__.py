"""Sensors that are named, stamped, late and failing: one state from all of them.

* `fusion`: `Fusion`, which takes readings in any order within a window.
* `results`: what it answers with; bands for what is to come.
* `motion`: how the state moves during any length of time.
* `sensors`: what a sensor measures, and the one vector in which all of them stand.
* `_timeline`: what was read when; late readings make the rest be judged anew; as plain arrays, and back.
* `_stepping`: one step, from stamp to stamp, as a pure function, by the policy that is asked for; R by first readings.
* `_table`: stamps, numbers or instants; what was read at each stamp, from a table.
* `recording`: a whole table at once, by the kernel; smoothed on request; how late each sensor's stamps are.
* `verdicts`: what is the matter with a sensor, since when, and what helps.
* `_watch`: cheap tests of every reading, which raise an alarm.
* `_faults`: the recent past, judged anew under every fault of every sensor.
* `reacquisition`: after a blackout or a jump, the sensor or the state being wrong, both carried until one is sure.

Imports from below: `influence`, `correction`, `kernel`, `filters`, `smoothing`.
"""

from __future__ import annotations

from robust_filterpy.correction.policies import Contaminated, Learnt, Scales
from robust_filterpy.fusion.fusion import Fusion
from robust_filterpy.fusion.motion import constant_acceleration, constant_velocity, from_continuous, from_function
from robust_filterpy.fusion.reacquisition import Reacquisition
from robust_filterpy.fusion.sensors import FusionWarning, Sensor, angle

__all__ = [
    "Contaminated", "Fusion", "FusionWarning", "Learnt", "Reacquisition", "Scales", "Sensor", "angle",
    "constant_acceleration", "constant_velocity", "from_continuous", "from_function",
]  # fmt: skip
