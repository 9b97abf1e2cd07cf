"""A filter's step by the kernel is the definition's, and what the kernel declines it leaves alone."""

from functools import partial

import numpy as np
import pytest
import support
from hostile import Sub
from support import assert_alike, shown

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import Scales
from robust_filterpy.filters import shell
from robust_filterpy.influence import Hampel, Linear

support.needs_kernel()

INFLUENCES = (Huber(), Linear(), Hampel(), TukeyBiweight(), StudentT())
EXTENSION = shell._extension
#: Nothing is passed for this call.
NONE = (None,) * 4
MOVES, SEES = [[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0]]


def before_and_after(kf, call):
    """What a call that the kernel declines has changed."""
    before = {name: getattr(kf, name) for name in ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "z", "_last")}
    contents = {name: np.copy(value) for name, value in before.items() if isinstance(value, np.ndarray)}
    outcome = call()
    same = all(getattr(kf, name) is value for name, value in before.items())
    same = same and all(before[name].tobytes() == value.tobytes() for name, value in contents.items())
    return outcome, same


SENSOR_BY_SENSOR = [
    ("component", scaling, information)
    for scaling in ("learnt", "innovation", "bounded", "unit")
    for information in ("realized", "expected", "weight")
]
AS_ONE = [
    ("joint", scaling, information) for scaling in ("learnt", "innovation") for information in ("realized", "weight")
]


def walked(problem, zs, ndim, options):
    """What a filter shows after each step of a recording with an input, and how many corrections are the kernel's."""
    kf, rows, served = support.make(RobustKalmanFilter, problem, ndim, **options), [], 0
    kf.B = np.ones((len(kf.x), 1))
    for k, z in enumerate(zs):
        if k == 10 and options["scaling"] != "unit":
            # From outside.
            kf.x = kf.x + 1.0
        kf.predict(0.1)
        kf.update(z)
        served += type(kf._last) is np.ndarray
        rows.append(shown(kf, "_memory") | {"information": kf._arrays().information})
    return rows, served


@pytest.mark.pairwise
@pytest.mark.parametrize(("grouping", "scaling", "information"), SENSOR_BY_SENSOR + AS_ONE)
@pytest.mark.parametrize("influence", INFLUENCES, ids=lambda f: type(f).__name__)
def test_a_step_is_the_definition(both, influence, grouping, scaling, information):
    """Recordings of several sizes, with outliers and gaps."""
    options = {"influence": influence, "scaling": scaling, "information": information, "grouping": grouping}
    draw, taken = support.random_problem if scaling != "unit" else lambda seed, n, m: support.mild(n, m, seed), 0
    for seed, (n, m) in enumerate(((1, 1), (2, 1), (4, 2), (3, 4), (7, 3))):
        problem = draw(seed, n, m)
        zs, _ = support.simulate(problem, 25, seed, 0.15, 20.0)
        # Sensors of every other problem are read in coarse steps, so that readings repeat.
        zs = np.round(zs) if seed % 2 else zs
        zs[np.random.default_rng(seed).random(zs.shape) < 0.1] = np.nan
        (ours, served), (theirs, _) = both(partial(walked, problem, zs, 1 + seed % 2, options))
        # After a jump that was believed P is a million times what is left of it.
        rtol = 1e-10 if scaling == "learnt" else 1e-11
        assert_alike(ours, theirs, rtol, {"_memory": 1e-9, "information": 1e-6})
        taken += served
    assert taken > 60


@pytest.mark.parametrize("information", ["realized", "weight"])
@pytest.mark.parametrize("grouping", ["component", "joint"])
def test_a_correction_with_the_gain_as_it_stands_is_the_definition(both, grouping, information):
    zs = np.random.default_rng(3).normal(size=(60, 2))
    zs[25] += 30.0

    def steps():
        options = {"grouping": grouping, "information": information}
        kf = support.mover(lambda n, m: RobustKalmanFilter(n, m, **options), H=[[1.0, 0.0], [1.0, 1.0]], q=0.01)
        for k, z in enumerate(zs):
            # From the 19th on S is that of the last correction, not H P H' + R.
            kf.predict_steadystate() if k > 19 else kf.predict()
            kf.update_steadystate(z) if k > 18 else kf.update(z)
        return [shown(kf, "_memory")]

    assert_alike(*both(steps), 1e-10, {"_memory": 1e-9})


@pytest.mark.parametrize("scaling", ["learnt", "innovation"])
def test_among_sensors_that_fail_together_one_that_sees_no_state_is_judged_alone(both, by_kernel_alone, scaling):
    problem = support.random_problem(3, 3, 4)
    zs = np.random.default_rng(4).normal(size=(30, 4)) * np.where(np.arange(30)[:, None] % 5, 1.0, 20.0)
    filters = []

    def steps():
        filters.append(support.make(RobustKalmanFilter, problem, 1, scaling=scaling, grouping="joint"))
        kf, rows = filters[-1], []
        kf.H = np.where(np.arange(4)[:, None] == 2, 0.0, problem.H)
        kf.R = np.diag(problem.R.diagonal())
        for z in zs:
            kf.predict()
            kf.update(z)
            # Where nothing is seen of the state, only this tells how it was judged.
            rows.append(shown(kf) | {"information": kf._arrays().information})
        return rows

    assert_alike(*both(steps), 1e-9, {"information": 1e-6})
    # What it says about the others the kernel cannot tell.
    kf = filters[0]
    kf.R = kf.R + 0.1
    assert before_and_after(kf, lambda: EXTENSION.correct(kf, zs[0], None, None, None)) == (False, True)


@pytest.mark.parametrize("sensors, served", [(16, True), (17, False)])
def test_so_many_sensors_that_fail_together_are_the_kernels_and_more_the_definitions(sensors, served):
    kf = RobustKalmanFilter(1, sensors, grouping="joint")
    kf.H = np.ones((sensors, 1))
    found = before_and_after(kf, lambda: EXTENSION.correct(kf, np.ones(sensors), None, None, None))
    assert found == (served, not served)


@pytest.mark.parametrize("grouping", ["component", "joint"])
def test_a_first_reading_that_is_exactly_as_predicted_is_the_kernels(grouping):
    """Of its noise nothing is known then, not even a spread."""
    kf = RobustKalmanFilter(2, 2, grouping=grouping)
    kf.H = np.eye(2)
    assert before_and_after(kf, lambda: EXTENSION.correct(kf, np.zeros(2), None, None, None)) == (True, False)
    assert kf.x.tolist() == [[0.0], [0.0]] and kf.P == pytest.approx(0.5 * np.eye(2))


@pytest.mark.parametrize("n", [1, 3, 4, 5, 7, 8, 9, 11, 12, 13])
def test_states_of_every_number_are_predicted(n):
    """The kernel takes four columns at a time where there are some, and four rows of more than eight states."""
    problem = support.random_problem(n, n, 1)
    kf = support.make(RobustKalmanFilter, problem, 1)
    assert EXTENSION.predict(kf, *NONE, None)
    np.testing.assert_allclose(kf.x, problem.F @ np.ravel(problem.x), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(kf.P, problem.F @ problem.P @ problem.F.T + problem.Q, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("process", ["scales", None, Scales((1.0, 10.0), jump=0.0)], ids=["jumps", "one", "no jumps"])
def test_what_a_correction_under_learnt_noise_leaves_cannot_be_changed_from_outside(process):
    options = {"noise": "learnt", "process": process}
    one, two = (support.make(RobustKalmanFilter, support.random_problem(1, 3, 2), **options) for _ in range(2))
    for kf in (one, two):
        kf.predict()
        kf.update([1.0, 2.0])
    y = two.y.copy()
    for name in ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "z", "H", "R"):
        getattr(one, name)[...] = 7.0
    np.testing.assert_array_equal(one.y, y)
    np.testing.assert_array_equal(one.process_probabilities, two.process_probabilities)


KINDS = {
    "int64": lambda a: np.round(a).astype(np.int64), "uint8": lambda a: a.astype(np.uint8),
    "float32": lambda a: a.astype(np.float32), "float16": lambda a: a.astype(np.float16),
    "column by column": np.asfortranarray, "every second": lambda a: np.repeat(a, 2, axis=-1)[..., ::2],
    "other bytes": lambda a: a.astype(">f8"),
}  # fmt: skip
SPOILT = {
    **{kind: KINDS[kind] for kind in ("int64", "float32", "other bytes", "every second")},
    "a subclass": lambda a: a.view(Sub), "a list": lambda a: a.tolist(), "one axis more": lambda a: a[None],
    "one row less": lambda a: a[:-1], "None": lambda a: None, "an object": lambda a: object(),
    "NaN": lambda a: np.full_like(a, np.nan), "infinity": lambda a: np.full_like(a, np.inf),
    "objects": lambda a: a.astype(object), "empty": lambda a: np.empty((0, 0)),
}  # fmt: skip


# Of these matrices it makes float64: see the tests of kinds below.
MADE_PLAIN = [(name, how) for name in "FQHR" for how in KINDS]


@pytest.mark.parametrize("how", SPOILT)
@pytest.mark.parametrize("name", ["x", "P", "F", "Q", "H", "R", "_memory", "_kept"])
@pytest.mark.parametrize("noise", [False, True], ids=["psi", "mixture"])
def test_what_is_out_of_the_ordinary_is_declined_and_nothing_changes(noise, name, how):
    options = {"noise": "learnt", "process": "scales"} if noise else {"scaling": "learnt"}
    kf = support.make(RobustKalmanFilter, support.random_problem(1, 3, 2), **options)
    kf.predict()
    kf.update([1.0, 2.0])
    if name != "_kept":
        setattr(kf, name, SPOILT[how](getattr(kf, name)))
    elif noise:
        kf._kept = kf._kept._replace(means=SPOILT[how](kf._kept.means))
    predict, correct = EXTENSION.predict, EXTENSION.correct
    for call in (lambda: predict(kf, *NONE, True), lambda: correct(kf, [1.0, 2.0], *NONE[1:])):
        outcome, same = before_and_after(kf, call)
        assert outcome is True or same
    # One of the two reads each of them.
    both = predict(kf, *NONE, True) and correct(kf, [1.0, 2.0], *NONE[1:])
    assert not both or name == "_kept" or (name, how) in MADE_PLAIN


MEASUREMENTS = (
    None, "x", [1.0], [1.0, None], [1.0, "2"], [np.inf, 1.0], [np.nan, np.nan], np.ones(3), np.ones((2, 2)), object(),
    10**400, [10**400, 1.0], np.ma.masked_array([1.0, 2.0]), np.ones(2, dtype="m8[s]"),
    [np.timedelta64(1), 1.0], np.ones(2, dtype=bool), np.ones(2, dtype=complex), (1.0,),
)  # fmt: skip


@pytest.mark.parametrize("z", MEASUREMENTS, ids=range(len(MEASUREMENTS)))
def test_a_measurement_out_of_the_ordinary_is_declined(z):
    kf = support.make(RobustKalmanFilter, support.random_problem(1, 3, 2))
    kf.update([1.0, 2.0])
    assert before_and_after(kf, lambda: EXTENSION.correct(kf, z, None, None, None)) == (False, True)


@pytest.mark.parametrize("R, served", [(1e-6, True), (1e-9, True), (1e-11, True), (1e-15, False)])
def test_a_sensor_that_repeats_another_is_taken_until_what_is_left_of_it_is_rounding(R, served):
    """After the first of two sensors of the same the other's variance is 2 R of 1 + R: served down to 1e-13 of it."""
    kf = RobustKalmanFilter(1, 2, scaling="innovation")
    kf.H, kf.R = np.ones((2, 1)), R * np.eye(2)
    (taken, same) = before_and_after(kf, lambda: kf._correct_by_kernel(np.array([0.5, 0.5]), None, None, None))
    assert taken == served and same == (not served)
    if served:
        np.testing.assert_allclose(kf.x, 1.0 / (2.0 + R), rtol=1e-4)
        np.testing.assert_allclose(kf.P, R / (2.0 + R), rtol=1e-4)


def assert_the_same_to_the_bit(plain, other, readings, **inputs):
    """Give two filters the same readings in two forms."""
    for k, forms in enumerate(readings):
        for kf, z in zip((plain, other), forms, strict=True):
            kf.predict(**inputs)
            kf.update(z)
        for name in ("x", "P", "z", "y", "S", "K", "weights", "log_likelihood"):
            assert np.array_equal(getattr(plain, name), getattr(other, name)), (name, k)


@pytest.mark.usefixtures("by_kernel_alone")
@pytest.mark.parametrize("noise", [None, "learnt"])
@pytest.mark.parametrize("kind", KINDS)
def test_matrices_and_measurements_of_other_kinds_are_the_kernels(kind, noise):
    plain, other = RobustKalmanFilter(2, 2, 1, noise=noise), RobustKalmanFilter(2, 2, 1, noise=noise)
    whole = {
        "F": [[1, 1], [0, 1]], "H": [[1, 0], [1, 2]], "Q": [[2, 1], [1, 2]], "R": [[3, 1], [1, 4]], "B": [[1], [2]],
    }  # fmt: skip
    for name, values in whole.items():
        setattr(plain, name, np.array(values, dtype=float))
        setattr(other, name, KINDS[kind](np.array(values, dtype=float)))
    given = {name: getattr(other, name) for name in whole}
    zs = [np.array([k, 40.0 if k == 7 else 2.0 + k % 2]) for k in range(12)]
    assert_the_same_to_the_bit(plain, other, [(z, KINDS[kind](z)) for z in zs], u=1.0)
    # They stay the user's own.
    assert all(getattr(other, name) is given[name] for name in whole)


NUMBERS = {
    "float": float, "int": int, "float32": np.float32, "float16": np.float16, "int64": np.int64, "uint8": np.uint8,
    "no axes": lambda value: np.array(float(value)), "no axes, integer": lambda value: np.array(int(value)),
}  # fmt: skip


@pytest.mark.usefixtures("by_kernel_alone")
@pytest.mark.parametrize("noise", [None, "learnt"])
@pytest.mark.parametrize("kind", NUMBERS)
def test_numbers_of_any_kind_are_the_kernels(kind, noise):
    number = NUMBERS[kind]
    plain, other = (support.of_matrices(RobustKalmanFilter, MOVES, SEES, 2.0, 4.0, noise=noise) for _ in "ab")
    other.R, other.Q = number(4), number(2)
    holders = [lambda z: z, lambda z: [z], lambda z: (z,)] if "axes" not in kind else [lambda z: z]
    readings = [(float(k % 5), holder(number(k % 5))) for k, holder in enumerate(holders * 4)]
    assert_the_same_to_the_bit(plain, other, readings)
    if noise is None:
        plain.update(3.0, R=np.array([[9.0]]))
        other.update(3.0, R=number(9))
        assert np.array_equal(plain.x, other.x) and np.array_equal(plain.P, other.P)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_density_of_variances_whose_product_is_no_number_is_the_definitions(both, sign):
    R = 10.0 ** (sign * np.array([90.0, 250.0, 90.0]))

    def densities():
        kf = support.of_matrices(RobustKalmanFilter, 1.0, np.eye(3), R.min(), np.diag(R), 0.0, scaling="innovation")
        found = []
        for z in np.sqrt(R) * np.random.default_rng(0).normal(size=(6, 3)):
            support.predict_and_update(kf, z)
            found.append(kf.log_likelihood)
        return found

    ours, theirs = both(densities)
    np.testing.assert_allclose(ours, theirs, rtol=1e-9)
    assert (np.abs(ours) > 400.0).all()


CREEPING = 0.7 * np.random.default_rng(0).normal(size=140) + np.where(np.arange(140) < 80, 0.0, 3.0)
DRAWS = np.random.default_rng(2)
LOUDER = np.where(np.arange(140) < 60, 1.0, 30.0) * DRAWS.choice([-1.0, 1.0], 140) * DRAWS.uniform(0.5, 1.5, 140)
KNOWN = np.random.default_rng(1).normal(size=40) + np.where(np.arange(40) < 30, 0.0, 30.0)
READ = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 4.0, 4.0, 30.0, 30.0])
# Two that come to nothing, of one reading each: the second reading of a third jump of this size is believed.
JUMPS = np.random.default_rng(3).normal(size=180)
JUMPS += 30.0 * (np.searchsorted([40, 80, 160], np.arange(180), side="right") + np.isin(np.arange(180), [120, 130]))
#: A filter and what it reads.
COURSES = {
    # No sensor makes it jump, and readings that are as predicted have no spread.
    "a state that is known exactly": (partial(support.of_matrices, F=MOVES, H=SEES, Q=0.0, P=0.0, x=[0, 0]), KNOWN),
    "readings as predicted": (partial(support.of_matrices, F=MOVES, H=SEES, Q=0.01, P=1.0, x=[-1, 1]), READ),
    # What correlates moves by a sensor of either sign.
    **{f"a jump that creeps, {sign}": (partial(support.mover, H=[[sign, 0.0]], q=1e-4), sign * CREEPING)
       for sign in (-1.0, 1.0)},
    # Ten far ones in a row are outliers, the next ones are what is usual.
    "noise thirty times larger": (partial(support.of_matrices, F=1.0, H=[[1.0]], Q=0.01), LOUDER),
    "jumps and runs in vain": (partial(support.of_matrices, F=1.0, H=[[1.0]], Q=0.01), JUMPS),
}  # fmt: skip


@pytest.mark.parametrize("name", COURSES)
def test_the_course_of_a_filter_is_the_definitions(both, name):
    make, zs = COURSES[name]

    def course():
        kf = make(RobustKalmanFilter)
        return [(support.predict_and_update(kf, z), shown(kf, "_memory"))[1] for z in zs]

    ours, theirs = both(course)
    assert_alike(ours, theirs, 1e-9)
    if make.func is support.mover:
        # Readings are no farther off than a few spreads.
        assert max(np.trace(row["P_post"]) - np.trace(row["P_prior"]) for row in theirs) > 0.0
    elif zs is LOUDER:
        clipped = [row["weights"][0] < 0.5 for row in theirs]
        assert all(clipped[60:69]) and not any(clipped[80:])
    elif zs is JUMPS:
        assert [abs(theirs[k]["y"][0]) > 20.0 for k in (160, 161, 162)] == [True, True, False]
