"""What goes into the kernel over series and comes out of it."""

from __future__ import annotations

from typing import NamedTuple

from robust_filterpy._checks import Array


class Model(NamedTuple):
    """Matrices with the axes (series, step) in front, of length 1 where one serves all."""

    F: Array
    Q: Array
    H: Array
    R: Array
    Bu: Array
    """(series, step, n)"""


class Output(NamedTuple):
    """What a run writes into: arrays over (series, kept step, ..), of length 0 where nothing is wanted."""

    means: Array
    covariances: Array
    """(.., n, n), or (.., 1, n) for the diagonals."""
    means_p: Array
    """Predicted, as covariances_p."""
    covariances_p: Array
    weights: Array
    log_likelihood: Array
    """(series,)"""
