"""One recording of a plant whose equations are known, checked: outputs, inputs, and times at any distance."""

from __future__ import annotations

import sys
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models.findings import Finding
from robust_filterpy.identification.models.grey_box_residuals import GreyRecording
from robust_filterpy.identification.models.signals import require_squares
from robust_filterpy.identification.models.state_space_structure import Signals
from robust_filterpy.identification.models.time_axis import recording
from robust_filterpy.identification.models.unmeasured import measurements

__all__ = ["ANY_TIMES", "Checked", "grey_recording", "require_inputs"]

#: Of samples that may come at any time.
ANY_TIMES: Final = Signals(0, 0, takes_phi=True)


class Checked(NamedTuple):
    """A recording, and what was found in it.

    Attributes
    ----------
    recording : GreyRecording
        Its times from 0 on.
    known : ndarray of bool, shape (N, p)
        Which outputs are measured.
    findings : tuple of Finding
        Fill values, stuck sensors, copies and gaps.
    """

    recording: GreyRecording
    known: Any
    findings: tuple[Finding, ...]


def grey_recording(y: Any, u: Any, t: Any, i: int = 0) -> Checked:
    """Return a recording, checked."""
    axis, y, u = recording(ANY_TIMES, y=y, u=u)
    output = _columns("y", y)
    require_squares(output)
    if np.isinf(output).any():
        raise ValueError("y: expected finite numbers or NaN (missing), got inf")
    for j, column in enumerate(output.T):
        if np.isnan(column).all():
            raise ValueError(f"y: expected some measured samples of output {j} in recording {i}, got none")
    signal = np.zeros((len(output), 0)) if u is None else _columns("u", u)
    if len(signal) != len(output):
        raise ValueError(f"u: expected {len(output)} samples like y, got {len(signal)}")
    if np.isinf(signal).any() or np.isnan(signal[:1]).any():
        raise ValueError("u: expected finite numbers, the first of them measured")
    gaps, findings = np.isnan(signal), []
    if gaps.any():
        last = np.maximum.accumulate(np.where(gaps, 0, np.arange(len(signal))[:, None]), axis=0)
        signal = np.take_along_axis(signal, last, axis=0)
        text = f"u is missing in {int(gaps.any(axis=1).sum())} samples of recording {i}: held at the value before"
        findings.append(Finding("gap", text, float("nan"), (0, len(signal))))
    times = _times(axis.index, t, len(output))
    output, lies = measurements(output, signal)
    return Checked(GreyRecording(times, np.nan_to_num(output), signal), ~np.isnan(output), (*lies, *findings))


def require_inputs(structure: Any, one: GreyRecording, p: Array) -> None:
    """Raise unless equations take the inputs of a recording."""
    for name, function in (("f", structure.f), ("h", structure.h)):
        try:
            if function is not None:
                function(structure.x0, one.u[0], p)
        except (IndexError, ValueError, TypeError) as error:
            raise ValueError(
                f"u: expected the inputs that {name} takes, got {one.u.shape[1]} of them ({error})"
            ) from None


def _columns(name: str, signal: Any) -> Array:
    """Return a signal as columns or raise."""
    found = _checks.numbers(name, signal)
    found = found[:, None] if found.ndim == 1 else found
    if found.ndim != 2 or not len(found):
        raise ValueError(f"{name}: expected shape (N,) or (N, n), N >= 1, got {np.shape(signal)}")
    return found


def _times(index: Any, t: Any, length: int) -> Array:
    """Return the times of a recording in s, from 0 on, or raise."""
    if t is None:
        pd = sys.modules.get("pandas")
        if pd is None or index is None:
            raise ValueError("t: expected the times of the samples in s, or a pandas index that has them, got None")
        is_time = isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex))
        t = (index - index[0]).total_seconds() if is_time else index
    times = _checks.numbers("t", np.asarray(t))
    if times.shape != (length,) or not np.isfinite(times).all():
        raise ValueError(f"t: expected {length} finite times like y, got shape {times.shape}")
    if (np.diff(times) <= 0.0).any():
        k = int(np.argmax(np.diff(times) <= 0.0))
        raise ValueError(
            f"t: expected times that increase, got {times[k]:.6g} and {times[k + 1]:.6g} in sample {k + 1}"
        )
    return times - times[0]
