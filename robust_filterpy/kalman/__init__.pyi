from filterpy.kalman import FadingKalmanFilter as FadingKalmanFilter
from filterpy.kalman import IMMEstimator as IMMEstimator
from filterpy.kalman import InformationFilter as InformationFilter
from filterpy.kalman import JulierSigmaPoints as JulierSigmaPoints
from filterpy.kalman import MerweScaledSigmaPoints as MerweScaledSigmaPoints
from filterpy.kalman import MMAEFilterBank as MMAEFilterBank
from filterpy.kalman import SimplexSigmaPoints as SimplexSigmaPoints
from filterpy.kalman import SquareRootKalmanFilter as SquareRootKalmanFilter
from filterpy.kalman import ckf_transform as ckf_transform
from filterpy.kalman import predict as predict
from filterpy.kalman import predict_steadystate as predict_steadystate
from filterpy.kalman import spherical_radial_sigmas as spherical_radial_sigmas
from filterpy.kalman import unscented_transform as unscented_transform
from filterpy.kalman import update_steadystate as update_steadystate

from robust_filterpy.filters.conversion import batch_filter as batch_filter
from robust_filterpy.filters.conversion import rts_smoother as rts_smoother
from robust_filterpy.filters.conversion import update as update
from robust_filterpy.filters.ensemble import RobustEnsembleKalmanFilter as EnsembleKalmanFilter
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter as ExtendedKalmanFilter
from robust_filterpy.filters.kalman import RobustKalmanFilter as KalmanFilter
from robust_filterpy.filters.sigma_point import RobustCubatureKalmanFilter as CubatureKalmanFilter
from robust_filterpy.filters.sigma_point import RobustUnscentedKalmanFilter as UnscentedKalmanFilter
from robust_filterpy.smoothing.fixed_lag import FixedLagSmoother as FixedLagSmoother

__all__ = [
    "CubatureKalmanFilter",
    "EnsembleKalmanFilter",
    "ExtendedKalmanFilter",
    "FadingKalmanFilter",
    "FixedLagSmoother",
    "IMMEstimator",
    "InformationFilter",
    "JulierSigmaPoints",
    "KalmanFilter",
    "MMAEFilterBank",
    "MerweScaledSigmaPoints",
    "SimplexSigmaPoints",
    "SquareRootKalmanFilter",
    "UnscentedKalmanFilter",
    "batch_filter",
    "ckf_transform",
    "predict",
    "predict_steadystate",
    "rts_smoother",
    "spherical_radial_sigmas",
    "unscented_transform",
    "update",
    "update_steadystate",
]
