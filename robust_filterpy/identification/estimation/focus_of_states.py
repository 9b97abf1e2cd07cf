"""A state-space model of one band of frequencies: `focus` for several outputs and a common state.

The model of all frequencies says what outliers and gaps should have been; the filtered signals are fitted as an output
error; level, start, noise and weights are those of the recording as it is, with the dynamics held.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.signal import sosfilt

from robust_filterpy._checks import Array
from robust_filterpy.identification.estimation.focus import band_filter
from robust_filterpy.identification.models.state_space import StateSpaceModel
from robust_filterpy.identification.models.state_space_structure import StateSpace

__all__ = ["focused_states", "require_focus"]


def require_focus(structure: StateSpace, recordings: int) -> None:
    """Raise unless a model of a band can be found.

    Parameters
    ----------
    structure : StateSpace
        What is to be found.
    recordings : int
        How many there are.
    """
    if isinstance(structure.n, str):
        raise ValueError("focus: expected a StateSpace with a number of states: of a band no evidence tells it")
    if structure.disturbance:
        raise ValueError(
            "focus: expected a StateSpace without disturbance, whose model of the noise would take the band off again"
        )
    if recordings > 1:
        raise ValueError("focus: expected one recording without long gaps; identify the longest one alone")


def focused_states(
    y: Array,
    u: Array,
    found: StateSpaceModel,
    edges: tuple[float, float],
    find: Callable[[Array, Array, Array], StateSpaceModel],
    held: Callable[[StateSpaceModel], StateSpaceModel],
) -> StateSpaceModel:
    """Return the model of a band.

    Parameters
    ----------
    y, u : ndarray, shape (N, p) and (N, m)
        Outputs, NaN where one is missing, and inputs.
    found : StateSpaceModel
        Of all frequencies.
    edges : (float, float)
        From `focus.band`.
    find : callable
        find(y, u, h) gives the model of filtered signals, h the filter's impulse response.
    held : callable
        Gives the model of the recording as it is for the dynamics of another one.

    Returns
    -------
    StateSpaceModel

    Raises
    ------
    ValueError
        If the recording is too short for the filter, or the inputs do not excite the states within the band.
    """
    known, expected = ~np.isnan(y), found.predict(y, u)
    trust = np.where(known, np.nan_to_num(found.weights), 0.0)
    clean = np.where(known, expected + trust * (y - expected), expected) - found.level
    sos, settled = band_filter(edges, found.dt or 1.0, len(y))
    output, signal = sosfilt(sos, clean, axis=0), sosfilt(sos, u - found.operating_point, axis=0)
    output[~known] = np.nan
    try:
        inner = find(output[settled:], signal[settled:], sosfilt(sos, np.eye(1, 2 * settled).ravel()))
    except ValueError as error:
        error.args = (f"focus: within {edges[0]:.4g} to {edges[1]:.4g} rad/s: {error}",)
        raise
    model = held(inner)
    doubt = "; ".join(dict.fromkeys(words for words in (inner.warning, model.warning) if words))
    return replace(model, P=inner.P, warning=doubt, focus=edges)
