"""The robust correction, as pure functions of arrays.

* `definition`: the equations as they read; every other form is tested against it.
* `options`: influence, scaling, information, grouping, checked.
* `result`: what a correction returns.
* `whitening`: T with T S T' = I.
* `covariance`: P+ in forms that stay positive semidefinite.
* `likelihood`: log-density of an innovation.
* `missing`: placing observed components among all.
* `scalar`: a fast form for one sensor.
* `moments`: the correction from sigma points.
* `mixture`: noise that is a known mixture of normal distributions, and the score of its innovation.
* `merging`: a correction for each hypothesis about the noise, merged by moments.
* `adaptive_noise`: a mixture that is learnt while a filter runs.
* `adaptive`: the correction under it.

Imports from below: `robust_filterpy.influence`.
"""

from __future__ import annotations

from robust_filterpy.correction.covariance import NotPositiveDefiniteError, posterior_covariance
from robust_filterpy.correction.definition import correct
from robust_filterpy.correction.likelihood import log_density
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.whitening import SingularInnovationError, standardize

__all__ = [
    "Choices",
    "Correction",
    "NotPositiveDefiniteError",
    "SingularInnovationError",
    "correct",
    "log_density",
    "posterior_covariance",
    "standardize",
]
