"""Pictures of what a filter did: states or parameters, innovations, weights.

Each function draws into ``ax`` (a new figure's if None) and returns it. Lines differ by style and lightness, clipped
samples by their marker, so that a print without color can be read. matplotlib is imported when something is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy.diagnostics.recording import is_saver
from robust_filterpy.plotting import _style as style

if TYPE_CHECKING:
    from matplotlib.axes import Axes


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
    mean, deviation = style.mean_and_deviation(source, covariances)
    (N, n), is_run = mean.shape, style.is_run(source)
    width, which = _checks.positive("sigmas", sigmas), style.chosen("states", states, n)
    if names is None and is_run:
        names = source.names or None
    names = style.all_names(names, n, "theta" if is_run else "x")
    time, half = style.time(t, N, source), None if deviation is None else width * deviation
    real: dict[int, Any] = {}
    if truth is not None:
        values = _checks.numbers("truth", truth)
        values = np.tile(values, (N, 1)) if values.shape == (n,) != (N,) else style.rows("truth", values)
        if len(values) != N or values.shape[1] not in (1, n):
            raise ValueError(f"truth: expected shape {(N,)}, {(N, n)} or {(n,)}, got {np.shape(truth)}")
        real = dict(enumerate(values.T)) if values.shape[1] == n else {which[0]: values[:, 0]}
    seen = None if zs is None else style.rows("zs", zs)
    if seen is not None and seen.shape != (N, 1):
        raise ValueError(f"zs: expected {N} numbers, got shape {seen.shape}")
    ax = style.one_axes(ax)
    empty = not ax.has_data()
    for place, i in enumerate(which):
        lines = [mean[:, i]] if half is None else [mean[:, i], mean[:, i] - half[:, i], mean[:, i] + half[:, i]]
        style.with_band(ax, time, lines, names[i], place, f"±{width:g} sigma")
        if i in real:
            look = {"color": "black", "linewidth": 1.5, "linestyle": (0, (1, 1.5))}
            ax.plot(time, real[i], label=f"{names[i]}, true", **look)
    if is_run and empty and half is not None:
        _look_at_the_paths(ax, half[:, which])
    if seen is not None:
        low, high = ax.get_ylim()
        margin = 0.25 * (high - low)
        ax.plot(time, seen, ".", color="0.6", markersize=3, zorder=1, label="measured")
        ax.set_ylim(low - margin, high + margin)
    several = "parameter" if is_run else "state"
    return style.finish(ax, several if len(which) > 1 else names[which[0]], unit, time_unit)


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
    width = _checks.positive("sigmas", sigmas)
    label = "clipped"
    if style.is_run(source):
        y, covariances, clipped = np.asarray(source.residual)[:, None], None, np.asarray(source.weights) < 1.0
        label = "weight below 1"
    elif is_saver(source):
        y, there = style.recorded(source, "y"), source.__dict__
        clipped = style.recorded(source, "clipped") if "clipped" in there else None
        if "weights" in there:
            y = np.where(np.isnan(style.recorded(source, "weights")), np.nan, y)
        covariances = style.recorded(source, "S").reshape(len(y), y.shape[1], -1)
    else:
        y = style.rows("source", source)
    marked = np.zeros(y.shape, bool) if clipped is None else style.rows("clipped", clipped) > 0
    if marked.shape != y.shape:
        raise ValueError(f"clipped: expected shape {y.shape}, that of the innovations, got {marked.shape}")
    deviation = None if covariances is None else style.deviation("covariances", covariances, y.shape[1], len(y))
    (i,) = style.chosen("component", component, y.shape[1])
    time = style.time(t, len(y), source)
    ax = style.one_axes(ax)
    hit = marked[:, i]
    if deviation is not None:
        style.zero_band(ax, time, width * deviation[:, i], f"±{width:g} sigma")
    ax.plot(time[~hit], y[~hit, i], ".", color=style.COLOURS[0], markersize=4, label="innovation")
    ax.plot(time[hit], y[hit, i], "x", color=style.MARK, markersize=5, label=label)
    ax.axhline(0.0, color="black", linewidth=0.6)
    return style.finish(ax, "innovation" if y.shape[1] == 1 else f"innovation {i}", unit, time_unit)


def plot_weights(
    source: Any, *, components: int | Sequence[int] | None = None, t: ArrayLike | None = None,
    names: Sequence[str] | None = None, time_unit: str = "", ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Draw how much of each measurement was believed: psi(e)/e over time.

    Parameters
    ----------
    source : array_like of shape (N,) or (N, m), Saver, or TrackingResult
        Weights, NaN where a component was missing, or a run.
    components : int or sequence of int, optional
        Which sensors; all by default.
    names : sequence of str, length m, optional
        Names of all sensors.
    t, time_unit, ax : optional
        As in `plot_states`.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If lengths do not fit.
    """
    if style.is_run(source):
        weights = np.asarray(source.weights)[:, None]
    elif is_saver(source):
        weights = style.recorded(source, "weights")
    else:
        weights = style.rows("source", source)
    time = style.time(t, len(weights), source)
    names = style.all_names(names, weights.shape[1], "z")
    which = style.chosen("components", components, weights.shape[1])
    ax = style.one_axes(ax)
    for place, i in enumerate(which):
        marker, colour = style.MARKERS[place % 6], style.COLOURS[place % 6]
        ax.plot(time, weights[:, i], marker, color=colour, markersize=3.5, fillstyle="none", label=names[i])
    ax.set_ylim(-0.05, 1.05)
    return style.finish(ax, "weight", "", time_unit)


def _look_at_the_paths(ax: Any, half: Any) -> None:
    """Fit the limits to the lines and to bands of ordinary width."""
    drawn = np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in ax.lines])
    drawn, half = drawn[np.isfinite(drawn)], half[np.isfinite(half)]
    if len(drawn) and len(half):
        margin = 3.0 * float(np.median(half)) + 0.05 * float(np.ptp(drawn))
        if margin > 0:
            ax.set_ylim(drawn.min() - margin, drawn.max() + margin)
