"""Recursive identification: the parameters of a linear model, sample by sample, by any filter of filterpy's kind.

`structures` says which signals the regressor phi is made of, `tracker` estimates theta in y = phi' theta + v, `bank`
does so for many actuators at once.
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
