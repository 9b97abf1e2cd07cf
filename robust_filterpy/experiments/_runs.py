"""How runs are numbered, seeded, handed to processes, shown and stacked."""

from __future__ import annotations

import collections.abc
import dataclasses
import inspect
import operator
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from numpy.typing import NDArray

from robust_filterpy._progress import stages

Trial: TypeAlias = Callable[[Generator], Any]
Seed: TypeAlias = "int | Sequence[int] | SeedSequence | None"


class Raised(NamedTuple):
    """Carry an exception home as text: the exception itself may not survive pickling."""

    error: str
    traceback: str


def _run(trial: Trial, root: SeedSequence, index: int) -> Any:
    """Do one run, wherever this is called."""
    try:
        # What takes long inside of one run is not told: the study tells how many runs there are.
        with stages("run", progress=False):
            return trial(default_rng(child_of(root, index)))
    except (Exception, SystemExit) as error:
        # A library that calls sys.exit ends its own run and no other.
        lines = traceback.format_exception_only(error)
        return Raised(lines[-1].strip(), traceback.format_exc())


def child_of(root: SeedSequence, index: int) -> SeedSequence:
    """Return the index-th of ``root.spawn``, without counting in root."""
    return SeedSequence(root.entropy, spawn_key=(*root.spawn_key, index), pool_size=root.pool_size)


def root_seed(seed: Seed) -> SeedSequence:
    """Turn what the caller gave into a seed sequence of our own."""
    if not isinstance(seed, SeedSequence):
        try:
            return SeedSequence(seed)
        except (TypeError, ValueError) as error:
            raise type(error)(f"seed: expected integers of 0 or more, a SeedSequence or None, got {seed!r}") from error
    if seed.n_children_spawned:
        raise ValueError(
            f"seed: expected a SeedSequence that has not spawned, found {seed.n_children_spawned} children, "
            "whose random numbers the runs would repeat; use seed.spawn(1)[0]"
        )
    return SeedSequence(seed.entropy, spawn_key=seed.spawn_key, pool_size=seed.pool_size)


def outcomes_of(
    trial: Trial, root: SeedSequence, indices: Sequence[int], n_jobs: int | None
) -> collections.abc.Generator[Any, None, None]:
    """Yield the outcome of each run in order, as soon as it and those before are there."""
    try:
        import joblib
    except ImportError as error:
        raise ImportError("monte_carlo needs joblib; use pip install robust_filterpy[studies]") from error
    task = joblib.delayed(_run)
    try:
        parallel = joblib.Parallel(n_jobs=n_jobs, return_as="generator")
    except ValueError:
        # Not every back end can hand over runs one by one.
        parallel = joblib.Parallel(n_jobs=n_jobs)
        size = max(-(-len(indices) // 20), 1)
        with parallel:
            for start in range(0, len(indices), size):
                yield from parallel(task(trial, root, i) for i in indices[start : start + size])
        return
    yield from parallel(task(trial, root, index) for index in indices)


def check_trial(trial: Trial) -> None:
    """Refuse what every run would fail with."""
    mend = "trial: expected a callable that takes one numpy Generator, got "
    if not callable(trial):
        raise TypeError(f"{mend}{trial!r}; use lambda rng: ... or functools.partial")
    try:
        signature = inspect.signature(trial)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(None)
    except TypeError as error:
        raise TypeError(f"{mend}signature {signature}: {error}") from None


def integer(name: str, value: Any) -> int:
    """Return an integer of any integer type."""
    if not isinstance(value, bool | np.bool_):
        try:
            return operator.index(value)
        except TypeError:
            pass
    raise TypeError(f"{name}: expected an integer, got {value!r}")


def run_numbers(runs: int | Iterable[int]) -> list[int]:
    """Return the numbers of the runs to do."""
    if isinstance(runs, Iterable) and not isinstance(runs, str) and bool(getattr(runs, "ndim", True)):
        numbers = [integer("runs", run) for run in runs]
    else:
        numbers = list(range(integer("runs", runs)))
    if not numbers or min(numbers) < 0:
        raise ValueError(f"runs: expected at least one run, numbered from 0, got {runs!r}")
    if len(set(numbers)) < len(numbers):
        raise ValueError("runs: expected every run once, found one repeated; a repeated run is the same run")
    return numbers


def stack_leaves(values: Sequence[Any], indices: NDArray[np.intp], name: str) -> Any:
    """Stack one branch of the results; name says where it is."""
    first = values[0]
    parts = _parts(first)
    if parts is None:
        leaves = [np.asarray(value) for value in values]
        for leaf, index in zip(leaves, indices, strict=True):
            if leaf.shape != leaves[0].shape:
                raise ValueError(
                    f"{name}: expected equal shapes, run {indices[0]} has {leaves[0].shape} and run {index} has "
                    f"{leaf.shape}; work on .results instead"
                )
        return np.stack(leaves)
    for value, index in zip(values, indices, strict=True):
        other = _parts(value)
        if type(value) is not type(first) or other is None or other.keys() != parts.keys():
            raise ValueError(
                f"{name}: expected the same structure in all runs, run {indices[0]} has {_describe(first)} and "
                f"run {index} has {_describe(value)}"
            )
    rows = [_parts(value) for value in values]
    stacked = {key: stack_leaves([row[key] for row in rows if row], indices, f"{name}[{key!r}]") for key in parts}
    if isinstance(first, tuple):
        return type(first)(*stacked.values()) if hasattr(first, "_fields") else tuple(stacked.values())
    return stacked


def _parts(value: Any) -> dict[Any, Any] | None:
    """Take a container apart by key; None for a leaf."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, tuple):
        return dict(zip(getattr(value, "_fields", range(len(value))), value, strict=True))
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return None


def _describe(value: Any) -> str:
    """Name a branch's type and keys."""
    parts = _parts(value)
    return type(value).__name__ + ("" if parts is None else f" with {list(parts)}")
