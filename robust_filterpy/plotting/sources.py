"""What is to be drawn, as arrays: from batch results, a Saver or a tracker's run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array, count, numbers, positive
from robust_filterpy.diagnostics.recording import is_saver
from robust_filterpy.plotting._style import with_band


class Paths(NamedTuple):
    """States or parameters over time, and which of them to draw."""

    mean: Array  # (N, n)
    half: Array | None  # (N, n), half widths of the bands
    time: Any
    which: list[int]
    names: list[str]
    band: str

    def draw(self, ax: Any, place: int) -> None:
        """Draw the path at a place, with its band."""
        i = self.which[place]
        mean, half = self.mean[:, i], None if self.half is None else self.half[:, i]
        lines = (mean,) if half is None else (mean, mean - half, mean + half)
        with_band(ax, self.time, lines, self.names[i], place, self.band)

    def label(self, several: str) -> str:
        """Return what the axis shows."""
        return several if len(self.which) > 1 else self.names[self.which[0]]


def paths(
    source: Any, covariances: Any, which: tuple[str, Any], names: tuple[str, Sequence[str] | None], sigmas: Any, t: Any
) -> Paths:
    """Return what is to be drawn of a source; which: name of the argument and its value; names: stem and names."""
    mean, deviation = mean_and_deviation(source, covariances)
    N, n = mean.shape
    times, columns = time(t, N, source), chosen(*which, n)
    named, width = all_names(names[1], n, names[0]), positive("sigmas", sigmas)
    half = None if deviation is None else width * deviation
    return Paths(mean, half, times, columns, named, f"±{width:g} sigma")


def is_run(source: Any) -> bool:
    """Tell the result of a tracker's run."""
    return all(hasattr(source, name) for name in ("theta", "std", "residual", "weights"))


def kept(saver: Any, name: str) -> Array:
    """Return a column of a Saver, shape (N, size), or say what it lacks."""
    values = saver.__dict__.get(name)
    if values is None or not len(values):
        raise ValueError(
            f"source: expected a Saver that kept {name!r}; call save() after each update of a robust filter"
        )
    return np.array([numbers(name, value).ravel() for value in values])


def rows(name: str, values: Any) -> Array:
    """Return an array as (N, size): (N,), (N, size) and (N, size, 1) are all understood."""
    if not hasattr(values, "__len__") and not hasattr(values, "__array__"):
        kind = "a Saver or the result of tracker.run(..)" if name == "source" else "an array"
        raise TypeError(f"{name}: expected {kind}, got {type(values).__name__}")
    array = numbers(name, values)
    if array.ndim == 0 or array.ndim > 3 or (array.ndim == 3 and array.shape[2] != 1):
        raise ValueError(f"{name}: expected shape (N,), (N, n) or (N, n, 1), got {array.shape}")
    return array.reshape(len(array), -1)


def mean_and_deviation(source: Any, covariances: Any) -> tuple[Array, Array | None]:
    """Return states or parameters (N, n) and their standard deviations."""
    if is_run(source):
        std = np.asarray(source.std)
        # No band where nothing is estimated yet.
        return np.asarray(source.theta), np.where(np.isfinite(std), std, np.nan)
    if is_saver(source):
        mean, covariance = kept(source, "x"), kept(source, "P")
        return mean, deviation("P", covariance.reshape(len(mean), mean.shape[1], -1), mean.shape[1])
    mean = rows("source", source)
    return mean, None if covariances is None else deviation("covariances", covariances, mean.shape[1], len(mean))


def deviation(name: str, covariances: Any, n: int, length: int | None = None) -> Array:
    """Return sqrt of the diagonals, shape (N, n)."""
    values = numbers(name, covariances)
    length = len(values) if length is None else length
    if values.shape != (length, n, n):
        raise ValueError(f"{name}: expected shape {(length, n, n)} for {length} rows of {n}, got {values.shape}")
    return np.asarray(np.sqrt(np.maximum(np.einsum("kii->ki", values), 0.0)))


def time(t: Any, length: int, source: Any = None) -> Any:
    """Return the abscissa: t, or the index that the source has, or the number of the sample."""
    index = getattr(source, "index", None) if t is None else t
    if t is None and (index is None or callable(index)):
        return np.arange(length, dtype=float)
    values = dates(index)
    if values is None:
        kind = np.asarray(index).dtype.kind
        values = np.arange(length, dtype=float) if t is None and kind not in "iuf" else numbers("t", index).ravel()
    if len(values) != length:
        raise ValueError(f"t: expected {length} times for {length} samples, got {len(values)}")
    return values


def dates(values: Any) -> Any:
    """Return dates as datetime64, durations as seconds; None if values are neither."""
    if hasattr(values, "to_timestamp"):
        values = values.to_timestamp()
    # matplotlib shows the hours of the place.
    if getattr(values, "tz", None) is not None:
        values = values.tz_localize(None)
    stamps = np.asarray(values)
    if stamps.dtype.kind == "O" and stamps.size and hasattr(stamps.flat[0], "isoformat"):
        stamps = stamps.astype("datetime64[us]")
    if stamps.dtype.kind == "m":
        return stamps.astype("timedelta64[ns]").astype(float) * 1e-9
    return stamps if stamps.dtype.kind == "M" else None


def chosen(name: str, which: Any, n: int) -> list[int]:
    """Return the numbers of the columns to draw."""
    if which is None:
        return list(range(n))
    each = list(which) if isinstance(which, (Sequence, np.ndarray)) else [which]
    for i in each:
        if count(name, i) >= n:
            raise ValueError(f"{name}: expected numbers below {n}, got {i}")
    return each


def column(name: str, values: Any, length: int) -> Array:
    """Return values as one column of that length."""
    one = rows(name, values)
    if one.shape != (length, 1):
        raise ValueError(f"{name}: expected {length} numbers, got shape {one.shape}")
    return one[:, 0]


def all_names(names: Sequence[str] | None, n: int, stem: str) -> list[str]:
    """Return a name for each column."""
    if names is None:
        return [f"{stem}[{i}]" for i in range(n)]
    if isinstance(names, str) or len(names) != n:
        raise ValueError(f"names: expected {n} names, got {names!r}")
    return list(names)
