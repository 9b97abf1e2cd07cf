"""`filterpy.common.discretization`, as it is."""

# ruff: noqa: F403
from filterpy.common.discretization import *
from filterpy.common.discretization import Q_continuous_white_noise as Q_continuous_white_noise
from filterpy.common.discretization import Q_discrete_white_noise as Q_discrete_white_noise
