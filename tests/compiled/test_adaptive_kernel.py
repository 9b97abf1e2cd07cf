"""The kernel of learnt noise is its definition, to rounding; what it does not serve goes to the definition."""

import numpy as np
import pytest
import support

from robust_filterpy import AdaptiveKalmanFilter, TwoSidedKalmanFilter
from robust_filterpy.compiled import dispatch
from robust_filterpy.correction.adaptive import NoiseClasses, correct_adaptively
from robust_filterpy.filters import _adaptive_step

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
        ours = _adaptive_step.corrected(x, P, p, learnt, z, H, R, noise)
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
    for one, other in zip(_adaptive_step.corrected(*given), correct_adaptively(*given), strict=True):
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
    for z in zs:
        compiled.predict(u)
        compiled.update(z)
        with monkeypatch.context() as patch:
            support.without_kernel(patch)
            plain.predict(u)
            plain.update(z)
        for name in READ:
            if hasattr(plain, name):
                ours, theirs = getattr(compiled, name), getattr(plain, name)
                np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("prior", [1e3, 1e9])
def test_p_keeps_its_digits_where_a_measurement_tells_nearly_all(prior):
    rng, noise = np.random.default_rng(6), NoiseClasses()
    x, P, p = filters(2, 3, rng)
    P, H, R = prior * P, rng.normal(size=(2, 3)), 1e-3 * np.eye(2)
    given = (x, P, p, noise.start(2), H @ x[0] + 0.1, H, R, noise)
    ours, theirs = _adaptive_step.corrected(*given), correct_adaptively(*given)
    seen = [H @ step.covariances @ H.T for step in (ours, theirs)]
    np.testing.assert_allclose(*seen, rtol=1e-4, atol=1e-4 * np.abs(seen[1]).min(where=np.eye(2) > 0, initial=np.inf))
    assert np.linalg.eigvalsh(ours.covariances).min() > 0.0
    np.testing.assert_array_equal(ours.covariances, ours.covariances.transpose(0, 2, 1))
