"""Repeat an experiment with other random numbers, and say what the repetitions show.

`monte_carlo` runs a trial many times, on as many processes as you like, with the same answer whatever their
number. `robust_filterpy.experiments.metrics` turns its results into the figures that a study prints: errors per step,
their ratio to the filter that knows which samples are outliers, percentages of fit, and intervals around all of them.

joblib does the work. Its back ends for Dask, Ray and Spark are chosen around the call, not in it::

    with joblib.parallel_config(backend="dask"):
        study = monte_carlo(trial, 1000)
"""

from __future__ import annotations

import collections.abc
import dataclasses
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from numpy.typing import NDArray

from robust_filterpy import _checks
from robust_filterpy._progress import progress_bar, stages
from robust_filterpy._warning import warn

Trial: TypeAlias = Callable[[Generator], Any]
Seed: TypeAlias = "int | Sequence[int] | SeedSequence | None"


class Raised(NamedTuple):
    """Carry an exception home as text: the exception itself may not survive pickling."""

    error: str
    traceback: str


def _run(trial: Trial, root: SeedSequence, index: int) -> Any:
    """Do one run, wherever this is called."""
    try:
        # What takes long inside of one run is not shown: the study says how many runs there are.
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


def run_numbers(runs: int | Iterable[int]) -> list[int]:
    """Return the numbers of the runs to do."""
    every = runs if isinstance(runs, Iterable) else range(_checks.count("runs", runs, 1))
    numbers = [_checks.count("runs", run) for run in every]
    if not numbers or len(set(numbers)) < len(numbers):
        raise ValueError(f"runs: expected at least one run and every run once, got {runs!r}")
    return numbers


def stack_leaves(values: Sequence[Any], indices: NDArray[np.intp], name: str) -> Any:
    """Stack one branch of the results; name says where it is."""
    parts = [_parts(value) for value in values]
    leaves = [np.asarray(value) for value in values] if parts[0] is None else []
    kinds: list[Any] = [leaf.shape for leaf in leaves] or [
        type(value).__name__ + ("" if part is None else f" with {list(part)}")
        for value, part in zip(values, parts, strict=True)
    ]
    for kind, index in zip(kinds, indices, strict=True):
        if kind != kinds[0]:
            raise ValueError(
                f"{name}: expected equal {'shapes' if leaves else 'structures'} in all runs, run {indices[0]} has "
                f"{kinds[0]} and run {index} has {kind}; work on .results instead"
            )
    if leaves:
        return np.stack(leaves)
    stacked = {key: stack_leaves([part[key] for part in parts if part], indices, f"{name}[{key!r}]")
               for key in parts[0] or ()}  # fmt: skip
    if isinstance(values[0], tuple):
        return type(values[0])(*stacked.values()) if hasattr(values[0], "_fields") else tuple(stacked.values())
    return stacked


def _parts(value: Any) -> dict[Any, Any] | None:
    """Take a container apart by key; None for a leaf."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, tuple):
        return dict(zip(getattr(value, "_fields", range(len(value))), value, strict=True))
    return dict(vars(value)) if dataclasses.is_dataclass(value) else None


class Failure(NamedTuple):
    """Describe a run that raised an exception.

    ``trial(numpy.random.default_rng(failure.seed))`` repeats it, and so does ``rerun(trial, seed, index)``.
    """

    index: int  # type: ignore[assignment]
    """Number of the run."""
    seed: SeedSequence
    """Seed of this run, unused."""
    error: str
    """Type and message of the exception."""
    traceback: str
    """Where it was raised, as Python prints it."""


@dataclasses.dataclass(frozen=True, eq=False)
class MonteCarloResult:
    """Hold what the runs of `monte_carlo` returned.

    Attributes
    ----------
    results : list
        What `trial` returned, one entry for each run that succeeded, in the order of the runs.
    indices : ndarray of int, shape (len(results),)
        Numbers of those runs.
    failures : list of Failure
        The runs that raised an exception.
    runs : int
        How many runs were asked for.
    seed : numpy.random.SeedSequence
        Seed of the whole study; ``rerun(trial, result.seed, index)`` repeats one run of it.
    stopped : str or None
        Why the study ended before its last run (``"KeyboardInterrupt"``, or the error of the back end);
        None if it did not.
    """

    results: list[Any]
    indices: NDArray[np.intp]
    failures: list[Failure]
    runs: int
    seed: SeedSequence
    stopped: str | None = None

    def __len__(self) -> int:
        """Count the runs that succeeded."""
        return len(self.results)

    def __repr__(self) -> str:
        """Count instead of printing every result."""
        stopped = f", stopped={self.stopped!r}" if self.stopped else ""
        return f"MonteCarloResult({len(self)} of {self.runs} runs, {len(self.failures)} failed{stopped})"

    def stacked(self) -> Any:
        """Stack the results leaf by leaf into arrays with a leading axis of runs.

        Returns
        -------
        same structure as one result
            A number becomes an array of shape (runs,), an array or list of shape s one of shape ``(runs, *s)``;
            a dict stays a dict, a tuple a tuple, a NamedTuple the same NamedTuple; a dataclass becomes a dict of
            its fields. Runs that failed have no row: row i belongs to run ``indices[i]``.

        Raises
        ------
        ValueError
            If no run succeeded, or the runs differ in structure or in the shape of a leaf.

        Examples
        --------
        >>> def trial(rng):
        ...     return {"path": rng.normal(size=5), "end": 1.0}
        >>> stack = monte_carlo(trial, 3).stacked()
        >>> stack["path"].shape, stack["end"].shape
        ((3, 5), (3,))
        """
        if not self.results:
            first = f"; run {self.failures[0].index}: {self.failures[0].error}" if self.failures else ""
            raise ValueError(f"results: expected at least one run that succeeded, found none{first}")
        return stack_leaves(self.results, self.indices, "result")


def monte_carlo(
    trial: Trial, runs: int | Iterable[int], seed: Seed = 0, n_jobs: int | None = None, progress: bool | None = None
) -> MonteCarloResult:
    """Run an experiment many times, each time with its own random numbers.

    Run i calls ``trial(numpy.random.default_rng(child))`` with the i-th child of ``SeedSequence(seed).spawn``, so
    its result depends on the trial, the seed and i only: not on the number of processes, nor on how many runs
    there are, nor on which of them failed.

    Parameters
    ----------
    trial : callable
        ``trial(rng)`` does one run with the `numpy.random.Generator` it is given and returns anything that can be
        pickled. It may be defined in a script or be a `functools.partial`. It should neither draw from numpy's
        global generator nor change objects that outlive it; both would tie the runs together.
    runs : int or iterable of int
        How many runs (0 .. runs-1), or the numbers of the runs to do: ``range(500, 1000)`` extends a study of 500.
    seed : int, sequence of int, SeedSequence or None
        Seed of the study. None takes a fresh one from the operating system, to be found in the result. A
        SeedSequence is not changed.
    n_jobs : int or None
        How many runs at a time, as in joblib: -1 is one per processor; None is 1, or what an enclosing
        `joblib.parallel_config` says. joblib's own worker processes share the processors' cores: each gets
        cpu_count // n_jobs threads for BLAS and OpenMP.
    progress : bool or None
        Show a progress bar (tqdm) on standard error: True always, False never, None from 2 s on; where that is no
        terminal, None writes a line now and then instead.

    Returns
    -------
    MonteCarloResult
        Fields ``results, indices, failures, runs, seed, stopped``; its `~MonteCarloResult.stacked` gives arrays.

    Raises
    ------
    TypeError
        If `trial` cannot be called, or `runs`, `n_jobs` or `seed` is of the wrong type.
    ValueError
        If `runs` is empty or negative or repeats a run, `n_jobs` is 0, or `seed` has spawned children already
        (the runs would get their random numbers).
    ImportError
        If joblib is missing, or `progress` is True and tqdm is missing.
    KeyboardInterrupt
        If it comes before the first run is done.

    Warns
    -----
    RuntimeWarning
        If a run fails (the others are kept, see ``failures``); if Ctrl-C or the death of a worker ends the
        study early (the runs done are kept, see ``stopped``).

    Notes
    -----
    An interrupted study keeps the runs in front of the first unfinished one, not all that happen to be ready:
    those would be the quick ones, and a mean over them is biased wherever the time depends on the outcome.

    A worker that is interrupted or dies takes its runs with it. Back ends that cannot deliver runs one by one
    (multiprocessing, Ray and Spark) deliver them in about twenty blocks, of which an
    interruption keeps the complete ones.

    Examples
    --------
    >>> study = monte_carlo(lambda rng: rng.normal(), 1000)
    >>> study
    MonteCarloResult(1000 of 1000 runs, 0 failed)
    >>> bool(abs(study.stacked().mean()) < 0.2)
    True
    >>> bool(rerun(lambda rng: rng.normal(), study.seed, 7) == study.results[7])
    True
    """
    if not callable(trial):
        raise TypeError(f"trial: expected a callable that takes one numpy Generator, got {trial!r}")
    indices = run_numbers(runs)
    root = root_seed(seed)
    if n_jobs is not None and not (isinstance(n_jobs, int) and n_jobs < 0):
        _checks.count("n_jobs", n_jobs, 1)
    outcomes = outcomes_of(trial, root, indices, n_jobs)
    bar = progress_bar(len(indices), progress, " runs", "monte_carlo")

    done: list[int] = []
    results: list[Any] = []
    failures: list[Failure] = []
    stopped = None
    try:
        for index, outcome in zip(indices, outcomes, strict=True):
            if isinstance(outcome, Raised):
                failures.append(Failure(index, child_of(root, index), *outcome))
                bar.set_postfix(failed=len(failures), refresh=False)
            else:
                results.append(outcome)
                done.append(index)
            bar.update()
    except (KeyboardInterrupt, Exception) as reason:
        # An error here is the back end's (a dead worker, a lost cluster, a result that cannot be pickled).
        if not results and not failures:
            raise
        stopped = traceback.format_exception_only(reason)[-1].strip()
    finally:
        bar.close()
        with warnings.catch_warnings():
            # joblib warns that finished runs are dropped; the Notes above say why they are.
            warnings.simplefilter("ignore")
            outcomes.close()

    # A signal between two appends would leave the lists unequal.
    del results[len(done) :]
    _warn_of(failures, stopped, len(done) + len(failures), len(indices))
    return MonteCarloResult(results, np.array(done, dtype=np.intp), failures, len(indices), root, stopped)


def rerun(trial: Trial, seed: Seed, index: int) -> Any:
    """Repeat one run of a study in this process, to debug it.

    Parameters
    ----------
    trial : callable
        The same as in `monte_carlo`.
    seed : int, sequence of int or SeedSequence
        The study's seed: the argument of `monte_carlo`, or ``result.seed``.
    index : int
        Number of the run, such as ``failure.index``.

    Returns
    -------
    object
        What ``trial(rng)`` returns; an exception it raises comes through.

    Raises
    ------
    ValueError
        If `index` is negative, or `seed` is None, which no run can be repeated from.

    Examples
    --------
    >>> def trial(rng):
    ...     return rng.integers(10, size=3)
    >>> bool((rerun(trial, 0, 5) == monte_carlo(trial, 8, seed=0).results[5]).all())
    True
    """
    if seed is None:
        raise ValueError("seed: expected the study's seed, got None; use result.seed")
    return trial(default_rng(child_of(root_seed(seed), _checks.count("index", index))))


def _warn_of(failures: Sequence[Failure], stopped: str | None, done: int, runs: int) -> None:
    """Tell the caller of monte_carlo what is missing from its result."""
    if failures:
        first = failures[0]
        warn(
            f"{len(failures)} of {done} runs failed, first run {first.index}: {first.error}; "
            f"rerun(trial, result.seed, {first.index}) repeats it",
            RuntimeWarning,
        )
    if stopped:
        warn(f"ended after {done} of {runs} runs: {stopped}", RuntimeWarning)
