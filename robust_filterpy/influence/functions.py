"""Influence functions: psi, its derivative, its integral rho, its weights psi(e)/e.

The protocol is that of `statsmodels.robust.norms`, so every norm of theirs can be passed where one of these
is expected. Arguments are standardized: e = T y has unit variance when the model is right.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from robust_filterpy._checks import Array, fraction, positive
from robust_filterpy.influence.information import LOG_SQRT_2PI, huber_log_normalizer, minimax_threshold, outlier_odds


@runtime_checkable
class Influence(Protocol):
    """What a filter needs of an influence function: four vectorized methods of e."""

    def rho(self, e: Any) -> Any:
        """Return the loss whose derivative is psi."""

    def psi(self, e: Any) -> Any:
        """Return the influence function."""

    def psi_deriv(self, e: Any) -> Any:
        """Return the derivative of psi."""

    def weights(self, e: Any) -> Any:
        """Return psi(e)/e, continued to e = 0."""


class _Base:
    """What the package's own influence functions add: the kernel's name for them, a density."""

    #: The kernel's name of psi, None if it has none, and which attributes are its numbers, at most three.
    kernel_name: ClassVar[str | None] = None
    kernel_fields: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls) -> None:
        """Keep a user's subclass with a psi or rho of its own, or a mixin's, from being filtered by its parent's."""
        for owner in cls.__mro__:
            if "kernel_name" in vars(owner):
                return
            if not {"psi", "psi_deriv", "weights", "rho"}.isdisjoint(vars(owner)):
                cls.kernel_name = None
                return

    @property
    def corners(self) -> tuple[float, ...]:
        """Where psi' jumps, e > 0, at a parameter: quadrature splits its interval there."""
        return tuple(corner for name in self.kernel_fields if math.isfinite(corner := getattr(self, name)))

    def nominal_information(self) -> float | None:
        """Return E[psi'] under the density that psi is made for, None if that is the standard normal."""
        return None

    def log_normalizer(self, dim: int) -> float:
        """Return log of the integral of exp(-rho(|e|)) over R^dim, the Gaussian's where that diverges."""
        return dim * LOG_SQRT_2PI


@dataclass(frozen=True)
class Linear(_Base):
    """Leave the innovation as it is: the Kalman filter.

    Examples
    --------
    >>> Linear().psi(1e6)
    array(1000000.)
    """

    kernel_name = "linear"

    def rho(self, e: ArrayLike) -> Array:
        """Return e^2/2, the shape of e."""
        e = np.asarray(e, dtype=float)
        with np.errstate(over="ignore"):
            return np.asarray(0.5 * e * e)

    def psi(self, e: ArrayLike) -> Array:
        """Return e, the shape of e."""
        return np.asarray(e, dtype=float)

    def psi_deriv(self, e: ArrayLike) -> Array:
        """Return 1, the shape of e."""
        return np.ones(np.shape(e))

    weights = psi_deriv


@dataclass(frozen=True)
class Huber(_Base):
    """Clip the innovation: psi(e) = max(-k, min(k, e)) (paper, figure 2).

    The minimax choice for the class of contaminated normal distributions (15)-(17).

    Parameters
    ----------
    threshold : float, default 1.345
        k, in standard deviations of the innovation; infinite is `Linear`. 1.345 keeps 95 % efficiency on
        normal data, 1 keeps 90 %, .5 79 %.

    Raises
    ------
    ValueError
        If the threshold is not > 0.

    Examples
    --------
    >>> Huber(1.5).psi([-3.0, 0.5, 1e300])
    array([-1.5,  0.5,  1.5])
    >>> round(Huber.from_contamination(0.1).threshold, 3)
    1.14
    """

    threshold: float = 1.345

    kernel_name = "huber"
    kernel_fields = ("threshold",)

    def __post_init__(self) -> None:
        """Check the threshold."""
        object.__setattr__(self, "threshold", positive("threshold", self.threshold, infinite=True))

    @classmethod
    def from_contamination(cls, contamination: float) -> Huber:
        """Return the minimax psi for a contamination.

        Solves 2 phi(k)/k - 2 Phi(-k) = contamination/(1 - contamination) for k.

        Parameters
        ----------
        contamination : float
            Share of outliers, in [0, 1); 0 gives an infinite threshold.

        Returns
        -------
        Huber
            0.05 -> k = 1.398, 0.1 -> 1.140, 0.15 -> 0.980.

        Raises
        ------
        ValueError
            If contamination is outside [0, 1).
        """
        return cls(minimax_threshold(fraction("contamination", contamination)))

    @property
    def contamination(self) -> float:
        """Share of outliers for which the threshold is minimax: the inverse of `from_contamination`."""
        odds = outlier_odds(self.threshold)
        return odds / (1.0 + odds)

    def nominal_information(self) -> float:
        """Return (1 - eps)(2 Phi(k) - 1), the least favorable density's (paper 40, 45)."""
        return (1.0 - self.contamination) * float(2.0 * special.ndtr(self.threshold) - 1.0)

    def log_normalizer(self, dim: int) -> float:
        """Return log of the integral of exp(-rho(|e|)) over R^dim; dim = 1: -log((1 - eps)/sqrt(2 pi))."""
        return huber_log_normalizer(self.threshold, dim)

    def rho(self, e: ArrayLike) -> Array:
        """Return e^2/2 up to k, k|e| - k^2/2 beyond; the shape of e."""
        r = np.abs(np.asarray(e, dtype=float))
        inner = np.minimum(r, self.threshold)
        with np.errstate(over="ignore"):
            # The second term is written as a product with 0 inside so that k = inf needs no case of its own.
            return np.asarray(0.5 * inner * inner + inner * (r - inner))

    def psi(self, e: ArrayLike) -> Array:
        """Return e clipped to [-k, k]; the shape of e."""
        return np.asarray(np.clip(np.asarray(e, dtype=float), -self.threshold, self.threshold))

    def psi_deriv(self, e: ArrayLike) -> Array:
        """Return 1 where |e| <= k, else 0; the shape of e."""
        return np.asarray(np.abs(np.asarray(e, dtype=float)) <= self.threshold, dtype=float)

    def weights(self, e: ArrayLike) -> Array:
        """Return min(1, k/|e|); the shape of e."""
        r = np.abs(np.asarray(e, dtype=float))
        if math.isinf(self.threshold):
            return np.ones_like(r)
        return np.asarray(self.threshold / np.maximum(r, self.threshold))


@dataclass(frozen=True)
class Hampel(_Base):
    """Clip, then let go: psi rises to a, stays there up to b, falls to 0 at c.

    Parameters
    ----------
    a, b, c : float, default 2, 4, 8
        Corners, 0 < a <= b < c, in standard deviations of the innovation.

    Raises
    ------
    ValueError
        If the corners are not in that order.

    Examples
    --------
    >>> Hampel().psi([1.0, 3.0, 6.0, 9.0])
    array([1., 2., 1., 0.])
    """

    a: float = 2.0
    b: float = 4.0
    c: float = 8.0

    kernel_name = "hampel"
    kernel_fields = ("a", "b", "c")

    def __post_init__(self) -> None:
        """Check the corners."""
        a, b, c = (positive(name, getattr(self, name)) for name in "abc")
        if not a <= b < c:
            raise ValueError(f"a, b, c: expected 0 < a <= b < c, got {self.a!r}, {self.b!r}, {self.c!r}")
        for name, value in zip("abc", (a, b, c), strict=True):
            object.__setattr__(self, name, value)

    def rho(self, e: ArrayLike) -> Array:
        """Return the integral of psi from 0; the shape of e."""
        r = np.minimum(np.abs(np.asarray(e, dtype=float)), self.c)
        inner, falling = np.minimum(r, self.a), np.maximum(r - self.b, 0.0)
        return np.asarray(0.5 * inner**2 + inner * (r - inner) - 0.5 * self.a * falling**2 / (self.c - self.b))

    def psi(self, e: ArrayLike) -> Array:
        """Return the three-part function; the shape of e."""
        r = np.minimum(np.abs(np.asarray(e, dtype=float)), self.c)
        falling = self.a * (self.c - r) / (self.c - self.b)
        return np.asarray(np.copysign(np.minimum(np.minimum(r, self.a), falling), e))

    def psi_deriv(self, e: ArrayLike) -> Array:
        """Return 1, 0, -a/(c - b), 0 on the four parts; the shape of e."""
        r = np.abs(np.asarray(e, dtype=float))
        slope = -self.a / (self.c - self.b)
        return np.asarray(np.where(r <= self.a, 1.0, np.where((r > self.b) & (r <= self.c), slope, 0.0)))

    def weights(self, e: ArrayLike) -> Array:
        """Return psi(e)/e, 1 at 0; the shape of e."""
        r = np.abs(np.asarray(e, dtype=float))
        return np.asarray(np.where(r <= self.a, 1.0, self.psi(r) / np.maximum(r, self.a)))


@dataclass(frozen=True)
class TukeyBiweight(_Base):
    """Let gross outliers go altogether: psi(e) = e (1 - (e/c)^2)^2 for |e| <= c, else 0.

    Parameters
    ----------
    threshold : float, default 4.685
        c, in standard deviations of the innovation; 4.685 keeps 95 % efficiency on normal data.

    Raises
    ------
    ValueError
        If the threshold is not finite and > 0.

    Examples
    --------
    >>> TukeyBiweight().psi([0.0, 5.0])
    array([0., 0.])
    """

    threshold: float = 4.685

    kernel_name = "tukey"
    kernel_fields = ("threshold",)

    def __post_init__(self) -> None:
        """Check the threshold."""
        object.__setattr__(self, "threshold", positive("threshold", self.threshold))

    def rho(self, e: ArrayLike) -> Array:
        """Return c^2/6 (1 - (1 - (e/c)^2)^3) up to c, c^2/6 beyond; the shape of e."""
        return np.asarray(self.threshold**2 / 6.0 * (1.0 - (1.0 - self._square(e)) ** 3))

    def psi(self, e: ArrayLike) -> Array:
        """Return the biweight; the shape of e."""
        return np.asarray(np.asarray(e, dtype=float) * self.weights(e))

    def psi_deriv(self, e: ArrayLike) -> Array:
        """Return (1 - (e/c)^2)(1 - 5 (e/c)^2) up to c, 0 beyond; the shape of e."""
        r = self._square(e)
        return np.asarray((1.0 - r) * (1.0 - 5.0 * r))

    def weights(self, e: ArrayLike) -> Array:
        """Return (1 - (e/c)^2)^2 up to c, 0 beyond; the shape of e."""
        return np.asarray((1.0 - self._square(e)) ** 2)

    def _square(self, e: ArrayLike) -> Array:
        """Return (e/c)^2, at most 1."""
        return np.minimum(np.abs(np.asarray(e, dtype=float)), self.threshold) ** 2 / self.threshold**2


@dataclass(frozen=True)
class StudentT(_Base):
    """Weigh softly, as for Student's t noise: psi(e) = e / (1 + e^2/(df + 1)).

    The score of a t distribution with df degrees of freedom and scale sqrt((df + 1)/df), which makes
    psi'(0) = 1, so that a small innovation has the Kalman filter's gain.

    Parameters
    ----------
    df : float, default 4
        Degrees of freedom, > 0.

    Raises
    ------
    ValueError
        If df is not finite and > 0.

    Examples
    --------
    >>> StudentT(4).weights([0.0, 5.0**0.5])
    array([1. , 0.5])
    """

    df: float = 4.0

    kernel_name = "student_t"
    kernel_fields = ("df",)
    # Its psi' is smooth.
    corners = ()

    def __post_init__(self) -> None:
        """Check the degrees of freedom."""
        object.__setattr__(self, "df", positive("df", self.df))

    def nominal_information(self) -> float:
        """Return E[psi'] under the t distribution whose score psi is: df/(df + 3)."""
        return self.df / (self.df + 3.0)

    def log_normalizer(self, dim: int) -> float:
        """Return log of the integral of exp(-rho(|e|)) over R^dim; the Gaussian's if dim >= df + 1."""
        a = self.df + 1.0
        if dim >= a:
            return super().log_normalizer(dim)
        sphere = math.log(2.0) + 0.5 * dim * math.log(math.pi) - special.gammaln(0.5 * dim)
        return float(sphere + 0.5 * dim * math.log(a) + special.betaln(0.5 * dim, 0.5 * (a - dim)) - math.log(2.0))

    def rho(self, e: ArrayLike) -> Array:
        """Return (df + 1)/2 log(1 + e^2/(df + 1)); the shape of e."""
        return np.asarray((self.df + 1.0) * np.log(self._hypot(e)))

    def psi(self, e: ArrayLike) -> Array:
        """Return e/(1 + e^2/(df + 1)); the shape of e."""
        h = self._hypot(e)
        return np.asarray(np.asarray(e, dtype=float) / h / h)

    def psi_deriv(self, e: ArrayLike) -> Array:
        """Return (1 - s)/(1 + s)^2 with s = e^2/(df + 1); the shape of e."""
        w = self.weights(e)
        return np.asarray(w * (2.0 * w - 1.0))

    def weights(self, e: ArrayLike) -> Array:
        """Return 1/(1 + e^2/(df + 1)); the shape of e."""
        return np.asarray((1.0 / self._hypot(e)) ** 2)

    def _hypot(self, e: ArrayLike) -> Array:
        """Return sqrt(1 + e^2/(df + 1)) without overflow."""
        return np.hypot(1.0, np.asarray(e, dtype=float) / math.sqrt(self.df + 1.0))
