"""A covariance that holds two standard deviations away, where the loss is not quadratic so far from its least.

Where a zero nearly cancels a pole, theta +- 2 std by linearization holds the truth in four recordings of five instead
of nineteen of twenty. So the loss is looked at along each principal axis of the covariance of C, D and F, with all that
is linear in the residuals (B, A, the constant, the start) at its best there: the profile of the likelihood. Where it
rises more slowly than a quadratic, the axis becomes as long as the farther of the two places at which it has risen by
2. Other ends that are nearly as likely count by their odds.

With two pairs of poles or more, those that nearly cancel may do so at other places nearly as well, and there the other
poles differ, too. No neighborhood of the estimate tells that. So one pair, or several but not all, is put at places all
over the unit circle, and from each the likeliest model near by is found: what the pair explains elsewhere, the rest
following it. The likelihood there is taken for normal (Laplace's method), times a normal density for the place of the
pair, as wide as its share of the circle, and, so that a flat likelihood counts no more than the circle holds, one
around the estimate for the rest. P is the mean square distance from the estimate in the mixture of all places; of
several choices of pairs that with the largest likelihood in all: the others miss some of it.

Before the recording each pair is as likely at one place as at another, as coefficients of its factor (1 + a/q + b/q^2);
what is linear has a density as wide as the recording, so that the least loss alone weighs the poles (Zellner's prior).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.stats import qmc

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.uncertainty import principal_axes

# So many places of each choice of pairs, from each of which so many steps lead to the likeliest model near by.
_PLACES: Final = 64
_STEPS: Final = 2
_SHORTER: Final = (1.0, 0.3, 0.1)
# A factor that is not put anywhere is within so much of where it is, in standard deviations of its coefficients.
_WIDEST: Final = 0.5
# Two standard deviations away the loss has risen by 2, or is bent if it is off by more than this share of it.
_FAR: Final = 2.0
_BENT: Final = 0.2
# So many standard deviations are the most that an axis has, and it is found to two or three digits.
_FARTHEST: Final = 16.0
_HALVINGS: Final = 6
# Ends so much less likely than the best count.
_CLOSE: Final = 4.0
# Weights of the residuals and what is linear take turns.
_TURNS: Final = 2


class Place(NamedTuple):
    """The best of what is linear for given poles.

    Attributes
    ----------
    loss : float
        Minus the log-likelihood, infinite where the model is not stable.
    p : ndarray, shape (n,)
        All free parameters.
    spread : function
        Gives the covariance of what is linear, shape (n, n), 0 elsewhere.
    """

    loss: float
    p: Array
    spread: Callable[[], Array]


class Sections(NamedTuple):
    """Polynomials as products of factors with one pair of roots, or a single one.

    Attributes
    ----------
    degrees : tuple of tuple of int
        Of the factors of each polynomial.
    values : ndarray, shape (k,)
        Coefficients of all factors, without the leading ones.
    """

    degrees: tuple[tuple[int, ...], ...]
    values: Array

    @classmethod
    def of(cls, polynomials: list[Array]) -> Sections:
        """Return the factors."""
        degrees, values = [], []
        for polynomial in polynomials:
            roots = np.roots(polynomial)
            real = np.sort(roots[roots.imag == 0.0].real)
            groups = [np.array([root, root.conjugate()]) for root in roots[roots.imag > 0.0]]
            groups += [real[i : i + 2] for i in range(0, real.size, 2)]
            degrees.append(tuple(group.size for group in groups))
            values += [np.real(np.poly(group))[1:] for group in groups]
        return cls(tuple(degrees), np.concatenate(values) if values else np.zeros(0))

    @property
    def places(self) -> tuple[slice, ...]:
        """Where the coefficients of each factor are."""
        ends = np.cumsum([degree for degrees in self.degrees for degree in degrees])
        return tuple(slice(begin, end) for begin, end in zip((0, *ends[:-1]), ends, strict=True))

    def multiplied(self, values: Array) -> Array:
        """Return the coefficients of all polynomials, without the leading ones."""
        coefficients, places = [], iter(self.places)
        for degrees in self.degrees:
            product = np.ones(1)
            for _ in degrees:
                product = np.convolve(product, np.append(1.0, values[next(places)]))
            coefficients.append(product[1:])
        return np.concatenate(coefficients)

    def are_stable(self, values: Array) -> bool:
        """Tell whether all roots are within the unit circle."""
        return all(_is_inside(values[place]) for place in self.places)


def wandering(loss: _Loss, sections: Sections) -> Array:
    """Return the mean square distance of the free parameters from the estimate, pairs of poles being anywhere."""
    x, places = sections.values, sections.places
    wide = np.full(x.size, _WIDEST)
    choices = [()] + [which for k in range(1, len(places)) for which in combinations(range(len(places)), k)]
    mixtures = []
    for which in choices:
        moved = np.concatenate([np.arange(x.size)[places[i]] for i in which] or [np.zeros(0, dtype=int)])
        degrees = [places[i].stop - places[i].start for i in which]
        # As large as the region of stable factors is: 2 for a single root, 4 for a pair.
        share = float(np.prod([2.0 * degree for degree in degrees])) / _PLACES
        width = wide.copy()
        width[moved] = 0.5 * share ** (1.0 / max(moved.size, 1))
        near = []
        for values in _anywhere(degrees) if which else [x[moved]]:
            center = x.copy()
            center[moved] = values
            near.append(_near(loss, sections, center, width, _STEPS if which else 0))
        # The density of places is even, that of the rest is not divided by its integral.
        size = np.log(share if which else 1.0) + (x.size - moved.size) * np.log(_WIDEST * np.sqrt(2.0 * np.pi))
        weights = [one + size for one, _ in near]
        total = float(np.logaddexp.reduce(weights))
        shares = np.exp(np.array(weights) - total)
        mixtures.append((total, sum(part * square for part, (_, square) in zip(shares, near, strict=True))))
    return np.asarray(max(mixtures, key=lambda one: one[0])[1])


def _anywhere(degrees: list[int]) -> Array:
    """Return stable factors of these degrees that cover all of them evenly, a row each."""
    drawn, columns = qmc.Sobol(sum(degrees), seed=0).random(_PLACES), []
    for degree in degrees:
        first, drawn = drawn[:, 0], drawn[:, 1:]
        if degree == 1:
            columns.append(2.0 * first - 1.0)
            continue
        last, drawn = 2.0 * np.sqrt(drawn[:, 0]) - 1.0, drawn[:, 1:]
        columns += [(2.0 * first - 1.0) * (1.0 + last), last]
    return np.column_stack(columns)


def _near(loss: _Loss, sections: Sections, center: Array, width: Array, steps: int) -> tuple[float, Array]:
    """Return the log of the integral of the likelihood around some factors, and the mean square distance there."""
    x, prior = center, width**-2.0
    best = loss.best(sections.multiplied(x))
    cost = best.loss
    for turn in range(steps + 1):
        slope, H, follows = loss.curvature(best.p, sections, x)
        H, slope = H + np.diag(prior), slope + prior * (x - center)
        step = np.linalg.solve(H, slope) if turn < steps else np.zeros(x.size)
        for part in _SHORTER if turn < steps else ():
            new = x - part * step
            if sections.are_stable(new):
                there = loss.best(sections.multiplied(new))
                lower = there.loss + 0.5 * float(prior @ (new - center) ** 2)
                if lower < cost:
                    x, best, cost = new, there, lower
                    break
        else:
            break
    apart = best.p - loss.p
    square = np.outer(apart, apart) + best.spread() + follows @ np.linalg.solve(H, follows.T)
    return 0.5 * float(np.log(prior).sum() - np.linalg.slogdet(H)[1]) - cost, square


def _is_inside(values: Array) -> bool:
    """Tell whether the roots of one factor are within the unit circle."""
    if values.size == 1:
        return bool(abs(values[0]) < 1.0)
    return bool(abs(values[1]) < 1.0 and abs(values[0]) < 1.0 + values[1])


def profiled(
    model: PolynomialModel, p: Array, noise: Noise, rows: Any, P: Array, held: Any, others: list[tuple[float, Array]],
    sampled: bool, colour: float = 1.0,
) -> tuple[Array, str]:  # fmt: skip
    """Return the covariance of the free parameters, wider where the loss bends, and how it was found."""
    loss = _Loss.of(model, p, noise, rows, held, colour)
    places = np.flatnonzero(loss.bent)
    if not places.size:
        return P, ""
    own = P[np.ix_(places, places)]
    axes, least = principal_axes(own), loss.at(p[places])
    reach = np.array([max(_reach(loss, p[places], sign * axis, least) for sign in (-1.0, 1.0)) for axis in axes])
    close = [(excess, end) for excess, end in others if excess < _CLOSE]
    if (reach <= 1.0).all() and not close:
        return P, ""
    sections = Sections.of(loss.polynomials(p))
    if (
        sampled
        and len(sections.places) > 1
        and sections.are_stable(sections.values)
        and not held[loss.polynomial].any()
    ):
        stage("models of pairs of poles anywhere, for their covariance")
        return wandering(loss, sections), "sampled likelihood"
    longer = axes * np.maximum(reach, 1.0)[:, None]
    wider = longer.T @ longer
    total = 1.0 + sum(np.exp(-excess) for excess, _ in close)
    for excess, end in close:
        apart = end[places] - p[places]
        wider += np.exp(-excess) / total * np.outer(apart, apart)
    # What is linear follows as the linearization says.
    follows = P[:, places] @ np.linalg.pinv(own)
    return P + follows @ (wider - own) @ follows.T, "profile likelihood"


def _reach(loss: _Loss, center: Array, axis: Array, least: float) -> float:
    """Return where the loss along an axis has risen as a quadratic would have in two standard deviations, over that."""

    def rise(t: float) -> float:
        return (loss.at(center + t * axis) - least) / (0.5 * _FAR**2)

    low, high = 0.0, _FAR
    if abs(rise(_FAR) - 1.0) < _BENT:
        return 1.0
    while high < _FARTHEST and rise(high) < 1.0:
        low, high = high, 2.0 * high
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rise(middle) < 1.0 else (low, middle)
    return 0.5 * (low + high) / _FAR


class _Loss(NamedTuple):
    """What the residuals say of C, D and F, all that is linear at its best."""

    model: PolynomialModel
    p: Array
    noise: Noise
    rows: Any
    weights: Array
    counted: float
    bent: Any
    linear: Any
    polynomial: Any

    @classmethod
    def of(cls, model: PolynomialModel, p: Array, noise: Noise, rows: Any, held: Any, colour: float) -> _Loss:
        """Return it, of which as much counts as the sandwich says."""
        places, bent = model.structure.polynomials, np.zeros(model.n, dtype=bool)
        for place in (places.f, places.c, places.d):
            bent[place] = True
        residual = model.residuals(p)[rows]
        square = max(float(np.mean(noise.psi(residual) ** 2)), np.finfo(float).tiny)
        counted = noise.slope(residual) / square * (1.0 - model.n / residual.size) / colour**2
        return cls(model, p, noise, rows, noise.weights(residual), counted, bent & ~held, ~bent & ~held, bent)

    def polynomials(self, p: Array) -> list[Array]:
        """Return those of C, D and F that have roots, in the order in which they stand in p."""
        places = self.model.structure.polynomials
        standing = sorted((places.f, places.c, places.d), key=lambda place: place.start)
        return [np.append(1.0, p[place]) for place in standing if place.stop > place.start]

    def curvature(self, p: Array, sections: Sections, x: Array) -> tuple[Array, Array, Array]:
        """Return slope and curvature of the loss by factors, what is linear at its best, and by them all of p."""
        tiny, k = 1e-6, x.size
        moved = [sections.multiplied(x + tiny * e) - sections.multiplied(x - tiny * e) for e in np.eye(k)]
        follows = np.zeros((p.size, k))
        follows[self.bent] = np.array(moved).T / (2.0 * tiny)
        residual, jacobian = self.model.residuals(p)[self.rows], self.model.jacobian(p)[self.rows]
        X = np.column_stack((jacobian @ follows, jacobian[:, self.linear]))
        size = np.linalg.norm(X, axis=0)
        size[size == 0.0] = 1.0
        weighted = X / size * self.noise.weights(residual)[:, None]
        square = X.T @ weighted / size[:, None] + 1e-12 * np.diag(np.arange(size.size) >= k)
        slope = weighted.T @ residual
        least = np.linalg.solve(square[k:, k:], square[k:, :k])
        scale, own = self.counted / self.noise.variance, size[:k]
        curvature = (square[:k, :k] - square[:k, k:] @ least) * np.outer(own, own)
        follows[self.linear] = -least * own / size[k:, None]
        return scale * own * (slope[:k] - least.T @ slope[k:]), scale * curvature, follows

    def at(self, bent: Array) -> float:
        """Return the least loss for these C, D and F, infinite where they are not stable."""
        return self.best(bent).loss

    def best(self, bent: Array) -> Place:
        """Return the least loss for these C, D and F, where it is, and how sure what is linear is there."""
        p = self.p.copy()
        p[self.bent] = bent
        if not self.model.is_stable(p):
            return Place(np.inf, p, lambda: np.zeros((p.size, p.size)))
        residual, X = self.model.residuals(p)[self.rows], self.model.jacobian(p).T[self.linear][:, self.rows]
        size = np.linalg.norm(X, axis=1)
        size = np.where(size > 0.0, size, 1.0)
        X = X / size[:, None]
        for turn in range(_TURNS):
            weighted = X * (self.noise.weights(residual) if turn else self.weights)
            square = weighted @ X.T + 1e-12 * np.eye(size.size)
            step = np.linalg.solve(square, weighted @ residual)
            residual = residual - step @ X
            p[self.linear] -= step / size

        def spread() -> Array:
            """Return the covariance of what is linear."""
            covariance = np.zeros((p.size, p.size))
            own = np.linalg.inv(square) / np.outer(size, size)
            covariance[np.ix_(self.linear, self.linear)] = self.noise.variance / self.counted * own
            return covariance

        return Place(self.counted * self.noise.cost(residual), p, spread)
