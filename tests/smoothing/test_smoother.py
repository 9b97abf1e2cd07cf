"""smooth: without doubts it is filterpy's smoother, with a psi the optimum, with nothing given close to knowing all."""

import warnings
from contextlib import nullcontext

import dense
import numpy as np
import pytest
import support
from dense import CART, drive
from filterpy.kalman import KalmanFilter
from statsmodels.robust.norms import HuberT
from support import noise_given, of_matrices, without_kernel

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight, smooth
from robust_filterpy.influence import Linear
from robust_filterpy.smoothing import smooth_series


def filter_of(problem=CART, ndim=2, cls=KalmanFilter, **choices):
    return support.make(cls, problem, ndim, **choices)


@pytest.mark.core
@pytest.mark.parametrize("influence", [Linear(), Huber(np.inf)], ids=repr)
@pytest.mark.parametrize("ndim", [1, 2])
def test_linear_is_filterpys_filter_and_smoother(form, ndim, influence):
    rng = np.random.default_rng(0)
    problem = support.random_problem(3, 3, 2)
    zs, _ = support.simulate(problem, 25, 1)
    varying = {
        "Fs": [support.stable(rng, 3) for _ in zs], "Qs": [support.spd(rng, 3, 0.1) for _ in zs],
        "Hs": [rng.normal(size=(2, 3)) for _ in zs], "Rs": [support.spd(rng, 2) for _ in zs],
    }  # fmt: skip
    for options in ({}, varying):
        kf = filter_of(problem, ndim)
        means, covariances, _, _ = kf.batch_filter([support.column(kf, z) for z in zs], **options)
        Fs, Qs = options.get("Fs"), options.get("Qs")
        x, P, _, _ = kf.rts_smoother(means, covariances, Fs=Fs, Qs=Qs)
        found = smooth(filter_of(problem, ndim), zs, influence=influence, **options)
        assert found.x.shape == x.shape and found.converged
        np.testing.assert_allclose(found.x, x, rtol=1e-7, atol=1e-9)
        np.testing.assert_allclose(found.P, P, rtol=1e-7, atol=1e-9)


def test_inputs_missing_components_singular_noise_and_a_known_start_are_the_joint_distribution(form):
    rng = np.random.default_rng(4)
    F, H, B, G = support.stable(rng, 3), rng.normal(size=(2, 3)), rng.normal(size=(3, 1)), rng.normal(size=(3, 1))
    kf = KalmanFilter(3, 2, 1)
    kf.F, kf.H, kf.B, kf.Q, kf.R = F, H, B, G @ G.T, support.spd(rng, 2)
    kf.x, kf.P = rng.normal(size=3), np.zeros((3, 3))
    z, u = rng.normal(size=(8, 2)), rng.normal(size=8)
    z[2, 1] = z[5, 0] = z[6, 0] = z[6, 1] = np.nan
    c = [B[:, 0] * one for one in u]
    x, P = dense.posterior([F] * 8, [kf.Q] * 8, c, [H] * 8, [kf.R] * 8, z, kf.x, kf.P)
    zs = [None if np.isnan(row).all() else row for row in z]
    found = smooth(kf, zs, influence=Linear(), us=list(u))
    np.testing.assert_allclose(found.x, x[1:], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.P, P[1:], rtol=1e-7, atol=1e-10)
    assert np.array_equal(np.isnan(found.weights), np.isnan(z))


@pytest.mark.pairwise
@pytest.mark.parametrize("influence", [Huber(0.7), HuberT(0.7), StudentT(2.0), TukeyBiweight(3.0)], ids=repr)
@pytest.mark.parametrize("grouping", ["component", "joint"])
def test_a_psi_gives_a_point_where_the_gradient_of_the_cost_vanishes(form, influence, grouping):
    """The cost of all states at once: rho of the residuals and the squares of what drives the states."""
    rng = np.random.default_rng(7)
    problem = support.random_problem(11, 3, 2)
    zs, _ = support.simulate(problem, 12, 5, contamination=0.3, size=8.0)
    kf = filter_of(support.with_(problem, R=np.diag([0.5, 2.0]), P=support.spd(rng, 3)), 1)
    found = smooth(kf, zs, influence=influence, grouping=grouping)
    assert found.converged

    def psi(e):
        if grouping == "component":
            return influence.psi(e)
        length = np.linalg.norm(e)
        return np.asarray(influence.psi(np.array([length])))[0] * e / max(length, 1e-300)

    steps = len(zs)
    lists = [[a] * steps for a in (kf.F, kf.Q, np.zeros(3), kf.H, kf.R)]
    slope, path = dense.gradient(*lists, zs, found.x, kf.x, kf.P, psi)
    np.testing.assert_allclose(path[1:], found.x, atol=1e-6)
    assert np.abs(slope).max() < 1e-5


RUNS = 40
CASES = {(0.0, 10.0): 1.02, (0.1, 10.0): 1.15, (0.3, 10.0): 1.40, (0.1, 40.0): 1.08}


@pytest.mark.parametrize("contamination, scale", CASES)
def test_it_is_close_to_the_smoother_that_knows_the_labels(contamination, scale):
    """Mean square error over the label-knowing smoother's, at most so much and 5 standard errors; many at once."""
    runs = [drive(seed, contamination, scale) for seed in range(20_000, 20_000 + RUNS)]
    zs = np.array([z for _, z, _ in runs])[:, :, None]
    arguments = CART.F, CART.H, CART.Q
    found = smooth_series(zs, *arguments, CART.R, np.zeros(2), CART.P)
    R = np.where(np.array([bad for _, _, bad in runs]), scale**2, 1.0)[:, :, None, None]
    labelled = smooth_series(zs, *arguments, R, np.zeros(2), CART.P, influence=Linear())
    truth = np.array([truth for truth, _, _ in runs])
    ours, theirs = (((one.x[:, :, 0] - truth) ** 2).mean(axis=1) for one in (found, labelled))
    apart = (ours - theirs) / theirs.mean()
    assert found.converged.all()
    assert 1.0 + apart.mean() < CASES[contamination, scale] + 5.0 * apart.std() / np.sqrt(RUNS)
    if contamination:
        assert abs(np.median(found.contamination) - contamination) < 0.05
        assert abs(np.log(np.median(found.scale_ratio) / scale)) < 0.3
    # The mean of e^2/P is 1, to 5 standard errors and what is left out where outliers are in doubt.
    each = ((found.x[:, :, 0] - truth) ** 2 / found.P[:, :, 0, 0]).mean(axis=1)
    assert abs(each.mean() - 1.0) < 0.15 + 5.0 * each.std() / np.sqrt(RUNS)


WAYS = [{}, {"process": None}, {"influence": Huber()}, {"influence": TukeyBiweight(), "process": StudentT()}]


@pytest.mark.parametrize("options", WAYS, ids=range(4))
def test_each_of_many_series_has_the_numbers_it_has_alone_by_kernel_and_definition(monkeypatch, options):
    support.needs_kernel()
    zs = np.array([drive(seed, share, 10.0, 60)[1] for seed, share in ((1, 0.0), (2, 0.1), (3, 0.4))])[:, :, None]
    zs[1, 5:9] = np.nan
    together = smooth_series(zs, CART.F, CART.H, CART.Q, CART.R, np.zeros(2), CART.P, **options)
    alone = [smooth(filter_of(ndim=1), z, **options) for z in zs]
    support.without_kernel(monkeypatch)
    for s, by_kernel in enumerate(alone):
        by_definition = smooth(filter_of(ndim=1), zs[s], **options)
        assert by_definition.sweeps == by_kernel.sweeps
        for one in (by_kernel, by_definition):
            np.testing.assert_allclose(together.x[s], one.x, rtol=1e-7, atol=1e-8)
            np.testing.assert_allclose(together.P[s], one.P, rtol=1e-7, atol=1e-9)
            np.testing.assert_allclose(together.weights[s], one.weights, rtol=1e-7, atol=1e-8)
            np.testing.assert_allclose(together.contamination[s], one.contamination, rtol=1e-7)


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("size", [1e3, 1e9, 1e100, 1e300])
@pytest.mark.parametrize(
    "options", [{}, {"grouping": "joint"}, {"influence": Huber()}, {"influence": StudentT()}], ids=str
)
def test_an_unbounded_outlier_has_a_bounded_influence(size, options):
    truth, zs, _ = drive(5, 0.0, 1.0)
    clean = smooth(filter_of(), zs, **options)
    zs[[50, 90, 91, 120]] = size, -size, size, size
    found = smooth(filter_of(), zs, **options)
    assert found.converged and np.isfinite(found.P).all()
    assert np.abs(found.x - clean.x).max() < 3.0
    assert np.abs(found.x[:, 0, 0] - truth).max() < 4.0
    assert (found.weights[[50, 90, 91, 120]] < 0.02).all()


def test_state_jumps_are_learnt_with_the_process():
    """Twice as good where the process jumps, at little cost where it does not."""
    rng = np.random.default_rng(6)
    for jumps, bound in ((0.05, 0.5), (0.0, 1.1)):
        w = 0.1 * rng.normal(size=400) * np.where(rng.random(400) < jumps, 100.0, 1.0)
        truth = np.cumsum(w)
        zs = truth + rng.normal(size=400)
        # A level, and a second state that stands still.
        kf = support.of_matrices(KalmanFilter, 1.0, np.eye(1, 2), np.diag([0.01, 0.0]), P=0.0)
        plain, both = smooth(kf, zs), smooth(kf, zs, process=None)
        error = [np.mean((one.x[:, 0, 0] - truth) ** 2) for one in (plain, both)]
        assert error[1] < bound * error[0]
        if jumps:
            assert both.process_weights[np.argmax(np.abs(w))] < 0.1 and both.process_contamination > 0.01


def test_what_moves_the_states_in_a_step_is_judged_together():
    """With equal noises of two levels turned coordinates change nothing; each judged for itself, they would."""
    U, rng = np.linalg.qr(np.array([[1.0, 2.0], [-2.0, 1.0]]))[0], np.random.default_rng(2)
    zs = np.cumsum(rng.normal(size=(60, 2)) * np.where(rng.random((60, 1)) < 0.1, 20.0, 1.0), axis=0)
    plain, other = (
        smooth(support.of_matrices(KalmanFilter, np.eye(2), H), zs, influence=Linear(), process=StudentT(2.0))
        for H in (np.eye(2), U.T)
    )
    assert plain.process_weights.min() < 0.3
    np.testing.assert_allclose(other.x[..., 0] @ U, plain.x[..., 0], rtol=1e-6, atol=1e-6)


def test_any_filter_will_do_is_left_as_it_was_and_its_grouping_is_taken():
    _, zs, _ = drive(10, 0.1, 10.0, 40)
    pairs = np.column_stack([zs, zs])
    pairs.setflags(write=False)
    problem = support.with_(CART, H=np.vstack([CART.H, CART.H]), R=np.eye(2), M=np.zeros((2, 2)))
    kf = support.make(RobustKalmanFilter, problem, grouping="joint")
    before = support.snapshot(kf)
    ours, theirs = smooth(kf, pairs), smooth(support.make(KalmanFilter, problem), pairs, grouping="joint")
    np.testing.assert_array_equal(ours.x, theirs.x)
    np.testing.assert_array_equal(ours.weights[:, 0], ours.weights[:, 1])
    support.assert_unchanged(before, kf)
    smooth(support.make(noise_given, problem), pairs)


BAD = [
    ({"zs": [1.0, np.inf]}, "zs: expected finite numbers or NaN .* step 1"),
    ({"zs": np.zeros((5, 2))}, r"zs: expected shape \(5, 1\)"),
    ({"zs": [[1.0, 2.0]]}, r"zs: expected 1 number\(s\) at each step"),
    ({"zs": []}, "zs: expected at least one entry"),
    ({"zs": 3.0}, "zs: expected a sequence"),
    ({"Fs": [np.eye(2)]}, "Fs: expected an entry for each of the 5"),
    ({"Fs": [np.eye(2)] * 4 + [np.eye(3)]}, "Fs: expected matrices of one shape"),
    ({"Qs": [np.eye(3)] * 5}, r"Q: expected shape \(2, 2\)"),
    ({"Rs": [-1.0] * 5}, r"R\[0, 0\]: expected a positive semidefinite"),
    ({"us": [1.0] * 5}, "us: expected no inputs for a filter without B"),
    ({"influence": np.sin}, "influence: expected an object"),
    ({"process": 3}, "process: expected an object"),
    ({"grouping": "pairs"}, "grouping: expected one of"),
    ({"max_sweeps": 0}, "max_sweeps: expected an integer >= 1"),
    ({"attributes": {"R": np.zeros((1, 1))}}, "R: expected noise of every sensor"),
    ({"attributes": {"Q": np.diag([1.0, -1.0])}}, "Q: expected a positive semidefinite"),
    ({"attributes": {"Q": np.array([[1.0, 0.2], [0.0, 1.0]])}}, "Q: expected a symmetric"),
    ({"attributes": {"P": -np.eye(2)}}, "P: expected a positive semidefinite"),
    ({"attributes": {"F": np.full((2, 2), np.nan)}}, "F: expected finite numbers"),
    ({"attributes": {"alpha": 1.1}}, "alpha: expected 1"),
    ({"attributes": {"F": 1e200 * np.eye(2)}}, "F: expected a model whose states stay finite"),
]


BAD_SERIES = [
    ({"zs": np.zeros((2, 3))}, r"zs: expected shape .*zs\[:, :, None\].*zs\[None\]"),
    ({"zs": np.zeros((2, 3, 0))}, "zs: expected shape"),
    ({"zs": np.zeros((2, 3, 2)), "H": np.eye(2), "R": np.diag([1.0, 0.0])}, "R: expected noise of every sensor"),
    # As filter_series, which reads them for it.
    ({"x0": np.zeros((2, 1))}, "x0: expected shape .*x0.ravel"),
]


def one_recording(attributes=(), zs=np.zeros(5), **change):
    kf = filter_of()
    for name, value in dict(attributes).items():
        setattr(kf, name, value)
    smooth(kf, zs, **change)


def many_series(**change):
    model = {"F": CART.F, "H": CART.H, "Q": CART.Q, "R": CART.R, "x0": np.zeros(2), "P0": CART.P}
    smooth_series(**{"zs": np.zeros((3, 4, 1)), **model, **change})


@pytest.mark.parametrize("call, change, match", [
    *((one_recording, *row) for row in BAD), *((many_series, *row) for row in BAD_SERIES),
])  # fmt: skip
@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
def test_bad_input_is_refused_by_name(call, change, match):
    with pytest.raises((TypeError, ValueError), match=match):
        call(**change)


def test_a_search_without_end_says_so_and_returns_its_best():
    truth, zs, _ = drive(11, 0.2, 10.0)
    for options in ({}, {"influence": TukeyBiweight()}, {"influence": Huber()}):
        found = smooth(filter_of(), zs, max_sweeps=2, **options)
        assert not found.converged and found.sweeps == 2 and "moved" in found.message
        assert np.isfinite(found.x).all() and np.isfinite(found.P).all()
        assert np.mean((found.x[:, 0, 0] - truth) ** 2) < np.mean((zs - truth) ** 2)


def test_nothing_measured_is_the_prediction():
    kf = filter_of(ndim=1)
    kf.x = np.array([1.0, 2.0])
    found = smooth(kf, [None] * 4)
    np.testing.assert_allclose(found.x[:, 0], [3.0, 5.0, 7.0, 9.0])
    assert np.isnan(found.weights).all() and found.converged


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_process_whose_noise_is_given_far_too_small_is_smoothed_as_one_that_jumps():
    """Its scale is learnt as 1e8: what everything else says of a noise is a difference, and was below zero then."""
    for seed in (10, 15, 40, 45, 50, 110):
        rng = np.random.default_rng(seed)
        n, m, steps = 3, int(rng.integers(1, 4)), int(rng.choice([6, 80, 300]))
        F = np.eye(n) + np.triu(rng.random((n, n)), 1)
        H, Q, R = rng.normal(size=(m, n)), 10.0 ** rng.uniform(-6, -2, n), 10.0 ** rng.uniform(-4, -2, m)
        kf = support.of_matrices(RobustKalmanFilter, F, H, np.diag(Q), np.diag(R), 1e6)
        jumps = 30.0 * (rng.random((steps, 1)) < 0.1) * rng.normal(size=(steps, 1))
        found = smooth(kf, rng.normal(size=(steps, m)) + np.cumsum(jumps, 0), process=None)
        assert np.isfinite(found.x).all() and np.isfinite(found.P).all(), seed
        assert (np.einsum("kii->ki", found.P) > 0.0).all(), seed


def test_a_redescending_psi_does_not_lock_out():
    """Three outliers in ten, a hundred times too large: the filter with this psi loses the state."""
    runs = [drive(seed, 0.3, 100.0) for seed in range(20_200, 20_210)]
    for truth, zs, _ in runs:
        found = smooth(filter_of(), zs, influence=TukeyBiweight())
        assert np.sqrt(np.mean((found.x[:, 0, 0] - truth) ** 2)) < 1.0


def test_each_sensor_has_a_contamination_of_its_own():
    rng = np.random.default_rng(8)
    kf = support.of_matrices(KalmanFilter, 1.0, [[1.0, 0.0], [1.0, 0.0]], np.diag([0.01, 0.0]), np.diag([1.0, 2.0]))
    zs = np.cumsum(0.1 * rng.normal(size=600))[:, None] + rng.multivariate_normal(np.zeros(2), kf.R, 600)
    zs[rng.random(600) < 0.2, 1] += 30.0
    contamination = smooth(kf, zs).contamination
    assert contamination[0] < 0.02 and abs(contamination[1] - 0.2) < 0.05


def test_variances_that_are_lost_in_rounding_are_refused():
    """A state that nothing measures grows by 1.02 a step for 900 steps: 1e15 times its variance at the beginning."""
    Q = np.diag([0.1, 2e-4, 2e-5])
    kf = support.of_matrices(RobustKalmanFilter, 1.02, [[1.0, -0.5, 0.3], [0.2, 1.0, -0.8]], Q)
    x, zs, rng = np.ones(3), np.empty((900, 2)), np.random.default_rng(0)
    for k in range(900):
        x = kf.F @ x + np.sqrt(np.diag(kf.Q)) * rng.normal(size=3)
        zs[k] = kf.H @ x + rng.normal(size=2)
    with pytest.raises(ValueError, match="F: expected a model whose covariances numbers can hold"):
        smooth(kf, zs, grouping="joint")


# A burst that can be followed is not, if it is less probable; a Q or R that does not fit is said, and only then.


G = np.array([0.5, 1.0])
PLANE = np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])
POSITIONS = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]])


def plane(q=0.05):
    return of_matrices(KalmanFilter, PLANE, POSITIONS, q**2 * np.kron(np.eye(2), np.outer(G, G)), P=1e4)


def walk(seed, steps=300, q=0.05):
    """Positions in the plane, shape (steps, 2), and what is measured of them."""
    rng = np.random.default_rng(seed)
    w = q * rng.normal(size=(steps, 2)) @ np.kron(np.eye(2), G)
    truth = support.states(PLANE, w, np.array([0.0, 1.0, 0.0, 0.5])) @ POSITIONS.T
    return truth, truth + rng.normal(size=truth.shape)


@pytest.mark.pairwise
@pytest.mark.parametrize("grouping", ["component", "joint"])
@pytest.mark.parametrize("q", [0.05, 0.1])
@pytest.mark.parametrize("length, off", [(20, 20.0), (50, 20.0), (50, 70.0), (50, 300.0)])
def test_a_burst_after_ten_good_samples_is_not_followed(length, off, q, grouping):
    for seed in range(40, 44):
        truth, zs = walk(seed, q=q)
        zs[10 : 10 + length] += off
        with (
            pytest.warns(UserWarning, match=f"samples 10 to {9 + length} are left out")
            if length == 50
            else nullcontext()
        ):
            found = smooth(plane(q), zs, grouping=grouping)
        assert (found.weights[10 : 10 + length] < 0.5).all()
        error = found.x[:, [0, 2], 0] - truth
        sd = np.sqrt(found.P[:, [0, 2], [0, 2]])
        assert np.abs(error / sd).max() < 6.0


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("gap", [100, 400])
@pytest.mark.parametrize("P0", [1e4, 1e6, 1e8])
def test_a_sensor_that_starts_late_is_smoothed_from_where_it_starts(P0, gap, monkeypatch):
    """What is known then is next to nothing: variances of residuals were differences of large numbers, and negative."""
    for seed in range(3):
        truth, zs = walk(seed, 600)
        rng = np.random.default_rng(seed)
        zs += np.where(rng.random(zs.shape) < 0.1, 50.0 * rng.normal(size=zs.shape), 0.0)
        zs[:gap] = np.nan
        kf = plane()
        kf.P = P0 * np.eye(4)
        late = smooth(kf, zs)
        error = (late.x[gap:, [0, 2], 0] - truth[gap:]) / np.sqrt(late.P[gap:, [0, 2], [0, 2]])
        assert np.abs(error).max() < 6.0
        if seed == 0 and gap == 100:
            without_kernel(monkeypatch)
            by_definition = smooth(kf, zs)
            monkeypatch.undo()
            np.testing.assert_allclose(by_definition.x[gap:], late.x[gap:], rtol=1e-4, atol=1e-4)


def test_inputs_and_gaps_are_part_of_what_is_probable():
    truth, zs = walk(52)
    pushed = np.zeros((300, 4))
    pushed[0, 1] = 5.0
    kf = plane()
    kf.B = np.eye(4)
    zs = zs + 5.0 * np.arange(1, 301)[:, None] * [1.0, 0.0]
    zs[10:60] += 70.0
    zs[200:210] = np.nan
    found = smooth(kf, zs, us=[PLANE @ u for u in pushed])
    there = found.x[:, [0, 2], 0] - truth - 5.0 * np.arange(1, 301)[:, None] * [1.0, 0.0]
    assert np.abs(there).max() < 8.0


def said(kf, zs, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = smooth(kf, zs, **options)
    messages = [str(each.message) for each in caught]
    assert all(message.split(": ", 1)[1].split("; fit")[0] in found.message for message in messages)
    return " ".join(messages)


def level(q, r):
    return of_matrices(KalmanFilter, 1.0, [[1.0]], q, r, 100.0)


def moving(q, r):
    return of_matrices(KalmanFilter, [[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0]], q * 0.01 * np.outer(G, G), r, 10.0)


def wandering(kind, seed, contamination, steps=400):
    """Readings of a level, or of a point whose speed wanders."""
    rng = np.random.default_rng(seed)
    outlier, w = np.where(rng.random(steps) < contamination, 10.0, 1.0), rng.normal(size=steps)
    return (np.cumsum(w) if kind is level else np.cumsum(np.cumsum(0.1 * w))) + outlier * rng.normal(size=steps)


# What is filtered, the share of outliers, how wrong Q and R are, the words, and by which psi besides what is learnt.
@pytest.mark.parametrize("kind, share, q, r, words, psis", [
    (level, 0.0, 1.0, 1.0, (), [Huber()]), (level, 0.1, 1.0, 1.0, (), [Huber()]), (level, 0.3, 1.0, 1.0, (), []),
    (level, 0.0, 0.1, 1.0, ("process noise", "process=None"), [Linear()]),
    (level, 0.0, 1.0, 10.0, ("as R says",), [Linear()]), (level, 0.0, 10.0, 1.0, ("Q and R do not fit",), [Linear()]),
    # Of a smooth state it is also said of an R too small and a Q too large.
    *((moving, share, *row, []) for share in (0.0, 0.3) for row in (
        (1.0, 1.0, ()), (1.0, 0.1, ("look like outliers to R",)), (10.0, 1.0, ("as Q says",)),
    )),
])  # fmt: skip
def test_a_noise_that_does_not_fit_is_said_and_only_then(kind, share, q, r, words, psis):
    for seed in range(60, 64 if words or kind is moving else 75):
        zs = wandering(kind, seed, share, 400 if kind is level else 600)
        for influence in (None, *psis):
            found = said(kind(q, r), zs, influence=influence)
            assert all(word in found for word in words) and bool(words) == bool(found), (seed, influence, found)
    assert kind is moving or not said(level(10.0, 10.0), zs[:12]), "few samples say nothing"


@pytest.mark.parametrize("begin, end", [(150, 300), (0, 60), (200, 300)])
def test_a_state_that_has_moved_is_followed(begin, end):
    """What lasts to an end of the recording is no burst, though one offset would explain it as well."""
    for seed in range(3):
        truth, zs = walk(seed)
        truth[begin:end] += 10.0
        zs[begin:end] += 10.0
        error = smooth(plane(), zs).x[:, [0, 2], 0] - truth
        assert np.sqrt(np.mean(error**2)) < 1.2
