"""Figure 1: the scheme of the pneumatic servo, with the names that equations (1)-(7) use."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import FancyArrowPatch, Rectangle
from report import Options, Part

CAPTION = (
    "The servo: a five-port valve fills one chamber from the supply and vents the other; u1 = y_a = -y_b. Pressures "
    "are absolute, so the atmosphere pushes on the rod's cross-section too, which (1) leaves out in print. What the "
    "nonlinear servo does, and how well a linear model with drifting parameters follows it (facts (a) and (b) of "
    "section 3), is measured by `examples/pneumatic_servo.py`."
)


def make(options: Options) -> Part:
    """Draw figure 1."""
    part = Part("Figure 1: the servo")
    if options.wants(1):
        part.save(figure(), "fig01.png", CAPTION, options)
    return part


def figure() -> plt.Figure:
    """Draw cylinder, load, valve and controller."""
    fig, axis = plt.subplots(figsize=(9, 4.8), layout="constrained")
    axis.set(xlim=(0, 18), ylim=(0, 9.6), aspect="equal")
    axis.axis("off")
    _cylinder(axis)
    _load(axis)
    _valve(axis)
    _controller(axis)
    return fig


def _box(axis: plt.Axes, x: float, y: float, width: float, height: float, color: str = "white") -> None:
    """Draw a rectangle."""
    axis.add_patch(Rectangle((x, y), width, height, facecolor=color, edgecolor="black", linewidth=1.2))


def _arrow(axis: plt.Axes, start: tuple[float, float], end: tuple[float, float], color: str = "black") -> None:
    """Draw an arrow."""
    axis.add_patch(FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=12, color=color, linewidth=1.2))


def _cylinder(axis: plt.Axes) -> None:
    """Draw the barrel, piston and rod, and what is in the chambers."""
    _box(axis, 1.0, 6.2, 7.0, 2.4, "aliceblue")
    _box(axis, 4.0, 6.2, 0.6, 2.4, "0.75")
    _box(axis, 4.6, 7.25, 5.4, 0.3, "0.75")
    axis.text(2.5, 7.4, "chamber a\n$P_a,\\ V_a,\\ A_a$", ha="center", va="center")
    axis.text(6.4, 8.05, "chamber b", ha="center", va="center")
    axis.text(6.4, 6.7, "$P_b,\\ V_b,\\ A_b$", ha="center", va="center")
    _arrow(axis, (4.3, 9.0), (6.0, 9.0))
    axis.plot([4.3, 4.3], [8.7, 9.3], color="black", linewidth=0.8)
    axis.text(6.1, 9.0, "$y$ (from mid-stroke)", va="center")
    axis.text(3.9, 5.85, "leakage past the piston", fontsize=8, color="0.35", ha="center")


def _load(axis: plt.Axes) -> None:
    """Draw the moving mass, its spring and damper, and the external force."""
    _box(axis, 10.0, 6.4, 2.0, 2.0, "0.9")
    axis.text(11.0, 7.4, "$m$", ha="center", va="center", fontsize=13)
    axis.text(11.9, 9.35, "dry friction $F_f(\\dot y)$", ha="right", va="center", fontsize=9)
    _arrow(axis, (11.8, 8.75), (10.2, 8.75))
    _arrow(axis, (14.2, 8.9), (12.0, 8.9))
    axis.plot([12.0, 12.0], [8.4, 9.2], color="black", linewidth=0.8)
    axis.text(14.3, 8.9, "$F_{ext}$ ($u_2$)", va="center")
    x = np.linspace(12.0, 15.0, 13)
    axis.plot(x, 7.9 + 0.22 * np.array([0, 0, 1, -1, 1, -1, 1, -1, 1, -1, 1, 0, 0]), color="black", linewidth=1.2)
    axis.text(13.5, 8.3, "$k_e$", ha="center")
    axis.plot([12.0, 13.3], [6.9, 6.9], color="black", linewidth=1.2)
    axis.plot([13.3, 13.3], [6.7, 7.1], color="black", linewidth=1.2)
    axis.plot([13.9, 13.1, 13.1, 13.9], [7.2, 7.2, 6.6, 6.6], color="black", linewidth=1.2)
    axis.plot([13.9, 13.9], [6.6, 7.2], color="black", linewidth=1.2)
    axis.plot([13.9, 15.0], [6.9, 6.9], color="black", linewidth=1.2)
    axis.text(13.5, 6.15, "$\\beta_e$", ha="center")
    axis.plot([15.0, 15.0], [6.2, 8.5], color="black", linewidth=2)
    for y in np.arange(6.3, 8.5, 0.3):
        axis.plot([15.0, 15.25], [y, y + 0.2], color="black", linewidth=0.8)


def _valve(axis: plt.Axes) -> None:
    """Draw the five-port valve with its ports and lines."""
    _box(axis, 2.2, 2.6, 4.6, 1.4, "lavender")
    axis.text(4.5, 3.3, "five-port valve, $W$, $\\beta(t)$", ha="center", va="center", fontsize=10)
    for x, top, label, side in ((1.6, 2.7, "$y_a$", -1), (7.4, 6.3, "$y_b$", 1)):
        axis.plot([top, top, x, x], [4.0, 4.6, 4.6, 6.2], color="tab:blue", linewidth=1.6)
        axis.text(x + 0.25 * side, 5.3, label, ha="right" if side < 0 else "left", va="center")
    _arrow(axis, (4.5, 1.2), (4.5, 2.6), color="tab:blue")
    axis.text(4.5, 0.9, "supply $P_s$, $T_S$", ha="center", va="center")
    for x in (2.9, 6.1):
        _arrow(axis, (x, 2.6), (x, 1.5), color="tab:blue")
        axis.text(x, 1.25, "$P_{atm}$", ha="center", va="center")


def _controller(axis: plt.Axes) -> None:
    """Draw the position loop."""
    _box(axis, 9.2, 2.6, 3.2, 1.4, "honeydew")
    axis.text(10.8, 3.3, "position\ncontroller", ha="center", va="center")
    _arrow(axis, (9.2, 3.3), (6.8, 3.3))
    axis.text(8.0, 3.6, "$u_1$", ha="center")
    _arrow(axis, (15.0, 3.0), (12.4, 3.0))
    axis.text(15.1, 3.0, "reference", va="center")
    axis.plot([11.0, 11.0], [6.4, 4.8], color="black", linewidth=1.0, linestyle="--")
    _arrow(axis, (11.0, 4.8), (11.0, 4.0))
    axis.text(11.2, 5.2, "measured $y$, $P_a$, $P_b$: noise and outliers", va="center", fontsize=9)
