"""What is refused, in which words, and that a refused call changes nothing."""

import itertools
import re
from functools import partial

import numpy as np
import pytest
import support
from filterpy.kalman import MerweScaledSigmaPoints

from robust_filterpy import (
    AdaptiveKalmanFilter,
    Contaminated,
    Huber,
    Learnt,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    StudentT,
    diagnose,
    estimate_noise,
    smooth,
)
from robust_filterpy.correction import Scales, SingularInnovationError
from robust_filterpy.correction.learning import NoiseClasses
from robust_filterpy.correction.options import Choices
from robust_filterpy.influence import Linear
from robust_filterpy.testing.checks import assert_refused_call_changes_nothing

pytestmark = pytest.mark.core

NAN, INF = np.nan, np.inf
REFUSED = (ValueError, TypeError)
Z = np.array([0.1, 0.2])


def started(ndim=2, **choices):
    """A filter with dim_x=4, dim_z=2, dim_u=1 in the middle of its work."""
    kf = support.make(RobustKalmanFilter, support.random_problem(61, 4, 2, dim_u=1), ndim, **choices)
    support.predict_and_update(kf, Z)
    kf.predict()
    return kf


def refuse(kf, call, match=""):
    """The call raises in these words and leaves alone whatever the filter shows."""
    message = assert_refused_call_changes_nothing(kf, call)
    assert re.search(match, message), message
    return message


def goes_on(kf, ndim=2, **choices):
    """Compare the next steps with those of a filter that never saw the bad call."""
    innocent = started(ndim, **choices)
    for one in (kf, innocent):
        one.update([0.3, 9.0])
        one.predict(support.column(one, [0.5]))
        one.update([0.1, NAN])
    support.assert_unchanged(support.snapshot(innocent), kf)


#: What is bad in each, and how the words about it begin.
BAD = {
    "z": (r"^z", [
        3.0, [1.0], [1.0, 2.0, 3.0], np.ones((1, 3)), [[1.0, 2.0], [3.0, 4.0]], [[[1.0], [2.0]]], [[1.0], [2.0, 3.0]],
        [], [1.0, INF], [-INF, 1.0], [NAN, INF], ["a", "b"], "12", [1.0 + 2.0j, 3.0], {"z": 1.0},
    ]),
    "R": (r"\bR\b", [
        np.eye(3), np.ones(2), np.ones((2, 3)), np.array([[1.0, 2.0], [2.0, 1.0]]), -np.eye(2), np.diag([INF, 1.0]),
        np.array([[NAN, 0.0], [0.0, 1.0]]), "R", -1.0, NAN, 1j, 10**400,
    ]),
    "H": (r"\b[HRzM]\b", [
        *(np.ones(shape) for shape in ((2, 5), (2, 3), 4, (3, 4), (1, 4))), 1.0, np.full((2, 4), NAN),
        np.where(np.eye(2, 4) > 0.0, INF, 0.0),
    ]),
    "F": (r"\bF\b", [np.eye(3), np.ones(4), NAN * np.ones((4, 4)), INF * np.ones((4, 4))]),
    "Q": (r"\bQ\b", [np.eye(5), np.ones(4), np.ones((4, 1)), NAN * np.ones((4, 4))]),
    "B": (r"\b[Bu]\b", [np.ones((3, 1)), np.ones((4, 2)), NAN * np.ones((4, 1))]),
    "u": (r"\bu\b", [np.ones((2, 1)), np.ones((1, 4)), np.array([[NAN]]), np.array([[INF]])]),
    "x": (r"\bx\b", [np.zeros((5, 1)), np.zeros(3), np.zeros((4, 2)), np.zeros((1, 4)), NAN * np.ones((4, 1))]),
    "P": (r"\bP\b", [np.eye(3), np.ones(4), NAN * np.eye(4), np.diag([1.0, 1.0, 1.0, INF])]),
    "M": (r"\bM\b", [np.zeros((2, 4)), np.zeros((4, 3)), np.zeros(4), NAN * np.ones((4, 2))]),
}  # fmt: skip
CORRECTIONS, PREDICTIONS = ("update", "update_correlated"), ("predict", "get_prediction")
STEADY = ("predict", "predict_steadystate")
#: Which calls take it, and which read it where it is an attribute.
TAKEN = {"z": (*CORRECTIONS, "get_update", "update_steadystate"), **dict.fromkeys("RH", CORRECTIONS),
         **dict.fromkeys("FQBu", PREDICTIONS)}  # fmt: skip
READ = {
    "R": (*CORRECTIONS, "get_update", "batch_filter", "update_sequential"), "H": CORRECTIONS, "Q": ("predict",),
    **dict.fromkeys("FB", STEADY), **dict.fromkeys("xP", ("predict", "update")), "M": ("update_correlated",),
}  # fmt: skip


def called(kf, method, **bad):
    """Call a method with what is good but for this."""
    good = {"u": np.ones((1, 1))} if "predict" in method else {"z": support.column(kf, Z)}
    if method == "batch_filter":
        good = {"zs": [Z]}
    elif method == "update_sequential":
        good = {"start": 0, "z_i": Z}
    getattr(kf, method)(**{**good, **bad})


@pytest.mark.parametrize("name, method, passed", [
    (name, method, table is TAKEN) for table in (TAKEN, READ) for name in table for method in table[name]
])  # fmt: skip
def test_what_is_passed_or_an_attribute(name, method, passed):
    words, values = BAD[name]
    for value, ndim in itertools.product(values, (1, 2)):
        kf = started(ndim)
        good = getattr(kf, name, None)
        if not passed:
            setattr(kf, name, value)
        refuse(kf, lambda kf: called(kf, method, **({name: value} if passed else {})), words)  # noqa: B023
        if name == "z" and method in CORRECTIONS:
            refuse(kf, lambda kf: getattr(kf, method)(value, H=kf.H), words)  # noqa: B023
        if not passed:
            setattr(kf, name, good)
        goes_on(kf, ndim)


SMOOTHED = {"Xs": np.zeros((5, 4, 1)), "Ps": np.zeros((5, 4, 4))}


def in_words(call, match, **choices):
    return pytest.param(call, match, choices, id=f"{match[:30]}{len(match)}")


def written(kf, name):
    getattr(kf, name)[0, 0] = NAN


@pytest.mark.parametrize("call, match, choices", [
    in_words(lambda kf: kf.update([1.0, 2.0, 3.0]), r"expected .*2.* got .*3"),
    in_words(lambda kf: kf.update([1.0, INF]), r"z: .*finite.*[Nn]a[Nn]"),
    in_words(lambda kf: kf.predict(F=5.0), r"^F: expected shape \(4, 4\) .*, got scalar 5.0; use 5.0\*np.eye\(4\)$"),
    in_words(lambda kf: kf.update(["a"] * 5000), r"^z: expected real numbers.{0,270}$"),
    in_words(lambda kf: setattr(kf, "alpha", np.zeros(5000)), r"^alpha: expected a number.{0,270}$"),
    *(in_words(lambda kf, alpha=alpha: setattr(kf, "alpha", alpha), "^alpha: expected a number >= 1")
      for alpha in (0.5, -1.0, NAN, INF, 1e200)),
    *(in_words(lambda kf, args=args: kf.update_sequential(*args), "") for args in (
        (2, 0.5), (-1, 0.5), (1, Z), (0, np.ones(3)), (0, INF), (0.5, 0.1), (0, 0.1, np.eye(2)), (0, 0.1, -1.0),
        (0, 0.1, None, np.ones((2, 4))), (0, 0.1, None, np.ones((1, 3))),
    )),
    *(in_words(lambda kf, z=z: kf.update([0.0, z]), "^z: expected real numbers, got ") for z in (
        np.datetime64("2026-01-01"), np.timedelta64(3, "s"), "3.0",
    )),
    in_words(lambda kf: kf.update(np.array(["1.0", "2.0"])), "^z: expected real numbers, got '1.0' at index 0; pandas"),
    # filterpy stops at the shorter list and returns zeros for the rest.
    *(in_words(lambda kf, name=name: kf.batch_filter([Z] * 3, **{name + "s": [getattr(kf, name, 1.0)] * 2}),
               f"^{name}s: expected") for name in "FQHRu"),
    *(in_words(lambda kf, name=name, no=no: kf.batch_filter(**{"zs": [Z], name: no}), f"^{name}: expected a sequence")
      for name in ("zs", "Fs", "us", "Rs") for no in (np.array("x"), np.ma.masked, np.array(1.0))),
    in_words(lambda kf: kf.batch_filter({0: Z}), "^zs: expected a sequence"),
    in_words(lambda kf: kf.batch_filter({0.1, 0.2}), "^zs: expected a sequence"),
    in_words(lambda kf: kf.batch_filter([Z], us={0: 1.0}), "^us: expected a sequence"),
    in_words(lambda kf: kf.batch_filter([Z], saver=3), r"^saver: expected an object with save\(\)"),
    # A fault in the middle undoes a batch.
    in_words(lambda kf: kf.batch_filter([Z, [0.1, NAN], [0.1, INF]]), "step 2: z: expected"),
    in_words(lambda kf: kf.batch_filter([Z] * 5, Rs=[kf.R] * 3 + [np.eye(7)] * 2), r"step 3: R\b"),
    in_words(lambda kf: kf.batch_filter([Z] * 5, Qs=[kf.Q] * 3 + [np.eye(7)] * 2, update_first=True), r"step 3: Q\b"),
    *(in_words(lambda kf, given=given: kf.rts_smoother(**{**SMOOTHED, **given}), f"^{match}") for given, match in (
        ({"Fs": [np.eye(4)] * 4}, "Fs: expected an entry for each of the 5"), ({"Qs": 0.1}, "Qs: expected a sequence"),
        ({"Qs": [np.eye(4)] * 4}, "Qs: expected an entry for each of the 5"), ({"Xs": None}, "Xs: expected"),
        ({"Ps": None}, "Ps: expected"), ({"Ps": np.zeros((4, 4, 4))}, "Ps: expected shape"),
    )),
    # Of what is written into an array that was good.
    in_words(lambda kf: kf.R.__setitem__((0, 0), -1.0) or kf.update(Z), r"^R\b|\bR\b", influence=Linear()),
    *(in_words(lambda kf, name=name, method=method: written(kf, name) or getattr(kf, method)(Z), f"^{name}: expected")
      for name in "HR" for method in ("update", "get_update", "update_steadystate")),
])  # fmt: skip
def test_in_these_words(call, match, choices):
    kf = started(**choices)
    H, R = np.copy(kf.H), np.copy(kf.R)
    message = assert_refused_call_changes_nothing(kf, call, names=("x", "P", "y", "alpha", "K", "z"))
    assert re.search(match, message), message
    kf.H[:], kf.R[:] = H, R
    goes_on(kf, **choices)


def nonlinear(cls, n=2, **options):
    """A nonlinear filter of a sensor of its first state, which stands still."""
    points = {"points": MerweScaledSigmaPoints(n, 0.5, 2.0, 1.0)} if cls is RobustUnscentedKalmanFilter else {}
    functions = {} if cls is RobustExtendedKalmanFilter else {"dt": 1.0, "hx": lambda x: x[:1], "fx": lambda x, dt: x}
    return cls(n, 1, **functions, **points, **options)


linear, adaptive = partial(RobustKalmanFilter, 2, 1), partial(AdaptiveKalmanFilter, 2, 1)
NO_CHOICES = [
    ("scaling", "inovation"), ("scaling", 1), ("information", "realised"), ("information", ["realized"]),
    ("grouping", "components"), ("grouping", True), ("influence", "huber"), ("influence", 1.345), ("influence", None),
    ("influence", Huber), ("influence", object()),
]  # fmt: skip
#: What is built, with which options, and which of them is named.
OPTIONS = [
    *((linear, {name: value}, name) for name, value in NO_CHOICES),
    (linear, {"scaling": "inovation"}, "innovation.*bounded.*unit|unit.*bounded"),
    *((partial(RobustKalmanFilter, *dims), {}, "dim_") for dims in (
        (0, 1), (1, 0), (1, 1, -1), (-2, 1), (2.5, 1), ("2", 1),
    )),
    *((Scales, {name: value}, f"^{shown}: expected") for shown, name, value in (
        ("process_scales", "scales", []), ("process_scales", "scales", [1.0, np.nan]),
        ("process_scales", "scales", [0.0, 1.0]), ("dwell", "dwell", 1.0), ("dwell", "dwell", "long"),
        ("jump", "jump", 1.0), ("jump", "jump", -0.1),
    )),
    (Scales, {"scales": [1.0, 2.0], "probabilities": [0.5, 0.6]}, "^probabilities: expected"),
    (NoiseClasses, {"probabilities": [0.5, 0.5]}, "^probabilities: expected"),
    (NoiseClasses, {"grouping": "each"}, "^grouping: expected"),
    *((Learnt, {"scales": scales}, "^measurement_scales: expected") for scales in (
        [], [2.0, 3.0], [1.0, 1.0], [1.0, np.inf], 10.0,
    )),
    *((Learnt, {name: value}, f"^{name}: expected") for name, value in (
        ("memory", 1.0), ("memory", np.inf), ("r_memory", np.nan), ("r_memory", None),
    )),
    *((Contaminated, given, f"{next(reversed(given))}: expected") for given in (
        {"contamination": 1.0}, {"contamination": 0.1, "scale_ratio": 0.5}, {"contamination": "a"},
    )),
    *((Choices, {"grouping": grouping}, "grouping") for grouping in (
        ((0, 0),), ((0,), (0, 1)), ((-1,),), ((),), ((0, 1.5),),
    )),
    *((support.recovering, {"dim_x": 1, "dim_z": 1, "patience": value}, "patience") for value in (
        1, 0, 2.5, True, "a",
    )),
    (adaptive, {"grouping": "all"}, "^grouping: expected"), (linear, {"noise": 0.1}, "noise: expected"),
    (linear, {"noise": "learned"}, "noise: expected"),
    (linear, {"noise": Contaminated(0.0), "process": StudentT()}, "process: expected"),
    (linear, {"process": "scales"}, "noise='learnt'"), (linear, {"noise": "learnt", "patience": 12}, "jump="),
    *((linear, {**given, "patience": 12}, "patience: expected none, or scaling='learnt'") for given in (
        {"scaling": "innovation"}, {"scaling": "unit"}, {"influence": Linear()},
    )),
    (linear, {"noise": "learnt", "influence": StudentT()}, "influence: expected none"),
    (linear, {"noise": "learnt", "scaling": "unit"}, "scaling: expected none"),
    (partial(RobustKalmanFilter, 2, 2), {"noise": "learnt", "grouping": ((0,), (0,))}, "grouping: expected"),
    *((partial(nonlinear, cls), options, words) for cls in support.NONLINEAR for options, words in (
        ({"influence": 3.0}, "influence"), ({**support.RECOVERING, "patience": 2.5}, "patience"),
    )),
]  # fmt: skip


@pytest.mark.parametrize("build, options, words", OPTIONS, ids=range(len(OPTIONS)))
def test_options_that_are_none_or_make_no_sense_together_are_named(build, options, words):
    with pytest.raises(REFUSED, match=words):
        build(**options)


@pytest.mark.parametrize("kf, name, value, words", [
    (support.noise_given(2, 1), "scaling", "unit", "follows from noise="),
    (linear(), "process", "scales", "noise='learnt'"), (linear(), "learnt", np.zeros((1, 30)), "noise=Learnt"),
    *((nonlinear(cls, noise="learnt"), "influence", Huber(), "noise=") for cls in support.NONLINEAR),
    *((nonlinear(cls, **support.RECOVERING), "patience", 1, "patience") for cls in support.NONLINEAR),
    *((nonlinear(cls), "scaling", "none", "scaling") for cls in support.NONLINEAR),
    *((linear(), name, value, name) for name, value in NO_CHOICES),
], ids=range(12 + len(NO_CHOICES)))  # fmt: skip
def test_what_does_not_fit_a_filter_is_not_set(kf, name, value, words):
    before = repr(kf)
    with pytest.raises((*REFUSED, AttributeError), match=words):
        setattr(kf, name, value)
    assert repr(kf) == before


@pytest.mark.parametrize("bad, words", [
    (-0.1, "variances >= 0"), (np.diag([1.0, 1.0, -1e-6, 1.0]), "variances >= 0"),
    (np.eye(4) + np.eye(4, k=1), "a symmetric"),
], ids=["negative", "one negative", "not symmetric"])  # fmt: skip
def test_a_q_that_is_no_covariance_is_refused_where_it_is_used(bad, words):
    kf, match = started(), f"^Q: expected {words}"
    for method in PREDICTIONS:
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
@pytest.mark.parametrize("cls", support.NONLINEAR)
def test_nonlinear_filters_refuse_such_a_q_too(cls, n):
    kf = nonlinear(cls, n)
    kf.predict()
    for kf.Q in (-0.1 * np.eye(n), np.eye(n) + np.eye(n, k=1)):
        refuse(kf, lambda kf: kf.predict(), match=r"^Q: expected ")
    kf.Q = np.ones((n, n))
    kf.predict()


@pytest.mark.parametrize("m", [1, 2])
def test_a_p_that_is_negative_is_named(m):
    kf = RobustKalmanFilter(2, m)
    kf.H, kf.P = np.eye(2)[:m], -98.0 * np.eye(2)
    with pytest.raises(SingularInnovationError, match=r"least eigenvalue -97.*the Q that predict adds to P"):
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
], ids=range(6))  # fmt: skip
def test_a_message_shows_a_value_as_its_user_wrote_it_and_the_ends_of_a_long_one(value, words):
    with pytest.raises(REFUSED, match=words):
        Huber(value)


@pytest.mark.parametrize("noise", [None, "learnt"])
def test_what_is_no_function_is_named_as_inverse(noise):
    kf = RobustKalmanFilter(2, 1, noise=noise)
    kf.inv = "pinv"
    refuse(kf, lambda kf: kf.update(1.0), match="^inv: expected a function such as numpy.linalg.pinv")


@pytest.mark.parametrize("z", [b"12", "12", bytearray(b"12"), [b"1", b"2"]])
@pytest.mark.parametrize("call", [
    RobustKalmanFilter.batch_filter, RobustKalmanFilter.update, smooth, diagnose, estimate_noise,
], ids=lambda call: call.__name__)  # fmt: skip
def test_bytes_and_text_are_no_measurements_whatever_takes_them(call, z):
    kf = support.of_matrices(RobustKalmanFilter, 1.0, [[1.0]])
    with pytest.raises(TypeError, match="expected"):
        call(kf, z)
    assert kf.x[0, 0] == 0.0
