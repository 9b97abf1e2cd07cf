"""Where cancelling poles may be anywhere, P is that of the likelihood at all places."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import lfilter

from robust_filterpy.identification import ARX, OutputError, identify
from robust_filterpy.identification.estimation.profile import Place, Sections, wandering


@pytest.mark.parametrize(
    "polynomial", [[1.0, -0.5], [1.0, 0.0, 0.0], [1.0, -1.5, 0.7, 0.1], [1.0, -1.2, 0.35, 0.02, -0.005, 0.0]]
)
def test_factors_multiply_to_the_polynomial(polynomial):
    sections = Sections.of([np.array(polynomial), np.array([1.0, 0.3])])
    assert_allclose(sections.multiplied(sections.values), [*polynomial[1:], 0.3], atol=1e-6)


def test_a_factor_with_a_root_outside_is_not_stable():
    assert Sections.of([np.poly([0.9, 0.5, -0.5])]).are_stable(np.array([-1.4, 0.45, 0.5]))
    for f in (np.poly([1.1, 0.5]), np.poly([1.1j, -1.1j]), np.array([1.0, 1.01])):
        sections = Sections.of([f])
        assert not sections.are_stable(sections.values)


class Factors(Sections):
    """Pairs that are the parameters themselves."""

    def multiplied(self, values):
        return values


class Likelihood:
    """A sum of normal densities of the factors of one polynomial, and a number that is known to a variance of 4."""

    def __init__(self, centers, widths, shares=(1.0,)):
        self.centers, self.shares = np.atleast_2d(centers), np.array(shares)
        count = self.centers.shape[1]
        self.inverse = np.diag(np.broadcast_to(1.0 / np.square(widths), count))
        self.sections = Factors(((2,) * (count // 2),), self.centers[0])
        self.p = self.best(self.centers[0]).p

    def distances(self, f):
        return np.log(self.shares) - 0.5 * np.einsum("ki,ij,kj->k", f - self.centers, self.inverse, f - self.centers)

    def best(self, f):
        spread = np.zeros((f.size + 1, f.size + 1))
        spread[-1, -1] = 4.0
        return Place(-float(np.logaddexp.reduce(self.distances(f))), np.append(f, 7.0), lambda: spread)

    def curvature(self, p, sections, x):
        share = np.exp(self.distances(x) - np.logaddexp.reduce(self.distances(x)))
        return self.inverse @ (x - share @ self.centers), self.inverse, np.eye(x.size + 1)[:, :-1]


def test_a_pair_of_which_the_likelihood_says_nothing_may_be_anywhere():
    loss = Likelihood([0.1, 0.2, 0.0, 0.0], [0.01, 0.01, 1e6, 1e6])
    # Of the triangle with the corners (-2, 1), (2, 1) and (0, -1): mean squares 2/3 and 1/3.
    expected = np.diag([1e-4, 1e-4, 2.0 / 3.0, 1.0 / 3.0, 4.0])
    assert_allclose(wandering(loss, loss.sections), expected, atol=0.05)


def test_of_a_normal_likelihood_p_is_its_covariance_and_that_of_what_is_linear():
    loss = Likelihood([-1.2, 0.5, -0.6, 0.1], 0.02)
    P = wandering(loss, loss.sections)
    assert_allclose(P[:4, :4] / 0.02**2, np.eye(4), atol=0.35)
    assert_allclose(P[4], [0.0, 0.0, 0.0, 0.0, 4.0])


def test_a_place_behind_a_barrier_counts_by_its_share():
    centers, shares = np.array([[-0.5, 0.2, 0.1, 0.1], [0.7, 0.35, 0.25, -0.05]]), (0.6, 0.4)
    loss = Likelihood(centers, 0.1, shares)
    apart = (wandering(loss, loss.sections).diagonal()[:4] - 0.01) / (centers[1] - centers[0]) ** 2
    assert_allclose(apart[0], shares[1], atol=0.1)


@pytest.fixture(scope="module")
def too_large():
    """Return a recording of a plant of order 2, and its model of order 4."""
    rng = np.random.default_rng(29)
    u = rng.choice([-1.0, 1.0], 300)
    y = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u)
    y += np.where(rng.random(300) < 0.1, 3.0, 0.3) * rng.normal(size=300)
    return y, u, identify(y, u, OutputError(4, 4), trend="constant", progress=False)


def test_the_pole_that_nothing_tells_has_no_narrow_interval(too_large):
    y, u, model = too_large
    profile = identify(y, u, OutputError(4, 4), trend="constant", sampled=False, progress=False)
    assert model.profiled
    assert model.sampled
    assert "sampled likelihood" in model.summary().to_text()
    assert profile.profiled
    assert not profile.sampled
    assert "profile likelihood" in profile.summary().to_text()
    assert_array_equal(model.theta, profile.theta)
    # A cancelling pair that may be anywhere, whose sum is known to no better than some tenths.
    assert model.std[0] > 0.3
    assert np.linalg.eigvalsh(model.P).min() >= -1e-9 * np.trace(model.P)


def test_what_is_given_goes_nowhere(too_large):
    y, u, model = too_large
    held = identify(y, u, OutputError(4, 4), trend="constant", fixed={"a1": float(model.theta[0])}, progress=False)
    assert not held.sampled
    assert held.std[0] == 0.0


@pytest.mark.nightly
def test_the_same_recording_gives_the_same_p(too_large):
    y, u, model = too_large
    again = identify(y, u, OutputError(4, 4), trend="constant", progress=False)
    assert_array_equal(again.P, model.P)


@pytest.mark.parametrize("sampled", [None, 1, "yes"])
def test_sampled_is_true_or_false(too_large, sampled):
    y, u, _ = too_large
    with pytest.raises(TypeError, match="sampled: expected True or False"):
        identify(y, u, ARX(1, 1), sampled=sampled)
