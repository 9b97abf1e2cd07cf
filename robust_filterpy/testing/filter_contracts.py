"""Promises between the lines: shapes, arrays that stay the caller's, copies, refused calls."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.testing import contracts, runs
from robust_filterpy.testing.checks import Promise, promise
from robust_filterpy.testing.filter_subject import FilterSubject, furthest, state

PROMISES: list[Promise] = []


@promise(PROMISES)
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


@promise(PROMISES)
def arguments_are_not_written_to(subject: FilterSubject) -> None:
    """x, P, F, H, Q, R and z that the caller passed are as they were after predict and update."""
    model = subject.model()
    kf = subject.new(model)
    given = {name: np.array(getattr(kf, name), dtype=float) for name in ("x", "P", "F", "H", "Q", "R")}
    before = {name: value.copy() for name, value in given.items()}
    for name, value in given.items():
        setattr(kf, name, value)
    for z in subject.recording(model, 3):
        kept = z.copy()
        runs.step(kf, z, model)
        if not np.array_equal(z, kept):
            raise AssertionError("update wrote into z")
    written = [name for name, value in given.items() if not np.array_equal(value, before[name])]
    if written:
        raise AssertionError(f"the caller's {', '.join(written)} changed: copy what is to be written into")


@promise(PROMISES)
def estimates_handed_out_stay_as_they_were(subject: FilterSubject) -> None:
    """kf.x and kf.P, kept in a list at each step, are not changed by later steps."""
    model = subject.model()
    kf, kept = subject.new(model), []
    for z in subject.recording(model, 4):
        kf.predict()
        kept.append((kf.x, kf.P, *state(kf)))
        runs.measure(kf, z, model)
        kept.append((kf.x, kf.P, *state(kf)))
    for x, P, x_then, P_then in kept:
        if not np.array_equal(np.ravel(x), x_then) or not np.array_equal(P, P_then):
            name = "P" if np.array_equal(np.ravel(x), x_then) else "x"
            raise AssertionError(f"a {name} that was kept from an earlier step has changed: it is written in place")


@promise(PROMISES)
def two_filters_share_nothing(subject: FilterSubject) -> None:
    """A filter at work changes neither another one nor those made later."""
    model = subject.model()
    worker, idle = subject.made(4, 2), subject.made(4, 2)
    before = contracts.visible(idle)
    subject.advance(runs.load(worker, model), subject.recording(model), model)
    contracts.assert_unchanged(before, idle, "another filter's work")
    contracts.assert_unchanged(before, subject.made(4, 2), "a filter's work, in filters made later,")


@promise(PROMISES)
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


@promise(PROMISES)
def integers_are_numbers_like_any_other(subject: FilterSubject) -> None:
    """x, P, F and H as integer arrays give the numbers that they give as floats."""
    model = subject.model().with_(
        x=np.array([0.0, 1.0, 0.0, 2.0]), P=2.0 * np.eye(4), F=np.eye(4, k=1) + np.eye(4), H=np.eye(2, 4)
    )
    zs, found = subject.recording(model, 5), []
    for kind in (float, int):
        kf = subject.new(model)
        for name in ("x", "P", "F", "H"):
            setattr(kf, name, np.array(getattr(kf, name)).astype(kind))
        found.append(state(subject.advance(kf, zs, model)))
    (x, P), (x2, _) = found
    if furthest(x2 - x, P) > 1e-9:
        raise AssertionError(
            f"x differs by {furthest(x2 - x, P):.2g} of its standard deviations: it is rounded to integers"
        )


@promise(PROMISES)
def deepcopies_go_on_alike(subject: FilterSubject) -> None:
    """A deepcopy goes on as the original does, bit for bit, and neither moves the other."""
    _round_trip(subject, "deepcopy")


@promise(PROMISES, "pickle")
def pickles_go_on_alike(subject: FilterSubject) -> None:
    """An unpickled filter goes on as the original does, bit for bit."""
    _round_trip(subject, "pickle")


def _round_trip(subject: FilterSubject, way: str) -> None:
    """Copy in the middle of a recording."""
    model = subject.model()
    zs = subject.recording(model)
    kf = subject.advance(subject.new(model), zs[:5], model)
    contracts.assert_state_round_trip(kf, lambda one: subject.advance(one, zs[5:], model), ways=(way,))


BAD_CALLS: dict[str, tuple[str | None, Any]] = {
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


@promise(PROMISES, "validates")
def bad_input_is_refused_and_changes_nothing(subject: FilterSubject) -> None:
    """A z, F, H, Q or R that cannot be right raises ValueError or TypeError, and x and P are as they were."""
    model, faults = subject.model(), []
    zs = subject.recording(model, 3)
    for words, (name, value) in BAD_CALLS.items():
        kf = subject.advance(subject.new(model), zs, model)
        if name is not None:
            setattr(kf, name, value)
        call = _bad_call(name, value, zs[0], model)
        try:
            contracts.assert_refused_call_changes_nothing(kf, call, names=("x", "P"))
        except AssertionError as error:
            faults.append(f"{words}: {error}")
    if faults:
        raise AssertionError("; ".join(faults))


def _bad_call(name: str | None, value: Any, z: Array, model: Any) -> Any:
    """Return the call that has to meet the bad value."""
    if name in ("F", "Q"):
        return lambda kf: kf.predict()
    if name == "H":
        # An extended filter asks for it.
        bad = model.with_(sensor=lambda x: z, sensor_jacobian=lambda x: value)
        return lambda kf: runs.measure(kf, z, bad if runs.is_extended(kf) else model)
    return lambda kf: runs.measure(kf, value if name is None else z, model)
