"""Where cancelling poles may be anywhere, P is that of models drawn from the likelihood."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import lfilter

from robust_filterpy.identification import ARX, OutputError, identify
from robust_filterpy.identification.estimation.profile import Place, Sections, wandered


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


def test_where_the_likelihood_says_nothing_every_stable_pair_is_as_likely():
    sections = Sections.of([np.array([1.0, 0.0, 0.0])])
    flat = wandered(lambda f: Place(0.0, f, lambda: np.zeros((2, 2))), np.zeros(2), np.eye(2), [sections])
    # Of the triangle with the corners (-2, 1), (2, 1) and (0, -1): mean squares 2/3 and 1/3.
    assert_allclose(flat, np.diag([2.0 / 3.0, 1.0 / 3.0]), atol=0.05)


def test_of_a_normal_likelihood_p_is_its_covariance_and_that_of_what_is_linear():
    center, covariance = np.array([-1.2, 0.5, -0.6]), np.diag([0.02, 0.02, 0.02]) ** 2
    inverse = np.linalg.inv(covariance)

    def at(f):
        return Place(0.5 * (f - center) @ inverse @ (f - center), np.append(f, 7.0), lambda: np.diag([0, 0, 0, 4.0]))

    sections = Sections.of([np.append(1.0, center[:2]), np.append(1.0, center[2:])])
    P = wandered(at, np.append(center, 7.0), covariance, [sections])
    assert_allclose(P[:3, :3] / 0.02**2, np.eye(3), atol=0.35)
    assert_allclose(P[3], [0.0, 0.0, 0.0, 4.0])


def test_a_place_behind_a_barrier_counts_by_its_share():
    places, width, shares = np.array([[-0.5, 0.2, 0.1, 0.1], [-0.35, 0.35, 0.25, -0.05]]), 0.03, np.array([0.6, 0.4])

    def at(f):
        distances = 0.5 * np.square((f - places) / width).sum(axis=1)
        return Place(-np.logaddexp(*(np.log(shares) - distances)), f, lambda: np.zeros((4, 4)))

    sections = Sections.of([np.append(1.0, places[0])])
    P = wandered(at, places[0], width**2 * np.eye(4), [sections])
    apart = (P.diagonal() - width**2) / (places[1] - places[0]) ** 2
    # Draws follow each other: of the share of the other place some 25 count.
    assert_allclose(apart, shares[1], atol=5.0 * np.sqrt(shares.prod() / 25.0))
    assert (apart > 0.1).all()


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


def test_what_is_told_is_not_walked_from(too_large):
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
