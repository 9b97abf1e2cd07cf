"""What goes into the kernel over series and comes out of it."""

from __future__ import annotations

from typing import NamedTuple

from robust_filterpy._checks import Array

#: Sizes that the compiler knows, 0 for any: it unrolls the loops over sensors, and over the states of small filters.
SIZES = ((0, 0), (0, 1), (0, 2), (0, 3), (0, 4), (2, 1), (4, 1), (4, 2), (7, 4), (8, 1))
#: The same where the noise is learnt: known sizes take two fifths less at (2, 1), a fifth at (4, 2).
ADAPTIVE_SIZES = ((0, 0), (2, 1), (4, 1), (4, 2))


class Model(NamedTuple):
    """Matrices with the axes (series, step) in front, of length 1 where one serves all."""

    F: Array
    Q: Array
    H: Array
    R: Array
    Bu: Array
    """(series, step, n)"""


class Run(NamedTuple):
    """What a run of the kernel over series does besides one step after the other."""

    alpha_sq: float
    """Fading memory: P is multiplied by it at each prediction."""
    update_first: bool
    """Whether a step begins with its correction."""
    every: int
    """Which steps are kept: each of so many."""
    likely: bool
    """Whether the log-likelihood is wanted."""
    start: int
    """First step."""


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


class Copies(NamedTuple):
    """Filters side by side that learn their measurement noise; with one more axis in front, a series each."""

    means: Array
    """(q, n)"""
    covariances: Array
    """(q, n, n)"""
    probabilities: Array
    """(q,)"""
    learnt: Array
    """What is known of the noise of each sensor, (m, ...)."""
    x: Array
    """Mean of all, (n,)."""
    P: Array
    """Its covariance, (n, n)."""


class Noise(NamedTuple):
    """What such filters are told of the noises."""

    process_scales: Array
    """Factors of Q, (q,)."""
    stay: float
    """Probability that a scale of Q stays."""
    scales: Array
    """Factors of R, (K,)."""
    begin: Array
    """What is known before the first sample, (...)."""
    memory: float
    r_memory: float
