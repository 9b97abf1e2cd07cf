"""Estimators that keep what they claim: filterpy's and ours, with several options."""

from __future__ import annotations

from functools import partial

from filterpy.kalman import ExtendedKalmanFilter, KalmanFilter
from wrong_filters import PLAIN, ROBUST, EigenvalueRoots, Textbook, TextbookRobust

from robust_filterpy import Huber, RobustExtendedKalmanFilter, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.influence import Hampel, Linear

#: The spread of the innovations is learnt, and remembered.
SPREAD = ("memoryless",)
#: Name: factory, what it does not claim.
FILTERS = {
    "filterpy KalmanFilter": (KalmanFilter, PLAIN),
    "filterpy ExtendedKalmanFilter": (ExtendedKalmanFilter, PLAIN),
    "textbook": (Textbook, PLAIN),
    "textbook, robust": (TextbookRobust, ROBUST),
    "textbook, eigenvalue roots": (EigenvalueRoots, PLAIN),
    "Linear": (partial(RobustKalmanFilter, influence=Linear()), ("robust",)),
    "Huber": (RobustKalmanFilter, SPREAD),
    "Huber, innovation": (partial(RobustKalmanFilter, scaling="innovation"), ()),
    "Huber(.8)": (partial(RobustKalmanFilter, influence=Huber(0.8)), SPREAD),
    "Huber, joint": (partial(RobustKalmanFilter, grouping="joint"), SPREAD),
    "Huber, bounded": (partial(RobustKalmanFilter, scaling="bounded"), ("units",)),
    "Huber, weight": (partial(RobustKalmanFilter, information="weight"), SPREAD),
    "Huber, expected": (partial(RobustKalmanFilter, information="expected"), ("recovers", *SPREAD)),
    "Hampel": (partial(RobustKalmanFilter, influence=Hampel()), ("recovers", *SPREAD)),
    "Student": (partial(RobustKalmanFilter, influence=StudentT()), ("recovers", *SPREAD)),
    "Tukey": (partial(RobustKalmanFilter, influence=TukeyBiweight()), ("recovers", "likelihood", *SPREAD)),
    "Huber, extended": (RobustExtendedKalmanFilter, SPREAD),
}
