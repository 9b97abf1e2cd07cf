"""A long recording through the kernel leaves what a loop over predict and update leaves."""

import numpy as np
import pytest
import support
from statsmodels.robust.norms import HuberT

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.filters import policies

support.needs_kernel()

N = 1500


@pytest.fixture
def count(monkeypatch):
    """Count the steps that the kernel took, so that no test passes because they were not used."""
    taken = []
    for policy in (policies.Bounded, policies.Mixture):

        def counting(*args, first=0, advance=policy.advance, **kwargs):
            done = advance(*args, first=first, **kwargs)
            taken.append(done - first)
            return done

        monkeypatch.setattr(policy, "advance", counting)
    return taken


def lists(case, problem, rng):
    """Matrices for each step, and inputs."""
    n, m, w = problem.dims
    each = {
        "constant": {}, "F": {"Fs": [support.stable(rng, n) for _ in range(N)]},
        "H": {"Hs": rng.normal(size=(N, m, n))}, "u": {"us": rng.normal(size=(N, w, 1))},
        "QR": {"Qs": [0.1] * N, "Rs": [support.spd(rng, m) for _ in range(N)]},
        "Bu": {"us": [np.ones(w)] * N, "Bs": rng.normal(size=(N, n, w))},
    }  # fmt: skip
    return each[case]


SHOWN = (*support.STATE, "y", "K", "S", "SI", *support.ROBUST, "log_likelihood", "mahalanobis")


@pytest.mark.pairwise
@pytest.mark.parametrize("update_first", [False, True])
@pytest.mark.parametrize("case", ["constant", "F", "H", "QR", "u", "Bu"])
@pytest.mark.parametrize("ndim, dims", [(2, (4, 2, 1)), (1, (3, 1, 2))])
@pytest.mark.parametrize("gaps", [0, 1, 40])
@pytest.mark.parametrize("policy", support.POLICIES)
def test_a_recording_by_the_kernel_is_the_loop(count, policy, ndim, dims, case, update_first, gaps):
    problem, steps = support.random_problem(4, *dims), N if policy == "default" else 400
    zs, _ = support.simulate(problem, steps, seed=5, contamination=0.1)
    rng = np.random.default_rng(0)
    zs[:-1][rng.random((steps - 1, dims[1])) < 0.1] = np.nan
    zs[steps - gaps :] = np.nan
    zs[200:] += 50.0
    rows = [None if k % 7 == 0 and k < steps - 1 else z for k, z in enumerate(zs[:, :, None] if ndim == 2 else zs)]
    one, two = (support.make(RobustKalmanFilter, problem, ndim, **support.POLICIES[policy]) for _ in range(2))
    per_step = {name: values[:steps] for name, values in lists(case, problem, rng).items()}
    ours = one.batch_filter(rows, update_first=update_first, **per_step)
    # With noise to learn or a patience an H of each step goes by the methods; the last step and reading always do.
    taken = sum(count)
    passed_on = case == "H" and policy in ("recovering", "learnt", "adaptive")
    assert taken == 0 if passed_on else taken >= steps - 1 - bool(gaps)
    for a, b in zip(ours, support.by_loop(two, rows, update_first, **per_step), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-10)
    for name in SHOWN if policy in ("default", "innovation") else (*SHOWN, "outlier_probability", "process_scale"):
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=1e-9, atol=1e-10, err_msg=name)
    assert one.z.tolist() == two.z.tolist()
    state, expected = one.state(), two.state()
    for name in expected:
        np.testing.assert_allclose(state[name], expected[name], rtol=1e-9, atol=1e-10, err_msg=name)


def test_a_step_that_the_kernel_declines_is_taken_by_the_filter(count):
    """A reading whose length is no number is left to the filter's own step, and the kernel goes on after it."""
    one, two = (support.make(RobustKalmanFilter, support.cart(), grouping="joint") for _ in range(2))
    one.R, two.R = 0.01 * one.R, 0.01 * two.R
    zs = np.random.default_rng(1).normal(size=N)
    zs[2] = 1.7e308
    np.testing.assert_allclose(one.batch_filter(zs)[0], support.by_loop(two, zs)[0], rtol=1e-10, atol=1e-11)
    assert count == [2, N - 4]  # the last step is always the filter's own


class Quieter(RobustKalmanFilter):
    """A subclass with an update of its own."""

    def update(self, z, R=None, H=None):
        super().update(0.5 * np.asarray(z), R, H)


@pytest.mark.parametrize("cls, options, inv", [
    (RobustKalmanFilter, {"influence": HuberT(1.345)}, np.linalg.inv), (Quieter, {}, np.linalg.inv),
    (RobustKalmanFilter, {}, np.linalg.pinv),
], ids=["psi", "update", "inverse"])  # fmt: skip
def test_what_the_loops_do_not_know_goes_by_the_methods(count, cls, options, inv):
    one, two = (support.make(cls, support.cart(), **options) for _ in range(2))
    one.inv = two.inv = inv
    zs = np.random.default_rng(2).normal(size=N)
    np.testing.assert_array_equal(one.batch_filter(zs)[0], support.by_loop(two, zs)[0])
    assert not any(count)
