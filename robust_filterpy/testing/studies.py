"""Repeat an experiment with other random numbers, and say how far the figures that it gives can be trusted.

joblib does the work. Its back ends for Dask and the like are chosen around the call, not in it::

    with joblib.parallel_config(backend="dask"):
        study = monte_carlo(trial, 1000)
"""

from __future__ import annotations

import dataclasses
import inspect
import traceback
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from numpy.typing import ArrayLike, NDArray

from robust_filterpy import _checks
from robust_filterpy._progress import stage, stages
from robust_filterpy._warning import warn

__all__ = ["bootstrap_interval", "monte_carlo", "rerun"]

Trial: TypeAlias = Callable[[Generator], Any]
Seed: TypeAlias = "int | Sequence[int] | SeedSequence | None"


class Failure(NamedTuple):
    """Describe a run that raised an exception.

    ``trial(numpy.random.default_rng(failure.seed))`` repeats it, and so does ``rerun(trial, seed, index)``.
    """

    #: Number of the run.
    index: int  # type: ignore[assignment]
    #: Seed of this run, unused.
    seed: SeedSequence
    #: Type and message of the exception, as text: the exception itself may not survive pickling.
    error: str
    #: Where it was raised, as Python prints it.
    traceback: str


def _run(trial: Trial, root: SeedSequence, index: int) -> Any:
    """Do one run, wherever this is called."""
    try:
        # What takes long inside of one run is not shown: the study says how many runs there are.
        with stages("run", progress=False):
            return trial(default_rng(_child_of(root, index)))
    except (Exception, SystemExit) as error:
        # A library that calls sys.exit ends its own run and no other.
        lines = traceback.format_exception_only(error)
        return Failure(index, _child_of(root, index), lines[-1].strip(), traceback.format_exc())


def _child_of(root: SeedSequence, index: int) -> SeedSequence:
    """Return the index-th of ``root.spawn``, without counting in root."""
    return SeedSequence(root.entropy, spawn_key=(*root.spawn_key, index), pool_size=root.pool_size)


def _root_seed(seed: Seed) -> SeedSequence:
    """Return the seed sequence that was given, or one of what was given, or raise."""
    if not isinstance(seed, SeedSequence):
        try:
            return SeedSequence(seed)
        except (TypeError, ValueError) as error:
            raise type(error)(f"seed: expected integers of 0 or more, a SeedSequence or None, got {seed!r}") from error
    if seed.n_children_spawned:
        raise ValueError(
            f"seed: expected a SeedSequence that has not spawned, got one with {seed.n_children_spawned} children, "
            "whose random numbers the runs would repeat; use seed.spawn(1)[0]"
        )
    return SeedSequence(seed.entropy, spawn_key=seed.spawn_key, pool_size=seed.pool_size)


def _stacked(values: Sequence[Any], indices: NDArray[np.intp], name: str) -> Any:
    """Stack one branch of the results; name says where it is."""
    values = [vars(value) if dataclasses.is_dataclass(value) else value for value in values]
    first = values[0]
    branches = isinstance(first, (Mapping, tuple))
    leaves = [] if branches else [np.asarray(value) for value in values]
    kinds: list[Any] = [leaf.shape for leaf in leaves] or [
        f"{type(value).__name__} with {list(value if isinstance(value, Mapping) else range(len(value)))}"
        for value in values
    ]
    for kind, index in zip(kinds, indices, strict=True):
        if kind != kinds[0]:
            raise ValueError(
                f"{name}: expected equal {'structures' if branches else 'shapes'} in all runs, run {indices[0]} has "
                f"{kinds[0]} and run {index} has {kind}; work on .results instead"
            )
    if not branches:
        return np.stack(leaves)
    keys = list(first) if isinstance(first, Mapping) else range(len(first))
    parts = [_stacked([value[key] for value in values], indices, f"{name}[{key!r}]") for key in keys]
    if isinstance(first, Mapping):
        return dict(zip(keys, parts, strict=True))
    return type(first)(*parts) if hasattr(first, "_fields") else tuple(parts)


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
            raise ValueError(f"results: expected at least one run that succeeded, got none{first}")
        return _stacked(self.results, self.indices, "result")


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
        Seed of the study. None takes a fresh one from the operating system, which the result names. A
        SeedSequence is not changed.
    n_jobs : int or None
        How many runs at a time, as in joblib: -1 is one per processor; None is 1, or what an enclosing
        `joblib.parallel_config` says, of a back end that delivers runs one by one. joblib's own worker processes share
        the processors' cores: each gets cpu_count // n_jobs threads for BLAS and OpenMP.
    progress : bool or None
        Whether to say on standard error how many runs are done: by default after 2 s.

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
        If joblib is missing.
    KeyboardInterrupt
        If it comes before the first run is done (later it ends the study, the runs done are kept, see ``stopped``).

    Notes
    -----
    An interrupted study keeps the runs in front of the first unfinished one, not all that happen to be ready:
    those would be the quick ones, and a mean over them is biased wherever the time depends on the outcome.

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
    every = runs if isinstance(runs, Iterable) else range(_checks.count("runs", runs, 1))
    indices = [_checks.count("runs", run) for run in every]
    if not indices or len(set(indices)) < len(indices):
        raise ValueError(f"runs: expected at least one run and every run once, got {runs!r}")
    root = _root_seed(seed)
    if n_jobs is not None and not (isinstance(n_jobs, int) and n_jobs < 0):
        _checks.count("n_jobs", n_jobs, 1)
    try:
        import joblib
    except ImportError as error:
        raise ImportError("monte_carlo needs joblib; use pip install robust_filterpy[studies]") from error
    outcomes = joblib.Parallel(n_jobs=n_jobs, return_as="generator")(
        joblib.delayed(_run)(trial, root, index) for index in indices
    )
    done: list[Any] = []
    stopped, failed = None, 0
    try:
        with stages("monte_carlo", progress):
            for outcome in outcomes:
                done.append(outcome)
                failed += isinstance(outcome, Failure)
                stage(f"{len(done)} of {len(indices)} runs{f', {failed} failed' if failed else ''}")
    except (KeyboardInterrupt, Exception) as reason:
        # An error here is the back end's (a dead worker, a lost cluster, a result that cannot be pickled).
        if not done:
            raise
        stopped = traceback.format_exception_only(reason)[-1].strip()
    finally:
        with warnings.catch_warnings():
            # joblib warns that finished runs are dropped; the Notes above say why they are.
            warnings.simplefilter("ignore")
            outcomes.close()
    failures = [one for one in done if isinstance(one, Failure)]
    if failures:
        warn(
            f"{len(failures)} of {len(done)} runs failed, first run {failures[0].index}: {failures[0].error}; "
            f"rerun(trial, result.seed, {failures[0].index}) repeats it",
            RuntimeWarning,
        )
    if stopped:
        warn(f"ended after {len(done)} of {len(indices)} runs: {stopped}", RuntimeWarning)
    succeeded = [(i, one) for i, one in zip(indices, done, strict=False) if not isinstance(one, Failure)]
    numbers = np.array([i for i, _ in succeeded], dtype=np.intp)
    return MonteCarloResult([one for _, one in succeeded], numbers, failures, len(indices), root, stopped)


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
    return trial(default_rng(_child_of(_root_seed(seed), _checks.count("index", index))))


class Interval(NamedTuple):
    """Hold an estimate and its confidence interval; every field has the shape of one run's sample."""

    #: The statistic of the samples.
    estimate: Any
    #: Lower end of the interval.
    low: Any
    #: Upper end of the interval.
    high: Any
    #: Standard deviation of the statistic over the resamples.
    standard_error: Any


_STATISTICS: dict[str, Callable[..., Any]] = {
    "mean": np.mean, "median": np.median,
    "rms": lambda samples, axis: np.sqrt(np.mean(samples**2, axis=axis)),
    "ratio": lambda error, reference, axis: np.mean(error, axis=axis) / np.mean(reference, axis=axis),
}  # fmt: skip


def bootstrap_interval(
    samples: ArrayLike | tuple[ArrayLike, ...], statistic: str | Callable[..., Any] = "mean", level: float = 0.95,
    rng: int | Generator | None = None, n_resamples: int = 9999, method: str = "BCa",
) -> Interval:  # fmt: skip
    """Find a confidence interval by resampling whole runs (`scipy.stats.bootstrap`).

    Parameters
    ----------
    samples : array_like, shape (runs, ...), or a tuple of such arrays of the same runs
        What the runs gave. Several arrays are resampled together, run by run: filters compared on the same
        noise share its luck, and their ratio is far more certain than their errors.
    statistic : {"mean", "median", "rms", "ratio"} or callable
        "ratio" is the mean of the first of two arrays over the mean of the second. A callable takes
        as many arrays as there are samples, and ``axis``.
    level : float
        Confidence level, between 0 and 1.
    rng : int, numpy.random.Generator or None
        Source of the resampling.
    n_resamples : int
        How many resamples.
    method : {"BCa", "percentile", "basic"}
        As in `scipy.stats.bootstrap`; for "BCa", bias-corrected and accelerated.

    Returns
    -------
    Interval
        Fields ``estimate, low, high, standard_error``: floats, or arrays of shape (...): one interval for each
        element, not a band for all of them at once.

    Raises
    ------
    ValueError
        If there are fewer than two runs, the arrays differ in shape, or an argument is out of its range.

    Notes
    -----
    Where all resamples agree, as at a first step common to all runs, the interval is that point.
    The time is proportional to ``n_resamples * samples.size``.

    Examples
    --------
    >>> errors = np.random.default_rng(0).exponential(size=200)
    >>> interval = bootstrap_interval(errors, rng=1)
    >>> bool(interval.low < errors.mean() < interval.high)
    True
    """
    from scipy import stats

    function = statistic if callable(statistic) else _STATISTICS[_checks.option("statistic", statistic, _STATISTICS)]
    arrays = [np.asarray(value, dtype=float) for value in (samples if isinstance(samples, tuple) else (samples,))]
    if not callable(statistic) and len(arrays) != (2 if statistic == "ratio" else 1):
        wanted = "a tuple of two arrays" if statistic == "ratio" else "one array"
        raise ValueError(
            f"samples: expected {wanted} for statistic={statistic!r}, got {len(arrays)}; "
            "use np.asarray(samples) if a tuple was meant as one array"
        )
    for i, array in enumerate(arrays):
        if array.size == 0 or np.shape(array)[:1] < (2,) or array.shape != arrays[0].shape:
            wanted = "(runs, ...), at least 2 runs" if not i else f"{arrays[0].shape} as samples[0] has it"
            raise ValueError(f"samples[{i}]: expected shape {wanted}, got {array.shape}")
    if not 0 < level < 1:
        raise ValueError(f"level: expected a number between 0 and 1, got {level!r}; use 0.95 for 95 percent")
    _checks.option("method", method, ("BCa", "percentile", "basic"))
    _checks.count("n_resamples", n_resamples, 2)

    # Of a study with many steps all resamples at once would not fit into memory.
    batch = max(1, 4_000_000 // sum(array.size for array in arrays))
    # scipy calls the argument `rng` from 1.15 on and will drop the older name.
    source = "rng" if "rng" in inspect.signature(stats.bootstrap).parameters else "random_state"
    with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):
        warnings.filterwarnings("ignore", category=stats.DegenerateDataWarning)
        interval = stats.bootstrap(
            arrays, function, paired=True, axis=0, confidence_level=level, n_resamples=n_resamples, batch=batch,
            method=method, **{source: default_rng(rng)},
        )  # fmt: skip
        estimate = np.asarray(function(*arrays, axis=0))
    error = np.asarray(interval.standard_error)
    ends = (np.where(error == 0, estimate, end) for end in interval.confidence_interval)
    fields = (np.asarray(field, dtype=float) for field in (estimate, *ends, error))
    return Interval(*(field if field.ndim else float(field) for field in fields))
