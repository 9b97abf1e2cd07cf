"""The kernel says what `correction` says, for every choice, size, pattern of missing components and changing model."""

import itertools

import numpy as np
import pytest
import support

from robust_filterpy import Hampel, Huber, Linear, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.compiled import dispatch
from robust_filterpy.compiled.records import SIZES, Model, Output
from robust_filterpy.correction import correct, log_density
from robust_filterpy.correction.options import GROUPINGS, INFORMATIONS, SCALINGS, Choices

support.needs_kernel()

INFLUENCES = [Huber(), Linear(), Hampel(), TukeyBiweight(), StudentT()]
STEPS = 12


def output(series, steps, n, m):
    return Output(
        np.zeros((series, steps, n)), np.zeros((series, steps, n, n)), np.zeros((series, steps, n)),
        np.zeros((series, steps, n, n)), np.zeros((series, steps, m)), np.zeros(series),
    )  # fmt: skip


def run(choices, zs, model, P, size=None, x=None, **options):
    """Run one series and return what the kernel kept, and how far it came."""
    (steps, m), n = zs.shape, model[0].shape[-1]
    dims = (3, 3, 3, 3, 2)
    model = Model(
        *(np.ascontiguousarray(a if a.ndim == dim else a[None])[None] for a, dim in zip(model, dims, strict=True))
    )
    kept = output(1, steps, n, m)
    x = np.zeros((1, n)) if x is None else x[None].copy()
    size = size or dispatch.series_size(n, m, steps)
    done = dispatch.filter_series(size, choices, zs[None], model, x, P[None].copy(), kept, **options)
    return kept, int(done[0])


def problem(rng, n, m, varying):
    """Matrices with an axis of steps, small enough for every scaling to be a filter, and gappy measurements."""
    k = STEPS if varying else 1
    F = np.array([support.stable(rng, n) for _ in range(k)])
    Q = np.array([support.spd(rng, n, 0.01) for _ in range(k)])
    H = rng.normal(size=(k, m, n)) / n
    if m > 2:
        H[:, 0] = 0.0
    R = np.array([support.spd(rng, m) for _ in range(k)])
    zs = rng.normal(size=(STEPS, m))
    zs[rng.random(zs.shape) < 0.15] += 50.0
    zs[rng.random(zs.shape) < 0.2] = np.nan
    return zs, (F, Q, H, R, rng.normal(size=(k, n))), 0.1 * np.eye(n)


def assert_is_the_definition(choices, zs, model, P, size=None):
    """Every kept number, to 1e-12 of the size of what it is computed from."""
    kept, done = run(choices, zs, model, P, size)
    assert done == len(zs)
    x, total = np.zeros(len(P)), 0.0
    for k, z in enumerate(zs):
        F, Q, H, R, Bu = (a[k if len(a) > 1 else 0] for a in model)
        x, P = F @ x + Bu, F @ P @ F.T + Q
        support.assert_close(kept.means_p[0, k], x, 1e-12, "x prior", 1.0)
        support.assert_close(kept.covariances_p[0, k], P, 1e-12, "P prior")
        c = correct(x, P, z - H @ x, H, R, choices)
        total += log_density(z - H @ x, c.S, choices)
        x, P = c.x, c.P
        support.assert_close(kept.means[0, k], x, 1e-12, f"x at {k}", 1.0)
        support.assert_close(kept.covariances[0, k], P, 1e-12, f"P at {k}")
        np.testing.assert_allclose(kept.weights[0, k], c.weights, rtol=1e-10, atol=1e-11)
    assert kept.log_likelihood[0] == pytest.approx(total, rel=1e-11)


@pytest.mark.parametrize("influence", INFLUENCES, ids=lambda f: type(f).__name__)
@pytest.mark.parametrize("rule", list(itertools.product(SCALINGS, INFORMATIONS, GROUPINGS)), ids="-".join)
def test_every_choice_is_the_definition(influence, rule):
    choices = Choices(influence, *rule)
    for n, m, varying in ((2, 1, False), (4, 2, True), (3, 3, True), (2, 4, False)):
        rng = np.random.default_rng(10 * n + m)
        assert_is_the_definition(choices, *problem(rng, n, m, varying))


@pytest.mark.parametrize("m", range(1, 7))
@pytest.mark.parametrize("n", range(1, 13))
def test_every_size_is_the_definition(n, m):
    for varying, grouping in ((False, "component"), (True, "joint")):
        assert_is_the_definition(Choices(grouping=grouping), *problem(np.random.default_rng(n + m), n, m, varying))


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_every_kernel_for_a_known_size_is_the_definition(size):
    n, m = size[0] or 5, size[1] or 5
    assert_is_the_definition(Choices(), *problem(np.random.default_rng(1), n, m, False), size)


def test_every_pattern_of_missing_components():
    for pattern in itertools.product((False, True), repeat=4):
        zs, model, P = problem(np.random.default_rng(7), 3, 4, False)
        zs = np.where(pattern, np.nan, np.nan_to_num(zs))
        for grouping in GROUPINGS:
            assert_is_the_definition(Choices(grouping=grouping), zs, model, P)


def test_correcting_first_is_the_filter_that_corrects_first():
    zs, model, P = problem(np.random.default_rng(3), 3, 2, True)
    kept, done = run(Choices(), zs, model, P, update_first=True, alpha_sq=1.1)
    kf = RobustKalmanFilter(3, 2)
    kf.P, kf.alpha, kf.x = P, np.sqrt(1.1), np.zeros(3)
    assert done == STEPS
    for k, z in enumerate(zs):
        F, Q, H, R, Bu = (a[k] for a in model)
        kf.update(z, R, H)
        support.assert_close(kept.means[0, k], kf.x, 1e-12, "x", 1.0)
        kf.predict(F=F, Q=Q, u=Bu, B=np.eye(3))
        support.assert_close(kept.means_p[0, k], kf.x, 1e-12, "x", 1.0)
        support.assert_close(kept.covariances_p[0, k], kf.P, 1e-12, "P")


def one_by_one(F=1.0):
    one = np.eye(1)
    return (F * one, one, one, one, np.zeros(1))


def test_the_kernel_stops_before_a_step_that_is_out_of_the_ordinary():
    zs = np.zeros((6, 1))
    zs[3] = np.inf
    assert run(Choices(), zs, one_by_one(), np.eye(1))[1] == 3
    assert run(Choices(scaling="unit"), zs, one_by_one(), np.eye(1))[1] == 0
    assert run(Choices(), zs, one_by_one(1e200), np.eye(1))[1] == 0
    zs[1] = 1e151
    assert run(Choices(), zs, one_by_one(), np.eye(1))[1] == 1
    H, P = np.array([[1.0, 0.0], [1.0, 1e-8], [0.0, 1.0]]), np.eye(2)
    model = (np.eye(2), 0.0 * np.eye(2), H, 1e-16 * np.eye(3), np.zeros(2))
    assert run(Choices(), np.zeros((2, 3)), model, P)[1] == 0


def test_a_series_that_overflows_leaves_the_others_alone():
    rng = np.random.default_rng(0)
    n, m, steps = 5, 2, 40
    eye, H = np.eye(n), rng.normal(size=(m, n))
    F = np.array([1e80 * eye, support.stable(rng, n), support.stable(rng, n)])[:, None]
    zs, P = rng.normal(size=(3, steps, m)), np.array([eye] * 3)

    def series(part):
        k = len(zs[part])
        model = Model(F[part], *(np.ascontiguousarray(a)[None, None] for a in (0.1 * eye, H, np.eye(m), np.zeros(n))))
        kept = output(k, steps, n, m)
        x, size = np.zeros((k, n)), dispatch.series_size(n, m, steps)
        done = dispatch.filter_series(size, Choices(), zs[part], model, x, P[part].copy(), kept, update_first=True)
        return kept, done

    together, done = series(slice(0, 3))
    alone, done_alone = series(slice(1, 3))
    assert done[0] == 1 and done[1:].tolist() == done_alone.tolist() == [steps, steps]
    np.testing.assert_array_equal(together.covariances[1:], alone.covariances)
    np.testing.assert_array_equal(together.means[1:], alone.means)


def test_a_long_run_stays_symmetric_and_positive_definite():
    rng = np.random.default_rng(3)
    n, m = 4, 3
    zs = rng.standard_t(1.5, size=(20000, m))
    model = (support.stable(rng, n), 1e-6 * np.eye(n), rng.normal(size=(m, n)), np.eye(m), np.zeros(n))
    kept, done = run(Choices(), zs, model, 1e9 * np.eye(n))
    assert done == len(zs)
    covariances = kept.covariances[0, 1000::100]
    np.testing.assert_array_equal(covariances, covariances.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(covariances).min() > 0.0


def test_an_exact_sensor_leaves_no_variance_in_its_direction():
    """R = 0, diag(1, 0) and of rank one are legal as long as S has an inverse."""
    for R in (np.zeros((2, 2)), np.diag([1.0, 0.0]), np.ones((2, 2))):
        zs, (F, Q, H, _, Bu), P = problem(np.random.default_rng(3), 4, 2, False)
        H = np.array([[[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]]])
        assert_is_the_definition(Choices(Linear()), zs, (F, Q, H, R[None], Bu), P)


def test_arrays_that_are_read_only_or_strided_are_not_compiled_for():
    from robust_filterpy.compiled import loops

    def series(change):
        kept = output(2, 9, 3, 2)
        rng = np.random.default_rng(0)
        eye, H, z = np.eye(3)[None, None], rng.normal(size=(1, 1, 2, 3)), rng.normal(size=(2, 9, 2))
        model = Model(*map(change, (0.9 * eye, 0.1 * eye, H, np.eye(2)[None, None], np.zeros((1, 1, 3)))))
        P = np.tile(np.eye(3), (2, 1, 1))
        dispatch.filter_series((0, 2), Choices(), change(z), model, np.zeros((2, 3)), P, kept)
        return kept.means, list(loops.filter_series[0, 2].signatures)

    def strided(a):
        return np.repeat(a, 2, axis=-1)[..., ::2]

    means, signatures = series(np.copy)
    for change in (strided, np.asfortranarray, lambda a: np.frombuffer(a.tobytes()).reshape(a.shape)):
        found, after = series(change)
        assert after == signatures
        np.testing.assert_array_equal(found, means)


def test_filters_whose_arrays_are_read_only_or_strided_are_not_compiled_for():
    from robust_filterpy.compiled import loops

    def filtered(change):
        problem = support.random_problem(3, 4, 2)
        kf = support.make(RobustKalmanFilter, problem)
        for name in ("x", "P", "F", "H", "Q", "R"):
            setattr(kf, name, change(getattr(kf, name)))
        kf.predict()
        kf.update([1.0, 2.0])
        return kf.x, [list(function.signatures) for function in (loops.predict_step, loops.correct_step)]

    x, signatures = filtered(np.copy)
    for change in (np.asfortranarray, lambda a: np.frombuffer(a.tobytes()).reshape(a.shape)):
        found, after = filtered(change)
        assert after == signatures
        support.assert_close(found, x, 1e-13)


@pytest.mark.parametrize("choices", [{}, {"scaling": "bounded"}, {"grouping": "joint"}, {"influence": StudentT(3)}])
@pytest.mark.parametrize("dims", [(2, 1), (4, 2), (5, 3)])
def test_a_filter_with_the_kernel_is_the_filter_without(monkeypatch, dims, choices):
    problem = support.random_problem(6, *dims)
    one, two = (support.make(RobustKalmanFilter, problem, **choices) for _ in range(2))
    for z in support.simulate(problem, 30, 4, 0.2)[0]:
        one.predict()
        one.update(z)
        with monkeypatch.context() as patch:
            support.without_kernel(patch)
            two.predict()
            two.update(z)
        for name in (*support.STATE, "y", "S", "SI", "K", "T", "e", "y_bounded", "weights"):
            support.assert_close(getattr(one, name), getattr(two, name), 1e-10, name, 1.0 if name in "ye" else 0.0)
        np.testing.assert_array_equal(one.clipped, two.clipped)
        assert one.log_likelihood == pytest.approx(two.log_likelihood, rel=1e-10)
