"""The C of a filter whose noise is given or learned is the package's kernel, to the last bit, or says it declines."""

import copy
import ctypes
import shutil

import c_programs
import numpy as np
import pytest
from c_programs import UNDEFINED, InC
from support import needs_kernel, random_problem

from robust_filterpy import AdaptiveKalmanFilter, Contaminated, Learnt, RobustKalmanFilter
from robust_filterpy.correction import Scales

pytestmark = [
    pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]

GIVEN = {"noise": Contaminated(0.1, 100.0)}
POLICIES = {
    "learnt": {"noise": Learnt()}, "learnt, scales": {"noise": Learnt(), "process": Scales()},
    "two classes, no jumps": {"noise": Learnt((1.0, 50.0), 100.0, 20.0), "process": Scales((1.0, 9.0), jump=0.0)},
    "given": GIVEN, "given, scales": {**GIVEN, "process": Scales()},
}  # fmt: skip


def made(seed, n=2, m=1, inputs=0, **policy):
    """A filter with random matrices, and measurements with outliers, a jump and gaps."""
    rng, problem = np.random.default_rng(seed), random_problem(seed, n, m, inputs)
    kf = RobustKalmanFilter(n, m, inputs, **policy)
    kf.x, kf.P, kf.F, kf.H = problem.x.copy(), problem.P, problem.F, problem.H.copy()
    kf.Q, kf.R, kf.B = problem.Q, problem.R, problem.B
    if seed % 3 == 0:
        kf.alpha = 1.01
    z = rng.normal(size=(80, m)) * rng.choice([1.0, 30.0], size=(80, m), p=[0.85, 0.15])
    z[40:] += 20.0
    z[rng.random((80, m)) < 0.1] = np.nan
    z[3] = np.nan
    return kf, z, rng.normal(size=(80, inputs))


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("sizes", [(1, 1, 0), (2, 1, 1), (4, 2, 0), (3, 3, 2)])
def test_c_equals_the_kernel_to_the_last_bit(policy, sizes, tmp_path):
    needs_kernel()
    kf, z, u = made(sum(sizes), *sizes, **POLICIES[policy])
    in_c = InC(kf, tmp_path)
    means, covariances, *_ = copy.deepcopy(kf).batch_filter(z, us=u if sizes[2] else None)
    # Of noise that is given the last sample that is measured is the definition's, which shows more of it.
    last = int(np.flatnonzero(~np.isnan(z).all(axis=1))[-1]) if "given" in policy else len(z)
    for k in range(len(z)):
        assert in_c.predict(u=u[k]) == in_c.update(z[k]) == c_programs.OK
        if k < last:
            assert np.array_equal(in_c.x, means[k].ravel()) and np.array_equal(in_c.P, covariances[k]), k
    assert last > 70
    np.testing.assert_allclose(in_c.x, means[-1].ravel(), rtol=1e-11)


def test_an_export_goes_on_from_where_the_filter_stands(tmp_path):
    needs_kernel()
    kf, z, _ = made(5, 2, 2, noise=Learnt(), process=Scales())
    adaptive = AdaptiveKalmanFilter(2, 2)
    for name in ("x", "P", "F", "H", "Q", "R"):
        setattr(adaptive, name, getattr(kf, name))
    adaptive.batch_filter(z[:30])
    adaptive.x = adaptive.x + 0.5
    in_c, hit = InC(adaptive, tmp_path), 0
    for row in z[30:]:
        adaptive.predict()
        adaptive.update(row)
        assert in_c.predict() == in_c.update(row) == c_programs.OK
        in_c.assert_shows(adaptive, row, rtol=0.0)
        hit += adaptive.outlier_probability > 0.5
    assert 3 < hit < len(z[30:])


def test_what_the_kernel_declines_is_refused_and_changes_nothing(tmp_path):
    kf, _, _ = made(1, noise=Learnt(), process=Scales())
    in_c = InC(kf, tmp_path, UNDEFINED)
    before = list(in_c.state)
    for z in (np.inf, -np.inf, 1e150):
        assert in_c.update(z) == c_programs.BAD_ARGUMENT and list(in_c.state) == before
    assert in_c.library.one_update(None, in_c.state, in_c.shown, None) == c_programs.BAD_ARGUMENT
    assert in_c.library.one_predict(ctypes.byref(in_c.model), None) == c_programs.BAD_ARGUMENT
    (tmp_path / "vague").mkdir()
    kf.P = 1e14 * np.eye(2)
    vague = InC(kf, tmp_path / "vague")
    before = list(vague.state)
    assert vague.update(1.0) == c_programs.SINGULAR and list(vague.state) == before


@pytest.mark.nightly
def test_odd_numbers_anywhere_do_no_harm(tmp_path):
    for k, policy in enumerate(POLICIES.values()):
        (tmp_path / str(k)).mkdir()
        InC(made(k, 2, 2, **policy)[0], tmp_path / str(k), UNDEFINED).fuzz()
