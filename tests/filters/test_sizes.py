"""No size is special: a step is taken where numpy raises whatever it can, or refused in a sentence of its own."""


import numpy as np
import pytest
import support
from filterpy.common import kinematic_kf
from recordings import unheard
from support import Extended, predict_and_update, through

from robust_filterpy import (
    AdaptiveKalmanFilter,
    Contaminated,
    Huber,
    RobustFilterWarning,
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


@pytest.mark.parametrize("policy", support.POLICIES)
def test_nor_does_it_stop_another_filter_or_a_series(path, raising, policy):
    problem = support.random_problem(5, 3, 2)
    for size in (1e-300, 1e-160, 1.0, 1e20, 1e160, 1e300):
        zs = np.array([[size] * 2] * 14 + [[-size] * 2, [0.0, 0.0]])
        kf = support.make(RobustKalmanFilter, problem, **support.POLICIES[policy])
        for z in zs:
            predict_and_update(kf, z)
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
                    predict_and_update(kf, rng.normal(size=m) * rng.choice(SIZES))
            except (ValueError, np.linalg.LinAlgError) as error:
                assert any(words in str(error) for words in SENTENCES), (given, error)
        assert np.isfinite(kf.x).all() and np.isfinite(kf.P).all()


# States that no sensor sees grow until what a sensor sees of P drowns in rounding: filterpy goes on there.


MAKERS = {
    "linear": lambda n, m: RobustKalmanFilter(n, m, influence=Linear()),
    "default": RobustKalmanFilter,
    "innovation": lambda n, m: RobustKalmanFilter(n, m, scaling="innovation"),
    "adaptive": AdaptiveKalmanFilter,
    "extended": Extended,
}


@pytest.mark.parametrize("dim, order, dt", [(7, 5, 1.0), (5, 5, 2.0), (3, 6, 1.5), (9, 4, 4.0)])
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_a_sum_of_chains_is_followed_with_a_warning(make, dim, order, dt):
    """A ramp, of which filterpy's own `test_steadystate` asks that nothing be raised."""
    kf = make(dim * (order + 1), 1)
    if not hasattr(kf, "H"):
        kf.H = np.zeros((1, kf.dim_x))
    kinematic_kf(dim=dim, order=order, dt=dt, kf=kf)
    with unheard(RobustFilterWarning):
        for k in range(150):
            predict_and_update(kf, np.array([float(k)]))
            assert np.isfinite(kf.x).all()
        assert kf.H @ kf.x == pytest.approx(k, abs=5.0)
        for z in range(100) if make is MAKERS["linear"] and dim == 7 else ():
            kf.predict_steadystate()
            kf.update_steadystate([z])
            assert kf.mahalanobis == pytest.approx(abs(kf.y.item()) / kf.S.item() ** 0.5)


def test_it_is_said_once(recwarn):
    class Mine(RobustKalmanFilter):
        pass

    for _ in range(2):
        kf = kinematic_kf(dim=7, order=5, kf=Mine(42, 1, influence=Linear()))
        through(kf, range(120))
    assert [str(w.message)[:40] for w in recwarn] == ["Mine: H P H' is negative by rounding, si"]


# A million updates, two in five of them outliers of any size.


@pytest.mark.slow
@pytest.mark.timeout(2400)
@pytest.mark.parametrize("dims, choices", [((2, 1), {}), ((4, 2), {"scaling": "bounded", "grouping": "joint"})])
def test_p_stays_positive_definite_and_x_finite(dims, choices):
    problem = support.random_problem(71, *dims)
    kf, rng = support.make(RobustKalmanFilter, problem, **choices), np.random.default_rng(0)
    largest = 0.0
    for _ in range(100):
        zs = rng.normal(size=(10_000, dims[1])) * np.sqrt(np.diag(problem.R))
        bad = rng.random(zs.shape) < 0.4
        zs[bad] = rng.choice([-1.0, 1.0], bad.sum()) * 10.0 ** rng.uniform(0, 300, bad.sum())
        through(kf, zs)
        support.assert_positive_definite(kf.P)
        support.assert_all_finite(kf)
        largest = max(largest, np.abs(kf.x).max(), np.abs(kf.P).max())
    assert largest < 1e3
