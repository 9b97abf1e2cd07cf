"""A filter's step by the kernel is the definition's, and what the kernel declines it leaves alone."""

import numpy as np
import pytest
import support

from robust_filterpy import Huber, RobustKalmanFilter, StudentT, TukeyBiweight
from robust_filterpy.correction import Scales
from robust_filterpy.filters import shell
from robust_filterpy.influence import Hampel, Linear

support.needs_kernel()

INFLUENCES = (Huber(), Linear(), Hampel(), TukeyBiweight(), StudentT())
EXTENSION = shell._extension
#: Nothing is passed for this call.
NONE = (None,) * 4
SHOWN = (
    *support.STATE, "z", "y", "S", "SI", "K", "T", "e", "weights", "clipped", "y_bounded", "spread", "log_likelihood",
    "mahalanobis",
)  # fmt: skip


def numbers(kf, name):
    return np.nan_to_num(np.asarray(getattr(kf, name), dtype=float), nan=-7.0)


def assert_same(one, two, rtol):
    for name in SHOWN:
        a, b = numbers(one, name), numbers(two, name)
        assert a.shape == b.shape, name
        assert np.abs(a - b).max() <= rtol * (1.0 + np.abs(b).max()), f"{name}: {a} instead of {b}"


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


@pytest.mark.pairwise
@pytest.mark.parametrize(("grouping", "scaling", "information"), SENSOR_BY_SENSOR + AS_ONE)
@pytest.mark.parametrize("influence", INFLUENCES, ids=lambda f: type(f).__name__)
def test_a_step_is_the_definition(monkeypatch, influence, grouping, scaling, information):
    taken = 0
    for seed, (n, m) in enumerate(((1, 1), (2, 1), (4, 2), (3, 4), (7, 3))):
        problem = support.mild(n, m, seed) if scaling == "unit" else support.random_problem(seed, n, m)
        options = {"influence": influence, "scaling": scaling, "information": information, "grouping": grouping}
        one, two = (support.make(RobustKalmanFilter, problem, 1 + seed % 2, **options) for _ in range(2))
        zs, _ = support.simulate(problem, 25, seed, 0.15, 20.0)
        # Sensors of every other problem are read in coarse steps, so that readings repeat.
        zs = np.round(zs) if seed % 2 else zs
        zs[np.random.default_rng(seed).random(zs.shape) < 0.1] = np.nan
        for z in zs:
            support.served_by(monkeypatch, EXTENSION)
            one.predict()
            one.update(z)
            taken += type(one._last) is np.ndarray
            support.without_kernel(monkeypatch)
            two.predict()
            two.update(z)
            # After a jump that was believed P is a million times what is left of it.
            assert_same(one, two, 1e-10 if scaling == "learnt" else 1e-11)
            # What is known of the sensors, of which the next steps are made.
            np.testing.assert_allclose(one._memory, two._memory, rtol=1e-9, atol=1e-9)
            told, right = one._arrays().information, two._arrays().information
            assert np.abs(told - right).max() <= 1e-6 * (1e-9 + np.abs(right).max())
    assert taken > 60


@pytest.mark.parametrize("information", ["realized", "weight"])
@pytest.mark.parametrize("grouping", ["component", "joint"])
def test_a_correction_with_the_gain_as_it_stands_is_the_definition(monkeypatch, grouping, information):
    def kind(n, m):
        return RobustKalmanFilter(n, m, grouping=grouping, information=information)

    H = [[1.0, 0.0], [1.0, 1.0]]
    one, two = (support.mover(kind, H=H, q=0.01) for _ in range(2))
    zs = np.random.default_rng(3).normal(size=(60, 2))
    zs[25] += 30.0
    for kf in (one, two):
        if kf is two:
            support.without_kernel(monkeypatch)
        for k, z in enumerate(zs):
            # From the 19th on S is that of the last correction, not H P H' + R.
            kf.predict_steadystate() if k > 19 else kf.predict()
            kf.update_steadystate(z) if k > 18 else kf.update(z)
    assert_same(one, two, 1e-10)
    np.testing.assert_allclose(one._memory, two._memory, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("scaling", ["learnt", "innovation"])
def test_among_sensors_that_fail_together_one_that_sees_no_state_is_judged_alone(monkeypatch, scaling):
    problem = support.random_problem(3, 3, 4)
    one, two = (support.make(RobustKalmanFilter, problem, 1, scaling=scaling, grouping="joint") for _ in range(2))
    for kf in (one, two):
        kf.H = np.where(np.arange(4)[:, None] == 2, 0.0, problem.H)
        kf.R = np.diag(problem.R.diagonal())
    zs = np.random.default_rng(4).normal(size=(30, 4)) * np.where(np.arange(30)[:, None] % 5, 1.0, 20.0)
    for z in zs:
        one.predict()
        assert EXTENSION.correct(one, z, None, None, None)
        support.without_kernel(monkeypatch)
        two.predict()
        two.update(z)
        support.served_by(monkeypatch, EXTENSION)
        assert_same(one, two, 1e-9)
        # Where nothing is seen of the state, only this tells how it was judged.
        np.testing.assert_allclose(one._arrays().information, two._arrays().information, rtol=1e-6, atol=1e-9)
    # What it says about the others the kernel cannot tell.
    one.R = one.R + 0.1
    assert before_and_after(one, lambda: EXTENSION.correct(one, zs[0], None, None, None)) == (False, True)


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
    assert EXTENSION.predict(kf, *NONE)
    np.testing.assert_allclose(kf.x, problem.F @ np.ravel(problem.x), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(kf.P, problem.F @ problem.P @ problem.F.T + problem.Q, rtol=1e-12, atol=1e-12)


def test_noise_that_is_thirty_times_larger_from_now_on_is_learnt_anew_as_by_the_definition(monkeypatch):
    rng = np.random.default_rng(2)
    zs = np.where(np.arange(140) < 60, 1.0, 30.0) * rng.choice([-1.0, 1.0], 140) * rng.uniform(0.5, 1.5, 140)
    one, two = RobustKalmanFilter(1, 1), RobustKalmanFilter(1, 1)
    clipped = []
    for kf in (one, two):
        kf.H[:], kf.Q[:] = 1.0, 0.01
    for z in zs:
        support.served_by(monkeypatch, EXTENSION)
        one.predict()
        one.update(z)
        support.without_kernel(monkeypatch)
        two.predict()
        two.update(z)
        assert_same(one, two, 1e-9)
        clipped.append(two.weights[0] < 0.5)
    # Ten far ones in a row are outliers, the next ones are the custom.
    assert all(clipped[60:69]) and not any(clipped[80:])


MIXTURES = {
    "scales and jumps": {"noise": "learnt", "process": "scales"},
    "one copy": {"noise": "learnt"},
    "no jumps": {"noise": "learnt", "process": Scales((1.0, 10.0), jump=0.0)},
}


@pytest.mark.parametrize("how", MIXTURES)
def test_a_step_under_learnt_noise_is_the_definition(monkeypatch, how):
    for seed, (n, m) in enumerate(((1, 1), (2, 1), (4, 2), (3, 4), (7, 3))):
        problem = support.random_problem(seed, n, m)
        one, two = (support.make(RobustKalmanFilter, problem, 1 + seed % 2, **MIXTURES[how]) for _ in range(2))
        for kf in (one, two):
            kf.B = np.ones((n, 1))
        zs, _ = support.simulate(problem, 25, seed, 0.15, 20.0)
        zs[np.random.default_rng(seed).random(zs.shape) < 0.1] = np.nan
        for k, z in enumerate(zs):
            if k == 10:
                # From outside: the copies begin there, by the definition.
                one.x, two.x = one.x + 1.0, two.x + 1.0
            for kf, extension in ((one, EXTENSION), (two, None)):
                support.served_by(monkeypatch, extension)
                kf.predict(0.1)
                kf.update(z)
            # Kernel and definition order sums differently, and a mixture of classes doubts at its border.
            assert_same(one, two, 1e-7)
            for name in ("R_learnt", "process_scale", "outlier_probability", "learnt"):
                np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=1e-6, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("how", MIXTURES)
def test_the_kernel_takes_ordinary_steps_under_learnt_noise(how):
    kf = support.make(RobustKalmanFilter, support.random_problem(1, 3, 2), **MIXTURES[how])
    # The first step begins at an x from outside.
    kf.predict()
    assert EXTENSION.correct_mixture(kf, [1.0, 2.0], *NONE[1:])
    assert EXTENSION.predict_mixture(kf, *NONE) and EXTENSION.correct_mixture(kf, [np.nan, 2.0], *NONE[1:])
    assert before_and_after(kf, lambda: EXTENSION.correct_mixture(kf, [np.nan, np.nan], *NONE[1:])) == (False, True)
    kf.x = kf.x + 1.0
    if how != "one copy":
        assert before_and_after(kf, lambda: EXTENSION.correct_mixture(kf, [1.0, 2.0], *NONE[1:])) == (False, True)
        kf._kept = (1.0,) * 6
        assert before_and_after(kf, lambda: EXTENSION.predict_mixture(kf, *NONE)) == (False, True)


@pytest.mark.parametrize("how", MIXTURES)
def test_what_a_correction_under_learnt_noise_leaves_cannot_be_changed_from_outside(how):
    one, two = (support.make(RobustKalmanFilter, support.random_problem(1, 3, 2), **MIXTURES[how]) for _ in range(2))
    for kf in (one, two):
        kf.predict()
        kf.update([1.0, 2.0])
    y = two.y.copy()
    for name in ("x", "P", "x_prior", "P_prior", "x_post", "P_post", "z", "H", "R"):
        getattr(one, name)[...] = 7.0
    np.testing.assert_array_equal(one.y, y)
    np.testing.assert_array_equal(one.process_probabilities, two.process_probabilities)


def spoilt():
    """Ways to spoil one attribute: the name, and what it becomes."""

    class Sub(np.ndarray):
        pass

    return {
        "integers": lambda a: np.round(a).astype(int), "single precision": lambda a: a.astype(np.float32),
        "other byte order": lambda a: a.astype(">f8"), "strides": lambda a: np.repeat(a, 2, axis=0)[::2],
        "a subclass": lambda a: a.view(Sub), "a list": lambda a: a.tolist(), "one axis more": lambda a: a[None],
        "one row less": lambda a: a[:-1], "None": lambda a: None, "an object": lambda a: object(),
        "NaN": lambda a: np.full_like(a, np.nan), "infinity": lambda a: np.full_like(a, np.inf),
        "objects": lambda a: a.astype(object), "empty": lambda a: np.empty((0, 0)),
    }  # fmt: skip


# Of these matrices it makes float64: see the tests of kinds below.
MADE_PLAIN = [(name, how) for name in "FQHR" for how in ("integers", "single precision", "other byte order", "strides")]


@pytest.mark.parametrize("how", spoilt())
@pytest.mark.parametrize("name", ["x", "P", "F", "Q", "H", "R", "_memory", "_kept"])
@pytest.mark.parametrize("noise", ["", "_mixture"])
def test_what_is_out_of_the_ordinary_is_declined_and_nothing_changes(noise, name, how):
    options = {"noise": "learnt", "process": "scales"} if noise else {"scaling": "learnt"}
    kf = support.make(RobustKalmanFilter, support.random_problem(1, 3, 2), **options)
    kf.predict()
    kf.update([1.0, 2.0])
    if name != "_kept":
        setattr(kf, name, spoilt()[how](getattr(kf, name)))
    elif noise:
        kf._kept = kf._kept._replace(means=spoilt()[how](kf._kept.means))
    predict, correct = (getattr(EXTENSION, call + noise) for call in ("predict", "correct"))
    for call in (lambda: predict(kf, *NONE), lambda: correct(kf, [1.0, 2.0], *NONE[1:])):
        outcome, same = before_and_after(kf, call)
        assert outcome is True or same
    # One of the two reads each of them.
    both = predict(kf, *NONE) and correct(kf, [1.0, 2.0], *NONE[1:])
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


def test_an_attribute_that_frees_arrays_while_it_is_read_does_no_harm():
    class Hostile(RobustKalmanFilter):
        armed = False

        @property
        def Q(self):
            if self.armed:
                self.x.resize(100000, refcheck=False)
                self.P = np.zeros((1, 1))
            return np.eye(3)

        @Q.setter
        def Q(self, value):
            pass

    kf = Hostile(3, 2)
    kf.armed = True
    assert EXTENSION.predict(kf, *NONE) is False


def test_what_an_attribute_raises_is_passed_on():
    class Broken(RobustKalmanFilter):
        @property
        def F(self):
            raise KeyError("not today")

        @F.setter
        def F(self, value):
            pass

    kf = Broken(2, 1)
    with pytest.raises(KeyError, match="not today"):
        EXTENSION.predict(kf, *NONE)


def test_wrong_calls_are_errors():
    kf = RobustKalmanFilter(2, 1)
    for call in (lambda: EXTENSION.predict(kf), lambda: EXTENSION.correct(kf, 1.0), lambda: EXTENSION.filter_series()):
        with pytest.raises(TypeError):
            call()
    with pytest.raises(AttributeError):
        EXTENSION.predict(object(), None, None, None, None)


def test_a_diffuse_start_that_cancels_is_for_the_definition():
    """P0/R of 1e16: what is left of P after the step is rounding."""
    kf = RobustKalmanFilter(2, 2)
    kf.H = np.array([[1.0, 0.0], [1.0, 1e-9]])
    kf.P, kf.R = 1e16 * np.eye(2), np.eye(2)
    kf.scaling = "innovation"
    assert EXTENSION.correct(kf, [1.0, 2.0], *NONE[1:]) is False


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


KINDS = {
    "int64": lambda a: a.astype(np.int64),
    "uint8": lambda a: a.astype(np.uint8),
    "float32": lambda a: a.astype(np.float32),
    "float16": lambda a: a.astype(np.float16),
    "column by column": np.asfortranarray,
    "every second": lambda a: np.repeat(a, 2, axis=-1)[..., ::2],
    "other bytes": lambda a: a.astype(">f8"),
}


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
    for k in range(12):
        z = np.array([k, 40.0 if k == 7 else 2.0 + k % 2])
        for kf, seen in ((plain, z), (other, KINDS[kind](z))):
            kf.predict(u=1.0)
            kf.update(seen)
        for name in ("x", "P", "z", "y", "S", "K", "weights", "log_likelihood"):
            assert np.array_equal(getattr(plain, name), getattr(other, name)), (name, k)
    # They stay the user's own.
    assert all(getattr(other, name) is given[name] for name in whole)


NUMBERS = {
    "float": float, "int": int, "float32": np.float32, "float16": np.float16, "int64": np.int64, "uint8": np.uint8,
    "no axes": lambda value: np.array(float(value)), "no axes, integer": lambda value: np.array(int(value)),
}  # fmt: skip
HOLDERS = {"": lambda value: value, "list": lambda value: [value], "tuple": lambda value: (value,)}


@pytest.mark.usefixtures("by_kernel_alone")
@pytest.mark.parametrize("noise", [None, "learnt"])
@pytest.mark.parametrize("kind", NUMBERS)
def test_numbers_of_any_kind_are_the_kernels(kind, noise):
    plain, other = RobustKalmanFilter(2, 1, noise=noise), RobustKalmanFilter(2, 1, noise=noise)
    for kf in (plain, other):
        kf.F, kf.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    plain.R, plain.Q = np.array([[4.0]]), 2.0 * np.eye(2)
    other.R, other.Q = NUMBERS[kind](4), NUMBERS[kind](2)
    holders = HOLDERS.values() if "axes" not in kind else [HOLDERS[""]]
    for k, holder in enumerate([*holders] * 4):
        plain.predict()
        other.predict()
        plain.update(float(k % 5))
        other.update(holder(NUMBERS[kind](k % 5)))
        for name in ("x", "P", "z", "y", "S", "K", "log_likelihood"):
            assert np.array_equal(getattr(plain, name), getattr(other, name)), (name, k)
    if noise is None:
        plain.update(3.0, R=np.array([[9.0]]))
        other.update(3.0, R=NUMBERS[kind](9))
        assert np.array_equal(plain.x, other.x) and np.array_equal(plain.P, other.P)


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, np.float32(-1.0), True, np.True_, 1j, "2", None, 10**400])
@pytest.mark.parametrize("name", ["R", "Q"])
def test_a_number_that_is_no_variance_is_refused_as_the_definition_does(name, value, monkeypatch):
    said = []
    for path in ("kernel", "definition"):
        if path == "definition":
            support.without_kernel(monkeypatch)
        kf = RobustKalmanFilter(2, 1)
        kf.H[0, 0] = 1.0
        before = kf.x.copy(), kf.P.copy()
        setattr(kf, name, value)
        try:
            kf.predict()
            kf.update(1.0)
            said.append("fine")
        except (TypeError, ValueError, OverflowError) as error:
            said.append(f"{type(error).__name__}: {error}")
            if name == "Q":
                assert np.array_equal(kf.x, before[0]) and np.array_equal(kf.P, before[1])
    assert said[0] == said[1]
