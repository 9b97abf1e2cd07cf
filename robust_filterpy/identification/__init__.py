"""Recursive identification: the parameters of a linear model, sample by sample, by any filter of filterpy's kind.

* `structures`, `noise_structures`: which signals the regressor phi is made of.
* `tracker`: theta in y = phi' theta + v, sample by sample; with `cold_start`, `noise_scale` (an R that is followed) and
  `watch` (whether it is lost).
* `tuned`: how fast the parameters of a tracker drift, from a recording.
* `bank`: the same for many actuators at once.
* `results`: what they return.
* `identify`: the model of a recording, from nothing; made of
  `polynomial_model`: residuals of all structures and their derivatives,
  `starts`: where to begin without a guess,
  `prediction_error`: the search for the least robust loss,
  `learnt_noise`: the noise that residuals show,
  `cleaning`: outliers that the regressor holds,
  `missing`: outputs that it holds and nobody measured,
  `search`: all of these together, and which of several ends to believe.
* `model`: what `identify` returns; with `prediction` through outliers.
* `summary`: its parameters as a table.
* `time_axis`: pandas objects in, results on the same index.
* `river_adapter`: a tracker as a regressor of river.
* `uncertainty`: how sure a model or tracker is of its responses, poles and zeros.
* `guard`: keeping a model that feeds back its own output stable.
* `validation`: how well a model agrees with a recording.
* `selection`: its orders and its delay, by an information criterion.
* `residual_tests`: whether anything is left in its residuals.
* `comparison`: which of several models is the best.
* `transfer_model`: a transfer function of python-control in the place of a model.

Imports from below: `influence`, `correction`, `compiled`, `filters`, `batch`.
"""

from __future__ import annotations

from robust_filterpy.identification.bank import BankResult, BankSample, TrackerBank
from robust_filterpy.identification.comparison import Comparison, compare
from robust_filterpy.identification.identify import identify
from robust_filterpy.identification.model import Model
from robust_filterpy.identification.noise_structures import AR, ARMA, BoxJenkins
from robust_filterpy.identification.residual_tests import Validation, validate
from robust_filterpy.identification.results import Coefficients, Intervals, Sample, TrackingResult
from robust_filterpy.identification.selection import Selection, select_structure
from robust_filterpy.identification.structures import ARMAX, ARX, FIR, LinearRegression, OutputError
from robust_filterpy.identification.summary import Summary
from robust_filterpy.identification.tracker import ParameterTracker
from robust_filterpy.identification.tuned import TunedTracker
from robust_filterpy.identification.uncertainty import FrequencyResponse, NoiseSpectrum, Regions, StepResponse
from robust_filterpy.identification.watch import LostTrackerWarning

# A tracker starts by `identify`, and a model goes on as a tracker: neither file can import the other.
ParameterTracker._identify = staticmethod(identify)
Model._tracker = ParameterTracker

__all__ = [
    "AR",
    "ARMA",
    "ARMAX",
    "ARX",
    "FIR",
    "BankResult",
    "BankSample",
    "BoxJenkins",
    "Coefficients",
    "Comparison",
    "FrequencyResponse",
    "Intervals",
    "LinearRegression",
    "LostTrackerWarning",
    "Model",
    "NoiseSpectrum",
    "OutputError",
    "ParameterTracker",
    "Regions",
    "Sample",
    "Selection",
    "StepResponse",
    "Summary",
    "TrackerBank",
    "TrackingResult",
    "TunedTracker",
    "Validation",
    "compare",
    "identify",
    "select_structure",
    "validate",
]
