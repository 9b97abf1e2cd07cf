"""Pictures of models: frequency and step response, noise, poles and zeros, with how sure they are; structures that
were tried, what is left in the residuals, and several models on one recording.

Legends stand next to the data. matplotlib is imported when something is drawn.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy.identification import Model, ParameterTracker
from robust_filterpy.identification.judging.select import Selection
from robust_filterpy.identification.judging.validate import Comparison, Validation, Validations
from robust_filterpy.identification.models.responses import FrequencyResponse, NoiseSpectrum, StepResponse
from robust_filterpy.identification.models.state_space import StateSpaceModel
from robust_filterpy.plotting.figures import (
    COLOURS,
    MARK,
    STYLES,
    finish,
    legend_outside,
    line_of,
    one_axes,
    several_axes,
    stems,
    times_of,
    with_band,
    zero_band,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_POINTS: Final = 400
# A zero further from the origin than this is left outside the picture.
_FAR: Final = 3.0
# Structures further than this from the best one's fit, in percent, are left below the picture.
_DEEP: Final = 30.0


def plot_bode(
    models: Any, omega: ArrayLike | None = None, *, level: float = 0.95, which: int = 0, output: int = 0,
    axes: Any = None,
) -> Any:  # fmt: skip
    """Draw the frequency responses of models with their bands.

    Parameters
    ----------
    models : Model, StateSpaceModel, ParameterTracker, FrequencyResponse or mapping of str to these
        Models by name; one alone is named by its structure.
    omega : array_like, shape (n,), optional
        Frequencies in rad/s, or in rad/sample if the models have no sampling period; in (0, pi/dt]. Default: the three
        decades up to half the sampling frequency.
    level : float, default 0.95
        Probability of the bands, at each frequency.
    which : int, default 0
        Which input.
    output : int, default 0
        Which output of a StateSpaceModel.
    axes : sequence of two matplotlib.axes.Axes, optional
        Where to draw magnitude and phase.

    Returns
    -------
    ndarray of matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If a model has no such input, only some have a sampling period, omega is outside its range, or level is no
        probability.
    TypeError
        If models are no models.
    """
    named = _named(models, (Model, StateSpaceModel, ParameterTracker, FrequencyResponse))
    periods = {name: getattr(model, "dt", None) for name, model in named.items()}
    if len({dt is None for dt in periods.values()}) > 1:
        raise ValueError(f"models: expected all with or all without a sampling period, got {periods}")
    responses = {name: _response(name, model, omega, level, output) for name, model in named.items()}
    rows = {name: _of_input(name, response, which) for name, response in responses.items()}
    axes = several_axes(axes, 2, 1, (7.5, 5.0), sharex=True)
    for place, (name, (magnitude, phase)) in enumerate(rows.items()):
        with np.errstate(divide="ignore"):
            decibels = 20.0 * np.log10(magnitude)
        for ax, lines in ((axes[0], decibels), (axes[1], np.degrees(phase))):
            with_band(ax, responses[name].omega, lines, name, place, _band_label(responses[name].level))
    unit = "sample" if None in periods.values() else "s"
    for ax, label in zip(axes, ("magnitude [dB]", "phase [degrees]"), strict=True):
        ax.set(xscale="log", ylabel=label)
        ax.grid(True, which="both", color="0.9", linewidth=0.5)
    positive = np.concatenate([response.omega[response.omega > 0.0] for response in responses.values()])
    if np.ptp(positive) > 0.0:
        axes[1].set_xlim(positive.min(), positive.max())
    axes[1].set_xlabel(f"frequency [rad/{unit}]")
    legend_outside(axes[0])
    return axes


def plot_poles(models: Any, *, level: float = 0.95, which: int = 0, output: int = 0, ax: Axes | None = None) -> Axes:
    """Draw poles and zeros of models, with the regions where they may lie.

    Parameters
    ----------
    models : Model, StateSpaceModel, ParameterTracker or mapping of str to these
        Models by name; one alone is named by its structure.
    level : float, default 0.95
        Probability of each region.
    which : int, default 0
        Which input's zeros; a model without input has none.
    output : int, default 0
        To which output of a StateSpaceModel.
    ax : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If a model has no such input, its regressor is the caller's, or level is no probability.
    TypeError
        If models are no models.

    Notes
    -----
    Poles and zeros at the origin, which only delay, are left out, and zeros further than 3 from it stand outside.
    """
    named = _named(models, (Model, StateSpaceModel, ParameterTracker))
    roots = {}
    for name, model in named.items():
        _require_started(name, model)
        roots[name] = [("poles", "x", model.poles(level))]
        if isinstance(model, StateSpaceModel) or model.structure.inputs:
            roots[name].append(("zeros", "o", model.zeros(level, input=which, **_to(model, output))))
    ax = one_axes(ax, (7.0, 4.8))
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    ax.plot(np.cos(turn), np.sin(turn), color="black", linewidth=0.8, label="unit circle")
    ax.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
    ax.axvline(0.0, color="0.8", linewidth=0.6, zorder=0)
    reach = 1.1
    for place, (name, kinds) in enumerate(roots.items()):
        for what, marker, regions in kinds:
            points, colour = regions.values, COLOURS[place % 6]
            if not points.size:
                continue
            for edge in regions.ellipses():
                ax.plot(edge.real, edge.imag, linestyle=STYLES[place % 6], linewidth=1.4, alpha=0.7, color=colour)
            ax.plot(
                points.real, points.imag, marker, markersize=6 + 2 * place, fillstyle="none", linestyle="none",
                markeredgewidth=1.6, label=f"{what}, {name}", color=colour,
            )  # fmt: skip
            near = np.abs(points)[np.abs(points) <= _FAR]
            reach = max(reach, 1.15 * float(near.max(initial=0.0)))
    ax.plot([], [], color="0.4", linewidth=1.4, label=f"{100 * level:.4g} % regions")
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal", xlabel="real part", ylabel="imaginary part")
    legend_outside(ax)
    return ax


def plot_step(response: StepResponse, *, ax: Axes | None = None) -> Axes:
    """Draw what the output does after a unit step of each input, with bands.

    Parameters
    ----------
    response : StepResponse
        What `step_response` returned.
    ax : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes

    """
    ax = one_axes(ax)
    rows = [np.atleast_2d(values) for values in (response.response, response.lower, response.upper)]
    for place, lines in enumerate(zip(*rows, strict=True)):
        name = "response" if len(rows[0]) == 1 else f"input {place}"
        with_band(ax, response.time, lines, name, place, _band_label(response.level), steps=True)
    ax.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
    ax.set(xlabel="time [s]", ylabel="output after a unit step")
    legend_outside(ax)
    return ax


def plot_noise_spectrum(spectrum: NoiseSpectrum, *, ax: Axes | None = None) -> Axes:
    """Draw the power spectral density of what the noise does to an output, with its band.

    Parameters
    ----------
    spectrum : NoiseSpectrum
        What `noise_spectrum` returned.
    ax : matplotlib.axes.Axes, optional
        Where to draw.

    Returns
    -------
    matplotlib.axes.Axes
    """
    ax, lines = one_axes(ax), (spectrum.density, spectrum.lower, spectrum.upper)
    with_band(ax, spectrum.omega, lines, "density", 0, _band_label(spectrum.level))
    ax.set(xscale="log", yscale="log", xlabel="frequency [rad/s]", ylabel="noise of the output [y² per Hz]")
    ax.grid(True, which="both", color="0.9", linewidth=0.5)
    legend_outside(ax)
    return ax


def _band_label(level: float) -> str:
    """Return what the legend says of a band."""
    return f"{100 * level:.4g} % band"


def _to(model: Any, output: int) -> dict[str, int]:
    """Return the argument that names an output, for a model that has several."""
    return {"output": output} if isinstance(model, StateSpaceModel) else {}


def _response(name: str, model: Any, omega: Any, level: float, output: int) -> FrequencyResponse:
    """Return the frequency response of a model."""
    if isinstance(model, FrequencyResponse):
        return model
    _require_started(name, model)
    w = np.geomspace(1e-3, 1.0, _POINTS) * np.pi / (model.dt or 1.0) if omega is None else np.sort(omega)
    return model.frequency_response(w, level=level, **_to(model, output))


def _of_input(name: str, response: FrequencyResponse, which: int) -> tuple[Any, Any]:
    """Return magnitude and phase of one input, each with its band, shape (3, n)."""
    inputs = len(response.response) if np.ndim(response.response) > 1 else 1
    if _checks.count("which", which) >= inputs:
        raise ValueError(f"which: expected an input below {inputs} of {name}, got {which}")
    ends, names = ("", "_lower", "_upper"), ("magnitude", "phase")
    curves = (np.array([getattr(response, name + end) for end in ends]) for name in names)
    magnitude, phase = (values.reshape(3, inputs, -1)[:, which] for values in curves)
    return magnitude, phase


def _named(models: Any, kinds: tuple[type, ...]) -> dict[str, Any]:
    """Return models by name, or raise."""
    expected = " or a ".join(kind.__name__ for kind in kinds)
    named = {str(getattr(models, "structure", "response")): models} if isinstance(models, kinds) else models
    if not isinstance(named, Mapping):
        raise TypeError(f'models: expected a {expected}, or {{"name": model, ..}}, got {_checks.shown(models)}')
    if not named:
        raise ValueError("models: expected at least one model, got none")
    for name, model in named.items():
        if not isinstance(model, kinds):
            raise TypeError(f"models[{name!r}]: expected a {expected}, got {_checks.shown(model)}")
    return {str(name): model for name, model in named.items()}


def _require_started(name: str, model: Any) -> None:
    """Raise if a tracker has no model yet."""
    if not np.isfinite(model.std).all():
        raise ValueError(f"models[{name!r}]: expected a tracker that has found a model, got one that is at its start")


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
    axes = several_axes(axes, len(panels), 1, (7.5, 0.8 + 2.1 * len(panels)), sharex=True)
    for ax, (title, first, values, bound) in zip(axes, panels, strict=True):
        lags = np.arange(first, first + values.size)
        outside = np.abs(values) > bound
        zero_band(ax, lags, bound, f"{100 * validation.level:.4g} % bound", step="mid")
        ax.axhline(0.0, color="black", linewidth=0.6)
        stems(ax, lags[~outside], values[~outside], COLOURS[0], "o", "within")
        stems(ax, lags[outside], values[outside], MARK, "x", "outside")
        ax.set(ylabel="correlation", title=title)
        ax.xaxis.get_major_locator().set_params(integer=True)
        ax.title.set_fontsize("medium")
        legend_outside(ax)
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
    axes = several_axes(axes, 2 + len(responses), 1, (7.5, 4.6 + 2.2 * len(responses)))
    size = np.array([row.structure.n_theta for row in rows])
    fit, criterion = (np.array([getattr(row, name) for row in rows]) for name in ("fit", "criterion"))
    shows = np.array([row.shows_delay for row in rows])
    above = criterion - criterion[0]
    for ax, values, best_of in ((axes[0], fit, np.nanmax), (axes[1], above, np.nanmin)):
        ax.plot(size[shows], values[shows], "o", color=COLOURS[2], markersize=5, label="tried")
        if not shows.all():
            ax.plot(size[~shows], values[~shows], "x", color=COLOURS[5], markersize=5, label="first b is 0")
        sizes = np.unique(size[shows]) if shows.any() else np.unique(size)
        counted = shows if shows.any() else ~shows
        front = [best_of(values[counted & (size == n)]) for n in sizes]
        ax.plot(sizes, front, color=COLOURS[0], linewidth=1.2, label="best of its size")
        ax.plot(
            size[:1], values[:1], "o", color=MARK, markersize=10, fillstyle="none", markeredgewidth=1.8, label="chosen"
        )
        ax.xaxis.get_major_locator().set_params(integer=True)
    best = float(np.nanmax(fit))
    worst = max(float(np.nanmin(fit)), best - _DEEP)
    margin = 0.08 * (best - worst) + 0.1
    axes[0].set(ylabel="fit [%]", ylim=(worst - margin, best + margin), title=f"chosen: {rows[0].structure}")
    axes[1].set_yscale("symlog", linthresh=10.0)
    axes[1].set(ylabel=f"{selection.criterion} above the best", xlabel="parameters")
    legend_outside(axes[0])
    for i, (ax, response) in enumerate(zip(axes[2:], responses, strict=True)):
        zero_band(ax, response.lags, response.band, "95 % band of 0", step="mid")
        stems(ax, response.lags, response.values, COLOURS[0], "o", "impulse response")
        delay = selection.best.structure.inputs[i][1]
        ax.axvline(delay, color=MARK, linestyle="--", linewidth=1.2, label=f"chosen delay, {delay}")
        ax.set(
            xlabel="lag [samples]", ylabel="response [y per u]" if len(responses) == 1 else f"response [y per u {i}]"
        )
        legend_outside(ax)
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
    time = times_of(t, y.size, comparison)
    ax = one_axes(ax, (8.5, 3.6))
    for place, row in enumerate(comparison.rows):
        label = f"{row.name}, fit {row.fit:.1f} %"
        shown = comparison.outputs[row.name]
        ax.plot(time, shown[:, output] if shown.ndim > 1 else shown, linewidth=1.2, label=label, **line_of(place))
    ordinary = np.quantile(y[~np.isnan(y)], [0.02, 0.98])
    low, high = ax.get_ylim()
    low, high = min(low, float(ordinary[0])), max(high, float(ordinary[1]))
    ax.plot(time, y, ".", color="0.6", markersize=3, zorder=1, label="measured")
    ax.set_ylim(low - 0.1 * (high - low), high + 0.1 * (high - low))
    finish(ax, "output", unit, time_unit)
    legend_outside(ax)
    return ax
