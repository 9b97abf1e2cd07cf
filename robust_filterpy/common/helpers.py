"""`filterpy.common.helpers`, as it is."""

# ruff: noqa: F403
from filterpy.common.helpers import *
from filterpy.common.helpers import Saver as Saver
