"""`filterpy.kalman.information_filter`, as it is."""

from filterpy.kalman.information_filter import InformationFilter as InformationFilter
