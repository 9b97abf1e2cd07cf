"""AdaptiveKalmanFilter: it finds the noise that nobody gave; what it has learnt is safe."""

import numpy as np
import pytest
from scipy.linalg import block_diag
from support import cart, make, of_matrices, predict_and_update, random_problem, simulate, states, through, with_

from robust_filterpy import AdaptiveKalmanFilter, Contaminated, Learnt, RobustKalmanFilter
from robust_filterpy.correction import Scales


def moving(seed, n, label=1.0, R=1.0, Q=1.0):
    """A point that moves with a nearly constant velocity; R and Q of the filter are these factors too large."""
    rng = np.random.default_rng(seed)
    w = 0.1 * rng.standard_normal(n)
    problem = with_(cart(), Q=Q * 0.01 * np.array([[0.25, 0.5], [0.5, 1.0]]), R=np.array([[R]]), P=10.0 * np.eye(2))
    truth = states(problem.F, np.outer(w, [0.5, 1.0]))
    return problem, truth, truth[:, 0] + label * rng.standard_normal(n)


def contaminated(seed, n, share, scale=10.0):
    return np.where(np.random.default_rng(1000 + seed).random(n) < share, scale, 1.0)


@pytest.mark.parametrize("share", [0.0, 0.1])
@pytest.mark.parametrize("factor", [0.01, 0.03, 1.0, 100.0])
def test_r_comes_back_from_far_off_and_outliers_are_counted(share, factor):
    """At .03 most samples pass for outliers of the next class, and P grows with the process scale."""
    noises, errors = [], []
    for seed in range(4):
        problem, truth, zs = moving(seed, 1000, contaminated(seed, 1000, share), R=factor)
        kf = make(AdaptiveKalmanFilter, problem, 1)
        errors.append(np.square(kf.batch_filter(zs)[0][500:, 0] - truth[500:, 0]).mean())
        noises.append(kf.noise_learnt)
        assert noises[-1].r[0] == pytest.approx(kf.R_learnt[0, 0] / factor)
    r, found, std, ratio, length = (
        np.array([getattr(noise, name)[0] for noise in noises])
        for name in ("r", "contamination", "contamination_std", "scale_ratio", "run_length")
    )
    # The memory is 30 ordinary samples: 26 % for each, 13 % for the mean of four.
    assert np.mean(r * factor) == pytest.approx(1.0, abs=0.5) and np.sqrt(np.mean(errors)) < 1.0
    if share and factor == 1.0:
        assert found.mean() == pytest.approx(share, abs=0.04) and ratio.mean() == pytest.approx(10.0, rel=0.4)
        assert (np.abs(found - share) < 3.0 * std).all() and (std < 0.06).all() and length.mean() < 2.0


@pytest.mark.parametrize("size", [30.0, 3e4])
def test_a_jump_of_the_whole_state_is_believed(size, path):
    """What a sensor does not see has jumped as well, so the candidate is as uncertain of it."""
    for seed in range(20 if path == "kernel" else 4):
        rng = np.random.default_rng(seed)
        problem = random_problem(seed, 4, 3)
        problem = with_(problem, F=np.eye(4) + 0.02 * rng.normal(size=(4, 4)), Q=0.01 * problem.Q)
        zs, x = simulate(problem, 40, seed)[0], size * rng.normal(size=4)
        for z in zs[28:]:
            z += problem.H @ x
            x = problem.F @ x
        kf = make(AdaptiveKalmanFilter, problem, 1)
        through(kf, zs)
        off = kf.H @ np.ravel(kf.x) - zs[-1]
        assert np.abs(off / np.sqrt(problem.R.diagonal())).max() < 8.0, seed


@pytest.mark.parametrize("sensors", [2, 3])
def test_what_is_shown_where_s_is_singular_to_rounding(sensors):
    """Sensors are taken one after the other, so that nothing was refused; only what is shown needs an inverse of S."""
    kf = of_matrices(AdaptiveKalmanFilter, 1.0, np.ones((sensors, 1)), P=1e18)
    predict_and_update(kf, np.full(sensors, 5.0))
    assert kf.x.item() == pytest.approx(5.0)
    for name in ("weights", "clipped", "e", "S", "SI", "K", "mahalanobis", "y_bounded"):
        assert np.isfinite(getattr(kf, name)).all(), name
    np.testing.assert_allclose(kf.K @ np.ones(sensors), [1.0])
    twin = AdaptiveKalmanFilter(1, sensors)
    twin.restore(kf.state())
    np.testing.assert_array_equal(twin.x, kf.x)


@pytest.mark.parametrize("grouping", ["component", "joint"])
@pytest.mark.parametrize("variances", [(0.0,), (1.0, 0.0)])
def test_a_sensor_without_noise_is_believed_and_teaches_nothing(variances, grouping, path):
    m = len(variances)
    problem = with_(random_problem(8, 3, m), R=np.diag(variances), M=np.zeros((3, m)))
    kf = make(AdaptiveKalmanFilter, problem, 1, grouping=grouping)
    for k, z in enumerate(simulate(problem, 20, 3)[0]):
        kf.predict()
        kf.update(z) if k % 2 else kf.update_correlated(z)
        assert np.isfinite(kf.learnt).all() and np.isfinite(kf.K).all()
        assert kf.H[-1] @ kf.x == pytest.approx(z[-1], rel=1e-6, abs=1e-6)
    assert (kf.learnt[-1, 0] == 1.0) == (grouping == "component" or m == 1)


@pytest.mark.parametrize("noise, P", [(0.0, 1.0), (1e-6, 1.0), (1e-6, 1e8), (1e-6, 1e14)])
def test_sensors_next_to_without_noise_are_believed_wherever_the_start_is(noise, P, path):
    """The start's covariance less what such a reading tells is rounding; nothing is beyond what a sensor may say."""
    for seed in range(20):
        problem, far = with_(random_problem(seed, 3, 2), R=noise * np.eye(2), P=P * np.eye(3)), max(300.0, P**0.5)
        kf = make(AdaptiveKalmanFilter, problem, 1)
        zs = simulate(with_(problem, x=problem.x + far * np.random.default_rng(seed).normal(size=(3, 1))), 8, seed)[0]
        through(kf, zs)
        np.testing.assert_allclose(kf.H @ np.ravel(kf.x), zs[-1], atol=0.02)
        assert noise or np.allclose(kf.H @ np.ravel(kf.x), zs[-1])


def test_what_is_missing_or_unseen_teaches_nothing_and_a_part_of_its_own_sensors():
    problem = with_(random_problem(8, 4, 3), R=np.diag([1.0, 2.0, 3.0]))
    kf, twin = (make(AdaptiveKalmanFilter, problem, 1) for _ in range(2))
    for one in (kf, twin):
        through(one, simulate(problem, 40, 8, contamination=0.2)[0])
        one.predict()

    def taught(call):
        before = kf.learnt.copy()
        call()
        return (kf.learnt != before).any(axis=1).tolist()

    assert taught(lambda: kf.update(None)) == [False] * 3
    assert kf.outlier_probability == 0.0 and kf.log_likelihood == 0.0
    assert taught(lambda: kf.update([50.0, 0.1, 0.2], H=np.vstack([np.zeros(4), problem.H[1:]]))) == [False, True, True]
    kf.restore(twin.state())
    assert taught(lambda: kf.update_sequential(1, [0.3, 40.0])) == [False, True, True]
    # The same as a measurement whose first component is missing.
    twin.update([np.nan, 0.3, 40.0])
    for name in ("x", "P", "learnt", "log_likelihood"):
        np.testing.assert_allclose(getattr(kf, name), getattr(twin, name), rtol=1e-10, atol=1e-12, err_msg=name)


def test_sensors_may_join_and_another_grouping_starts_to_learn_anew(form):
    problem = random_problem(9, 4, 3)
    kf = make(AdaptiveKalmanFilter, with_(problem, H=problem.H[:1], R=problem.R[:1, :1], M=problem.M[:, :1]), 1)
    zs = simulate(problem, 30, 9)[0]
    through(kf, zs[:, :1])
    width = kf.learnt.shape[1]
    for m, most in ((2, 2), (3, 3), (1, 3)):
        predict_and_update(kf, zs[0, :m], H=problem.H[:m], R=problem.R[:m, :m])
        assert kf.learnt.shape == (most, width)
    assert kf.R_learnt.shape == (1, 1)
    kf = make(AdaptiveKalmanFilter, problem, 1)
    through(kf, zs)
    learnt = kf.learnt.copy()
    kf.grouping = "component"
    np.testing.assert_array_equal(kf.learnt, learnt)
    kf.grouping = "joint"
    assert kf.learnt.shape[0] == 1 and kf.noise_learnt.r == pytest.approx([1.0])
    through(kf, zs)


def test_where_the_noise_is_learned_the_process_is_doubted_unless_it_is_given():
    problem = random_problem(4, 2, 1)
    zs = simulate(problem, 60, 4, contamination=0.1)[0]
    short, adaptive, given, none = (
        make(cls, problem, 1, **options)
        for cls, options in (
            (RobustKalmanFilter, {"noise": "learnt"}), (AdaptiveKalmanFilter, {}),
            (RobustKalmanFilter, {"noise": "learnt", "process": "given"}), (RobustKalmanFilter, {"process": "given"}),
        )
    )  # fmt: skip
    for kf in (short, adaptive, given, none):
        through(kf, zs)
    np.testing.assert_array_equal(short.x, adaptive.x)
    assert short.process == adaptive.process == Scales() and given.process == Contaminated(0.0)
    # One that is made with what another shows goes on like it.
    again = make(RobustKalmanFilter, problem, 1, noise=given.noise, process=given.process)
    through(again, zs)
    np.testing.assert_array_equal(given.x, again.x)
    assert given.process_probabilities.shape[0] == 1 and not np.array_equal(given.x, short.x)
    assert none.noise is None and none.process is None


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.parametrize("grouping", ["joint", "component"])
def test_what_was_learnt_can_be_handed_on(grouping):
    problem = with_(random_problem(13, 4, 2), R=np.diag([4.0, 50.0]))
    zs = simulate(problem, 400, 13, contamination=0.1)[0]
    old, new, blank = (
        make(AdaptiveKalmanFilter, with_(problem, R=0.01 * problem.R), 1, grouping=grouping) for _ in "abc"
    )
    through(old, zs[:300])
    new.learnt = array = old.learnt
    np.testing.assert_equal(new.noise_learnt._asdict(), old.noise_learnt._asdict())
    # It is a copy: what the one learns now, or a program writes, is not the other's.
    through(new, zs[300:301]), through(blank, zs[300:301])
    np.testing.assert_array_equal(old.learnt, array)
    array[:] = 7.0
    assert not (old.learnt == 7.0).all()
    assert (new.R_learnt > 10 * blank.R_learnt).diagonal().all()
    # Also of a reading beyond all numbers.
    through(old, [[1e300, 2.0]])
    new.learnt = old.learnt
    np.testing.assert_array_equal(new.learnt, old.learnt)


@pytest.mark.parametrize("name, spoil, words", [
    *(("handed on", spoil, "learnt: expected") for spoil in (
        lambda a: None, lambda a: "r", lambda a: np.ones(5), lambda a: a[:, :-1], lambda a: a[:1],
        lambda a: np.full_like(a, np.nan), lambda a: -a, lambda a: 0 * a,
    )),
    ("learnt", lambda a: -a, "learnt: expected finite numbers >= 0"),
    ("learnt", lambda a: 2.0 * a, "learnt: expected probabilities"),
    *(("belief", spoil, "state: belief: expected probabilities >= 0 of the models that sum to 1") for spoil in (
        lambda a: a - 1.0, lambda a: 0.0 * a,
    )),
    ("belief", lambda a: np.vstack((a[:6], a[6:] + 7.0)), "state: belief: expected a chance of a jump"),
    ("belief", lambda a: np.vstack((a[:7], a[7:] + 1.0)), "state: belief: expected the first state of each"),
    ("belief", lambda a: np.vstack((a[:8], a[8:9] - 1.0, a[9:])), "state: belief: expected evidence and readings"),
    ("belief", lambda a: np.vstack((a[:10], 0.0 * a[10:])), "state: belief: .* and a factor > 0"),
], ids=range(16))  # fmt: skip
def test_what_was_learnt_and_makes_no_sense_is_refused(name, spoil, words):
    kf = make(AdaptiveKalmanFilter, with_(cart(), H=np.eye(2), R=np.eye(2), M=np.zeros((2, 2))), 1)
    through(kf, [[0.1, 0.2], [50.0, 0.3]])
    before = kf.state()
    with pytest.raises((ValueError, TypeError), match=words):
        if name == "handed on":
            kf.learnt = spoil(before["learnt"])
        else:
            kf.restore({**before, name: spoil(before[name]), "x": before["x"] + 1.0})
    np.testing.assert_equal(kf.state(), before)


def apart():
    """Two problems in one state: a point with a speed and its sensor, a level with two sensors."""
    one, other = random_problem(21, 2, 1), random_problem(22, 1, 2)
    whole = {name: block_diag(getattr(one, name), getattr(other, name)) for name in ("F", "Q", "H", "R", "P")}
    return with_(random_problem(23, 3, 3), x=np.vstack((one.x, other.x)), **whole), one, other


@pytest.mark.parametrize("options", [
    {"noise": Contaminated(0.1, 100.0), "process": Scales()}, {"noise": Learnt(), "grouping": ((0,), (1, 2))},
], ids=["process", "learnt"])  # fmt: skip
def test_what_nothing_couples_is_filtered_as_by_filters_of_their_own(options):
    """Each has its own scale of Q, jumps, start; an outlier is that of any sensor: 1 - (1 - p_1)(1 - p_2)."""
    problems = apart()
    jumps = "process" in options
    groupings = [options["grouping"], ((0,),), ((0, 1),)] if "grouping" in options else [None] * 3
    both, first, second = filters = [
        make(RobustKalmanFilter, problem, 1, **options | ({"grouping": grouping} if grouping else {}))
        for problem, grouping in zip(problems, groupings, strict=True)
    ]
    zs = simulate(problems[0], 150, 3, contamination=0.1, size=10.0)[0] + np.array([200.0, 0.0, 0.0]) * jumps
    zs[100:, 1:] += 90.0 * jumps
    apart_by = 0.0
    for z in zs:
        for kf, part in zip(filters, (z, z[:1], z[1:]), strict=True):
            predict_and_update(kf, part)
        p, q = first.outlier_probability, second.outlier_probability
        assert both.outlier_probability == pytest.approx(1.0 - (1.0 - p) * (1.0 - q), rel=1e-6, abs=1e-10)
        apart_by = max(apart_by, both.outlier_probability - max(p, q))
    assert apart_by > 0.01
    np.testing.assert_allclose(np.ravel(both.x), np.r_[np.ravel(first.x), np.ravel(second.x)], rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(both.P, block_diag(first.P, second.P), rtol=1e-8, atol=1e-11)
    if jumps:
        scales = np.r_[first.process_scale, second.process_scale]
        np.testing.assert_allclose(both.process_scale, scales, rtol=1e-8)


@pytest.mark.parametrize("off", [(75.0, -40.0), (75.0, 0.0)])
def test_a_start_that_is_doubted_stays_so_where_a_sensor_couples_two_parts(off):
    """Readings of both, then of sum and difference: what the first has begun is not to be begun anew."""
    problem = with_(
        random_problem(1, 2, 2), F=np.eye(2), H=np.eye(2), Q=0.01 * np.eye(2), R=np.eye(2), P=np.eye(2),
        x=np.zeros((2, 1)),
    )  # fmt: skip
    for seed in range(10):
        kf, noise = make(AdaptiveKalmanFilter, problem, 1), np.random.default_rng(seed).normal(size=(5, 2))
        for k in range(5):
            H = np.array([[1.0, 1.0], [1.0, -1.0]]) if k == 1 else np.eye(2)
            predict_and_update(kf, H @ off + noise[k], H=H)
            assert k < 2 or np.abs(np.ravel(kf.x) - off).max() < 4.0


def test_parts_that_contradict_each_other_utterly_become_one_all_the_same(path):
    alone = {name: np.eye(3) for name in ("F", "Q", "H", "R", "P")}
    kf = make(AdaptiveKalmanFilter, with_(random_problem(1, 3, 3), **alone), 1)
    state = kf.state()
    # Each is certain of a scale that the others rule out.
    state["belief"][:5] = 1e-200
    state["belief"][[1, 4, 2], [0, 1, 2]] = 1.0
    kf.restore(state)
    kf.F = np.ones((3, 3))
    kf.predict()
    assert np.isfinite(kf.x).all() and np.isfinite(kf.P).all()
    np.testing.assert_allclose(kf.process_probabilities.sum(axis=0), 1.0)


def test_a_sensor_ten_times_better_than_r_says_is_known_in_a_few_dozen_samples_and_others_are_believed():
    falls = []
    for seed in range(40):
        g = np.random.default_rng(seed)
        for sigma in (0.1, 1.0):
            kf = of_matrices(AdaptiveKalmanFilter, 1.0, [[1.0]], 1e-4)
            through(kf, sigma * g.normal(size=60) + np.cumsum(0.01 * g.normal(size=60)))
            falls.append(kf.learnt[0, 0])
    better, right = np.reshape(falls, (40, 2)).T
    assert np.median(better) < 0.03 and (better < 0.1).mean() > 0.9 and (right > 0.25).all()


def test_sensors_that_fail_together_have_one_noise_whatever_H_is_passed():
    kf = of_matrices(AdaptiveKalmanFilter, 1.0, np.eye(2), 0.01, 0.1, grouping="joint")
    for k, z in enumerate(np.random.default_rng(0).normal(size=20)):
        predict_and_update(kf, z, R=0.1, H=kf.H[[k % 2]])
        assert kf.learnt.shape[0] == 1
    kf.restore(kf.state())
