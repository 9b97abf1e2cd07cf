"""Either all of a call happened or none: whatever a saver, a psi, a user's function or an interrupt raises."""

import copy
from types import SimpleNamespace

import numpy as np
import pytest
import support
from interruption import half_steps
from support import by_night

from robust_filterpy import (
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    kernel,
)
from robust_filterpy.filters import snapshot
from robust_filterpy.filters.snapshot import _copied
from robust_filterpy.influence import Huber

ERRORS = [KeyboardInterrupt, OSError, ZeroDivisionError, MemoryError, SystemExit, ValueError]


def raising(error, after):
    """Return a function that raises at the call after so many."""
    calls = iter(range(10**9))

    def call(*_, **__):
        if next(calls) >= after:
            raise error("on purpose")

    return call


class FailingPsi(Huber):
    """A user's psi."""

    fails = None

    def psi(self, e):
        type(self).fails()
        return super().psi(e)


class Tracker(RobustKalmanFilter):
    """A user's class, whose step writes in place."""

    fails = None

    def predict(self, *args, **kwargs):
        self.x[:] += 1.0
        self.F[0, 0] += 1.0
        super().predict(*args, **kwargs)
        self.fails and self.fails()


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("name", [*support.POLICIES, "a class", "a psi"])
def test_a_saver_a_psi_or_a_step_of_ones_own_that_fails_leaves_the_filter_of_before(name, error, monkeypatch):
    monkeypatch.setattr(FailingPsi, "fails", staticmethod(lambda: None))
    own = {"a class": Tracker, "a psi": FailingPsi}.get(name)
    options = {"influence": FailingPsi()} if own is FailingPsi else support.POLICIES.get(name, {})
    kf = support.make(Tracker if own is Tracker else RobustKalmanFilter, support.random_problem(3, 3, 2), **options)
    support.predict_and_update(kf, [0.3, 0.1])
    fails, saver = raising(error, 3), None
    if own:
        monkeypatch.setattr(own, "fails", staticmethod(fails))
    else:
        saver = SimpleNamespace(save=fails)
    before, F = support.contents(kf), kf.F
    with pytest.raises(error, match="on purpose"):
        kf.batch_filter(np.ones((20, 2)), saver=saver)
    support.assert_same_contents(support.contents(kf), before)
    assert kf.F is F or own is Tracker


@pytest.mark.parametrize("error", [None, *ERRORS])
@pytest.mark.parametrize("cls", support.NONLINEAR)
def test_a_model_function_that_writes_into_its_argument_and_fails_changes_nothing(cls, error):
    def square(x):
        return np.square(np.ravel(x))

    def spoiling(x):
        value, x[:] = square(x), 7.0
        if error is not None:
            raise error("on purpose")
        return value

    def step(kf, function):
        kf.predict()
        before, kf.hx = support.contents(kf), function
        # A Jacobian comes first.
        extended = cls is RobustExtendedKalmanFilter
        kf.update(np.array([1.0, 2.0]), *((lambda x: np.diag(2.0 * np.ravel(x)), function) if extended else ()))
        return before

    kf = support.of_matrices(cls, 0.9, np.eye(2), 0.1, x=[1.0, 2.0])
    step(kf, square)
    twin = copy.deepcopy(kf)
    before = step(twin, square)
    if error is None:
        step(kf, spoiling)
        np.testing.assert_array_equal(kf.x, twin.x)
        np.testing.assert_array_equal(kf.P, twin.P)
    else:
        with pytest.raises(error, match="on purpose"):
            step(kf, spoiling)
        support.assert_same_contents(support.contents(kf), before)


@pytest.mark.parametrize("kept", [_copied, kernel.extension() and kernel.extension().copied_arrays], ids=["numpy", "C"])
def test_what_a_model_function_wrote_into_any_kind_of_array_is_undone(kept, monkeypatch):
    if kept is None:
        pytest.skip("no kernel")
    if kept is _copied:
        monkeypatch.setattr(snapshot, "_copied_arrays", _copied)
    kf = RobustExtendedKalmanFilter(2, 1)
    kf.x, kf.P, kf.Q = np.array([1.0, 2.0]), np.asfortranarray([[2.0, 0.5], [0.25, 1.0]]), np.eye(4)[::2, ::2]
    kf.F, kf.R, kf.z = np.eye(2, dtype=int), np.ones((1, 1), dtype=np.float32), np.array([None])
    # What the filter does not know of is put back too; an array of no numbers lies between others.
    kf.none, kf.mine = np.zeros(0), np.arange(3.0)
    names = ("x", "P", "Q", "F", "R", "z", "none", "mine")
    before = {name: getattr(kf, name).copy() for name in names}

    def fails(x):
        for name in names:
            getattr(kf, name)[...] = 7
        raise KeyError("a function of the user's")

    with pytest.raises(KeyError):
        kf.update(0.5, lambda x: np.ones((1, 2)), fails)
    for name in names:
        np.testing.assert_array_equal(getattr(kf, name), before[name], err_msg=name)


@pytest.mark.parametrize("cls", [RobustKalmanFilter, support.Extended])
def test_what_the_last_correction_showed_is_the_same_when_a_missing_one_is_looked_at_late(cls):
    kf = support.of_matrices(cls, 1.0, [[1.0, 0.0], [0.5, 1.0]], x=np.zeros(2))
    kf.update([1.0, 30.0])
    before = support.snapshot(copy.deepcopy(kf), ("S", "SI", "T", "K"))
    for _ in range(2):
        support.predict_and_update(kf, None)
    support.assert_unchanged(before, copy.deepcopy(kf))
    assert kf.log_likelihood == kf.mahalanobis == 0.0
    assert np.isnan(kf.weights).all() and not kf.y.any() and not kf.e.any()


# Ctrl-C at any line inside any call of any filter: the call has happened, or it has not.


F, H = np.array([[1.0, 0.1], [0.0, 1.0]]), np.array([[1.0, 0.0]])


FILTERS = support.of_every_kind(F, H, patience=2)


def update(kf, z):
    kf.update(None if z is None else np.array([z]))


CALLS = {
    "predict": lambda kf: kf.predict(), "update": lambda kf: update(kf, 0.5), "outlier": lambda kf: update(kf, 60.0),
    "missing": lambda kf: update(kf, None), "restore": None,
}  # fmt: skip
#: What the linear filter has besides.
LINEAR = {
    "predict with matrices": lambda kf: kf.predict(F=F, Q=np.eye(2)),
    "update with matrices": lambda kf: kf.update(0.5, R=2.0, H=2.0 * H),
    "sequential": lambda kf: kf.update_sequential(0, 0.5),
    "steady state": lambda kf: kf.update_steadystate(0.5),
    "predict, steady state": lambda kf: kf.predict_steadystate(),
    "get_update": lambda kf: kf.get_update(60.0),
    "correlated": lambda kf: kf.update_correlated(0.5),
    "recording": lambda kf: kf.batch_filter([0.1, 60.0, None]),
}


def seen(kf):
    """All that a call moves, and all that it shows."""
    found = {name: value for name, value in kf.state().items() if name != "format"}
    for name in ("x_prior", "P_prior", "x_post", "P_post", "y", "weights", "log_likelihood", "K", "S"):
        found[name] = np.asarray(getattr(kf, name), dtype=float)
    return found


CASES = [(name, call) for name in FILTERS for call in CALLS] + [("recovering", call) for call in LINEAR]
BY_DAY = ("linear", "recovering", "adaptive", "extended", "unscented", "ensemble")


@pytest.mark.parametrize(
    "name, call", [pytest.param(*case, marks=[] if case[0] in BY_DAY else pytest.mark.nightly) for case in CASES]
)
@pytest.mark.parametrize("every", by_night([1, 3], 3))
def test_an_interrupt_leaves_no_half_step(name, call, every):
    kf = FILTERS[name]()
    kf.Q = 0.01 * np.eye(2)
    for z in (0.1, 0.2, 5.0, 0.1):
        kf.predict()
        update(kf, z)
    if call not in ("predict", "predict with matrices"):
        kf.predict()
    make = {**CALLS, **LINEAR}[call]
    if call == "restore":
        later = copy.deepcopy(kf)
        update(later, 0.3)
        make = lambda one: one.restore(later.state())  # noqa: E731
    half, lines = half_steps(kf, make, seen, every=every)
    assert half == [] and lines > 0
