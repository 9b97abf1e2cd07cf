"""Pictures of what a filter did: states or parameters, and innovations; and what all pictures share.

Each function draws into ``ax`` (a new figure's if None) and returns it. Lines differ by style and lightness, clipped
samples by their marker, so that a print without color can be read. matplotlib is imported when something is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, count, numbers, positive
from robust_filterpy.diagnostics.recording import is_saver, of_saver

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# From dark to light, so that they differ in gray as well.
COLOURS = ("#08306b", "#a63603", "#2b8cbe", "#74a33e", "#fd8d3c", "#999999")
STYLES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1, 1, 1)))
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
    return several_axes(None, 1, 1, size)[0] if ax is None else ax


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
    if any(np.asarray(line.get_xdata()).dtype.kind == "M" for line in ax.lines):
        from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

        locator = AutoDateLocator()
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))
        ax.set_xlabel("time")
    else:
        ax.set_xlabel(f"time [{time_unit}]" if time_unit else "sample")
    ax.legend(loc="best", fontsize="small", framealpha=0.8)
    return ax


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


def deviations(name: str, covariances: Any, of: Array) -> Array | None:
    """Return sqrt of the diagonals of covariances of something, shape (N, n), if there are any."""
    if covariances is None:
        return None
    values, (length, n) = numbers(name, covariances), of.shape
    if values.shape != (length, n, n):
        raise ValueError(f"{name}: expected shape {(length, n, n)} for {length} rows of {n}, got {values.shape}")
    return np.asarray(np.sqrt(np.maximum(np.einsum("kii->ki", values), 0.0)))


def times_of(t: Any, length: int, source: Any = None) -> Any:
    """Return the abscissa: t, or the index that the source has, or the number of the sample; durations in seconds."""
    index: Any = getattr(source, "index", None) if t is None else t
    index = index.to_timestamp() if hasattr(index, "to_timestamp") else index
    # matplotlib shows the hours of the place.
    values = np.asarray(index.tz_localize(None) if getattr(index, "tz", None) is not None else index)
    if values.dtype.kind == "O" and values.size and hasattr(values.flat[0], "isoformat"):
        values = values.astype("datetime64[us]")
    elif values.dtype.kind == "m":
        values = values / np.timedelta64(1, "s")
    if t is None and values.dtype.kind not in "iufM":
        return np.arange(length, dtype=float)
    values = values if values.dtype.kind == "M" else numbers("t", values).ravel()
    if len(values) != length:
        raise ValueError(f"t: expected {length} times for {length} samples, got {len(values)}")
    return values


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


def plot_states(
    source: Any, covariances: ArrayLike | None = None, *, states: int | Sequence[int] | None = None,
    truth: ArrayLike | None = None, zs: ArrayLike | None = None, sigmas: float = 2.0, t: ArrayLike | None = None,
    names: Sequence[str] | None = None, unit: str = "", time_unit: str = "", ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Draw states over time, with bands of their standard deviation.

    Parameters
    ----------
    source : array_like of shape (N, n) or (N, n, 1), Saver, or TrackingResult
        Means of a batch, or a run; the states of a tracker are its parameters.
    covariances : array_like, shape (N, n, n), optional
        Covariances of a batch; without them there is no band.
    states : int or sequence of int, optional
        Which states; all by default.
    truth : array_like, shape (N,), (N, n) or (n,), optional
        True states; one column is the first chosen state's, n numbers are constants.
    zs : array_like, shape (N,), optional
        Measurements of the first chosen state, NaN where missing; drawn as dots.
    sigmas : float, default 2
        Half width of the band, in standard deviations.
    t : array_like, shape (N,), optional
        Times or dates; default the index of a pandas object, or the number of the sample.
    names : sequence of str, length n, optional
        Names of all states. Default: those of a tracker's run.
    unit, time_unit : str, default ""
        Units for the axes' labels.
    ax : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If lengths do not fit.

    Notes
    -----
    The axis shows what the states and the truth do; an outlier among zs beyond it is left outside, and so is the band
    of a tracker's first samples, where P is large.
    """
    tracked = is_run(source)
    if is_saver(source):
        mean = recorded(source, "x")
        covariances = recorded(source, "P").reshape(*mean.shape, -1)
    else:
        mean = rows("theta", source.theta) if tracked else rows("source", source)
    N, n = mean.shape
    deviation = deviations("covariances", covariances, mean)
    if tracked:
        # No band where nothing is estimated yet.
        deviation = np.where(np.isfinite(source.std), source.std, np.nan)
    width, which = positive("sigmas", sigmas), chosen("states", states, n)
    if names is None and tracked:
        names = source.names or None
    names = all_names(names, n, "theta" if tracked else "x")
    time, half = times_of(t, N, source), None if deviation is None else width * deviation
    real: dict[int, Any] = {}
    if truth is not None:
        values = numbers("truth", truth)
        values = np.tile(values, (N, 1)) if values.shape == (n,) != (N,) else rows("truth", values)
        if len(values) != N or values.shape[1] not in (1, n):
            raise ValueError(f"truth: expected shape {(N,)}, {(N, n)} or {(n,)}, got {np.shape(truth)}")
        real = dict(enumerate(values.T)) if values.shape[1] == n else {which[0]: values[:, 0]}
    seen = None if zs is None else rows("zs", zs)
    if seen is not None and seen.shape != (N, 1):
        raise ValueError(f"zs: expected {N} numbers, got shape {seen.shape}")
    ax = one_axes(ax)
    empty = not ax.has_data()
    for place, i in enumerate(which):
        lines = [mean[:, i]] if half is None else [mean[:, i], mean[:, i] - half[:, i], mean[:, i] + half[:, i]]
        with_band(ax, time, lines, names[i], place, f"±{width:g} sigma")
        if i in real:
            look: dict[str, Any] = {"color": "black", "linewidth": 1.5, "linestyle": (0, (1, 1.5))}
            ax.plot(time, real[i], label=f"{names[i]}, true", **look)
    if tracked and empty and half is not None:
        _look_at_the_paths(ax, half[:, which])
    if seen is not None:
        low, high = ax.get_ylim()
        margin = 0.25 * (high - low)
        ax.plot(time, seen, ".", color="0.6", markersize=3, zorder=1, label="measured")
        ax.set_ylim(low - margin, high + margin)
    several = "parameter" if tracked else "state"
    return finish(ax, several if len(which) > 1 else names[which[0]], unit, time_unit)


def plot_innovations(
    source: Any, covariances: ArrayLike | None = None, *, clipped: ArrayLike | None = None, component: int = 0,
    sigmas: float = 2.0, t: ArrayLike | None = None, unit: str = "", time_unit: str = "", ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Draw the innovations of one sensor, with the clipped ones marked.

    Parameters
    ----------
    source : array_like of shape (N, m), Saver, or TrackingResult
        Innovations y, or a run.
    covariances : array_like, shape (N, m, m), optional
        Innovation covariances S to innovations given as an array.
    clipped : array_like of bool, shape (N, m), optional
        Which innovations were clipped, to innovations given as an array.
    component : int, default 0
        Which sensor.
    sigmas : float, default 2
        Half width of the band, in standard deviations sqrt(S_ii).
    t, unit, time_unit, ax : optional
        As in `plot_states`.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If lengths do not fit.

    Notes
    -----
    Of a tracker's run the samples with a weight below 1 are marked; it has not kept S, so there is no band.
    """
    width, label = positive("sigmas", sigmas), "clipped"
    if is_run(source):
        y, covariances, clipped = rows("residual", source.residual), None, np.asarray(source.weights) < 1.0
        label = "weight below 1"
    elif is_saver(source):
        record = of_saver(source)
        y, covariances, clipped = record.y, record.S, record.clipped
    else:
        y = rows("source", source)
    marked = np.zeros(y.shape, bool) if clipped is None else rows("clipped", clipped) > 0
    if marked.shape != y.shape:
        raise ValueError(f"clipped: expected shape {y.shape}, that of the innovations, got {marked.shape}")
    deviation = deviations("covariances", covariances, y)
    (i,) = chosen("component", component, y.shape[1])
    time = times_of(t, len(y), source)
    ax = one_axes(ax)
    hit = marked[:, i]
    if deviation is not None:
        zero_band(ax, time, width * deviation[:, i], f"±{width:g} sigma")
    ax.plot(time[~hit], y[~hit, i], ".", color=COLOURS[0], markersize=4, label="innovation")
    ax.plot(time[hit], y[hit, i], "x", color=MARK, markersize=5, label=label)
    ax.axhline(0.0, color="black", linewidth=0.6)
    return finish(ax, "innovation" if y.shape[1] == 1 else f"innovation {i}", unit, time_unit)


def _look_at_the_paths(ax: Any, half: Any) -> None:
    """Fit the limits to the lines and to bands of ordinary width."""
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in ax.lines])
    drawn, half = drawn[np.isfinite(drawn)], half[np.isfinite(half)]
    if len(drawn) and len(half):
        margin = 3.0 * float(np.median(half)) + 0.05 * float(np.ptp(drawn))
        if margin > 0:
            ax.set_ylim(drawn.min() - margin, drawn.max() + margin)
