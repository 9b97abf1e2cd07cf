"""Many series are a loop over filters, whatever runs them and whatever is known of the noise."""

import numpy as np
import pytest
import support
from recordings import same

from robust_filterpy import Contaminated, Learnt, RobustKalmanFilter, StudentT, filter_series
from robust_filterpy.correction import NotPositiveDefiniteError, Scales, SingularInnovationError
from robust_filterpy.correction.learning import NoiseClasses
from robust_filterpy.influence import Hampel, Linear

SERIES, N = 3, 25
LEARNING = {"noise": "learnt", "process": "scales"}
EITHER = pytest.mark.parametrize("options", [{}, LEARNING], ids=["psi", "learnt noise"])


def problem_and_series(dims=(3, 2, 0)):
    problem = support.random_problem(8, *dims)
    problem = support.with_(problem, R=np.diag(problem.R.diagonal()))
    zs = np.array([support.simulate(problem, N, seed, contamination=0.15)[0] for seed in range(SERIES)])
    zs[np.random.default_rng(0).random(zs.shape) < 0.1] = np.nan
    zs[1, 4:6] = np.nan
    zs[2, 12:] += 40.0
    return problem, zs


def arguments(problem):
    return problem.F, problem.H, problem.Q, problem.R, problem.x[:, 0], problem.P


def by_filters(problem, zs, learnt=None, model=lambda s, k: {}, **options):
    """A loop over filters: what each shows at each step, by name."""
    names = ["x", "P", "weights", "log_likelihood"]
    names += ["outlier_probability", "process_scale"] if options.get("noise") is not None else []
    shown, states = {name: [] for name in names}, []
    for s, z in enumerate(zs):
        kf = support.load(RobustKalmanFilter(*problem.dims, **options), problem, 1)
        if learnt is not None:
            kf.learnt = learnt[s]
        for k, z_k in enumerate(z):
            given = model(s, k)
            kf.predict(F=given.get("F"), Q=given.get("Q"))
            kf.update(z_k, H=given.get("H"), R=given.get("R"))
            for name, column in shown.items():
                column.append(np.copy(getattr(kf, name)))
        states.append(kf.state())
    shown = {name: np.array(column).reshape(*zs.shape[:2], *column[0].shape) for name, column in shown.items()}
    return {**shown, "log_likelihood": shown["log_likelihood"].sum(axis=1), "state": states}


def assert_same(found, expected, rtol=1e-8):
    for name in set(expected) - {"state"}:
        np.testing.assert_allclose(getattr(found, name), expected[name], rtol=rtol, atol=1e-10, err_msg=name)
    for name, values in found.state.items():
        states = [state[name] for state in expected["state"]]
        np.testing.assert_allclose(values, states, rtol=rtol, atol=1e-10, err_msg=name)


OPTIONS = {
    "default": {}, "recovering": {**support.RECOVERING, "patience": 4}, "innovation": {"scaling": "innovation"},
    "joint": {"influence": StudentT(3), "scaling": "bounded", "grouping": "joint"},
    "hampel": {"influence": Hampel(), "scaling": "innovation", "information": "weight"},
    "linear": {"influence": Linear(), "scaling": "bounded", "information": "expected"},
    "learnt noise": LEARNING, "learnt noise, joint": {**LEARNING, "grouping": "joint"},
    "learnt noise, groups": {**LEARNING, "grouping": ((0, 1),)},
    "other classes": {"noise": Learnt((1.0, 30.0), 50.0, 10.0), "process": Scales((1.0, 0.1), dwell=20.0)},
    "a process as given": {"noise": "learnt", "process": "given"},
    "a noise that is given": {"noise": Contaminated(0.1, 10.0), "process": Scales((1.0, 10.0), jump=1e-6)},
    "both given": {"noise": Contaminated(0.1, 10.0), "process": Contaminated(0.05, 20.0)},
    "given, and a process as given": {"noise": Contaminated(0.1, 10.0)},
    "nothing contaminated": {"noise": Contaminated(0.0)},
}  # fmt: skip


@pytest.mark.parametrize("options", OPTIONS.values(), ids=OPTIONS)
def test_series_are_a_loop_over_filters(options, form):
    problem, zs = problem_and_series()
    correlated = support.with_(problem, R=problem.R + 0.1)
    for one in (problem, correlated) if options in ({}, LEARNING) else (problem,):
        whole = filter_series(zs, *arguments(one), **options)
        assert_same(whole, by_filters(one, zs, **options))
    # And however they are cut, to the last bit.
    state = filter_series(zs[:, :13], *arguments(one), **options).state
    rest = filter_series(zs[:, 13:], *arguments(one)[:4], state=state, **options)
    for name in ("x", "P", "weights"):
        np.testing.assert_array_equal(getattr(rest, name), getattr(whole, name)[:, 13:])
    same(rest.state, whole.state)


@EITHER
def test_each_series_may_have_its_own_matrices_at_each_step(options, form):
    problem, zs = problem_and_series()
    rng = np.random.default_rng(1)
    F = np.array([[support.stable(rng, 3) for _ in range(N)] for _ in range(SERIES)])
    Q = np.array([support.spd(rng, 3) for _ in range(N)])
    H = rng.normal(size=(SERIES, 1, 2, 3))
    H[1, 0, 0] = 0.0
    R = np.array([[np.diag(rng.uniform(0.5, 2.0, 2)) for _ in range(N)] for _ in range(SERIES)])
    x0, P0 = rng.normal(size=(SERIES, 3)), np.array([support.spd(rng, 3) for _ in range(SERIES)])
    found = filter_series(zs, F, H, Q, R, x0, P0, **options)
    for s in range(SERIES):
        own = support.with_(problem, x=x0[s][:, None], P=P0[s])
        matrices = lambda _, k, s=s: {"F": F[s, k], "Q": Q[k], "H": H[s, 0], "R": R[s, k]}  # noqa: E731
        expected = by_filters(own, zs[s : s + 1], model=matrices, **options)
        for name in set(expected) - {"state"}:
            np.testing.assert_allclose(getattr(found, name)[s], expected[name][0], rtol=1e-8, atol=1e-10, err_msg=name)


def test_what_was_learnt_is_passed_on_and_arguments_are_left_alone():
    problem, zs = problem_and_series()
    learnt = filter_series(zs, *arguments(problem), **LEARNING).state["learnt"]
    given = [zs, *arguments(problem), learnt]
    before = [array.copy() for array in given]
    again = filter_series(zs, *arguments(problem), learnt=learnt, **LEARNING)
    assert_same(again, by_filters(problem, zs, learnt=learnt, **LEARNING))
    shared = filter_series(zs, *arguments(problem), learnt=learnt[1], **LEARNING)
    assert_same(shared, by_filters(problem, zs, learnt=[learnt[1]] * SERIES, **LEARNING))
    assert np.abs(again.x - by_filters(problem, zs, **LEARNING)["x"]).max() > 1e-3
    same(given, before)


def test_a_state_is_not_written_into_and_a_refused_series_stays_refused():
    problem, zs = problem_and_series()
    state = filter_series(zs, *arguments(problem), **LEARNING).state
    before = {name: array.copy() for name, array in state.items()}
    spoilt = {**state, "x": state["x"].copy()}
    spoilt["x"][1] = np.nan
    spoilt["means"][1] = np.nan
    found = filter_series(zs, *arguments(problem)[:4], state=spoilt, refused="nan", **LEARNING)
    assert np.isnan(found.x[1]).all() and np.isnan(found.state["x"][1]).all() and np.isfinite(found.x[[0, 2]]).all()
    state["means"][1] = before["means"][1]
    same(state, before)


def test_a_state_that_does_not_fit_is_refused():
    problem, zs = problem_and_series()
    state, model = filter_series(zs, *arguments(problem), **LEARNING).state, arguments(problem)[:4]
    for change, error, words in (
        ({"x0": np.zeros(3), "P0": np.eye(3)}, ValueError, r"none of x0, P0, `?learnt`?"),
        ({"state": state["learnt"]}, TypeError, "state: expected what filter_series"),
        ({"process": Scales((1.0,))}, ValueError, r"state\['means'\]: expected shape"),
        ({"process": "given"}, ValueError, "state: expected x, P, learnt in it, got x, P, means"),
        ({"noise": None, "process": None}, ValueError, "state: expected x, P, spread in it"),
        ({"state": {**state, "belief": 2.0 * state["belief"]}}, ValueError, r"state\['belief'\]: .* sum to 1"),
        ({"state": {**state, "learnt": -state["learnt"]}}, ValueError, "learnt: expected"),
        ({"state": None}, ValueError, "x0"),
    ):
        with pytest.raises(error, match=words):
            filter_series(zs, *model, **{"state": state, **LEARNING, **change})


@EITHER
def test_threads_and_what_is_kept_change_nothing(options, form):
    problem, zs = problem_and_series()
    whole = filter_series(zs, *arguments(problem), **options)
    last = filter_series(zs, *arguments(problem), keep="last", covariance="diagonal", n_threads=1, **options)
    some = filter_series(zs, *arguments(problem), keep=7, covariance="none", n_threads=3, **options)
    np.testing.assert_array_equal(last.x, whole.x[:, -1:])
    np.testing.assert_array_equal(last.P, np.diagonal(whole.P[:, -1:], axis1=2, axis2=3))
    assert some.P is None
    for name in ("x", "weights", *(("outlier_probability", "process_scale") if options else ())):
        np.testing.assert_array_equal(getattr(some, name), getattr(whole, name)[:, 6::7])
    np.testing.assert_array_equal(some.log_likelihood, whole.log_likelihood)
    same(some.state, whole.state)


@EITHER
def test_a_series_that_is_refused_is_nan_from_there_on_and_leaves_the_others_alone(options, form):
    problem, zs = problem_and_series((2, 1, 0))
    zs, F = np.where(np.isnan(zs), 0.5, zs), np.tile(problem.F, (SERIES, N, 1, 1))
    F[1, 20] *= 1e200
    model = (problem.H, problem.Q, problem.R, problem.x[:, 0], problem.P)
    with np.errstate(over="ignore", invalid="ignore"):
        with pytest.raises(ValueError, match=r"series 1, step 20: predict"):
            filter_series(zs, F, *model, **options)
        for keep, row in ((1, 20), (4, 5), (7, 2), ("last", 0)):
            found = filter_series(zs, F, *model, refused="nan", keep=keep, **options)
            columns = (found.x, found.P, found.weights)
            for column in (*columns, found.outlier_probability, found.process_scale) if options else columns:
                assert np.isnan(column[1, row:]).all() and not np.isnan(column[1, :row]).any()
                assert not np.isnan(column[[0, 2]]).any()
            np.testing.assert_array_equal(np.isnan(found.log_likelihood), [False, True, False])
            for name in ("means", "covariances", "x", "P") if options else ("x", "P"):
                ends = found.state[name].reshape(SERIES, -1)
                np.testing.assert_array_equal(np.isnan(ends).all(axis=1), [False, True, False])
    alone = filter_series(zs[[0, 2]], F[[0, 2]], *model, keep="last", **options)
    for name in [name for name in alone._fields[:-1] if getattr(alone, name) is not None]:
        np.testing.assert_allclose(getattr(found, name)[[0, 2]], getattr(alone, name), rtol=1e-10)
    # What it had learnt until then is what it keeps.
    before = filter_series(zs[1:2, :20], F[1:2, :20], *model, **options)
    name = "learnt" if options else "spread"
    np.testing.assert_allclose(found.state[name][1], before.state[name][0], rtol=1e-10)


def test_a_series_whose_covariance_would_be_indefinite_is_named(form):
    P0 = np.tile(0.1 * np.eye(2), (3, 1, 1))
    P0[2] *= 1e4
    model = (np.zeros((3, 5, 1)), np.eye(2), np.eye(1, 2), 1e-3 * np.eye(2), np.eye(1), np.zeros(2), P0)
    with pytest.raises(NotPositiveDefiniteError, match=r"series 2, step 0: scaling"):
        filter_series(*model, scaling="unit")
    found = filter_series(*model, scaling="unit", refused="nan")
    np.testing.assert_array_equal(np.isnan(found.x).all(axis=(1, 2)), [False, False, True])
    nothing, scaling = np.zeros((1, 1)), {"scaling": "innovation"}
    for options in (LEARNING, scaling, {**scaling, "grouping": ((0,),)}):
        with pytest.raises(SingularInnovationError, match="series 0, step 0: "):
            filter_series(np.ones((1, 3, 1)), np.eye(1), np.eye(1), nothing, nothing, [0.0], nothing, **options)


@pytest.mark.parametrize("change, match", [
    ({"zs": np.zeros((2, 3))}, r"zs: expected shape .*zs\[:, :, None\].*zs\[None\]"),
    ({"zs": np.zeros((2, 3, 0))}, "zs: expected dim_z >= 1"),
    ({"zs": np.full((1, 2, 2), np.inf)}, "zs: expected finite"),
    ({"x0": np.zeros((3, 1))}, r"x0: expected shape .* got \(3, 1\); use x0.ravel"),
    ({"x0": 0.0}, "x0: expected shape"),
    ({"x0": np.zeros(0), "P0": np.zeros((0, 0))}, "x0: expected dim_x >= 1"),
    ({"Q": np.eye(3) + 0.1 * np.eye(3, k=1)}, "Q: expected a symmetric"),
    ({"P0": np.eye(2)}, "P0: expected shape"), ({"F": np.full((3, 3), np.inf)}, "F: expected finite"),
    ({"R": 5.0}, "R: expected shape"),
    ({"R": -np.eye(2)}, "R: expected a positive semidefinite"),
    ({"R": np.tile(np.eye(2), (3, N, 1, 1)) * np.where(np.arange(3 * N) == 57, -0.1, 1.0).reshape(3, N, 1, 1)},
     r"R\[2, 7\]: expected a positive semidefinite matrix"),
    ({"Q": np.diag([1.0, 1.0, -1e-3])}, "^Q: expected variances >= 0"),
    ({"keep": 0}, "keep"),
    ({"covariance": "half"}, "covariance"),
    ({"F": 1e200 * np.eye(3)}, "step 0: predict"),
    ({"Q": np.array([np.diag([1.0, 1.0, k - 23.5]) for k in range(N)][::-1]), **LEARNING},
     "^Q\\[0, 1\\]: expected variances >= 0"),
    ({"process": "scales"}, "process: expected None or 'given' without noise="),
    ({"learnt": np.ones((2, 30))}, "learnt: expected none"),
    ({"noise": Contaminated(), "learnt": np.ones((2, 30))}, "learnt: expected none"),
    ({**LEARNING, "n_threads": 0}, "n_threads"),
    ({**LEARNING, "learnt": np.ones((2, 3))}, "learnt: expected shape"),
    ({**LEARNING, "learnt": np.ones((5, 2, 30))}, "learnt: expected an entry for each of the 3 series, got 5"),
])  # fmt: skip
def test_refusals_say_what_was_expected(form, change, match):
    problem, zs = problem_and_series()
    call = dict(zip(["F", "H", "Q", "R", "x0", "P0"], arguments(problem), strict=True), zs=zs)
    with pytest.raises(ValueError, match=match):
        filter_series(**{**call, **change})


@EITHER
@pytest.mark.parametrize("shape", [(0, 7, 2), (4, 0, 2), (0, 0, 2)])
def test_of_nothing_comes_nothing(form, shape, options):
    problem, _ = problem_and_series()
    found = filter_series(np.zeros(shape), *arguments(problem), **options)
    assert found.x.shape == (*shape[:2], 3) and found.P.shape == (*shape[:2], 3, 3)
    np.testing.assert_array_equal(found.log_likelihood, np.zeros(shape[0]))
    assert not options or found.state["learnt"].shape == (shape[0], *NoiseClasses().start(2).shape)
