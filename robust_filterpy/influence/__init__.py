"""Influence functions psi and what follows from them.

* `functions`: psi, psi', rho and weights of arrays, in the protocol of `statsmodels.robust.norms`.
* `information`: threshold <-> contamination <-> efficiency of Huber's psi; E[psi'] of any.
* `regression`: a linear regression by Huber's weights, and a scale that outliers do not move.

Imports from below: `robust_filterpy._checks` alone.
"""

from __future__ import annotations

from robust_filterpy.influence.functions import Hampel, Huber, Linear, StudentT, TukeyBiweight

__all__ = ["Hampel", "Huber", "Linear", "StudentT", "TukeyBiweight"]
