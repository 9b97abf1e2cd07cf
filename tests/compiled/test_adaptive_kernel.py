"""The kernel of learnt noise is its definition, to rounding; what it does not serve goes to the definition."""

import numpy as np
import pytest
import support

from robust_filterpy import AdaptiveKalmanFilter, TwoSidedKalmanFilter
from robust_filterpy.compiled import dispatch
from robust_filterpy.correction.adaptive import AdaptiveStep, NoiseClasses, correct_adaptively
from robust_filterpy.filters import _adaptive_step
from robust_filterpy.filters._interacting import merged_bank

READ = ("x", "P", "learnt", "log_likelihood", "outlier_probability", "process_probabilities", "weights")


@pytest.fixture(autouse=True)
def kernel():
    support.needs_kernel()
    if dispatch.adaptive() is None:
        pytest.skip("no kernel of learnt noise in the cache")


def filters(q, n, rng):
    roots = rng.normal(size=(q, n, n))
    covariances = 0.1 * roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(n)
    return rng.normal(size=(q, n)), covariances, rng.dirichlet(np.ones(q))


def corrected(x, P, p, learnt, z, H, R, noise, *options):
    """The step as the filters take it, in the definition's terms."""
    bank = merged_bank(x, P, p)
    found = _adaptive_step.corrected(bank, learnt, z, H, R, noise, *options)
    merged = merged_bank(*found.bank[:3])
    np.testing.assert_allclose(found.bank.x, merged.x, rtol=1e-12)
    np.testing.assert_allclose(found.bank.P, merged.P, rtol=1e-12, atol=1e-300)
    return AdaptiveStep(*found.bank[:3], found.learnt, found.log_density, found.weights, found.outlying)


def close(ours, theirs):
    for name, one, other in zip(ours._fields, ours, theirs, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-11, err_msg=name)


@pytest.mark.parametrize("scales", [(1.0,), (1.0, 10.0, 100.0, 1000.0)])
@pytest.mark.parametrize("q, n, m", [(1, 1, 1), (3, 2, 1), (1, 4, 2), (3, 5, 4)])
def test_a_correction_is_the_definitions(q, n, m, scales, monkeypatch):
    rng, noise = np.random.default_rng([q, n, m]), NoiseClasses(scales)
    learnt = noise.start(m)
    # Were the kernel not to serve, the two would be the same function.
    monkeypatch.setattr(_adaptive_step, "correct_adaptively", None)
    for _ in range(40):
        x, P, p = filters(q, n, rng)
        H, R = rng.normal(size=(m, n)), np.diag(rng.uniform(0.5, 2.0, m))
        truth = rng.multivariate_normal(x[0], P[0])
        z = H @ truth + R.diagonal() ** 0.5 * rng.normal(size=m) * rng.choice([1.0, 30.0, 1e6], m, p=[0.8, 0.1, 0.1])
        copies = [a.copy() for a in (x, P, p, learnt, z, H, R)]
        ours = corrected(x, P, p, learnt, z, H, R, noise)
        close(ours, correct_adaptively(x, P, p, learnt, z, H, R, noise))
        for one, other in zip((x, P, p, learnt, z, H, R), copies, strict=True):
            np.testing.assert_array_equal(one, other)
        learnt = ours.learnt


@pytest.mark.parametrize("why", ["correlated", "joint", "inverse"])
def test_what_the_kernel_does_not_serve_is_the_definition_to_the_bit(why):
    rng, noise = np.random.default_rng(5), NoiseClasses(grouping="joint" if why == "joint" else "component")
    x, P, p = filters(2, 3, rng)
    H, R, z = rng.normal(size=(2, 3)), np.diag([1.0, 2.0]), np.array([3.0, -40.0])
    if why == "correlated":
        R = np.array([[1.0, 0.5], [0.5, 2.0]])
    options = (None, np.linalg.pinv) if why == "inverse" else ()
    given = (x, P, p, noise.start(2), z, H, R, noise, *options)
    for one, other in zip(corrected(*given), correct_adaptively(*given), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("cls", [AdaptiveKalmanFilter, TwoSidedKalmanFilter])
@pytest.mark.parametrize("dims", [(1, 1), (3, 2), (4, 3, 1)])
def test_a_filter_gives_the_numbers_of_the_definition(cls, dims, monkeypatch):
    problem = support.random_problem(8, *dims)
    problem = support.with_(problem, R=np.diag(problem.R.diagonal()))
    zs, _ = support.simulate(problem, 80, 8, contamination=0.2)
    zs[7, 0] = zs[9] = np.nan
    compiled, plain = support.make(cls, problem), support.make(cls, problem)
    compiled.alpha = plain.alpha = 1.01
    u = None if problem.B is None else np.ones(problem.B.shape[1])
    for k, z in enumerate(zs):
        # A sensor in which the state does not show teaches nothing.
        H = problem.H * (np.arange(dims[1]) != 1 + k % 9)[:, None]
        compiled.predict(u)
        compiled.update(z, H=H)
        with monkeypatch.context() as patch:
            support.without_kernel(patch)
            plain.predict(u)
            plain.update(z, H=H)
        for name in READ:
            if hasattr(plain, name):
                ours, theirs = getattr(compiled, name), getattr(plain, name)
                np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("chance", [0.0, 1e-300])
def test_a_class_that_is_all_but_impossible_goes_to_the_definition(chance):
    """The kernel adds likelihoods, which the widest class keeps from vanishing, unless that has been ruled out."""
    rng, noise = np.random.default_rng(7), NoiseClasses()
    x, P, p = filters(2, 3, rng)
    learnt = noise.start(1)
    learnt[0, 6:10], learnt[0, 10:14] = (1.0, 0.0, 0.0, 0.0), (1.0, 0.0, 0.0, chance)
    given = (x, P, p, learnt, np.array([1e6]), rng.normal(size=(1, 3)), np.eye(1), noise)
    with np.errstate(divide="ignore"):
        for one, other in zip(corrected(*given), correct_adaptively(*given), strict=True):
            np.testing.assert_array_equal(one, other)
            assert np.isfinite(one).all()


@pytest.mark.parametrize("start", [0, 1])
def test_a_part_that_the_state_does_not_show_in_changes_nothing(start):
    kf = support.make(AdaptiveKalmanFilter, support.with_(support.random_problem(8, 3, 2), R=np.eye(2)))
    kf.predict()
    kf.update([3.0, 40.0])
    before = kf.state()
    kf.update_sequential(start, 5.0, H_i=np.zeros((1, 3)))
    assert kf.log_likelihood == kf.outlier_probability == 0.0
    kf.update([5.0, 6.0], H=np.zeros((2, 3)))
    assert kf.log_likelihood == kf.outlier_probability == 0.0
    kf.H = np.zeros((2, 3))
    assert kf.log_likelihood_of([5.0, 6.0]) == 0.0
    for name in ("x", "P", "means", "covariances", "shares", "learnt"):
        np.testing.assert_array_equal(kf.state()[name], before[name])


N = 60
SHOWN = (*READ, *support.STATE, "y", "e", "S", "K", "R_learnt", "process_scale", "mahalanobis", "z")


@pytest.fixture
def steps(monkeypatch):
    """Count the steps that the loop took, so that no test passes because it was not used."""
    taken, adaptive_series = [], dispatch.adaptive_series

    def counting(*args, start=0, **kwargs):
        done = adaptive_series(*args, start=start, **kwargs)
        taken.append(int(done[0]) - start)
        return done

    monkeypatch.setattr(dispatch, "adaptive_series", counting)
    if dispatch.adaptive_name((0, 0)) not in dispatch._cached():
        pytest.skip("no kernel of recordings in the cache")
    return taken


def diagonal(seed, *dims):
    problem = support.random_problem(seed, *dims)
    return support.with_(problem, R=np.diag(problem.R.diagonal()))


def recording(problem, seed=5):
    """Outliers, missing components, missing rows."""
    rng = np.random.default_rng(seed)
    zs, _ = support.simulate(problem, N, seed, contamination=0.15)
    zs[rng.random(zs.shape) < 0.1] = np.nan
    return [None if k in (7, 8, 30) else z for k, z in enumerate(zs)]


class Loop:
    """A saver, with which a recording goes by the filter's own methods."""

    def save(self):
        pass


def per_step(case, problem, rng):
    n, m, w = problem.dims
    H = rng.normal(size=(N, m, n))
    H[::5, 0] = 0.0
    return {
        "constant": {},
        "FQ": {"Fs": [support.stable(rng, n) for _ in range(N)], "Qs": [support.spd(rng, n) for _ in range(N)]},
        "HR": {"Hs": H, "Rs": [np.diag(rng.uniform(0.5, 2.0, m)) for _ in range(N)]},
        "taller": {"Hs": rng.normal(size=(N, m + 1, n)), "Rs": [np.eye(m + 1)] * N},
        "u": {"us": rng.normal(size=(N, w)), "Qs": [0.1] * N},
    }[case]


@pytest.mark.parametrize("update_first", [False, True])
@pytest.mark.parametrize("case", ["constant", "FQ", "HR", "taller", "u"])
@pytest.mark.parametrize("ndim, dims, options", [
    (2, (3, 2, 1), {}),
    (1, (2, 1, 2), {"process_scales": (1.0,), "measurement_scales": (1.0, 30.0)}),
])  # fmt: skip
def test_a_recording_is_the_loop(steps, ndim, dims, options, case, update_first):
    problem, rng = diagonal(4, *dims), np.random.default_rng(0)
    zs = recording(problem)
    if case == "taller":
        zs = [None if z is None else np.append(z, z[0]) for z in zs]
    one, two = (support.make(AdaptiveKalmanFilter, problem, ndim, **options) for _ in range(2))
    for kf in (one, two):
        kf.alpha = 1.01
        kf.predict()
        kf.update(np.full(dims[1], 3.0))
    given = {"update_first": update_first, **per_step(case, problem, rng)}
    ours = one.batch_filter(zs, **given)
    assert sum(steps) == N - 1
    theirs = two.batch_filter(zs, saver=Loop(), **given)
    assert sum(steps) == N - 1
    for name, a, b in zip(("x", "P", "x_p", "P_p"), ours, theirs, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-8, atol=1e-10, err_msg=name)
    np.testing.assert_allclose(one._process_scales, two._process_scales, rtol=1e-8)
    for name in SHOWN:
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=1e-8, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(one.rts_smoother(*ours[:2])[0], two.rts_smoother(*theirs[:2])[0], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("gaps", [1, 9, N])
def test_a_recording_that_ends_with_gaps_leaves_what_the_loop_leaves(steps, gaps):
    problem = diagonal(4, 3, 2)
    zs = [z if k < N - gaps else None for k, z in enumerate(recording(problem))]
    one, two = (support.make(AdaptiveKalmanFilter, problem) for _ in range(2))
    one.batch_filter(zs)
    assert sum(steps) == N - (1 if gaps == N else 2)
    two.batch_filter(zs, saver=Loop())
    for name in SHOWN[:-1]:
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=1e-8, atol=1e-9, err_msg=name)


class Quieter(AdaptiveKalmanFilter):
    """A subclass with an update of its own."""

    def update(self, z, R=None, H=None):
        super().update(None if z is None else 0.5 * np.asarray(z), R, H)


@pytest.mark.parametrize("why", ["joint", "correlated", "own", "inverse", "saver"])
def test_what_the_loop_does_not_serve_goes_by_the_methods(steps, why):
    problem = diagonal(4, 3, 2)
    if why == "correlated":
        problem = support.with_(problem, R=np.array([[1.0, 0.5], [0.5, 2.0]]))
    kf = support.make(
        Quieter if why == "own" else AdaptiveKalmanFilter, problem, grouping="joint" if why == "joint" else "component"
    )
    if why == "inverse":
        kf.inv = np.linalg.pinv
    kf.batch_filter(recording(problem), saver=Loop() if why == "saver" else None)
    assert not steps


def test_a_step_that_the_loop_declines_is_taken_by_the_filter(steps, monkeypatch):
    """A class that has been ruled out: the filter's own step decides, and the loop goes on after it."""
    problem = diagonal(4, 2, 1)
    zs = recording(problem)
    zs[20:22] = [np.array([1e7])] * 2
    one, two = (support.make(AdaptiveKalmanFilter, problem) for _ in range(2))
    learnt = one.learnt
    learnt[0, 10:] = np.tile([1.0, 0.0, 0.0, 0.0], 4)
    monkeypatch.setattr(_adaptive_step.adaptive_noise, "start", lambda K: learnt[0])
    _adaptive_step._told.cache_clear()
    try:
        for kf in (one, two):
            kf.learnt = learnt
        with np.errstate(divide="ignore"):
            a, b = one.batch_filter(zs), two.batch_filter(zs, saver=Loop())
    finally:
        _adaptive_step._told.cache_clear()
    assert len(steps) > 1 and steps[0] <= 20 and sum(steps) >= N - 6
    np.testing.assert_allclose(a[0], b[0], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(one.learnt, two.learnt, rtol=1e-8, atol=1e-12)


def test_a_predicted_measurement_that_is_not_finite_goes_to_the_definition(steps):
    kf = support.make(AdaptiveKalmanFilter, diagonal(4, 2, 1))
    Hs = np.ones((N, 1, 2))
    Hs[40] = 1e308
    kf.x, kf.F, kf.Q, before = np.full((2, 1), 1e10), np.eye(2), 0.0, kf.state()
    with np.errstate(over="ignore"), pytest.raises(ValueError, match="step 40: x: expected finite numbers, got H x"):
        kf.batch_filter(np.full((N, 1), 2e10), Hs=Hs)
    assert steps[0] == 40
    kf.x[1] = np.inf
    with pytest.raises(ValueError, match="x: expected finite numbers, got H x"):
        kf.update(1.0)
    np.testing.assert_array_equal(kf.learnt, before["learnt"])


@pytest.mark.parametrize("first", [0, 40])
def test_an_infinite_measurement_in_a_recording_is_named_and_changes_nothing(first):
    kf = support.make(AdaptiveKalmanFilter, diagonal(4, 3, 2))
    zs, before = [np.zeros(2) for _ in range(N)], kf.state()
    zs[first] = np.array([1.0, -np.inf])
    with pytest.raises(ValueError, match=f"step {first}: z: expected finite numbers"):
        kf.batch_filter(zs)
    for name in ("x", "P", "learnt"):
        np.testing.assert_array_equal(kf.state()[name], before[name])


def test_a_fault_late_in_a_recording_is_named_and_undone(steps):
    problem = diagonal(4, 3, 2)
    kf = support.make(AdaptiveKalmanFilter, problem)
    kf.predict()
    kf.update([0.3, 5.0])
    before, y = kf.state(), kf.y.copy()
    Fs = np.tile(problem.F, (N, 1, 1))
    Fs[40] *= 1e200
    with np.errstate(over="ignore", invalid="ignore"), pytest.raises(ValueError, match="step 40: predict"):
        kf.batch_filter(recording(problem), Fs=Fs)
    assert steps[0] == 40
    for name, value in kf.state().items():
        np.testing.assert_array_equal(value, before[name], err_msg=name)
    np.testing.assert_array_equal(kf.y, y)


@pytest.mark.parametrize("prior", [1e3, 1e9])
def test_p_keeps_its_digits_where_a_measurement_tells_nearly_all(prior):
    rng, noise = np.random.default_rng(6), NoiseClasses()
    x, P, p = filters(2, 3, rng)
    P, H, R = prior * P, rng.normal(size=(2, 3)), 1e-3 * np.eye(2)
    given = (x, P, p, noise.start(2), H @ x[0] + 0.1, H, R, noise)
    ours, theirs = corrected(*given), correct_adaptively(*given)
    seen = [H @ step.covariances @ H.T for step in (ours, theirs)]
    np.testing.assert_allclose(*seen, rtol=1e-4, atol=1e-4 * np.abs(seen[1]).min(where=np.eye(2) > 0, initial=np.inf))
    assert np.linalg.eigvalsh(ours.covariances).min() > 0.0
    np.testing.assert_array_equal(ours.covariances, ours.covariances.transpose(0, 2, 1))
