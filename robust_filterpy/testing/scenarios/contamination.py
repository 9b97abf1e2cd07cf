"""Ways in which a recording goes wrong, as one argument of a scenario.

=============  ========================================================  ============================================
name           what happens to a measurement                             good for
=============  ========================================================  ============================================
none           nothing                                                   consistency, whiteness, efficiency
mixture        some samples have ten times the noise (paper 17)          robustness as the paper means it
one-sided      some samples are too large, never too small               filters that trust in symmetry
bursts         outliers come in runs                                     telling a run from a jump
student        Student's t: no sample is an outlier, many are far        a psi that is not made for two classes
sentinels      some samples are replaced by 9999                         gross errors of no meaning
stuck          a sensor repeats its last value for a while               errors that look plausible
missing        NaN, in runs                                              missing data
=============  ========================================================  ============================================
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, TypeAlias

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array

__all__ = ["CONTAMINATIONS", "Bursts", "Missing", "Mixture", "OneSided", "Sentinels", "Stuck", "Student"]


class Spoilt(NamedTuple):
    """Hold measurements together with what no filter is told about them.

    Attributes
    ----------
    z : ndarray, shape (N, m)
        Measurements, NaN where missing.
    noise_ratio : ndarray, shape (N, m)
        Deviation of each sample's noise over the ordinary one; infinite where z tells nothing.
    is_outlier : ndarray of bool, shape (N, m)
        Labels.
    """

    z: Array
    noise_ratio: Array
    is_outlier: np.ndarray


def _runs(probability: float, length: int, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Return marks that are set with about this probability, in runs of this length along the first axis."""
    starts = rng.random(shape) < probability / length
    marks = starts.copy()
    for lag in range(1, min(length, len(starts))):
        marks[lag:] |= starts[:-lag]
    return marks


def _enlarged(before: Spoilt, clean: Array, ratio: Array, labels: np.ndarray) -> Spoilt:
    """Multiply the noise of each sample by a ratio."""
    z = clean + (before.z - clean) * ratio
    return Spoilt(z, before.noise_ratio * ratio, before.is_outlier | labels)


def _replaced(before: Spoilt, z: Array, labels: np.ndarray) -> Spoilt:
    """Put other values in the place of some samples."""
    return Spoilt(
        np.where(labels, z, before.z), np.where(labels, np.inf, before.noise_ratio), before.is_outlier | labels
    )


@dataclass(frozen=True)
class Mixture:
    """Samples of which some have a larger noise, the contaminated normal of the paper (15)-(17).

    Parameters
    ----------
    probability : float, default .1
        Of an outlier, in [0, 1).
    scale_ratio : float, default 10
        Its deviation over the ordinary one.
    """

    of_noise: ClassVar[bool] = True
    probability: float = 0.1
    scale_ratio: float = 10.0

    def __call__(self, before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator) -> Spoilt:
        """Multiply the noise of some samples."""
        bad = rng.random(clean.shape) < self.probability
        return _enlarged(before, clean, np.where(bad, self.scale_ratio, 1.0), bad)


@dataclass(frozen=True)
class OneSided:
    """Samples of which some are too large: half-normal outliers, never negative.

    Parameters
    ----------
    probability : float, default .1
        Of an outlier, in [0, 1).
    scale_ratio : float, default 10
        Deviation of the normal distribution that is halved, over that of the noise.
    """

    of_noise: ClassVar[bool] = True
    probability: float = 0.1
    scale_ratio: float = 10.0

    def __call__(self, before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator) -> Spoilt:
        """Add something positive to some samples."""
        bad = rng.random(clean.shape) < self.probability
        z = before.z + np.where(bad, self.scale_ratio * sigma * np.abs(rng.standard_normal(clean.shape)), 0.0)
        ratio = np.where(bad, np.hypot(1.0, self.scale_ratio), 1.0)
        return Spoilt(z, before.noise_ratio * ratio, before.is_outlier | bad)


@dataclass(frozen=True)
class Bursts:
    """Outliers that come in runs.

    Parameters
    ----------
    probability : float, default .1
        Of a sample to be in a run, about, in [0, 1).
    length : int, default 5
        Samples of a run.
    scale_ratio : float, default 10
        Deviation of an outlier over the ordinary one.
    """

    of_noise: ClassVar[bool] = True
    probability: float = 0.1
    length: int = 5
    scale_ratio: float = 10.0

    def __call__(self, before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator) -> Spoilt:
        """Multiply the noise in runs."""
        bad = _runs(self.probability, self.length, clean.shape, rng)
        return _enlarged(before, clean, np.where(bad, self.scale_ratio, 1.0), bad)


@dataclass(frozen=True)
class Student:
    """Student's t in the place of the normal distribution: each sample has a variance of its own.

    Parameters
    ----------
    df : float, default 3
        Degrees of freedom. Samples of more than three times the ordinary deviation are labelled outliers.
    """

    of_noise: ClassVar[bool] = True
    df: float = 3.0

    def __call__(self, before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator) -> Spoilt:
        """Divide the noise by the root of a chi-square."""
        ratio = np.sqrt(self.df / rng.chisquare(self.df, clean.shape))
        return _enlarged(before, clean, ratio, ratio > 3.0)


@dataclass(frozen=True)
class Sentinels:
    """Samples of which some are replaced by one value, as many devices report a failure.

    Parameters
    ----------
    probability : float, default .05
        Of a replaced sample, in [0, 1).
    value : float, default 9999
        What stands there, in the unit of z.
    """

    of_noise: ClassVar[bool] = False
    probability: float = 0.05
    value: float = 9999.0

    def __call__(self, before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator) -> Spoilt:
        """Replace some samples."""
        return _replaced(before, np.full(clean.shape, self.value), rng.random(clean.shape) < self.probability)


@dataclass(frozen=True)
class Stuck:
    """A sensor that repeats its last value for a while.

    Parameters
    ----------
    probability : float, default .1
        Of a sample to be in a run, about, in [0, 1).
    length : int, default 10
        Samples of a run.
    """

    of_noise: ClassVar[bool] = False
    probability: float = 0.1
    length: int = 10

    def __call__(self, before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator) -> Spoilt:
        """Repeat the sample before each run."""
        stuck = _runs(self.probability, self.length, clean.shape, rng)
        stuck[0] = False
        z = before.z.copy()
        for k in range(1, len(z)):
            z[k] = np.where(stuck[k], z[k - 1], z[k])
        return _replaced(before, z, stuck)


@dataclass(frozen=True)
class Missing:
    """Samples that are not there, in runs.

    Parameters
    ----------
    probability : float, default .1
        Of a sample to be in a run, about, in [0, 1).
    length : int, default 5
        Samples of a run.
    """

    of_noise: ClassVar[bool] = False
    probability: float = 0.1
    length: int = 5

    def __call__(self, before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator) -> Spoilt:
        """Put NaN in the place of some samples."""
        gone = _runs(self.probability, self.length, clean.shape, rng)
        return before._replace(z=np.where(gone, np.nan, before.z), is_outlier=before.is_outlier & ~gone)


#: What a scenario knows by name.
CONTAMINATIONS: dict[str, Callable[..., Any]] = {
    "mixture": Mixture,
    "one-sided": OneSided,
    "bursts": Bursts,
    "student": Student,
    "sentinels": Sentinels,
    "stuck": Stuck,
    "missing": Missing,
}

#: What spoils measurements: ``kind(before, clean, sigma, rng)`` returns the `Spoilt` ones; clean are the measurements
#: without noise, shape (N, m), sigma its deviations, shape (m,). With an attribute of_noise that is true it only makes
#: the noise larger: in a plant with its noise inside the loop (ARX) such an outlier goes round the loop.
Contamination: TypeAlias = "Callable[[Spoilt, Array, Array, np.random.Generator], Spoilt]"

#: A name, something that spoils measurements, or several, which act one after another.
Kinds: TypeAlias = "str | Contamination | Sequence[str | Contamination]"


def of_noise(kind: Contamination) -> bool:
    """Tell whether a kind only makes the noise larger."""
    return bool(getattr(kind, "of_noise", False))


def objects(kinds: Kinds) -> list[Contamination]:
    """Return what is meant as functions that spoil measurements.

    Parameters
    ----------
    kinds : str, Contamination or sequence of these
        Names and functions; "none" for nothing.

    Returns
    -------
    list of Contamination

    Raises
    ------
    ValueError, TypeError
        If a kind is unknown.
    """
    found: list[Contamination] = []
    several: Any = (kinds,) if isinstance(kinds, str) or callable(kinds) else kinds
    for kind in several:
        if isinstance(kind, str):
            name = _checks.option("contamination", kind, ("none", *CONTAMINATIONS))
            found += [] if name == "none" else [CONTAMINATIONS[name]()]
        elif callable(kind):
            found.append(kind)
        else:
            raise TypeError(f"contamination: expected a name or something to call, got {_checks.shown(kind)}")
    return found


def spoilt(z: Array, clean: Array, sigma: Array, kinds: Sequence[Contamination], rng: np.random.Generator) -> Spoilt:
    """Spoil measurements.

    Parameters
    ----------
    z, clean : ndarray, shape (N, m)
        Measurements with their ordinary noise, and without.
    sigma : ndarray, shape (m,)
        Deviation of the ordinary noise.
    kinds : sequence of Contamination
        What happens to them, in this order.
    rng : numpy.random.Generator
        Draws it.

    Returns
    -------
    Spoilt
    """
    result = Spoilt(z, np.ones(z.shape), np.zeros(z.shape, dtype=bool))
    for kind in kinds:
        result = kind(result, clean, sigma, rng)
    return result
