"""Measurement noise that is learnt while a filter runs: how large it is, how often and how far it is exceeded.

A sample of noise belongs to one of K classes; in class k its variance is ``r s_k R``. R is what the filter was given;
the scales s_0 = 1 < s_1 < ... are fixed, by default a decade apart; the factor r and the probabilities of the classes
are learnt. The class is a Markov chain, since outliers come in runs: its transitions are learnt as expected counts
with a forgetting memory and a weak prior, and r from the expected squares of the samples of class 0, the ordinary ones.
When these are no longer the majority, the class in which the median falls becomes the ordinary one: the way out of a
wrong R.

Everything that is learnt about a sensor is one array, `start` says in which order. `class_probabilities` and `learn`
are the chain's prediction and what a sample adds to it, in plain floats and loops, which are fastest on lists;
`robust_filterpy.correction.adaptive` corrects a state between the two.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array

# An array, or a list, which Python indexes in a third of the time.
Floats = Any

__all__ = ["DECADES", "LearntNoise", "class_probabilities", "describe", "learn", "start"]

#: Factors of the variance: a standard deviation of 1, 3.2, 10 and 32 times the ordinary one.
DECADES = (1.0, 10.0, 100.0, 1000.0)
# The prior: ten samples of a chain with 15 % outliers whose class stays with probability 3/4, else is drawn anew; R is
# worth 20 samples. On 20 kinds of noise a half or the double of each changes most errors by 1 %.
_PRIOR_SAMPLES, _PRIOR_OUTLIERS, _PRIOR_STAY, _PRIOR_R = 10.0, 0.15, 0.75, 20.0


class LearntNoise(NamedTuple):
    """What has been learnt about the noise; g = 1 if all sensors fail together, else the number of sensors."""

    r: Array
    """Variance of ordinary noise over what the filter was given, shape (g,)."""
    r_std: Array
    """Standard error of r, shape (g,)."""
    contamination: Array
    """Share of outliers in the memory, shape (g,)."""
    contamination_std: Array
    """Standard error of contamination, shape (g,)."""
    scale_ratio: Array
    """Root-mean-square size of outliers over that of ordinary noise, shape (g,); the prior's where there were none."""
    run_length: Array
    """Mean length of a run of outliers, in samples, shape (g,)."""


def start(classes: int) -> Array:
    """Return what is known before the first sample.

    Parameters
    ----------
    classes : int
        K, >= 1.

    Returns
    -------
    ndarray, shape (2 + 2 K + K^2,)
        r; how many ordinary samples it stands on; the share of each class of late; the probability of each class for
        the last sample; how often class i was followed by class j, row by row.
    """
    K = classes
    share = np.full(K, _PRIOR_OUTLIERS / max(K - 1, 1))
    share[0] = 1.0 - _PRIOR_OUTLIERS if K > 1 else 1.0
    moves = _PRIOR_STAY * np.eye(K) + (1.0 - _PRIOR_STAY) * share
    return np.concatenate([[1.0, _PRIOR_R], share, share, (_PRIOR_SAMPLES * share[:, None] * moves).ravel()])


def class_probabilities(learnt: Floats, p: Floats) -> None:
    """Predict the class of the next sample.

    Parameters
    ----------
    learnt : ndarray or list, shape (2 + 2 K + K^2,)
        What is known of the noise.
    p : ndarray or list, shape (K,)
        The probabilities of the classes are written here.
    """
    K = len(p)
    for j in range(K):
        p[j] = 0.0
    for i in range(K):
        first = 2 + 2 * K + i * K
        total = 0.0
        for j in range(K):
            total += learnt[first + j]
        share = learnt[2 + K + i] / total
        for j in range(K):
            p[j] += share * learnt[first + j]


def learn(
    learnt: Floats, begin: Floats, scales: Floats, p: Floats, energy: float, memory: float, r_memory: float
) -> None:
    """Learn from one sample, in place.

    Parameters
    ----------
    learnt : ndarray or list, shape (2 + 2 K + K^2,)
        What is known of the noise; changed.
    begin : ndarray or list, shape (2 + 2 K + K^2,)
        What `start` returned.
    scales : sequence of float, length K
        Factors of the variance.
    p : ndarray or list, shape (K,)
        Probabilities of the sample's classes.
    energy : float
        E[v^2 | class 0]/R.
    memory : float
        Samples for which the transitions are remembered.
    r_memory : float
        Ordinary samples for which r is remembered; the share of each class is for twice as many.
    """
    K = len(p)
    keep, keep_r, keep_share = 1.0 - 1.0 / memory, 1.0 - 1.0 / r_memory, 1.0 - 0.5 / r_memory
    learnt[1] = keep_r * learnt[1] + p[0]
    if learnt[1] > 1e-12:
        learnt[0] += p[0] * (energy - learnt[0]) / learnt[1]
    learnt[0] = min(max(learnt[0], 1e-8), 1e8)
    for j in range(K):
        learnt[2 + j] = keep_share * learnt[2 + j] + (1.0 - keep_share) * p[j]
    # E[class i before, class j now] = q_i A_ij p_j / sum_l q_l A_lj, A_ij the counts over their sum.
    last = 2 + K
    counts = last + K
    for i in range(K):
        total = 0.0
        for j in range(K):
            total += learnt[counts + i * K + j]
        learnt[last + i] /= total
    for j in range(K):
        predicted = 0.0
        for i in range(K):
            predicted += learnt[last + i] * learnt[counts + i * K + j]
        moved = p[j] / predicted if predicted > 0.0 else 0.0
        for i in range(K):
            at = counts + i * K + j
            learnt[at] = begin[at] + keep * (learnt[at] - begin[at]) + moved * learnt[last + i] * learnt[at]
    for j in range(K):
        learnt[last + j] = p[j]
    # Ordinary is what most samples are. (At .4 an R that is 30 times too small can stay so for 1000 samples.)
    if K > 1 and learnt[2] < 0.5:
        k, below = 0, learnt[2]
        while below < 0.5 and k < K - 1:
            k += 1
            below += learnt[2 + k]
        r = learnt[0] * scales[k]
        for at in range(len(learnt)):
            learnt[at] = begin[at]
        learnt[0] = r


def describe(learnt: Array, scales: Array, sensors: int = 1) -> LearntNoise:
    """Return what has been learnt in the user's terms.

    Parameters
    ----------
    learnt : ndarray, shape (g, 2 + 2 K + K^2)
        A row for each sensor that fails on its own.
    scales : ndarray, shape (K,)
        Factors of the variance.
    sensors : int, default 1
        Components whose squares each r is learnt from.

    Returns
    -------
    LearntNoise

    Notes
    -----
    The standard errors hold for samples in a memory that forgets exponentially; that of the contamination counts runs
    of outliers rather than outliers.
    """
    K = len(scales)
    counts = learnt[:, 2 + 2 * K :].reshape(-1, K, K)
    classes, total = counts.sum(axis=1), counts.sum(axis=(1, 2))
    share = 1.0 - classes[:, 0] / total
    outliers = classes[:, 1:].sum(axis=1)
    squares = classes[:, 1:] @ scales[1:] / outliers if K > 1 else np.ones(len(learnt))
    bad = counts[:, 1:, 1:].sum(axis=(1, 2)) / counts[:, 1:].sum(axis=(1, 2)) if K > 1 else np.zeros(len(learnt))
    # Correlation of one sample's indicator with the next one's.
    stay = np.clip(bad - counts[:, 0, 1:].sum(axis=1) / counts[:, 0].sum(axis=1), 0.0, 0.99)
    return LearntNoise(
        r=learnt[:, 0].copy(),
        r_std=learnt[:, 0] / np.sqrt(sensors * learnt[:, 1]),
        contamination=share,
        contamination_std=np.sqrt(share * (1.0 - share) / (total + 1.0) * (1.0 + stay) / (1.0 - stay)),
        scale_ratio=np.sqrt(squares),
        run_length=1.0 / (1.0 - np.minimum(bad, 1.0 - 1e-9)),
    )
