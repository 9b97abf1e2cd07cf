"""What all pictures share: colors, axes, labels, bands, where the legend stands."""

from __future__ import annotations

from typing import Any

import numpy as np

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
    "told": {"color": COLOURS[5], "linestyle": (0, (3, 1, 1, 1, 1, 1))},
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


def true_line(ax: Any, t: Any, values: Any, label: str) -> None:
    """Draw what is true."""
    ax.plot(t, values, color="black", linewidth=1.5, linestyle=(0, (1, 1.5)), label=label)
