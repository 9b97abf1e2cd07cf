"""Pictures of the workbench: which structure, what is left in the residuals, which model.

Legends stand next to the data. matplotlib is imported when something is drawn.
"""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from robust_filterpy import _checks
from robust_filterpy.identification.judging.select import Selection
from robust_filterpy.identification.judging.validate import Comparison, Validation, Validations
from robust_filterpy.plotting import _style as style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Structures further than this from the best one's fit, in percent, are left below the picture.
_DEEP: Final = 30.0


def plot_validation(validation: Validation | Validations, *, axes: Any = None) -> Any:
    """Draw what a model leaves in its residuals: correlations with their bounds, the verdict above.

    Parameters
    ----------
    validation : Validation or Validations
        What `validate` returned; of several outputs each has a figure.
    axes : sequence of matplotlib.axes.Axes, optional
        Where to draw: one for the residuals among themselves and one for each input; of Validations one such sequence
        for each.

    Returns
    -------
    ndarray of matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If there are not as many axes as pictures.
    """
    if isinstance(validation, Validations):
        places = [None] * len(validation) if axes is None else axes
        drawn = [plot_validation(one, axes=place) for one, place in zip(validation, places, strict=True)]
        for j, (one, own) in enumerate(zip(validation, drawn, strict=True)):
            own[0].figure.suptitle(textwrap.fill(f"output {j}: {one.verdict}", 80), fontsize="medium")
        return np.array(drawn)
    panels = [("residuals among themselves", 1, validation.autocorrelation, validation.autocorrelation_bound)]
    several = len(validation.cross_correlation) > 1
    for i, pair in enumerate(zip(validation.cross_correlation, validation.cross_bound, strict=True)):
        panels.append((f"input {i} and residuals" if several else "input and residuals", 0, *pair))
    axes = style.several_axes(axes, len(panels), 1, (7.5, 0.8 + 2.1 * len(panels)), sharex=True)
    for ax, (title, first, values, bound) in zip(axes, panels, strict=True):
        lags = np.arange(first, first + values.size)
        outside = np.abs(values) > bound
        style.zero_band(ax, lags, bound, f"{100 * validation.level:.4g} % bound", step="mid")
        ax.axhline(0.0, color="black", linewidth=0.6)
        style.stems(ax, lags[~outside], values[~outside], style.COLOURS[0], "o", "within")
        style.stems(ax, lags[outside], values[outside], style.MARK, "x", "outside")
        ax.set(ylabel="correlation", title=title)
        ax.xaxis.get_major_locator().set_params(integer=True)
        ax.title.set_fontsize("medium")
        style.legend_outside(ax)
    axes[-1].set_xlabel("lag [samples]")
    axes[0].figure.suptitle(textwrap.fill(validation.verdict, 80), fontsize="medium")
    return axes


def plot_structure_selection(selection: Selection, *, axes: Any = None) -> Any:
    """Draw the fit and the criterion of all structures against their complexity, and the impulse response.

    Parameters
    ----------
    selection : Selection
        What `select_structure` returned.
    axes : sequence of matplotlib.axes.Axes, optional
        Where to draw: fit, criterion, and the impulse response to each input if there are any.

    Returns
    -------
    ndarray of matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If there are not as many axes as pictures.

    Notes
    -----
    Fits more than 30 points below the best one's are left below the picture.
    """
    responses, rows = selection.impulse_responses, selection.rows
    axes = style.several_axes(axes, 2 + len(responses), 1, (7.5, 4.6 + 2.2 * len(responses)))
    size = np.array([row.structure.n_theta for row in rows])
    fit, criterion = (np.array([getattr(row, name) for row in rows]) for name in ("fit", "criterion"))
    shows = np.array([row.shows_delay for row in rows])
    above = criterion - criterion[0]
    for ax, values, best_of in ((axes[0], fit, np.nanmax), (axes[1], above, np.nanmin)):
        ax.plot(size[shows], values[shows], "o", color=style.COLOURS[2], markersize=5, label="tried")
        if not shows.all():
            ax.plot(size[~shows], values[~shows], "x", color=style.COLOURS[5], markersize=5, label="first b is 0")
        sizes = np.unique(size[shows]) if shows.any() else np.unique(size)
        counted = shows if shows.any() else ~shows
        front = [best_of(values[counted & (size == n)]) for n in sizes]
        ax.plot(sizes, front, color=style.COLOURS[0], linewidth=1.2, label="best of its size")
        style.ring(ax, size[:1], values[:1])
        ax.xaxis.get_major_locator().set_params(integer=True)
    best = float(np.nanmax(fit))
    worst = max(float(np.nanmin(fit)), best - _DEEP)
    margin = 0.08 * (best - worst) + 0.1
    axes[0].set(ylabel="fit [%]", ylim=(worst - margin, best + margin), title=f"chosen: {rows[0].structure}")
    axes[1].set_yscale("symlog", linthresh=10.0)
    axes[1].set(ylabel=f"{selection.criterion} above the best", xlabel="parameters")
    style.legend_outside(axes[0])
    for i, (ax, response) in enumerate(zip(axes[2:], responses, strict=True)):
        style.zero_band(ax, response.lags, response.band, "95 % band of 0", step="mid")
        style.stems(ax, response.lags, response.values, style.COLOURS[0], "o", "impulse response")
        delay = selection.best.structure.inputs[i][1]
        ax.axvline(delay, color=style.MARK, linestyle="--", linewidth=1.2, label=f"chosen delay, {delay}")
        ax.set(
            xlabel="lag [samples]", ylabel="response [y per u]" if len(responses) == 1 else f"response [y per u {i}]"
        )
        style.legend_outside(ax)
    return axes


def plot_comparison(
    comparison: Comparison, *, output: int = 0, t: Any = None, unit: str = "", time_unit: str = "",
    ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Draw the outputs of several models over the measured one, with their fits next to them.

    Parameters
    ----------
    comparison : Comparison
        What `compare` returned.
    output : int, default 0
        Which of several outputs; fits are those of all.
    t, unit, time_unit, ax : optional
        As in `plot_states`.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If t or output does not fit.

    Notes
    -----
    The axis shows what the models do; outliers beyond it are left outside. Fits are those on ordinary samples.
    """
    y = comparison.measured
    y = y if y.ndim > 1 else y[:, None]
    if _checks.count("output", output) >= y.shape[1]:
        raise ValueError(f"output: expected 0 to {y.shape[1] - 1}, got {output}")
    y = y[:, output]
    time = style.time(t, y.size, comparison)
    ax = style.one_axes(ax, (8.5, 3.6))
    for place, row in enumerate(comparison.rows):
        label = f"{row.name}, fit {row.fit:.1f} %"
        shown = comparison.outputs[row.name]
        ax.plot(time, shown[:, output] if shown.ndim > 1 else shown, linewidth=1.2, label=label, **style.line_of(place))
    ordinary = np.quantile(y[~np.isnan(y)], [0.02, 0.98])
    low, high = ax.get_ylim()
    low, high = min(low, float(ordinary[0])), max(high, float(ordinary[1]))
    ax.plot(time, y, ".", color="0.6", markersize=3, zorder=1, label="measured")
    ax.set_ylim(low - 0.1 * (high - low), high + 0.1 * (high - low))
    style.finish(ax, "output", unit, time_unit)
    style.legend_outside(ax)
    return ax
