"""Recursive identification: the parameters of a linear model, sample by sample, by any filter of filterpy's kind.

* `structures`: which signals the regressor phi is made of.
* `tracker`: theta in y = phi' theta + v, sample by sample.
* `bank`: the same for many actuators at once.
* `results`: what they return.
* `guard`: keeping a model that feeds back its own output stable.
* `validation`: how well a model agrees with a recording.

Imports from below: `influence`, `correction`, `compiled`, `filters`, `batch`.
"""

from __future__ import annotations

from robust_filterpy.identification.bank import BankResult, BankSample, TrackerBank
from robust_filterpy.identification.results import Coefficients, Intervals, Sample, TrackingResult
from robust_filterpy.identification.structures import ARMAX, ARX, FIR, LinearRegression, OutputError
from robust_filterpy.identification.tracker import ParameterTracker

__all__ = [
    "ARMAX",
    "ARX",
    "FIR",
    "BankResult",
    "BankSample",
    "Coefficients",
    "Intervals",
    "LinearRegression",
    "OutputError",
    "ParameterTracker",
    "Sample",
    "TrackerBank",
    "TrackingResult",
]
