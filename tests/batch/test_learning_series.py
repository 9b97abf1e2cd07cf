"""Many series whose noise is learnt are a loop over filters, whatever runs them."""

import numpy as np
import pytest
import support

from robust_filterpy import AdaptiveKalmanFilter, Contaminated, Huber, Learnt, RobustKalmanFilter, filter_series
from robust_filterpy.correction import Scales, SingularInnovationError
from robust_filterpy.correction.learning import NoiseClasses

SERIES, N = 3, 25


def problem_and_series(dims=(3, 2, 0)):
    problem = support.random_problem(8, *dims)
    problem = support.with_(problem, R=np.diag(problem.R.diagonal()))
    zs = np.array([support.simulate(problem, N, seed, contamination=0.15)[0] for seed in range(SERIES)])
    zs[np.random.default_rng(0).random(zs.shape) < 0.1] = np.nan
    zs[1, 4:6] = np.nan
    return problem, zs


def arguments(problem):
    return problem.F, problem.H, problem.Q, problem.R, problem.x[:, 0], problem.P


def learning(zs, *model, noise="learnt", process="scales", **options):
    """Series as an `AdaptiveKalmanFilter` filters them."""
    return filter_series(zs, *model, noise=noise, process=process, **options)


def by_filters(problem, zs, learnt=None, model=lambda s, k: {}, **options):
    """A loop over filters: what each shows at each step, by name."""
    rows = {name: [] for name in ("x", "P", "weights", "outlier_probability", "process_scale", "log_likelihood")}
    known = []
    for s, z in enumerate(zs):
        kf = support.make(AdaptiveKalmanFilter, problem, 1, **options)
        if learnt is not None:
            kf.learnt = learnt[s]
        for k, z_k in enumerate(z):
            given = model(s, k)
            kf.predict(F=given.get("F"), Q=given.get("Q"))
            kf.update(z_k, H=given.get("H"), R=given.get("R"))
            for name, column in rows.items():
                column.append(np.copy(getattr(kf, name)))
        known.append(kf.state())
    shown = {name: np.array(column).reshape(len(zs), zs.shape[1], *column[0].shape) for name, column in rows.items()}
    shown["log_likelihood"] = shown["log_likelihood"].sum(axis=1)
    return {**shown, "state": known}


def assert_same(found, expected, rtol=1e-8):
    assert set(found._fields) == set(expected)
    for name in set(expected) - {"state"}:
        np.testing.assert_allclose(getattr(found, name), expected[name], rtol=rtol, atol=1e-10, err_msg=name)
    for name, values in found.state.items():
        states = [state[name] for state in expected["state"]]
        np.testing.assert_allclose(values, states, rtol=rtol, atol=1e-10, err_msg=name)


OPTIONS = {
    "as it is": {},
    "other classes": {"noise": Learnt((1.0, 30.0), 50.0, 10.0), "process": Scales((1.0, 0.1), dwell=20.0)},
    "a process as told": {"process": None},
    "a noise that is given": {"noise": Contaminated(0.1, 10.0), "process": Scales((1.0, 10.0), jump=1e-6)},
    "both told": {"noise": Contaminated(0.1, 10.0), "process": Contaminated(0.05, 20.0)},
    "told, and a process as told": {"noise": Contaminated(0.1, 10.0), "process": None},
    "nothing contaminated": {"noise": Contaminated(0.0), "process": None},
}


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_series_are_a_loop_over_filters(options, form):
    problem, zs = problem_and_series()
    assert_same(learning(zs, *arguments(problem), **options), by_filters(problem, zs, **options))


@pytest.mark.parametrize("why", ["joint", "groups", "correlated"])
def test_so_are_sensors_that_have_to_do_with_each_other(why):
    problem, zs = problem_and_series()
    grouping = {"joint": "joint", "groups": ((0, 1),), "correlated": "component"}[why]
    if why == "correlated":
        problem = support.with_(problem, R=problem.R + 0.1)
    found = learning(zs, *arguments(problem), grouping=grouping)
    assert_same(found, by_filters(problem, zs, grouping=grouping))


def test_each_series_may_have_its_own_matrices_at_each_step():
    problem, zs = problem_and_series()
    rng = np.random.default_rng(1)
    F = np.array([[support.stable(rng, 3) for _ in range(N)] for _ in range(SERIES)])
    Q = np.array([support.spd(rng, 3) for _ in range(N)])
    H = rng.normal(size=(SERIES, 1, 2, 3))
    H[1, 0, 0] = 0.0
    R = np.array([[np.diag(rng.uniform(0.5, 2.0, 2)) for _ in range(N)] for _ in range(SERIES)])
    found = learning(zs, F, H, Q, R, *arguments(problem)[4:])
    own = by_filters(problem, zs, model=lambda s, k: {"F": F[s, k], "Q": Q[k], "H": H[s, 0], "R": R[s, k]})
    assert_same(found, own)


def test_what_was_learnt_is_passed_on():
    problem, zs = problem_and_series()
    first = learning(zs, *arguments(problem))
    again = learning(zs, *arguments(problem), learnt=first.state["learnt"])
    assert_same(again, by_filters(problem, zs, learnt=first.state["learnt"]))
    shared = learning(zs, *arguments(problem), learnt=first.state["learnt"][1])
    assert_same(shared, by_filters(problem, zs, learnt=[first.state["learnt"][1]] * SERIES))
    assert np.abs(again.x - first.x).max() > 1e-3


@pytest.mark.parametrize("grouping", ["component", "joint"])
def test_parts_give_the_numbers_of_the_whole(grouping):
    problem, zs = problem_and_series()
    whole = learning(zs, *arguments(problem), grouping=grouping)
    state, parts = None, []
    for part in np.split(zs, [1, 2, N // 2], axis=1):
        start = arguments(problem) if state is None else arguments(problem)[:4]
        found = learning(part, *start, grouping=grouping, state=state)
        state = found.state
        parts.append(found)
    for name in ("x", "P", "weights", "outlier_probability", "process_scale"):
        joined = np.concatenate([getattr(part, name) for part in parts], axis=1)
        np.testing.assert_allclose(joined, getattr(whole, name), rtol=1e-8, atol=1e-10, err_msg=name)
    for name, values in whole.state.items():
        np.testing.assert_allclose(state[name], values, rtol=1e-8, atol=1e-10)


def test_a_state_is_not_written_into_and_a_refused_series_stays_refused():
    problem, zs = problem_and_series()
    state = learning(zs, *arguments(problem)).state
    before = {name: array.copy() for name, array in state.items()}
    spoilt = {**state, "x": state["x"].copy()}
    spoilt["x"][1] = np.nan
    spoilt["means"][1] = np.nan
    found = learning(zs, *arguments(problem)[:4], state=spoilt, refused="nan")
    assert np.isnan(found.x[1]).all() and np.isnan(found.state["x"][1]).all() and np.isfinite(found.x[[0, 2]]).all()
    state["means"][1] = before["means"][1]
    for name, kept in before.items():
        np.testing.assert_array_equal(state[name], kept)


def test_a_state_that_does_not_fit_is_refused():
    problem, zs = problem_and_series()
    state, model = learning(zs, *arguments(problem)).state, arguments(problem)[:4]
    with pytest.raises(ValueError, match=r"none of x0, P0, `?learnt`?"):
        learning(zs, *arguments(problem), state=state)
    with pytest.raises(TypeError, match="state: expected what filter_series"):
        learning(zs, *model, state=state["learnt"])
    with pytest.raises(ValueError, match=r"state\['means'\]: expected shape"):
        learning(zs, *model, state=state, process=Scales((1.0,)))
    with pytest.raises(ValueError, match="state: expected x, P, learnt in it, got x, P, means"):
        learning(zs, *model, state=state, process=None)
    with pytest.raises(ValueError, match="state: expected x, P, spread in it"):
        learning(zs, *model, state=state, noise=None, process=None)
    with pytest.raises(ValueError, match=r"state\['belief'\]: .* sum to 1"):
        learning(zs, *model, state={**state, "belief": 2.0 * state["belief"]})
    with pytest.raises(ValueError, match="learnt: expected"):
        learning(zs, *model, state={**state, "learnt": -state["learnt"]})
    with pytest.raises(ValueError, match="x0"):
        learning(zs, *model)


def test_threads_and_what_is_kept_change_nothing():
    problem, zs = problem_and_series()
    whole = learning(zs, *arguments(problem))
    last = learning(zs, *arguments(problem), keep="last", covariance="diagonal", n_threads=1)
    some = learning(zs, *arguments(problem), keep=7, covariance="none", n_threads=3)
    np.testing.assert_array_equal(last.x, whole.x[:, -1:])
    np.testing.assert_array_equal(last.P, np.diagonal(whole.P[:, -1:], axis1=2, axis2=3))
    assert some.P is None
    for name in ("x", "weights", "outlier_probability", "process_scale"):
        np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[:, 6::7])
    np.testing.assert_array_equal(some.log_likelihood, whole.log_likelihood)
    np.testing.assert_array_equal(some.state["learnt"], whole.state["learnt"])


def test_arguments_are_left_alone():
    problem, zs = problem_and_series()
    given = [zs, *arguments(problem), learning(zs, *arguments(problem)).state["learnt"]]
    copies = [a.copy() for a in given]
    learning(*given[:-1], learnt=given[-1])
    for one, other in zip(given, copies, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_series_that_is_refused_is_nan_from_there_on_and_leaves_the_others_alone():
    problem, zs = problem_and_series((2, 1, 0))
    zs = np.where(np.isnan(zs), 0.5, zs)
    H = np.tile(problem.H, (SERIES, N, 1, 1))
    R = np.tile(problem.R, (SERIES, N, 1, 1))
    F = np.tile(problem.F, (SERIES, N, 1, 1))
    F[1, 20] *= 1e200
    model = (F, H, problem.Q, R, problem.x[:, 0], problem.P)
    with np.errstate(over="ignore", invalid="ignore"):
        with pytest.raises(ValueError, match=r"^series 1, step 20: predict"):
            learning(zs, *model)
        for keep, row in ((1, 20), (4, 5), ("last", 0)):
            found = learning(zs, *model, refused="nan", keep=keep)
            for column in (found.x, found.P, found.weights, found.outlier_probability, found.process_scale):
                assert np.isnan(column[1, row:]).all() and not np.isnan(column[1, :row]).any()
            np.testing.assert_array_equal(np.isnan(found.log_likelihood), [False, True, False])
            for name in ("means", "covariances", "x", "P"):
                ends = found.state[name].reshape(SERIES, -1)
                np.testing.assert_array_equal(np.isnan(ends).all(axis=1), [False, True, False])
    rows = [0, 2]
    alone = learning(zs[rows], F[rows], H[rows], problem.Q, R[rows], *model[4:], keep="last")
    for name in found._fields[:-1]:
        np.testing.assert_allclose(getattr(found, name)[rows], getattr(alone, name), rtol=1e-10)
    # What it had learnt until then is what it keeps.
    before = learning(zs[1:2, :20], F[1:2, :20], H[1:2, :20], problem.Q, R[1:2, :20], *model[4:])
    np.testing.assert_allclose(found.state["learnt"][1], before.state["learnt"][0], rtol=1e-10)


@pytest.mark.parametrize("spoil", ["x0", "P0"])
def test_a_start_that_is_not_finite_is_refused(spoil):
    problem, zs = problem_and_series()
    start = {"x0": np.tile(problem.x[:, 0], (SERIES, 1)), "P0": np.tile(problem.P, (SERIES, 1, 1))}
    start[spoil][2] = np.nan
    with pytest.raises(ValueError, match="series 2, step 0: "):
        learning(zs, *arguments(problem)[:4], **start)
    found = learning(zs, *arguments(problem)[:4], **start, refused="nan")
    assert np.isnan(found.x[2]).all() and not np.isnan(found.x[:2]).any()


def test_a_certain_state_and_sensor_are_refused_by_name():
    with pytest.raises(SingularInnovationError, match="series 0, step 0: "):
        learning(np.ones((1, 3, 1)), np.eye(1), np.eye(1), np.zeros((1, 1)), np.zeros((1, 1)), [0.0], [[0.0]])


@pytest.mark.parametrize("change, match", [
    ({"zs": np.zeros((2, 3))}, r"zs: expected shape .*zs\[:, :, None\]"),
    ({"R": -np.eye(2)}, "R: expected a positive semidefinite"),
    ({"Q": np.diag([1.0, 1.0, -1e-3])}, "^Q: expected variances >= 0"),
    ({"Q": np.array([np.diag([1.0, 1.0, k - 23.5]) for k in range(N)][::-1])}, "^Q\\[0, 1\\]: expected variances >= 0"),
    ({"keep": "some"}, "keep"),
    ({"covariance": "half"}, "covariance"),
    ({"grouping": "together"}, "grouping"),
    ({"process": "scale"}, "process"),
    ({"influence": Huber(2.0)}, "influence: expected none with noise="),
    ({"noise": None}, "process: expected None without noise="),
    ({"noise": None, "process": None, "learnt": np.ones((2, 30))}, "learnt: expected none"),
    ({"noise": Contaminated(), "learnt": np.ones((2, 30))}, "learnt: expected none"),
    ({"n_threads": 0}, "n_threads"),
    ({"learnt": np.ones((2, 3))}, "learnt: expected shape"),
    ({"learnt": np.ones((5, 2, 30))}, "learnt: expected an entry for each of the 3 series, got 5"),
])  # fmt: skip
def test_refusals_say_what_was_expected(change, match):
    problem, zs = problem_and_series()
    call = dict(zip(["F", "H", "Q", "R", "x0", "P0"], arguments(problem), strict=True), zs=zs)
    with pytest.raises(ValueError, match=match):
        learning(**{**call, **change})


@pytest.mark.parametrize("shape", [(0, 7, 2), (4, 0, 2)])
def test_of_nothing_comes_nothing(shape):
    problem, _ = problem_and_series()
    found = learning(np.zeros(shape), *arguments(problem))
    assert found.x.shape == (*shape[:2], 3) and found.P.shape == (*shape[:2], 3, 3)
    assert found.state["learnt"].shape == (shape[0], *NoiseClasses().start(2).shape)


@pytest.mark.parametrize(
    "options", [{"scaling": "learnt"}, {"noise": "learnt", "process": "scales"}, {"noise": Contaminated()}]
)
def test_a_live_filter_goes_on_where_a_series_has_ended(options):
    problem, zs = problem_and_series()
    half = filter_series(zs[:, : N // 2], *arguments(problem), **options)
    whole = filter_series(zs, *arguments(problem), **options)
    for s in range(SERIES):
        kf = support.make(RobustKalmanFilter, problem, 1, **options)
        kf.restore({name: values[s] for name, values in half.state.items()})
        kf.batch_filter(zs[s, N // 2 :])
        np.testing.assert_allclose(kf.x, whole.x[s, -1], rtol=1e-8, atol=1e-10)


def test_psi_goes_on_from_a_state_too():
    problem, zs = problem_and_series()
    first = filter_series(zs[:, :10], *arguments(problem))
    later = filter_series(zs[:, 10:], *arguments(problem)[:4], state=first.state)
    np.testing.assert_allclose(later.x, filter_series(zs, *arguments(problem)).x[:, 10:], rtol=1e-10, atol=1e-12)
