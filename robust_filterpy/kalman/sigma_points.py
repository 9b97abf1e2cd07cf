"""`filterpy.kalman.sigma_points`, as it is."""

from filterpy.kalman.sigma_points import JulierSigmaPoints as JulierSigmaPoints
from filterpy.kalman.sigma_points import MerweScaledSigmaPoints as MerweScaledSigmaPoints
from filterpy.kalman.sigma_points import SimplexSigmaPoints as SimplexSigmaPoints
