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

Each is a function ``kind(before, clean, sigma, rng, **options)`` that makes `Spoilt` measurements of those before;
clean are the measurements without noise, shape (N, m), sigma its deviations, shape (m,).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy.signal

from robust_filterpy import _checks
from robust_filterpy._checks import Array


class Spoilt(NamedTuple):
    """Hold measurements together with what no filter is given about them.

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


#: What spoils measurements. With an attribute of_noise that is true it only makes the noise larger: in a plant with its
#: noise inside the loop (ARX) such an outlier goes round the loop.
Contamination: TypeAlias = "Callable[[Spoilt, Array, Array, np.random.Generator], Spoilt]"

#: A name; names with their options; something that spoils measurements; or several, which act one after another.
Kinds: TypeAlias = "str | Mapping[str, Mapping[str, float]] | Contamination | Sequence[str | Contamination]"


def _runs(probability: float, length: int, shape: tuple[int, ...], rng: np.random.Generator) -> np.ndarray:
    """Return marks that are set with about this probability, in runs of this length along the first axis."""
    starts = rng.random(shape) < probability / length
    return np.asarray(scipy.signal.lfilter(np.ones(length), 1.0, starts, axis=0) > 0.5)


def _enlarged(before: Spoilt, clean: Array, ratio: Array, labels: np.ndarray) -> Spoilt:
    """Multiply the noise of each sample by a ratio."""
    z = clean + (before.z - clean) * ratio
    return Spoilt(z, before.noise_ratio * ratio, before.is_outlier | labels)


def _replaced(before: Spoilt, z: Array | float, labels: np.ndarray) -> Spoilt:
    """Put other values in the place of some samples."""
    return Spoilt(
        np.where(labels, z, before.z), np.where(labels, np.inf, before.noise_ratio), before.is_outlier | labels
    )


def mixture(
    before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator,
    *, probability: float = 0.1, scale_ratio: float = 10.0, length: int = 1,
) -> Spoilt:  # fmt: skip
    """Make the noise of some samples larger, in runs of some length: the contaminated normal of the paper (15)-(17)."""
    bad = _runs(probability, length, clean.shape, rng)
    return _enlarged(before, clean, np.where(bad, scale_ratio, 1.0), bad)


def one_sided(
    before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator,
    *, probability: float = 0.1, scale_ratio: float = 10.0,
) -> Spoilt:  # fmt: skip
    """Add a half-normal number, never negative, to some samples; scale_ratio is its deviation over the noise's."""
    bad = rng.random(clean.shape) < probability
    z = before.z + np.where(bad, scale_ratio * sigma * np.abs(rng.standard_normal(clean.shape)), 0.0)
    ratio = np.where(bad, np.hypot(1.0, scale_ratio), 1.0)
    return Spoilt(z, before.noise_ratio * ratio, before.is_outlier | bad)


def student(before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator, *, df: float = 3.0) -> Spoilt:
    """Give each sample a variance of its own; those of more than three ordinary deviations are labeled outliers."""
    ratio = np.sqrt(df / rng.chisquare(df, clean.shape))
    return _enlarged(before, clean, ratio, ratio > 3.0)


def sentinels(
    before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator,
    *, probability: float = 0.05, value: float = 9999.0,
) -> Spoilt:  # fmt: skip
    """Replace some samples by one value, in the unit of z, as many devices report a failure."""
    return _replaced(before, value, rng.random(clean.shape) < probability)


def stuck(
    before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator, *, probability: float = 0.1, length: int = 10
) -> Spoilt:
    """Repeat the sample before each run."""
    held = _runs(probability, length, clean.shape, rng)
    held[0] = False
    last = np.maximum.accumulate(np.where(held, 0, np.arange(len(held))[:, None]), axis=0)
    return _replaced(before, np.take_along_axis(before.z, last, axis=0), held)


def missing(
    before: Spoilt, clean: Array, sigma: Array, rng: np.random.Generator, *, probability: float = 0.1, length: int = 5
) -> Spoilt:
    """Put NaN in the place of some samples, in runs."""
    gone = _runs(probability, length, clean.shape, rng)
    return before._replace(z=np.where(gone, np.nan, before.z), is_outlier=before.is_outlier & ~gone)


#: What a scenario knows by name; the first four only make the noise larger.
CONTAMINATIONS: dict[str, Callable[..., Spoilt]] = {
    "mixture": mixture, "one-sided": one_sided, "bursts": partial(mixture, length=5), "student": student,
    "sentinels": sentinels, "stuck": stuck, "missing": missing,
}  # fmt: skip


def objects(kinds: Kinds) -> list[Contamination]:
    """Return what is meant as functions that spoil measurements, or raise if a name or an option is unknown."""
    several: Any = (kinds,) if isinstance(kinds, str) or callable(kinds) else kinds
    options: Mapping[str, Any] = kinds if isinstance(kinds, Mapping) else {}
    return [
        kind if callable(kind) else _named(kind, options.get(kind, {}))
        for kind in several
        if callable(kind) or _checks.option("contamination", kind, ("none", *CONTAMINATIONS)) != "none"
    ]


def _named(name: str, options: Mapping[str, float]) -> Contamination:
    """Return what spoils measurements in the way of this name."""
    function: Any = partial(CONTAMINATIONS[name], **options)
    parameters = inspect.signature(CONTAMINATIONS[name]).parameters.values()
    for option in options:
        _checks.option(f"contamination {name!r}", option, [p.name for p in parameters if p.kind is p.KEYWORD_ONLY])
    function.of_noise = name in list(CONTAMINATIONS)[:4]
    return function  # type: ignore[no-any-return]


def spoilt(z: Array, clean: Array, sigma: Array, kinds: Sequence[Contamination], rng: np.random.Generator) -> Spoilt:
    """Spoil measurements."""
    result = Spoilt(z, np.ones(z.shape), np.zeros(z.shape, dtype=bool))
    for kind in kinds:
        result = kind(result, clean, sigma, rng)
    return result
