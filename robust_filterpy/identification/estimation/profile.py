"""A covariance that holds two standard deviations away, where the loss is not quadratic so far from its least.

Where a zero nearly cancels a pole, theta +- 2 std by linearization holds the truth in four recordings of five instead
of nineteen of twenty. So the loss is looked at along each principal axis of the covariance of C, D and F, with all that
is linear in the residuals (B, A, the constant, the start) at its best there: the profile of the likelihood. Where it
rises more slowly than a quadratic, the axis becomes as long as the farther of the two places at which it has risen by
2. Other ends that are nearly as likely count by their odds.

With two pairs of poles or more, those that nearly cancel may do so at other places nearly as well, and there the other
poles differ, too. No neighborhood of the estimate tells that. So poles are drawn with the probability that the
likelihood gives them, by the steps of Metropolis and Hastings (Robert and Casella, Monte Carlo Statistical Methods,
2004, chapter 7): all poles move a little, one pair moves a little, or one pair jumps to any place within the unit
circle. What is linear in the residuals is at its best for these poles, with its own covariance there. P is the mean
square distance from the estimate.

One walk alone stays in one place for thousands of steps. So there are several, each through a flatter likelihood than
the one before, and neighbors exchange their places with the probability that leaves both as they should be
(replica exchange; Geyer, Computing Science and Statistics 23, 1991). Only the first counts.

Before the recording each pair is as likely at one place as at another, as coefficients of its factor (1 + a/q + b/q^2);
what is linear has a density as wide as the recording, so that the least loss alone weighs the poles (Zellner's prior).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._progress import stage
from robust_filterpy.identification.models.noise import Noise
from robust_filterpy.identification.models.polynomial_model import PolynomialModel
from robust_filterpy.identification.models.uncertainty import principal_axes

# Of so many steps in all the first share only leads away from where the walks begin.
_STEPS: Final = 10000
_BEGINNING: Final = 0.2
# A walk at temperature T is through the likelihood to the power 1/T, where what lies between two places is no barrier.
_TEMPERATURES: Final = (1.0, 2.0, 4.0, 8.0)
# How often a pair jumps; a small step is of all poles as often as of one pair.
_JUMPS: Final = 0.4
# Small steps have sizes of 10 to these powers, in standard deviations by linearization (none of which counts as more
# than the second number), or for one pair in units of the third.
_SIZES: Final = (-1.5, 0.5)
_WIDEST: Final = 0.5
_OF_A_PAIR: Final = 0.3
# Two standard deviations away the loss has risen by 2, or is bent if it is off by more than this share of it.
_FAR: Final = 2.0
_BENT: Final = 0.2
# So many standard deviations are the most that an axis has, and it is found to two or three digits.
_FARTHEST: Final = 16.0
_HALVINGS: Final = 6
# Ends so much less likely than the best count.
_CLOSE: Final = 4.0
# A walk may begin at an end that is less likely still, since it leaves it.
_WORTH_A_WALK: Final = 10.0
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


def wandered(at: Callable[[Array], Place], p: Array, covariance: Array, begins: list[Sections]) -> Array:
    """Return the mean square distance of the free parameters from the estimate."""
    # Always the same draws, so that a recording gives the same P twice.
    rng = np.random.default_rng(0)
    sections = begins[0]
    values = [begins[k % len(begins)].values for k in range(len(_TEMPERATURES))]
    places = [at(sections.multiplied(each)) for each in values]
    small, turns = _steps_of(sections, covariance), _STEPS // len(_TEMPERATURES)
    total, counted, square = np.zeros((p.size, p.size)), 0, _square(places[0], p)
    for turn in range(turns):
        before = places[0]
        for k, temperature in enumerate(_TEMPERATURES):
            new = _next(values[k], temperature**0.5 * small, sections, rng)
            there = at(sections.multiplied(new)) if sections.are_stable(new) else None
            if there is not None and temperature * np.log(rng.random()) < places[k].loss - there.loss:
                values[k], places[k] = new, there
        for k in range(turn % 2, len(places) - 1, 2):
            colder, hotter = (1.0 / temperature for temperature in _TEMPERATURES[k : k + 2])
            if np.log(rng.random()) < (places[k].loss - places[k + 1].loss) * (colder - hotter):
                values[k : k + 2] = values[k : k + 2][::-1]
                places[k : k + 2] = places[k : k + 2][::-1]
        square = square if places[0] is before else _square(places[0], p)
        if turn >= _BEGINNING * turns:
            total, counted = total + square, counted + 1
    return total / counted


def _next(x: Array, small: Array, sections: Sections, rng: np.random.Generator) -> Array:
    """Return where the walk may go next; the way back is as likely."""
    new, kind = x.copy(), rng.random()
    place = sections.places[rng.integers(len(sections.places))]
    if kind < _JUMPS:
        new[place] = _anywhere(place.stop - place.start, rng)
        return new
    size = 10.0 ** rng.uniform(*_SIZES)
    if kind < 0.5 * (1.0 + _JUMPS):
        return np.asarray(new + size * small @ rng.normal(size=x.size))
    new[place] += _OF_A_PAIR * size * rng.normal(size=place.stop - place.start)
    return new


def _steps_of(sections: Sections, covariance: Array) -> Array:
    """Return a root of the covariance of the factors, times the usual 2.4 over the root of their number."""
    x, tiny = sections.values, 1e-6
    moved = [sections.multiplied(x + tiny * e) - sections.multiplied(x - tiny * e) for e in np.eye(x.size)]
    inverse = np.linalg.pinv(np.array(moved).T / (2.0 * tiny))
    values, vectors = np.linalg.eigh(inverse @ covariance @ inverse.T)
    lengths = np.minimum(np.sqrt(np.maximum(values, 0.0)), _WIDEST)
    return np.asarray(2.4 / np.sqrt(x.size) * vectors * lengths)


def _square(place: Place, p: Array) -> Array:
    """Return the mean square distance from p at one place."""
    apart = place.p - p
    return np.outer(apart, apart) + place.spread()


def _is_inside(values: Array) -> bool:
    """Tell whether the roots of one factor are within the unit circle."""
    if values.size == 1:
        return bool(abs(values[0]) < 1.0)
    return bool(abs(values[1]) < 1.0 and abs(values[0]) < 1.0 + values[1])


def _anywhere(degree: int, rng: np.random.Generator) -> Array:
    """Return a stable factor, any of them as likely as any other."""
    while True:
        values = rng.uniform(-1.0, 1.0, degree) * (2.0, 1.0)[2 - degree :]
        if _is_inside(values):
            return np.asarray(values)


def profiled(
    model: PolynomialModel,
    p: Array,
    noise: Noise,
    rows: Any,
    P: Array,
    held: Any,
    others: list[tuple[float, Array]],
    sampled: bool,
    colour: float = 1.0,
) -> tuple[Array, str]:
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
        begins = [sections, *(Sections.of(loss.polynomials(end)) for excess, end in others if excess < _WORTH_A_WALK)]
        stage("models drawn from the likelihood, for their covariance")
        begins = [each for each in begins if each.are_stable(each.values)]
        return wandered(loss.best, p, own, begins), "sampled likelihood"
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
