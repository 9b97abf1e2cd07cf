"""What all pictures share: colors, axes, labels, bands, legends; what is to be drawn of a source, as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from robust_filterpy._checks import Array, count, numbers
from robust_filterpy.diagnostics.recording import is_saver

# From dark to light, so that they differ in gray as well.
COLOURS = ("#08306b", "#a63603", "#2b8cbe", "#74a33e", "#fd8d3c", "#999999")
STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1, 1, 1)))
MARKERS = ("o", "x", "^", "s", "+", "d")
MARK = "#cb181d"


# The same filter looks the same in every picture, and no two alike to the color-blind.
LOOKS: dict[str, dict[str, Any]] = {
    "Kalman": {"color": COLOURS[1], "linestyle": "--"},
    "gate": {"color": "#e6ab02", "linestyle": ":"},
    "Huber": {"color": COLOURS[0], "linestyle": "-"},
    "Tukey": {"color": COLOURS[2], "linestyle": "-."},
    "learnt": {"color": "#41ab5d", "linestyle": (0, (5, 1))},
    "ideal": {"color": COLOURS[5], "linestyle": (0, (3, 1, 1, 1, 1, 1))},
}


def one_axes(ax: Any, size: tuple[float, float] = (7.0, 3.6)) -> Any:
    """Return ax, or that of a new figure."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.subplots(figsize=size, layout="constrained")[1]


def several_axes(axes: Any, rows: int, columns: int, size: tuple[float, float], **options: Any) -> Any:
    """Return axes as an array of rows times columns, or those of a new figure."""
    if axes is not None:
        flat = np.atleast_1d(np.asarray(axes, dtype=object)).ravel()
        if flat.size != rows * columns:
            raise ValueError(f"axes: expected {rows * columns} matplotlib axes, got {flat.size}")
        return flat
    import matplotlib.pyplot as plt

    return plt.subplots(rows, columns, figsize=size, layout="constrained", squeeze=False, **options)[1].ravel()


def finish(ax: Any, what: str, unit: str, time_unit: str) -> Any:
    """Label axes over time and return them."""
    ax.set_ylabel(f"{what} [{unit}]" if unit else what)
    if has_dates(ax):
        from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

        locator = AutoDateLocator()
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        ax.set_xlabel("time")
    else:
        ax.set_xlabel(f"time [{time_unit}]" if time_unit else "sample")
    ax.legend(loc="best", fontsize="small", framealpha=0.8)
    return ax


def has_dates(ax: Any) -> bool:
    """Tell whether the lines are drawn over dates."""
    return any(np.asarray(line.get_xdata()).dtype.kind == "M" for line in ax.lines)


def legend_outside(ax: Any) -> None:
    """Put the legend to the right of the data."""
    ax.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, fontsize="small", frameon=False)


def line_of(place: int) -> dict[str, Any]:
    """Return color and style of the line at a place; they come again after six."""
    return {"color": COLOURS[place % 6], "linestyle": STYLES[place % 6]}


def zero_band(ax: Any, x: Any, half: Any, label: str, **options: Any) -> None:
    """Draw the band about 0 in which nothing means anything."""
    ax.fill_between(x, -half, half, color="0.85", linewidth=0, label=label, **options)


def stems(ax: Any, x: Any, y: Any, colour: str, marker: str, label: str) -> None:
    """Draw values as marks on stems from 0."""
    ax.vlines(x, 0.0, y, color=colour, linewidth=1.2)
    ax.plot(x, y, marker, color=colour, markersize=5, linestyle="none", label=label)


def ring(ax: Any, x: Any, y: Any) -> None:
    """Draw a ring around what was chosen."""
    ax.plot(x, y, "o", color=MARK, markersize=10, fillstyle="none", markeredgewidth=1.8, label="chosen")


def with_band(ax: Any, x: Any, lines: Any, name: str, place: int, band: str, steps: bool = False) -> None:
    """Draw the line of a place, and from the second to the third line its band, which the first place explains."""
    (line, *edges), look = lines, line_of(place)
    if edges:
        label, step = band if place == 0 else "_nolegend_", "post" if steps else None
        ax.fill_between(x, *edges, step=step, color=look["color"], alpha=0.2, linewidth=0, label=label)
    ax.plot(x, line, linewidth=1.4, label=name, drawstyle="steps-post" if steps else "default", **look)


def is_run(source: Any) -> bool:
    """Tell the result of a tracker's run."""
    return all(hasattr(source, name) for name in ("theta", "std", "residual", "weights"))


def recorded(saver: Any, name: str) -> Array:
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
        mean, covariance = recorded(source, "x"), recorded(source, "P")
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


def all_names(names: Sequence[str] | None, n: int, stem: str) -> list[str]:
    """Return a name for each column."""
    if names is None:
        return [f"{stem}[{i}]" for i in range(n)]
    if isinstance(names, str) or len(names) != n:
        raise ValueError(f"names: expected {n} names, got {names!r}")
    return list(names)
