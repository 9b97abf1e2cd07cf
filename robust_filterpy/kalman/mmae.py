"""`filterpy.kalman.mmae`, as it is."""

from filterpy.kalman.mmae import MMAEFilterBank as MMAEFilterBank
