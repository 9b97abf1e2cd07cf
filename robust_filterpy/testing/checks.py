"""`check_filter`: every promise of a filter, tested by name.

Those about calls, what a program relies on between the lines, stand here: refused calls, copies, shapes.
"""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy.testing import filter_data, filter_equations, runs
from robust_filterpy.testing.bench import FILTER_TAGS, OLD, Check, CheckResult, ChecksFailed, FilterSubject, promise
from robust_filterpy.testing.consistency import probability
from robust_filterpy.testing.models import StateModel
from robust_filterpy.testing.runs import furthest, state

#: What a refusal is: an error that names what was wrong, not a failed assert inside the estimator.
REFUSALS = (ValueError, TypeError)


def visible(estimator: Any, names: Iterable[str] | None = None) -> dict[str, Any]:
    """Return copies of the numbers and arrays that an estimator shows: public attributes and properties."""
    shown = {}
    for name in [name for name in dir(estimator) if name[0] != "_"] if names is None else names:
        try:
            value = getattr(estimator, name)
            array = None if callable(value) else np.array(value, copy=True)
        except Exception:
            continue
        if array is not None and (array.dtype.kind in "biuf" or _of_none_and_numbers(array)):
            shown[name] = array
    return shown


def _of_none_and_numbers(array: np.ndarray) -> bool:
    """Tell what filterpy makes of a missing measurement from an array of objects."""
    return array.dtype.kind == "O" and all(isinstance(item, (int, float, type(None))) for item in array.flat)


def assert_unchanged(before: dict[str, Any], estimator: Any, what: str = "the call") -> None:
    """Assert that an estimator shows what it showed before, to the last bit."""
    now = visible(estimator, before)
    alike = {
        name: np.array_equal(value, now[name], equal_nan=value.dtype.kind == now[name].dtype.kind == "f")
        for name, value in before.items() if name in now
    }  # fmt: skip
    changed = [name for name in before if not alike.get(name, False)]
    if changed:
        raise AssertionError(f"{what} changed {', '.join(changed)}")


def assert_refused_call_changes_nothing(
    estimator: Any, call: Callable[[Any], Any], names: Iterable[str] | None = None
) -> str:
    """Assert that a bad call raises, and leaves everything that can be seen as it was.

    Parameters
    ----------
    estimator : object
        Filter or tracker.
    call : callable
        ``call(estimator)`` makes the bad call.
    names : iterable of str, optional
        Attributes to compare. Default: all public ones.

    Returns
    -------
    str
        The message of the error, to be looked at.

    Raises
    ------
    AssertionError
        If it does not raise, raises none of `REFUSALS`, or changes something.
    """
    before, expected = visible(estimator, names), " or ".join(kind.__name__ for kind in REFUSALS)
    try:
        call(estimator)
    except REFUSALS as error:
        assert_unchanged(before, estimator, f"the call was refused ({type(error).__name__}: {error}), but")
        return str(error)
    except Exception as error:
        raise AssertionError(f"expected {expected}, got {type(error).__name__}: {error}") from error
    raise AssertionError(f"expected {expected}, the call was accepted")


#: What is looked at before the equations.
FIRST: list[Check] = []
#: What holds the estimate.
_SHOWN = ("x", "P")
#: Values that cannot be right, and the attribute to set to them; None: the measurement.
BAD_VALUES: dict[str, tuple[str | None, Any]] = {
    "a z that is too long": (None, np.zeros(3)),
    "a z that is too short": (None, np.zeros(1)),
    "an infinite z": (None, np.array([np.inf, 0.0])),
    "text for z": (None, ["a", "b"]),
    "an R of another shape": ("R", np.eye(3)),
    "a negative R": ("R", -np.eye(2)),
    "an H of another shape": ("H", np.ones((2, 3))),
    "an F of another shape": ("F", np.eye(3)),
    "a Q of another shape": ("Q", np.ones(4)),
}


@promise(FIRST)
def state_keeps_its_shape(subject: FilterSubject) -> None:
    """predict and update leave the shapes of x and P as they were, for z as an array, a list or a number."""
    for dims in ((1, 1), (4, 2)):
        model = subject.model(*dims)
        kf = subject.new(model)
        shape = np.shape(kf.x)
        forms: list[Any] = [np.zeros(dims[1]), [0.0] * dims[1], *([0.0] if dims[1] == 1 else [])]
        for z in forms:
            runs.step(kf, z, model)
            if np.shape(kf.x) != shape or np.shape(kf.P) != (dims[0], dims[0]):
                raise AssertionError(
                    f"after update({z!r}) x has shape {np.shape(kf.x)} and P {np.shape(kf.P)}, expected {shape} and "
                    f"{(dims[0], dims[0])}"
                )


@promise(FIRST)
def arguments_are_not_written_to(subject: FilterSubject) -> None:
    """x, P, F, H, Q, R and z that the caller passed are as they were after predict and update."""
    model = subject.model()
    kf = subject.new(model)
    given = {name: np.array(getattr(kf, name), dtype=float) for name in ("x", "P", "F", "H", "Q", "R")}
    before = {name: value.copy() for name, value in given.items()}
    for name, value in given.items():
        setattr(kf, name, value)
    for z in subject.recording(model, 3):
        original = z.copy()
        runs.step(kf, z, model)
        if not np.array_equal(z, original):
            raise AssertionError("update wrote into z")
    written = [name for name, value in given.items() if not np.array_equal(value, before[name])]
    if written:
        raise AssertionError(f"the caller's {', '.join(written)} changed: copy what is to be written into")


@promise(FIRST)
def same_data_give_the_same_numbers(subject: FilterSubject) -> None:
    """Two filters with the same data agree to the last bit and leave numpy's global random state alone."""
    model = subject.model()
    zs, before = subject.recording(model), _global_state()
    one, two = (state(subject.advance(subject.new(model), zs, model)) for _ in range(2))
    if not all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, two, strict=True)):
        raise AssertionError("the same data gave other numbers: draw random numbers from a seeded Generator")
    if not np.array_equal(before, _global_state()):
        raise AssertionError("numpy's global random state was changed: draw from a Generator of its own")


def _global_state() -> Any:
    """Return numpy's global random state."""
    return np.random.get_state(legacy=False)["state"]["key"]  # type: ignore[call-overload,index]  # noqa: NPY002


@promise(FIRST)
def integers_are_numbers_like_any_other(subject: FilterSubject) -> None:
    """x, P, F and H as integer arrays give the numbers that they give as floats."""
    model = subject.model().with_(
        x=np.array([0.0, 1.0, 0.0, 2.0]), P=2.0 * np.eye(4), F=np.eye(4, k=1) + np.eye(4), H=np.eye(2, 4)
    )
    zs, states = subject.recording(model, 5), []
    for kind in (float, int):
        kf = subject.new(model)
        for name in ("x", "P", "F", "H"):
            setattr(kf, name, np.array(getattr(kf, name)).astype(kind))
        states.append(state(subject.advance(kf, zs, model)))
    (x, P), (x2, _) = states
    if furthest(x2 - x, P) > 1e-9:
        raise AssertionError(
            f"x differs by {furthest(x2 - x, P):.2g} of its standard deviations: it is rounded to integers"
        )


@promise(FIRST)
def estimates_handed_out_stay_as_they_were(subject: FilterSubject) -> None:
    """What the estimator showed, kept in a list after each call, is not changed by later calls."""
    model = subject.model()
    estimator, shown_before = subject.new(model), []
    # As long as it takes for a buffer of past estimates to be written over.
    for _ in runs.calls(estimator, subject.recording(model, OLD // 2), model):
        shown = {name: getattr(estimator, name) for name in _SHOWN if hasattr(estimator, name)}
        shown_before += [(name, value, np.array(value, dtype=float)) for name, value in shown.items()]
    for name, value, then in shown_before:
        if not np.array_equal(value, then, equal_nan=True):
            raise AssertionError(f"a {name} that was kept from an earlier step has changed: it is written in place")


@promise(FIRST)
def two_estimators_share_nothing(subject: FilterSubject) -> None:
    """An estimator at work changes neither another one, nor those made later, nor what these find."""
    model = subject.model()
    zs, idle = subject.recording(model), subject.new(model)
    before = visible(idle)
    after = visible(subject.advance(subject.new(model), zs, model), _SHOWN)
    assert_unchanged(before, idle, "another one's work")
    assert_unchanged(before, subject.new(model), "the first one's work, in those made later,")
    again = subject.advance(subject.new(model), zs, model)
    assert_unchanged(after, again, "something that is left of the first one")


@promise(FIRST)
def deepcopies_go_on_alike(subject: FilterSubject) -> None:
    """A deepcopy goes on as the original does, bit for bit, and neither moves the other."""
    _round_trip(subject, "deepcopy", copy.deepcopy)


@promise(FIRST, "pickle")
def pickles_go_on_alike(subject: FilterSubject) -> None:
    """An unpickled estimator goes on as the original does, bit for bit."""
    _round_trip(subject, "pickle", lambda estimator: pickle.loads(pickle.dumps(estimator)))


def _round_trip(subject: FilterSubject, way: str, copied: Callable[[Any], Any]) -> None:
    """Copy in the middle of a recording, and go on with both."""
    model = subject.model()
    first, rest = np.split(subject.recording(model), 2)
    estimator = subject.advance(subject.new(model), first, model)
    try:
        twin = copied(estimator)
    except Exception as error:
        raise AssertionError(f"{way} failed with {type(error).__name__}: {error}") from error
    if type(twin) is not type(estimator):
        raise AssertionError(f"{way} made a {type(twin).__name__} of a {type(estimator).__name__}")
    before = visible(estimator)
    assert_unchanged(before, twin, way)
    after = visible(subject.advance(estimator, rest, model))
    assert_unchanged(before, twin, f"the original went on and, through what a {way} shares with it,")
    gone_on = subject.advance(twin, rest, model)
    assert_unchanged(after, gone_on, f"going on after {way} gave other numbers than the original's: it")


@promise(FIRST, "validates")
def bad_input_is_refused_and_changes_nothing(subject: FilterSubject) -> None:
    """What cannot be right raises ValueError or TypeError; the estimate, and what it is later, are as without it."""
    model, faults = subject.model(), []
    first, rest = np.split(subject.recording(model), 2)
    wanted = visible(subject.advance(subject.advance(subject.new(model), first, model), rest, model), _SHOWN)
    for words, bad in BAD_VALUES.items():
        call = partial(_bad_call, subject.model(), *bad)
        estimator = subject.advance(subject.new(model), first, model)
        try:
            assert_refused_call_changes_nothing(estimator, call, names=_SHOWN)
            assert_unchanged(wanted, subject.advance(estimator, rest, model), "after it, what followed")
        except AssertionError as error:
            faults.append(f"{words}: {error}")
    if faults:
        raise AssertionError("; ".join(faults))


def _bad_call(model: StateModel, name: str | None, value: Any, kf: Any) -> None:
    """Meet a bad value, and take it back."""
    if name is None:
        runs.measure(kf, value, model)
        return
    before = getattr(kf, name)
    try:
        setattr(kf, name, value)
        if name in ("F", "Q"):
            kf.predict()
        # An extended filter asks for H.
        elif name == "H" and runs.is_extended(kf):
            z = np.zeros(len(model.R))
            runs.measure(kf, z, model.with_(sensor=lambda x: z, sensor_jacobian=lambda x: value))
        else:
            runs.measure(kf, np.zeros(len(model.R)), model)
    finally:
        setattr(kf, name, before)


#: From what breaks everything to what only shows in the long run, so that the first failure is the one to look at.
FILTER_PROMISES = (*FIRST, *filter_equations.PROMISES, *filter_data.LATER)


def filter_checks(
    *, not_claimed: Iterable[str] = (), expected_failures: Mapping[str, str] | None = None, seed: int = 0,
    false_alarm: float = 1e-6,
) -> list[Check]:  # fmt: skip
    """List the checks of an estimator, for ``pytest.mark.parametrize``.

    Parameters
    ----------
    not_claimed : iterable of str
        What the estimator does not claim; an unknown name is refused with all that can be claimed. "exact" is
        tested only of estimators that do not claim "robust".
    expected_failures : mapping of str to str, optional
        Names of checks that are known to fail, and the reason. They are reported as skipped; one that passes warns.
    seed : int, default 0
        Seed of all checks.
    false_alarm : float, default 1e-6
        Probability that a right estimator fails one of the stochastic checks.

    Returns
    -------
    list of Check
        Each is called with the estimator's factory.

    Raises
    ------
    ValueError, TypeError
        If a tag or a name is unknown, or a number out of range.
    """
    if isinstance(not_claimed, str):
        raise TypeError(f"not_claimed: expected several tags, got the text {not_claimed!r}; use ({not_claimed!r},)")
    claims = frozenset(FILTER_TAGS) - {_checks.option("not_claimed", tag, FILTER_TAGS) for tag in not_claimed}
    # A robust estimator is not the Kalman filter, nor least squares.
    claims -= {"exact"} if "robust" in claims else set()
    expected, names = dict(expected_failures or {}), [entry.name for entry in FILTER_PROMISES]
    for name in expected:
        _checks.option("expected_failures", name, names)
    alpha, seed = probability(false_alarm), _checks.count("seed", seed)

    return [
        replace(entry, expected_failure=expected.get(entry.name), claims=claims, seed=seed, false_alarm=alpha)
        for entry in FILTER_PROMISES
        if entry.needs <= claims
    ]


def check_filter(
    make: Callable[..., Any], *, not_claimed: Iterable[str] = (), expected_failures: Mapping[str, str] | None = None,
    seed: int = 0, false_alarm: float = 1e-6,
) -> tuple[CheckResult, ...]:  # fmt: skip
    """Test every promise that a filter claims to keep.

    Parameters
    ----------
    make : callable
        ``make(dim_x, dim_z)`` returns a new filter with ``x, P, F, H, Q, R``, ``predict()`` and ``update(z)``; a class
        will do. B, y, S, log_likelihood are tested where it has them, HJacobian where ``update`` asks for it.
    not_claimed, expected_failures, seed, false_alarm
        As in `filter_checks`.

    Returns
    -------
    tuple of CheckResult
        Name, status, message and seconds of each check.

    Raises
    ------
    ChecksFailed
        An AssertionError that names every check that failed, with its figures.
    TypeError, ValueError
        If make returns something else, or a tag or a name is unknown.

    Examples
    --------
    >>> from filterpy.kalman import KalmanFilter
    >>> from robust_filterpy.testing import check_filter
    >>> results = check_filter(KalmanFilter, not_claimed=("robust", "nan", "validates"))
    >>> {result.status for result in results} <= {"passed", "skipped"}
    True

    In a test file::

        @pytest.mark.parametrize("check", filter_checks(not_claimed=("robust",)))
        def test_my_filter(check):
            check(MyFilter)
    """
    checks = filter_checks(
        not_claimed=not_claimed, expected_failures=expected_failures, seed=seed, false_alarm=false_alarm
    )
    subject = FilterSubject(make, frozenset(), (seed,), false_alarm)
    try:
        subject.new(subject.model())
    except (TypeError, ValueError) as error:
        raise type(error)(str(error).replace("kf: ", "make: ", 1)) from None
    results = [check.result(make) for check in checks]
    if any(result.status == "failed" for result in results):
        raise ChecksFailed(results)
    return tuple(results)
