"""The robust correction, as pure functions of arrays.

* `definition`: the equations as they read; the kernel is tested against it.
* `options`: influence, scaling, information, grouping, checked.
* `result`: what a correction returns, and T of a group of sensors, and of all of them in the order taken.
* `spread`: how large a sensor's innovations usually are, learned.
* `contaminated`: `Contaminated`, the mixture of two normal distributions: drawn, given, learned, and as a psi.
* `policies`: what a filter is given of noise: `Contaminated`, `Learnt`, `Scales`.
* `repeats`: whether a sensor repeats its last reading though it seldom does and its noise is white.
* `learning`: what is learned of a sensor's noise, a mixture of classes, while a filter runs.
* `side_by_side`: models of a filter that differ in what they take the process for.
* `hypotheses`: models of a state, advanced together: what failed, what moved, which repair explains a recording.
* `factor`: one factor by which P, Q and R that are given are all too large or too small.
* `learnt`: the correction of models under such noise, learned or given; `mixed`: what a filter keeps of one.

Imports from below: `robust_filterpy.influence`.
"""

from __future__ import annotations

from robust_filterpy.correction.contaminated import Contaminated
from robust_filterpy.correction.definition import NotPositiveDefiniteError
from robust_filterpy.correction.policies import Learnt, Scales
from robust_filterpy.correction.result import SingularInnovationError

__all__ = ["Contaminated", "Learnt", "NotPositiveDefiniteError", "Scales", "SingularInnovationError"]
