"""What is refused, in which words, and that a refused call changes nothing."""

import re

import numpy as np
import pytest
import support
from filterpy.kalman import MerweScaledSigmaPoints

from robust_filterpy import (
    AdaptiveKalmanFilter,
    Huber,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    StudentT,
    TukeyBiweight,
)
from robust_filterpy.filters import RobustCubatureKalmanFilter
from robust_filterpy.influence import Hampel, Linear
from robust_filterpy.testing.assertions.contracts import assert_refused_call_changes_nothing

pytestmark = pytest.mark.core

NAN, INF = np.nan, np.inf
REFUSED = (ValueError, TypeError)
OTHER = support.random_problem(62, 5, 3, dim_u=2)


def started(ndim=2, **choices):
    """A filter with dim_x=4, dim_z=2, dim_u=1 in the middle of its work."""
    kf = support.make(RobustKalmanFilter, support.random_problem(61, 4, 2, dim_u=1), ndim, **choices)
    kf.predict()
    kf.update([0.1, 0.2])
    kf.predict()
    return kf


def column(kf, values):
    return np.reshape(values, (-1, 1)) if kf.x.ndim == 2 else np.asarray(values)


def refuse(kf, call, match=""):
    """The call raises in these words and leaves alone whatever the filter shows."""
    message = assert_refused_call_changes_nothing(kf, call, raises=REFUSED)
    assert re.search(match, message), message
    return message


def goes_on(kf, ndim=2, **choices):
    """Compare the next steps with those of a filter that never saw the bad call."""
    innocent = started(ndim, **choices)
    for one in (kf, innocent):
        one.update([0.3, 9.0])
        one.predict(column(one, [0.5]))
        one.update([0.1, NAN])
    support.assert_unchanged(support.snapshot(innocent), kf)


BAD_Z = {
    "scalar": 3.0,
    "too short": [1.0],
    "too long": [1.0, 2.0, 3.0],
    "matrix": [[1.0, 2.0], [3.0, 4.0]],
    "three axes": [[[1.0], [2.0]]],
    "ragged": [[1.0], [2.0, 3.0]],
    "empty": [],
    "infinite": [1.0, INF],
    "minus infinite": [-INF, 1.0],
    "infinite beside missing": [NAN, INF],
    "text": ["a", "b"],
    "one text": "12",
    "complex": [1.0 + 2.0j, 3.0],
    "dictionary": {"z": 1.0},
}
CORRECTING = {
    "update": lambda z: lambda kf: kf.update(z),
    "update_correlated": lambda z: lambda kf: kf.update_correlated(z),
    "update_steadystate": lambda z: lambda kf: kf.update_steadystate(z),
    "get_update": lambda z: lambda kf: kf.get_update(z),
    "update with H": lambda z: lambda kf: kf.update(z, H=kf.H),
    "update_correlated with H": lambda z: lambda kf: kf.update_correlated(z, H=kf.H),
}


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("case", BAD_Z)
@pytest.mark.parametrize("method", CORRECTING)
@pytest.mark.parametrize("ndim", [1, 2])
def test_z(case, method, ndim):
    kf = started(ndim)
    refuse(kf, CORRECTING[method](BAD_Z[case]), match="^z")
    goes_on(kf, ndim)


def test_the_message_says_what_was_expected_and_what_was_found():
    message = refuse(started(), lambda kf: kf.update([1.0, 2.0, 3.0]))
    assert "expected" in message and "got" in message and "2" in message and "3" in message
    message = refuse(started(), lambda kf: kf.update([1.0, INF]), match="z.*finite|z.*inf")
    assert "NaN" in message or "nan" in message, "the likely mend is NaN for missing"


def test_a_scalar_f_is_refused_in_the_documented_words():
    kf = started()
    kf.F = 5.0
    message = refuse(kf, lambda kf: kf.predict())
    assert message == "F: expected shape (4, 4) for dim_x, got scalar 5.0; use 5.0*np.eye(4)"


BAD_R = {
    "too large": np.eye(3), "a vector": np.ones(2), "not square": np.ones((2, 3)),
    "indefinite": np.array([[1.0, 2.0], [2.0, 1.0]]), "negative": -np.eye(2), "NaN": np.array([[NAN, 0.0], [0.0, 1.0]]),
    "infinite": np.diag([INF, 1.0]), "text": "R",
}  # fmt: skip


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("case", BAD_R)
@pytest.mark.parametrize("method", ["update", "update_correlated", "get_update", "batch_filter", "update_sequential"])
def test_r_as_an_attribute(case, method):
    kf, good = started(), started().R
    kf.R = BAD_R[case]
    arguments = {"batch_filter": ([[[0.1], [0.2]]],), "update_sequential": (0, np.array([0.1, 0.2]))}
    refuse(kf, lambda kf: getattr(kf, method)(*arguments.get(method, ([0.1, 0.2],))), match=r"\bR\b")
    kf.R = good
    goes_on(kf)


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("case", [*BAD_R, "negative scalar", "scalar NaN"])
@pytest.mark.parametrize("method", ["update", "update_correlated"])
def test_r_for_one_call(case, method):
    kf = started()
    R = {**BAD_R, "negative scalar": -1.0, "scalar NaN": NAN}[case]
    refuse(kf, lambda kf: getattr(kf, method)([0.1, 0.2], R=R), match=r"\bR\b")
    goes_on(kf)


BAD_H = {
    "too wide": np.ones((2, 5)), "too narrow": np.ones((2, 3)), "a vector": np.ones(4), "scalar": 1.0,
    "NaN": np.full((2, 4), NAN), "infinite": np.full((2, 4), INF), "taller than z": np.ones((3, 4)),
    "lower than z": np.ones((1, 4)),
}  # fmt: skip


@pytest.mark.pairwise
@pytest.mark.parametrize("case", BAD_H)
@pytest.mark.parametrize("method", ["update", "update_correlated"])
@pytest.mark.parametrize("ndim", [1, 2])
def test_h(case, method, ndim):
    kf = started(ndim)
    good = kf.H
    refuse(kf, lambda kf: getattr(kf, method)(column(kf, [0.1, 0.2]), H=BAD_H[case]), match=r"\b[HRzM]\b")
    kf.H = BAD_H[case]
    refuse(kf, lambda kf: getattr(kf, method)([0.1, 0.2]), match=r"\b[HRzM]\b")
    kf.H = good
    goes_on(kf, ndim)


def test_z_of_another_height_than_h_does_not_widen_the_state():
    """With filterpy 2.0 a flat z beside H turns a column x into a matrix."""
    kf = started()
    for z in ([0.1], [0.1, 0.2, 0.3], np.ones((1, 3))):
        refuse(kf, lambda kf, z=z: kf.update(z, H=kf.H))
    kf.update([0.1, 0.2], H=kf.H)
    assert kf.x.shape == (4, 1)


BAD_PREDICTIONS = {
    "F too small": {"F": np.eye(3)},
    "F a vector": {"F": np.ones(4)},
    "F NaN": {"F": np.full((4, 4), NAN)},
    "F infinite": {"F": np.full((4, 4), INF)},
    "Q too large": {"Q": np.eye(5)},
    "Q a vector": {"Q": np.ones(4)},
    "Q a column": {"Q": np.ones((4, 1))},
    "Q NaN": {"Q": np.full((4, 4), NAN)},
    "B of another height": {"B": np.ones((3, 1)), "u": np.ones((1, 1))},
    "B of another width": {"B": np.ones((4, 2)), "u": np.ones((1, 1))},
    "B NaN": {"B": np.full((4, 1), NAN), "u": np.ones((1, 1))},
    "u too long": {"u": np.ones((2, 1))},
    "u a row": {"u": np.ones((1, 4))},
    "u NaN": {"u": np.array([[NAN]])},
    "u infinite": {"u": np.array([[INF]])},
}


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("case", BAD_PREDICTIONS)
@pytest.mark.parametrize("method", ["predict", "get_prediction"])
def test_predict_for_one_call(case, method):
    kf = started()
    refuse(kf, lambda kf: getattr(kf, method)(**BAD_PREDICTIONS[case]), match=r"\b[FQBu]\b")
    goes_on(kf)


@pytest.mark.parametrize("case", [c for c in BAD_PREDICTIONS if not c.startswith("u")])
@pytest.mark.parametrize("method", ["predict", "predict_steadystate"])
def test_predict_with_a_bad_attribute(case, method):
    arguments = dict(BAD_PREDICTIONS[case])
    u = arguments.pop("u", None)
    (name, value), *_ = arguments.items()
    if method == "predict_steadystate" and name == "Q":
        pytest.skip("it does not use Q")
    kf = started()
    good = getattr(kf, name)
    setattr(kf, name, value)
    refuse(kf, lambda kf: getattr(kf, method)(np.ones((1, 1)) if u is None else u), match=rf"\b[{name}u]\b")
    setattr(kf, name, good)
    goes_on(kf)


@pytest.mark.parametrize("call", [lambda kf: kf.predict(), lambda kf: kf.update([0.1, 0.2])], ids=["predict", "update"])
@pytest.mark.parametrize("name, value", [
    ("x", np.zeros((5, 1))), ("x", np.zeros(3)), ("x", np.zeros((4, 2))), ("x", np.zeros((1, 4))),
    ("x", np.full((4, 1), NAN)), ("P", np.eye(3)), ("P", np.ones(4)), ("P", np.full((4, 4), NAN)),
    ("P", np.diag([1.0, 1.0, 1.0, INF])),
])  # fmt: skip
def test_x_and_p(name, value, call):
    kf = started()
    setattr(kf, name, value)
    refuse(kf, call, match=rf"\b{name}\b")


@pytest.mark.parametrize("M", [np.zeros((2, 4)), np.zeros((4, 3)), np.zeros(4), np.full((4, 2), NAN)])
def test_m(M):
    kf = started()
    kf.M = M
    refuse(kf, lambda kf: kf.update_correlated([0.1, 0.2]), match=r"\bM\b")


@pytest.mark.parametrize("arguments", [
    (2, 0.5),
    (-1, 0.5),
    (1, np.array([0.1, 0.2])),
    (0, np.array([0.1, 0.2, 0.3])),
    (0, INF),
    (0.5, 0.1),
    (0, 0.1, np.eye(2)),
    (0, 0.1, -1.0),
    (0, 0.1, None, np.ones((2, 4))),
    (0, 0.1, None, np.ones((1, 3))),
], ids=str)  # fmt: skip
def test_sequential(arguments):
    kf = started()
    refuse(kf, lambda kf: kf.update_sequential(*arguments))
    goes_on(kf)


@pytest.mark.parametrize("name", ["Fs", "Qs", "Hs", "Rs", "us"])
def test_a_list_for_the_batch_of_another_length(name):
    """filterpy stops at the shorter one and returns zeros for the rest."""
    kf = started()
    value = {"Fs": kf.F, "Qs": kf.Q, "Hs": kf.H, "Rs": kf.R, "us": np.ones((1, 1))}[name]
    refuse(kf, lambda kf: kf.batch_filter([[[0.1], [0.2]]] * 3, **{name: [value] * 2}), match=name)
    goes_on(kf)


@pytest.mark.parametrize(("arguments", "match"), [
    ({"zs": {0: [0.1, 0.2]}}, "zs: expected a sequence"),
    ({"zs": {0.1, 0.2}}, "zs: expected a sequence"),
    ({"zs": [[0.1, 0.2]], "us": {0: 1.0}}, "us: expected a sequence"),
    ({"zs": [[0.1, 0.2]], "saver": 3}, r"saver: expected an object with save\(\)"),
])  # fmt: skip
def test_what_has_no_order_or_cannot_save_is_refused_before_the_first_step(arguments, match):
    kf = started()
    refuse(kf, lambda kf: kf.batch_filter(**arguments), match=f"^{match}")
    goes_on(kf)


@pytest.mark.parametrize("update_first", [False, True])
@pytest.mark.parametrize("fault", ["z", "R", "Q"])
def test_a_fault_in_the_middle_of_a_batch_undoes_the_batch(update_first, fault):
    kf = started()
    zs, lists = [[[0.1], [0.2]] for _ in range(5)], {"Rs": [kf.R] * 5, "Qs": [kf.Q] * 5}
    if fault == "z":
        zs[3] = [[0.1], [INF]]
    else:
        lists[fault + "s"] = [*lists[fault + "s"][:3], np.eye(7), np.eye(7)]
    message = refuse(kf, lambda kf: kf.batch_filter(zs, update_first=update_first, **lists), match=rf"\b{fault}\b")
    assert "3" in message, "the step is named"
    goes_on(kf)


@pytest.mark.parametrize("alpha", [0.5, -1.0, [1.0, 2.0], NAN, INF])
def test_alpha(alpha):
    refuse(started(), lambda kf: setattr(kf, "alpha", alpha), match="alpha")


BAD_CHOICES = [
    ("scaling", "inovation"), ("scaling", 1), ("information", "realised"), ("information", ["realized"]),
    ("grouping", "components"), ("grouping", True), ("influence", "huber"), ("influence", 1.345), ("influence", None),
    ("influence", Huber), ("influence", object()),
]  # fmt: skip


@pytest.mark.parametrize("name, value", BAD_CHOICES)
def test_choices(name, value):
    with pytest.raises(REFUSED, match=name):
        RobustKalmanFilter(4, 2, **{name: value})
    kf = started()
    good = getattr(kf, name)
    refuse(kf, lambda kf: setattr(kf, name, value), match=name)
    assert getattr(kf, name) == good
    goes_on(kf)


def test_an_unknown_option_is_answered_with_the_known_ones():
    with pytest.raises(ValueError, match="innovation") as error:
        RobustKalmanFilter(4, 2, scaling="none")
    for option in ("innovation", "unit", "bounded", "none"):
        assert option in str(error.value)


@pytest.mark.parametrize("dims", [(0, 1), (1, 0), (1, 1, -1), (-2, 1), (2.5, 1), ("2", 1)])
def test_dimensions(dims):
    with pytest.raises(REFUSED, match="dim_"):
        RobustKalmanFilter(*dims)


def test_choices_are_keywords_only():
    with pytest.raises(TypeError):
        RobustKalmanFilter(4, 2, 0, Huber())


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("size", [1e3, 1e10, 1e100, 1e154, 1e155, 1e200, 1e300, -1e300])
@pytest.mark.parametrize("scaling", ["innovation", "bounded"])
@pytest.mark.parametrize("ndim", [1, 2])
@pytest.mark.filterwarnings("error")
def test_an_enormous_measurement_is_no_bad_input(size, scaling, ndim):
    """It moves x by a bounded amount, and nothing overflows on the way, not even in a warning."""
    kf = started(ndim, scaling=scaling)
    for z in ([size, -size], [size, 0.1], [NAN, size]):
        x = kf.x.copy()
        kf.update(z)
        assert np.abs(kf.x - x).max() < 20
        for name in (*support.STATE, "y", "K", "S", "SI", "e", "T", "y_bounded"):
            assert np.all(np.isfinite(getattr(kf, name))), name
        assert np.isfinite(kf.log_likelihood) and np.isfinite(kf.likelihood) and np.isfinite(kf.mahalanobis)
        assert kf.likelihood >= 0
        repr(kf)
        kf.predict()


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("influence", [Huber(0.5), Hampel(), TukeyBiweight(), StudentT(), StudentT(50.0)], ids=repr)
@pytest.mark.parametrize("information", ["realized", "weight"])
@pytest.mark.parametrize("dim_z", [1, 2])
def test_no_size_of_measurement_up_to_1e300_is_special(influence, information, dim_z):
    """Where e^2 overflows, where psi(e)/e turns subnormal, and everywhere between."""
    problem = support.random_problem(64, 2, dim_z)
    kf = support.make(RobustKalmanFilter, problem, influence=influence, information=information)
    for exponent in np.arange(0.0, 300.5, 0.5):
        support.load(kf, problem)
        kf.update([10.0**exponent, 0.1][:dim_z])
        support.assert_positive_definite(kf.P, f"P after z = 1e{exponent}")
        assert np.abs(kf.x - problem.x).max() < 100, exponent
        assert np.isfinite(kf.log_likelihood) and np.isfinite(kf.mahalanobis), exponent


@pytest.mark.parametrize("dim_z", [1, 2, 3])
@pytest.mark.parametrize("grouping", ["component", "joint"])
def test_nothing_overflows_where_a_tiny_s_makes_the_standardized_innovation_infinite(dim_z, grouping):
    problem = support.random_problem(63, 3, dim_z)
    tiny = support.with_(problem, P=1e-24 * problem.P, Q=1e-24 * problem.Q, R=1e-24 * problem.R)
    kf = support.make(RobustKalmanFilter, tiny, grouping=grouping)
    kf.update([1e300, -1e300, 3.0][:dim_z])
    support.assert_all_finite(kf)
    support.assert_positive_definite(kf.P)
    assert 0 < np.abs(kf.x - problem.x).max() < 1e-9


def test_bad_r_is_told_from_a_good_one_after_it_was_written_into():
    """A factor of R that is remembered must not outlive the R that it belongs to."""
    kf = started(influence=Linear())
    kf.R[0, 0] = -1.0
    refuse(kf, lambda kf: kf.update([0.1, 0.2]), match=r"\bR\b")


@pytest.mark.pairwise(1)
@pytest.mark.parametrize("name", ["H", "R"])
@pytest.mark.parametrize("dim_z", [1, 2, 4])
@pytest.mark.parametrize("method", ["update", "get_update", "update_steadystate"])
def test_nan_in_h_or_r_is_named(method, dim_z, name):
    kf = support.make(RobustKalmanFilter, support.random_problem(61, 4, dim_z))
    kf.predict()
    kf.update(np.full(dim_z, 0.1))
    setattr(kf, name, np.array(getattr(kf, name)))
    getattr(kf, name)[0, 0] = NAN
    refuse(kf, lambda kf: getattr(kf, method)(np.full(dim_z, 0.1)), match=f"^{name}: expected")


@pytest.mark.parametrize(("z", "what"), [
    (np.datetime64("2026-01-01"), "dtype datetime64"), (np.timedelta64(3, "s"), "dtype timedelta64"), ("3.0", "'3.0'$"),
    (np.array(["1.0"]), "'1.0' at index 0$"), (np.array(["1.0"], dtype=object), "'1.0' at index 0$"),
])  # fmt: skip
def test_times_and_text_are_no_measurements(z, what):
    kf = RobustKalmanFilter(dim_x=1, dim_z=1)
    refuse(kf, lambda kf: kf.update(z), match=f"^z: expected real numbers, got {what}")


def test_a_message_is_short_however_long_the_value():
    kf = started()
    assert len(refuse(kf, lambda kf: kf.update(["a"] * 5000), match="^z: expected real numbers")) < 300
    assert len(refuse(kf, lambda kf: setattr(kf, "alpha", np.zeros(5000)), match="^alpha: expected a number")) < 300


@pytest.mark.parametrize(("arguments", "match"), [
    ({"Fs": [np.eye(4)] * 4}, "Fs: expected an entry for each of the 5"),
    ({"Qs": [np.eye(4)] * 4}, "Qs: expected an entry for each of the 5"),
    ({"Qs": 0.1}, "Qs: expected a sequence"),
    ({"Xs": None}, "Xs: expected"),
    ({"Ps": None}, "Ps: expected"),
    ({"Ps": np.zeros((4, 4, 4))}, "Ps: expected shape"),
])  # fmt: skip
def test_the_smoother(arguments, match):
    kf = started()
    means, covariances, _, _ = kf.batch_filter([[0.1, 0.2]] * 5)
    with pytest.raises(REFUSED, match=f"^{match}"):
        kf.rts_smoother(**{"Xs": means, "Ps": covariances} | arguments)


BAD_Q = {
    "negative": (-0.1, "variances >= 0"),
    "one negative": (np.diag([1.0, 1.0, -1e-6, 1.0]), "variances >= 0"),
    "not symmetric": (np.eye(4) + np.eye(4, k=1), "a symmetric"),
}


@pytest.mark.parametrize("case", BAD_Q)
def test_a_q_that_is_no_covariance_is_refused_where_it_is_used(case):
    bad, words = BAD_Q[case]
    kf, match = started(), f"^Q: expected {words}"
    for method in ("predict", "get_prediction"):
        refuse(kf, lambda kf, method=method: getattr(kf, method)(Q=bad), match=match)
    # Long recordings go through the kernel.
    for Qs in ([bad] * 200, [np.eye(4)] * 150 + [bad * np.ones((4, 4))] * 50):
        first = 0 if Qs[0] is bad else 150
        refuse(kf, lambda kf, Qs=Qs: kf.batch_filter(np.zeros((200, 2)), Qs=Qs), match=f"step {first}: {match[1:]}")
    goes_on(kf)
    # Written into the array that was good in the step before.
    kf = started()
    kf.Q[:] = bad * np.ones((4, 4)) if np.ndim(bad) else bad * np.eye(4)
    refuse(kf, lambda kf: kf.predict(), match=match)
    refuse(kf, lambda kf: kf.batch_filter(np.zeros((200, 2))), match=f"step 0: {match[1:]}")


@pytest.mark.parametrize("n", [2, 40])
@pytest.mark.parametrize("cls", [RobustExtendedKalmanFilter, RobustUnscentedKalmanFilter, RobustCubatureKalmanFilter])
def test_nonlinear_filters_refuse_such_a_q_too(cls, n):
    functions = () if cls is RobustExtendedKalmanFilter else (1.0, lambda x: x[:1], lambda x, dt: x)
    points = (MerweScaledSigmaPoints(n, 0.5, 2.0, 1.0),) if cls is RobustUnscentedKalmanFilter else ()
    kf = cls(n, 1, *functions, *points)
    kf.predict()
    for bad in (-0.1 * np.eye(n), np.eye(n) + np.eye(n, k=1)):
        kf.Q = bad
        before = kf.P.copy()
        with pytest.raises(ValueError, match=r"^Q: expected "):
            kf.predict()
        np.testing.assert_array_equal(kf.P, before)
    kf.Q = np.ones((n, n))
    kf.predict()


@pytest.mark.parametrize("m", [1, 2])
def test_a_p_that_is_negative_is_named(m):
    kf = RobustKalmanFilter(2, m)
    kf.H, kf.P = np.eye(2)[:m], -98.0 * np.eye(2)
    with pytest.raises(np.linalg.LinAlgError, match=r"least eigenvalue -97.*the Q that predict adds to P"):
        kf.update(np.ones(m))


class NoRepr:
    def __repr__(self):
        raise RuntimeError


@pytest.mark.parametrize("value, words", [
    (np.float64(-1.5), r"got -1\.5$"),
    (np.int64(-2), r"got -2$"),
    ("a" * 198, r"got 'a{198}'$"),
    ("a" * 200, r"got 'a{119} \.\.\. a{39}'$"),
    (np.zeros(21), r"got array\(\[0\., 0\., 0\., \.\.\., 0\., 0\., 0\.\]"),
    (NoRepr(), r"got NoRepr without a repr$"),
])  # fmt: skip
def test_a_message_shows_a_value_as_its_user_wrote_it_and_the_ends_of_a_long_one(value, words):
    with pytest.raises(REFUSED, match=words):
        Huber(value)


@pytest.mark.parametrize("make", [RobustKalmanFilter, AdaptiveKalmanFilter])
@pytest.mark.parametrize("value", [np.array("x"), np.ma.masked, np.array(1.0)], ids=["text", "masked", "number"])
@pytest.mark.parametrize("name", ["zs", "Fs", "us", "Rs"])
def test_an_array_without_axes_is_no_sequence(make, name, value):
    kf = make(2, 1)
    given = {"zs": [1.0, 2.0], name: value}
    refuse(kf, lambda kf: kf.batch_filter(**given), match=f"^{name}: expected a sequence")


@pytest.mark.parametrize("noise", [None, "learnt"])
def test_what_is_no_function_is_named_as_inverse(noise):
    kf = RobustKalmanFilter(2, 1, noise=noise)
    kf.inv = "pinv"
    refuse(kf, lambda kf: kf.update(1.0), match="^inv: expected a function such as numpy.linalg.pinv")
    with pytest.raises(ValueError, match=r"^alpha: expected a number >= 1"):
        kf.alpha = 1e200
