"""The nonlinear filters: filterpy's without a threshold, the linear filter's on a linear model, under every policy."""

import copy

import numpy as np
import pytest
from filterpy.common import Saver
from filterpy.kalman import (
    CubatureKalmanFilter,
    ExtendedKalmanFilter,
    JulierSigmaPoints,
    MerweScaledSigmaPoints,
    UnscentedKalmanFilter,
)
from support import (
    FILTERPY_2,
    RECOVERING,
    assert_same_contents,
    contents,
    load,
    of_matrices,
    polar,
    polar_jacobian,
    predict_and_update,
    random_problem,
    simulate,
    with_,
    wrapped,
)

from robust_filterpy import Huber, RobustKalmanFilter
from robust_filterpy.correction import NotPositiveDefiniteError, Scales
from robust_filterpy.filters import RobustCubatureKalmanFilter, RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter
from robust_filterpy.influence import Linear

pytestmark = pytest.mark.core
DT = 0.1
F = np.kron(np.eye(2), [[1.0, DT], [0.0, 1.0]])
Q = np.kron(np.eye(2), [[DT**3 / 3, DT**2 / 2], [DT**2 / 2, DT]])
R = np.diag([0.25, 1e-4])
EAST = np.array([30.0, -2.0, 20.0, 1.0])
PLAIN = {
    RobustExtendedKalmanFilter: ExtendedKalmanFilter,
    RobustUnscentedKalmanFilter: UnscentedKalmanFilter,
    RobustCubatureKalmanFilter: CubatureKalmanFilter,
}
EVERY_CLASS = pytest.mark.parametrize("cls", PLAIN)
ADAPTIVE, TRUSTING = {"noise": "learnt"}, {"noise": "learnt", "process": "given"}
POLICIES = {"bounded": {}, "recovering": RECOVERING, "learnt": TRUSTING, "adaptive": ADAPTIVE}
EVERY = ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "y", "S", "SI", "K", "log_likelihood", "mahalanobis")


def straight(x, dt):
    return F @ x


def made(cls, n, m, fx, hx, points=None, **options):
    """Return a filter of any of the kinds, filterpy's too."""
    if issubclass(cls, ExtendedKalmanFilter):
        return cls(n, m, **options)
    points = (points or MerweScaledSigmaPoints(n, 0.5, 2.0, 3.0 - n),) if issubclass(cls, UnscentedKalmanFilter) else ()
    return cls(n, m, DT, hx, fx, *points, **options)


def radar(cls, ndim=1, **options):
    """A filter of a target in the plane, of its range and bearing."""
    kf = made(cls, 4, 2, straight, polar, **options)
    kf.residual_z = wrapped
    kf.x = np.reshape(EAST, (4,) if ndim == 1 else (4, 1)).copy()
    kf.P, kf.Q, kf.R = np.diag([4.0, 1.0, 4.0, 1.0]), Q, R
    if isinstance(kf, ExtendedKalmanFilter):
        kf.F = F.copy()
    return kf


def returns(steps, seed, contamination=0.0):
    """Radar returns of a target, shape (n, 2)."""
    rng = np.random.default_rng(seed)
    x, zs = EAST.copy(), np.empty((steps, 2))
    for k in range(steps):
        x = F @ x + np.linalg.cholesky(Q) @ rng.normal(size=4)
        zs[k] = polar(x) + np.sqrt(np.diag(R)) * rng.normal(size=2) * np.where(rng.random(2) < contamination, 20.0, 1.0)
    return zs


def correct(kf, z, **call):
    """Update any of the kinds."""
    if isinstance(kf, ExtendedKalmanFilter):
        kf.update(z, polar_jacobian, polar, residual=wrapped, **call)
    else:
        kf.update(z, **call)


def run(kf, zs):
    """Return x after each of the measurements."""
    xs = []
    for z in zs:
        kf.predict()
        correct(kf, z)
        xs.append(np.ravel(kf.x).copy())
    return np.array(xs)


@pytest.mark.pairwise
@EVERY_CLASS
@pytest.mark.parametrize("information", ["realized", "expected", "weight"])
@pytest.mark.parametrize("influence", [Linear(), Huber(np.inf)], ids=repr)
def test_equals_filterpy_for_infinite_threshold(cls, information, influence):
    ours = radar(cls, influence=influence, scaling="innovation", information=information)
    theirs, cubature = radar(PLAIN[cls]), cls is RobustCubatureKalmanFilter
    for z in returns(60, 1):
        ours.predict(), theirs.predict()
        correct(ours, z), correct(theirs, z[:, None] if cubature else z)
        for name in EVERY:
            if name == "mahalanobis" and cubature:
                continue  # filterpy's multiplies a column from the wrong side there
            a, b = getattr(ours, name), getattr(theirs, name, None)
            if b is None or (name in {"SI", "mahalanobis"} and not np.any(b)):
                continue  # 1.4.5's extended filter leaves SI at 0
            np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-10 * max(1.0, np.abs(b).max()), err_msg=name)
            assert np.shape(a) == np.shape(b), name


@pytest.mark.parametrize("residual_z", [np.subtract, wrapped, lambda a, b: np.subtract(a, b) / [1.0, 2.0]])
@pytest.mark.parametrize("points", [MerweScaledSigmaPoints(4, 0.1, 2.0, -1.0), JulierSigmaPoints(4, 0.5)])
def test_unscented_equals_filterpy_for_every_kind_of_points(points, residual_z):
    ours = radar(RobustUnscentedKalmanFilter, points=points, influence=Linear())
    theirs = radar(UnscentedKalmanFilter, points=points)
    for kf in (ours, theirs):  # where motion bends, the mean is not the middle point, whose weights differ
        kf.fx, kf.residual_z = lambda x, dt: F @ x + 0.05 * np.sin(x), residual_z
    np.testing.assert_allclose(run(ours, returns(50, 2)), run(theirs, returns(50, 2)), rtol=1e-9)
    np.testing.assert_allclose(ours.P, theirs.P, rtol=1e-8, atol=1e-12)


SOON = {**RECOVERING, "patience": 4}
LINEAR = {
    "bounded": {}, "joint": {"grouping": "joint"}, "expected": {"scaling": "innovation", "information": "expected"},
    "bounded scaling": {"scaling": "bounded", "information": "weight", "grouping": "joint"},
    "recovering": SOON, "recovering, joint": {**SOON, "grouping": "joint"},
    "recovering, weight": {**SOON, "information": "weight"},
    "learnt": TRUSTING, "learnt, joint": {**TRUSTING, "grouping": "joint"},
    "learnt, groups": {**TRUSTING, "grouping": ((0, 1),)}, "adaptive": ADAPTIVE,
}  # fmt: skip


@pytest.mark.skipif(not FILTERPY_2, reason="filterpy 1.4.5 corrects by sigma points without Q")
@pytest.mark.pairwise
@pytest.mark.parametrize("policy", LINEAR)
@pytest.mark.parametrize("dims", [(1, 1), (3, 2)])
@EVERY_CLASS
def test_on_a_linear_model_they_are_the_linear_filter(cls, dims, policy):
    options, dims = LINEAR[policy], (3, 3) if policy == "learnt, groups" else dims
    problem = random_problem(7, *dims)
    # Without Q, on which see below, a P that F shrinks would not stay definite.
    problem = with_(problem, F=0.99 * np.linalg.qr(problem.F)[0])
    zs, _ = simulate(problem, 80, seed=7, contamination=0.1)
    zs[30:] += problem.H @ np.full(dims[0], 40.0)
    zs[5, 0] = zs[9] = zs[33, 0] = np.nan
    if dims == (3, 2) and options.get("noise") is None and "patience" not in options:
        # A sensor that sees nothing of the state must not take part in the joint length.
        problem, dims = with_(problem, H=np.vstack([problem.H, np.zeros(3)]), R=np.diag([0.4, 0.5, 0.6])), (3, 3)
        zs = np.column_stack([zs, np.tile([0.0, 50.0], 40)])
    linear = RobustKalmanFilter(*dims, **options)
    load(linear, with_(problem, M=np.zeros(dims)))
    kf = made(cls, *dims, lambda x, dt: problem.F @ x, lambda x: problem.H @ x, **options)
    kf.x, kf.P, kf.Q, kf.R = np.ravel(problem.x).astype(float), problem.P.copy(), problem.Q.copy(), problem.R.copy()
    if cls is RobustExtendedKalmanFilter:
        kf.F = problem.F.copy()
    # filterpy's cubature filter corrects by the sigma points from before Q was added.
    if cls is RobustCubatureKalmanFilter:
        kf.Q = linear.Q = np.zeros_like(problem.Q)
    names = ["x", "P", "y", "S", "K", "weights", "T", "y_bounded", "log_likelihood"]
    if "noise" in options:
        names += ["learnt", "outlier_probability"]
    for z in zs:
        linear.predict(), kf.predict()
        linear.update(z)
        kf.update(z, *((lambda x: problem.H, lambda x: problem.H @ x) if cls is RobustExtendedKalmanFilter else ()))
        for name in names:
            ours, theirs = getattr(kf, name), getattr(linear, name)
            if name == "learnt" and options.get("grouping") != "joint":
                # What a nonlinear filter takes for readings are innovations.
                ours, theirs = ours[:, :-2], theirs[:, :-2]
            atol = 1e-9 * np.nanmax(np.abs(theirs), initial=1.0)
            np.testing.assert_allclose(np.ravel(ours), np.ravel(theirs), rtol=1e-6, atol=atol, err_msg=name)


@pytest.mark.parametrize("policy", POLICIES)
@EVERY_CLASS
def test_a_copy_and_a_batch_go_on_alike_and_what_is_refused_changes_nothing(cls, policy):
    zs = returns(150, 2)
    zs[50:, 0] += 15.0
    zs[55, 1], zs[57] = np.nan, np.nan
    rows = [*zs[:60], None, *zs[61:]]
    kf = radar(cls, **POLICIES[policy])
    run(kf, rows[:58])
    twin, before, good = copy.deepcopy(kf), contents(kf), zs[58]
    for bad in ([1.0, 2.0, 3.0], 1.0, [np.inf, 0.0], "ab"):
        with pytest.raises((ValueError, TypeError), match="z: expected"):
            correct(kf, bad)
    for bad in (np.eye(3), -1.0, np.array([[1.0, 2.0], [2.0, 1.0]]), "a"):
        with pytest.raises((ValueError, TypeError), match="R: expected"):
            correct(kf, good, R=bad)
    functions, last = ((polar_jacobian, polar), {"residual": wrapped}) if not hasattr(kf, "hx") else ((), {})
    with pytest.raises(ValueError, match=r"step 3: z: expected finite"):
        kf.batch_filter([*rows[58:61], [np.inf, 0.0]], *functions, **last)
    with pytest.raises(ValueError, match="Rs: expected an entry for each of the 92"):
        kf.batch_filter(rows[58:], *functions, Rs=[R] * 3, **last)
    with pytest.raises(TypeError, match="zs: expected a sequence"):
        kf.batch_filter(3.0, *functions, **last)
    assert_same_contents(contents(kf), before)
    saver = Saver(kf)
    means, covariances = kf.batch_filter(rows[58:], *functions, saver=saver, **last)
    assert len(saver) == 92
    if cls is RobustUnscentedKalmanFilter:
        assert kf.rts_smoother(means, covariances)[0].shape == means.shape
    np.testing.assert_array_equal(run(twin, rows[58:]), means)
    np.testing.assert_array_equal(twin.P, covariances[-1])


@pytest.mark.parametrize(("wrong", "most"), [
    (lambda kf: {"x": kf.x + np.array([12.0, 0.0, -12.0, 0.0])}, 0.6), (lambda kf: {"Q": 1e-3 * Q}, 0.6),
    (lambda kf: {name: 1e-4 * getattr(kf, name) for name in "PQR"}, 0.3),
], ids=["start", "Q", "P, Q, R"])  # fmt: skip
@pytest.mark.parametrize("cls", [RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter])
def test_a_wrong_start_and_wrong_covariances_are_learned(cls, wrong, most):
    # With process="given" a filter is off by 2 to 27 m.
    right = run(radar(PLAIN[cls]), returns(250, 3))
    for contamination in (0.0, 0.1):
        kf = radar(cls, **ADAPTIVE)
        for name, value in wrong(kf).items():
            setattr(kf, name, value)
        apart = (run(kf, returns(250, 3, contamination)) - right)[:, ::2]
        assert (apart**2).mean() < most**2


@EVERY_CLASS
def test_models_that_do_not_differ_are_one_where_motion_and_sensor_bend(cls):
    def swung(x, dt):
        return np.array([x[0] + DT * x[1], x[1] - 9.81 * DT * np.sin(x[0])])

    def seen(x):
        return np.array([np.sin(x[0])])

    filters = [
        made(cls, 2, 1, swung, seen, noise="learnt", process=process)
        for process in ("given", Scales((1.0, 1.0), jump=0.0))
    ]
    for kf in filters:
        kf.x, kf.P, kf.Q, kf.R = np.array([0.9, 0.0]), 0.2 * np.eye(2), 0.001 * np.eye(2), 0.01 * np.eye(1)
        kf.predict_x = lambda u=0, kf=kf: setattr(kf, "x", swung(kf.x, DT))
    for z in np.sin(1.2 * np.cos(0.3 * np.arange(60))) + 0.1 * np.random.default_rng(3).normal(size=60):
        for kf in filters:
            kf.F = np.array([[1.0, DT], [-9.81 * DT * np.cos(np.ravel(kf.x)[0]), 1.0]])
            kf.predict()
            bends = (lambda x: np.array([[np.cos(x[0]), 0.0]]), seen) if cls is RobustExtendedKalmanFilter else ()
            kf.update(np.array([z]), *bends)
        for name in ("x", "P", "learnt"):
            ours, theirs = (np.ravel(getattr(kf, name)) for kf in filters)
            if name == "learnt":
                # What is typical of a sensor is looked after where there is a scale of Q alone.
                ours, theirs = ours[:26], theirs[:26]
            np.testing.assert_allclose(ours, theirs, rtol=1e-7, atol=1e-10, err_msg=name)


def failing():
    """What fails: a filter, the error, and the call."""
    kinds = [radar(cls) for cls in PLAIN]
    for kf in kinds:
        run(kf, returns(5, 0))
    (extended, unscented, cubature), z = kinds, returns(1, 0)[0]
    for Hx in (lambda x: np.ones(3), lambda x: polar(x) * np.nan):
        yield extended, ValueError, lambda Hx=Hx: extended.update(z, polar_jacobian, Hx)
        yield extended, ValueError, lambda Hx=Hx: extended.predict_update(z, polar_jacobian, Hx)
    yield extended, ValueError, lambda: extended.update(z, lambda x: np.eye(2), polar)
    yield extended, ValueError, lambda: extended.update(z, polar_jacobian, polar, residual=lambda a, b: a[:1])
    yield unscented, ValueError, lambda: unscented.update(z, hx=lambda x: x * np.nan)
    yield unscented, ValueError, lambda: unscented.predict(fx=lambda x, dt: x * np.nan)
    yield unscented, ZeroDivisionError, lambda: unscented.predict(fx=lambda x, dt: 1 // 0)
    yield cubature, ValueError, lambda: cubature.update(z[:1])
    lost = radar(RobustExtendedKalmanFilter)
    lost.F = np.eye(4) * np.nan
    yield lost, ValueError, lost.predict
    for cls in (RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter):
        kf = radar(cls, scaling="unit")
        kf.P *= 1e4
        kf.predict()
        yield kf, NotPositiveDefiniteError, lambda kf=kf: correct(kf, polar(EAST))


def test_a_model_that_fails_changes_nothing():
    for kf, error, call in failing():
        before = contents(kf)
        with pytest.raises(error):
            call()
        assert_same_contents(contents(kf), before)


def test_extended_predict_update_predicts_then_corrects():
    ours, theirs = radar(RobustExtendedKalmanFilter, influence=Linear()), radar(ExtendedKalmanFilter)
    for z in returns(30, 8, contamination=0.1):
        ours.predict_update(z, polar_jacobian, polar)
        theirs.predict_update(z, polar_jacobian, polar)
        for name in ("x", "P", "y", "S", "K"):
            np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-9, atol=1e-12)
    x, P = ours.x.copy(), ours.P.copy()
    ours.predict_update(None, polar_jacobian, polar)
    np.testing.assert_allclose(ours.x, F @ x)
    np.testing.assert_allclose(ours.P, F @ P @ F.T + Q)


@pytest.mark.parametrize("ndim", [1, 2])
def test_rows_columns_and_numbers_mean_the_same(ndim):
    """As in filterpy's own example R of a call and what hx returns may be plain numbers."""
    z = returns(1, 0)[0] + [3.0, 0.1]
    reference = radar(RobustExtendedKalmanFilter)
    correct(reference, z)
    for shape in ((2,), (2, 1), (1, 2)):
        kf = radar(RobustExtendedKalmanFilter, ndim=ndim)
        correct(kf, z.reshape(shape))
        np.testing.assert_allclose(kf.x.ravel(), reference.x)
        assert kf.x.shape == ((4,) if ndim == 1 else (4, 1))
    given = {"P": 50.0, "x": [90.0, 1100.0]}
    numbers, arrays = (of_matrices(RobustExtendedKalmanFilter, 1.0, np.eye(1, 2), **given) for _ in "ab")
    for z in (1000.0, 1500.0):
        numbers.update(z, lambda x: x[None] / np.hypot(*x), lambda x: np.hypot(*x), R=2500.0)
        arrays.update(np.array([z]), lambda x: x[None] / np.hypot(*x), lambda x: np.hypot(*x)[None], R=[[2500.0]])
        np.testing.assert_array_equal(numbers.x, arrays.x)


@EVERY_CLASS
def test_arguments_reach_the_measurement_function(cls):
    z, kf = np.array([3.0, 4.0]), radar(cls, influence=Linear())
    kf.residual_z = np.subtract
    kf.predict()

    def hx(x, a, b):
        return a * np.ravel(x)[:2] + b

    if cls is RobustExtendedKalmanFilter:
        kf.update(z, lambda x, a: a * np.eye(2, 4), hx, args=2.0, hx_args=(2.0, 1))
    elif cls is RobustUnscentedKalmanFilter:
        kf.update(z, hx=hx, a=2.0, b=1)
    else:
        kf.hx = hx
        kf.update(z, hx_args=(2.0, 1))
    np.testing.assert_allclose(np.ravel(kf.y), z - 2.0 * np.ravel(kf.x_prior)[:2] - 1)


def test_unscented_moves_the_state_by_state_add():
    kf = radar(RobustUnscentedKalmanFilter, state_add=lambda x, dx: x + dx + [100.0, 0, 0, 0])
    plain = radar(RobustUnscentedKalmanFilter)
    for one in (kf, plain):
        run(one, [polar(EAST)])
    np.testing.assert_allclose(kf.x, plain.x + np.array([100.0, 0, 0, 0]))


@pytest.mark.parametrize("u", [np.array([0.3, -0.7]), np.zeros(2), [[0.3], [-0.7]]], ids=str)
def test_an_extended_filter_with_several_inputs_is_moved_by_all_of_them(u):
    p = random_problem(8, 3, 1, dim_u=2)
    kf = of_matrices(RobustExtendedKalmanFilter, p.F, p.H, p.Q, P=p.P, x=np.ravel(p.x), dim_u=2)
    kf.B = p.B
    kf.predict(u)
    np.testing.assert_allclose(kf.x, p.F @ np.ravel(p.x) + p.B @ np.ravel(u), rtol=1e-12)
    np.testing.assert_allclose(kf.P, p.F @ p.P @ p.F.T + p.Q, rtol=1e-12)


@pytest.mark.parametrize("column", [False, True])
@EVERY_CLASS
def test_refused_angles_agree_by_their_residual(cls, column):
    """A jump leads across the end of the turn, where readings lie on both sides."""
    extended = cls is RobustExtendedKalmanFilter

    def turned(a, b):
        # The cubature filter's predicted measurement is a column.
        assert cls is RobustCubatureKalmanFilter or np.shape(a) == np.shape(b) == np.shape(predicted(kf.x))
        return (a - b + np.pi) % (2 * np.pi) - np.pi

    def predicted(x):
        return np.reshape(np.ravel(x), (1, 1) if column and extended else (1,))

    # Points of a widened P have to lie within a turn.
    kf = made(cls, 1, 1, lambda x, dt: x, predicted, MerweScaledSigmaPoints(1, 0.1, 2.0, 2.0), **RECOVERING)
    kf.residual_z, kf.x = turned, np.full((1, 1) if column else 1, 1.0)
    kf.Q, kf.R = 1e-4 * np.eye(1), 0.01 * np.eye(1)
    functions = {"HJacobian": lambda x: np.eye(1), "Hx": predicted, "residual": turned} if extended else {}
    noise = 0.1 * np.random.default_rng(3).normal(size=60)
    for k in range(60):
        kf.predict()
        z = (noise[k] + (np.pi if k >= 20 else 1.0) + np.pi) % (2 * np.pi) - np.pi
        kf.update(z if extended else np.array([z]), **functions)
    assert abs(abs(kf.x.item()) - np.pi) < 0.2


def test_what_curvature_adds_to_the_innovation_is_no_noise():
    """A squared state that is hardly known: S is a hundred times R at most steps, ten with filterpy 1.4.5's points."""
    rng, x, excess = np.random.default_rng(10003), 0.0, []
    kf = of_matrices(RobustUnscentedKalmanFilter, 0.5, [[1.0]], 1.0, 0.04, noise="learnt")
    kf.hx = np.square
    for _ in range(1500):
        x = 0.5 * x + rng.normal()
        predict_and_update(kf, np.array([x**2 + 0.2 * rng.normal()]))
        excess.append(kf.S[0, 0] / 0.04)
    assert np.median(excess) > 10.0
    assert kf.R_learnt[0, 0] < 2.0 * 0.04


@pytest.mark.usefixtures("form")
def test_rounding_of_sigma_points_makes_independent_states_no_part_of_each_other():
    kf = of_matrices(RobustUnscentedKalmanFilter, np.diag([0.9, 1.1]), np.eye(2), noise="learnt")
    kf.P, kf.Q = np.diag([0.3, 0.7]), np.diag([0.1, 0.2])
    for z in np.random.default_rng(0).normal(size=(20, 2)):
        predict_and_update(kf, z)
        assert kf._kept.hypotheses.parts.tolist() == [0, 1]
