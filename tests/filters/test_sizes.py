"""No size is special: a step is taken where numpy raises whatever it can, or refused in a sentence of its own."""


import numpy as np
import pytest
import support
from recordings import unheard
from support import noise_given, recovering, two_sided

from robust_filterpy import (
    AdaptiveKalmanFilter,
    Contaminated,
    Huber,
    RobustKalmanFilter,
    StudentT,
    TukeyBiweight,
    filter_series,
)
from robust_filterpy.influence import Hampel, Linear

SHOWN = (*support.STATE, "y", "K", "S", "SI", "e", "T", "y_bounded", "weights", "log_likelihood", "mahalanobis")


@pytest.fixture
def raising():
    """Tell numpy to raise whatever it can."""
    with np.errstate(all="raise"):
        yield


@pytest.mark.pairwise
@pytest.mark.parametrize(
    "influence", [Linear(), Huber(), Huber(0.5), Hampel(), TukeyBiweight(), StudentT(), StudentT(50.0)], ids=repr
)
@pytest.mark.parametrize("scaling, information, grouping", [
    ("innovation", "realized", "component"), ("innovation", "weight", "joint"), ("bounded", "realized", "component"),
    ("innovation", "expected", "component"),
])  # fmt: skip
@pytest.mark.parametrize("dim_z, ndim", [(1, 2), (2, 1), (2, 2)])
def test_a_numpy_that_raises_changes_no_number(path, influence, scaling, information, grouping, dim_z, ndim):
    """Where e^2 overflows, where psi(e)/e turns subnormal, and everywhere between, after a missing reading too."""
    problem = support.random_problem(64, 2, dim_z)
    options = {"influence": influence, "information": information, "scaling": scaling, "grouping": grouping}
    quiet, loud = (support.make(RobustKalmanFilter, problem, ndim, **options) for _ in range(2))
    for k, exponent in enumerate(np.arange(-300.0, 300.5, 4.0)):
        second = (0.1, -(10.0**exponent), np.nan)[k % 3]
        z = [-(10.0**exponent), second][-dim_z:] if dim_z == 2 else 10.0**exponent
        support.load(quiet, problem, ndim).update(z)
        with np.errstate(all="raise"):
            support.load(loud, problem, ndim).update(z)
            _ = [getattr(loud, name) for name in SHOWN]
        for name in SHOWN:
            np.testing.assert_array_equal(getattr(loud, name), getattr(quiet, name), err_msg=name)
            assert name == "weights" or np.all(np.isfinite(getattr(loud, name))), (name, exponent)
        assert 0.0 <= loud.likelihood < np.inf
        support.assert_positive_definite(loud.P, f"P after z = 1e{exponent}")
        assert influence == Linear() or np.abs(np.ravel(loud.x) - problem.x[:, 0]).max() < 100, exponent
    assert repr(loud)


@pytest.mark.parametrize(
    "cls", [recovering, noise_given, two_sided, AdaptiveKalmanFilter],
    ids=["recovering", "given", "two-sided", "adaptive"],
)
def test_nor_does_it_stop_another_filter_or_a_series(path, raising, cls):
    problem = support.random_problem(5, 3, 2)
    for size in (1e-300, 1e-160, 1.0, 1e20, 1e160, 1e300):
        zs = np.array([[size] * 2] * 14 + [[-size] * 2, [0.0, 0.0]])
        kf = support.make(cls, problem)
        for z in zs:
            support.predict_and_update(kf, z)
            assert all(np.isfinite(getattr(kf, name)).all() for name in (*SHOWN, "likelihood"))
        support.make(RobustKalmanFilter, problem).batch_filter(zs)
        p = problem
        filter_series(np.tile(zs, (2, 1, 1)), p.F, p.H, p.Q, p.R, p.x.ravel(), p.P)


def test_a_prediction_that_overflows_is_refused_in_the_usual_words(path, raising):
    kf = support.make(RobustKalmanFilter, support.random_problem(5, 3, 2))
    kf.F = 1e200 * np.eye(3)
    before = support.snapshot(kf)
    with pytest.raises(ValueError, match="finite P"):
        kf.predict()
    support.assert_unchanged(before, kf)


SIZES = 10.0 ** np.array([-300, -160, -10, 0, 0, 10, 150, 160, 200, 300, 307])
SENTENCES = ("expected", "S = H P H' + R: ", 'scaling="unit" would make P indefinite')


def options(rng):
    found = {"grouping": str(rng.choice(["joint", "component"]))}
    if rng.random() < 0.4:
        found["noise"] = ["learnt", Contaminated(0.1, 10.0)][rng.integers(2)]
        return {**found, "process": "scales"} if rng.random() < 0.5 else found
    found["influence"] = [Huber(), Linear(), TukeyBiweight(), StudentT()][rng.integers(4)]
    return {**found, "scaling": str(rng.choice(["innovation", "unit", "bounded", "learnt"]))}


@pytest.mark.parametrize("seed", range(6))
def test_a_step_is_taken_or_refused_in_a_sentence(seed):
    rng = np.random.default_rng(seed)
    for _ in range(100):
        (n, m), given = rng.integers(1, 4, 2), options(rng)
        kf, A = RobustKalmanFilter(n, m, **given), rng.normal(size=(n, n))
        kf.F, kf.H, kf.R = np.eye(n), rng.normal(size=(m, n)), np.eye(m) * rng.choice(SIZES)
        kf.Q = A @ A.T * rng.choice(SIZES) if rng.random() < 0.7 else np.diag(rng.choice(SIZES, n))
        with unheard(), np.errstate(all="ignore"):
            try:
                for _ in range(4):
                    support.predict_and_update(kf, rng.normal(size=m) * rng.choice(SIZES))
            except (ValueError, np.linalg.LinAlgError) as error:
                assert any(words in str(error) for words in SENTENCES), (given, error)
        assert np.isfinite(kf.x).all() and np.isfinite(kf.P).all()
