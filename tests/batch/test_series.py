"""Many series are a loop over filters, whatever runs them."""

import numpy as np
import pytest
import support

from robust_filterpy import RobustKalmanFilter, StudentT
from robust_filterpy.correction import NotPositiveDefiniteError
from robust_filterpy.filters.series import filter_series


def problem_and_series(dims=(3, 2, 0), series=4, steps=30):
    problem = support.random_problem(8, *dims)
    zs = np.array([support.simulate(problem, steps, seed, contamination=0.1)[0] for seed in range(series)])
    zs[np.random.default_rng(0).random(zs.shape) < 0.1] = np.nan
    return problem, zs


def arguments(problem):
    return problem.F, problem.H, problem.Q, problem.R, problem.x[:, 0], problem.P


@pytest.mark.parametrize("choices", [
    {"scaling": "learnt"},
    {"scaling": "innovation"},
    {"influence": StudentT(3), "scaling": "bounded", "grouping": "joint"},
])  # fmt: skip
def test_series_are_a_loop_over_filters(form, choices):
    problem, zs = problem_and_series()
    result = filter_series(zs, *arguments(problem), **choices)
    for s, z in enumerate(zs):
        kf, total = support.make(RobustKalmanFilter, problem, 1, **choices), 0.0
        for k, z_k in enumerate(z):
            kf.predict()
            kf.update(z_k)
            total += kf.log_likelihood
            for ours, theirs in [(result.x, kf.x), (result.P, kf.P), (result.weights, kf.weights)]:
                np.testing.assert_allclose(ours[s, k], theirs, rtol=1e-10, atol=1e-11)
        assert result.log_likelihood[s] == pytest.approx(total, rel=1e-10)


def test_each_series_may_have_its_own_matrices_at_each_step(form):
    problem, zs = problem_and_series()
    rng = np.random.default_rng(1)
    F = np.array([[support.stable(rng, 3) for _ in range(30)] for _ in range(4)])
    R = np.array([[support.spd(rng, 2)] for _ in range(4)])
    x0, P0 = rng.normal(size=(4, 3)), np.array([support.spd(rng, 3) for _ in range(4)])
    result = filter_series(zs, F, problem.H, problem.Q, R, x0, P0)
    for s in range(4):
        one = filter_series(zs[s : s + 1], F[s], problem.H, problem.Q, R[s, 0], x0[s], P0[s])
        np.testing.assert_allclose(result.x[s], one.x[0], rtol=1e-11, atol=1e-12)
        kf = RobustKalmanFilter(3, 2)
        kf.x, kf.P, kf.H, kf.Q, kf.R = x0[s], P0[s], problem.H, problem.Q, R[s, 0]
        np.testing.assert_allclose(result.x[s], kf.batch_filter(list(zs[s]), Fs=list(F[s]))[0], rtol=1e-10, atol=1e-11)


def test_keeping_less_changes_nothing_else(form):
    problem, zs = problem_and_series()
    whole = filter_series(zs, *arguments(problem))
    last = filter_series(zs, *arguments(problem), keep="last", covariance="diagonal")
    some = filter_series(zs, *arguments(problem), keep=7, covariance="none", n_threads=1)
    np.testing.assert_array_equal(last.x, whole.x[:, -1:])
    np.testing.assert_array_equal(last.P, np.diagonal(whole.P[:, -1:], axis1=2, axis2=3))
    np.testing.assert_array_equal(some.x, whole.x[:, 6::7])
    assert some.P is None
    np.testing.assert_array_equal(some.log_likelihood, whole.log_likelihood)


@pytest.mark.parametrize("change, match", [
    ({"zs": np.zeros((2, 3))}, r"zs: expected shape .*zs\[:, :, None\].*zs\[None\]"),
    ({"zs": np.zeros((2, 3, 0))}, "zs: expected dim_z >= 1"),
    ({"x0": np.zeros((3, 1))}, r"x0: expected shape .* got \(3, 1\); use x0.ravel"),
    ({"x0": 0.0}, "x0: expected shape"),
    ({"x0": np.zeros(0), "P0": np.zeros((0, 0))}, "x0: expected dim_x >= 1"),
    ({"Q": np.eye(3) + 0.1 * np.eye(3, k=1)}, "Q: expected a symmetric"),
    ({"P0": np.eye(3) + 0.1 * np.eye(3, k=1)}, "P0: expected a symmetric"),
    ({"zs": np.full((1, 2, 2), np.inf)}, "zs: expected finite"),
    ({"R": 5.0}, "R: expected shape"),
    ({"R": -np.eye(2)}, "R: expected a positive semidefinite"),
    ({"Q": np.diag([1.0, 1.0, -1e-3])}, "^Q: expected variances >= 0"),
    ({"P0": np.eye(2)}, "P0: expected shape"),
    ({"keep": 0}, "keep"),
    ({"keep": "some"}, "keep"),
    ({"covariance": "half"}, "covariance"),
    ({"F": 1e200 * np.eye(3)}, "step 0: predict"),
])  # fmt: skip
def test_refusals_say_what_was_expected(form, change, match):
    problem, zs = problem_and_series()
    call = dict(zip(["F", "H", "Q", "R", "x0", "P0"], arguments(problem), strict=True), zs=zs)
    with pytest.raises(ValueError, match=match):
        filter_series(**{**call, **change})


@pytest.mark.slow
def test_blocks_on_a_dask_cluster_are_the_whole():
    pytest.importorskip("distributed")
    import dask.array
    from dask.distributed import Client, LocalCluster

    problem, zs = problem_and_series(series=8)
    model = arguments(problem)
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster, Client(cluster):
        blocks = dask.array.from_array(zs, chunks=(2, -1, -1))
        x = blocks.map_blocks(lambda z: filter_series(z, *model).x, dtype=float, chunks=((2,) * 4, (30,), (3,)))
        np.testing.assert_array_equal(x.compute(), filter_series(zs, *model).x)


def test_a_series_that_is_refused_leaves_the_others_alone(form):
    zs = np.random.default_rng(3).normal(size=(5, 30, 1))
    P0 = np.tile(0.1 * np.eye(2), (5, 1, 1))
    P0[3] *= 1e4
    model = (np.eye(2), np.eye(1, 2), 1e-3 * np.eye(2), np.eye(1), np.zeros(2))
    with pytest.raises(NotPositiveDefiniteError, match=r"step 0: .*scaling"):
        filter_series(zs, *model, P0, scaling="unit")
    result = filter_series(zs, *model, P0, scaling="unit", refused="nan")
    others = [0, 1, 2, 4]
    alone = filter_series(zs[others], *model, P0[others], scaling="unit")
    for found, expected in zip(result[:4], alone[:4], strict=True):
        np.testing.assert_allclose(found[others], expected, rtol=1e-12)
        assert np.isnan(found[3]).all()


def test_a_series_is_nan_from_the_refused_step_on(form):
    zs = np.zeros((2, 30, 1))
    H = np.tile(np.eye(1, 2), (2, 30, 1, 1))
    H[1, 20] *= 100.0
    model = (np.eye(2), H, 1e-3 * np.eye(2), np.eye(1), np.zeros(2), 0.1 * np.eye(2))
    for keep, row in ((1, 20), (4, 5), (7, 2), ("last", 0)):
        result = filter_series(zs, *model, scaling="unit", refused="nan", keep=keep)
        for column in (result.x, result.P, result.weights):
            assert np.isnan(column[1, row:]).all() and not np.isnan(column[1, :row]).any()
            assert not np.isnan(column[0]).any()
        np.testing.assert_array_equal(np.isnan(result.log_likelihood), [False, True])
    with pytest.raises(NotPositiveDefiniteError, match=r"step 20: .*scaling"):
        filter_series(zs, *model, scaling="unit")


def test_a_bad_R_among_many_is_found():
    problem, zs = problem_and_series((3, 1, 0))
    R = np.ones((4, 30, 1, 1))
    R[2, 7] = -0.1
    F, H, Q, _, x0, P0 = arguments(problem)
    with pytest.raises(ValueError, match=r"R\[2, 7\]: expected a positive semidefinite matrix"):
        filter_series(zs, F, H, Q, R, x0, P0)


@pytest.mark.parametrize("shape", [(0, 7, 2), (4, 0, 2), (0, 0, 2)])
def test_of_nothing_comes_nothing(form, shape):
    problem, _ = problem_and_series()
    result = filter_series(np.zeros(shape), *arguments(problem))
    assert result.x.shape == (*shape[:2], 3) and result.P.shape == (*shape[:2], 3, 3)
    np.testing.assert_array_equal(result.log_likelihood, np.zeros(shape[0]))


@pytest.mark.parametrize("spoil", ["x0", "P0", "F"])
def test_a_series_of_numbers_that_are_not_finite_leaves_the_others_alone(form, spoil):
    zs = np.random.default_rng(4).normal(size=(3, 30, 1))
    x0, P0 = np.zeros((3, 2)), np.tile(np.eye(2), (3, 1, 1))
    F = np.tile(np.eye(2), (3, 1, 1, 1))
    if spoil == "F":
        F[1] *= 1e200
    else:
        {"x0": x0, "P0": P0}[spoil][1] = np.nan

    def run(rows, **options):
        return filter_series(
            zs[rows], F[rows], np.eye(1, 2), 1e-3 * np.eye(2), np.eye(1), x0[rows], P0[rows], **options
        )

    with pytest.raises(ValueError, match="step 0: "):
        run([0, 1, 2])
    result = run([0, 1, 2], refused="nan")
    for found, expected in zip(result[:4], run([0, 2])[:4], strict=True):
        np.testing.assert_allclose(found[[0, 2]], expected, rtol=1e-12)
        assert np.isnan(found[1]).all()


def test_an_error_names_the_series_alone():
    support.needs_kernel()
    P0 = np.tile(0.1 * np.eye(2), (3, 1, 1))
    P0[2] *= 1e4
    with pytest.raises(NotPositiveDefiniteError, match=r"^series 2, step 0: scaling"):
        filter_series(
            np.zeros((3, 5, 1)), np.eye(2), np.eye(1, 2), 1e-3 * np.eye(2), np.eye(1), np.zeros(2), P0, scaling="unit"
        )
