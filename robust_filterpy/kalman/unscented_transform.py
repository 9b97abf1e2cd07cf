"""`filterpy.kalman.unscented_transform`, as it is."""

from filterpy.kalman.unscented_transform import unscented_transform as unscented_transform
