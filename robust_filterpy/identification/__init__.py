"""Recursive identification: the parameters of a linear model, sample by sample, by a robust filter.

* `models`: structures, a model of a recording, and what follows from it.
* `estimation`: `identify`, the model of a whole recording, from nothing.
* `recursive`: `ParameterTracker` and `TrackerBank`, sample by sample.
* `judging`: `select_structure`, `validate`, `compare`.

Imports from below: `influence`, `correction`, `kernel`, `filters`.
"""

from __future__ import annotations

from robust_filterpy.identification.estimation.identify import identify
from robust_filterpy.identification.judging.select import select_structure
from robust_filterpy.identification.judging.validate import compare, validate
from robust_filterpy.identification.models.grey_box import GreyBox
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.state_space import StateSpace
from robust_filterpy.identification.models.structures import (
    AR,
    ARMA,
    ARMAX,
    ARX,
    FIR,
    BoxJenkins,
    LinearRegression,
    OutputError,
)
from robust_filterpy.identification.recursive.tracker import ParameterTracker, TrackerBank
from robust_filterpy.identification.recursive.watch import LostTrackerWarning

__all__ = [
    "AR", "ARMA", "ARMAX", "ARX", "FIR", "BoxJenkins", "GreyBox", "LinearRegression", "LostTrackerWarning", "Model",
    "OutputError", "ParameterTracker", "StateSpace", "TrackerBank", "compare", "identify", "select_structure",
    "validate",
]  # fmt: skip
