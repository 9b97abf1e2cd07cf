"""Promises between the lines: shapes, arrays that stay the caller's, numbers of any type."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy.testing.assertions.bounds import furthest
from robust_filterpy.testing.checks.bench import Promise, promise
from robust_filterpy.testing.checks.filter_subject import FilterSubject
from robust_filterpy.testing.scenarios import runs
from robust_filterpy.testing.scenarios.runs import state

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
