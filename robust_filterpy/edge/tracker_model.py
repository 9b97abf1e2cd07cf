"""From a `ParameterTracker` to the tables and sections of its C, or the reason why there is none."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from robust_filterpy._arrays import process_noise
from robust_filterpy.edge.filter_model import (
    Described,
    choice_values,
    finite,
    influence_fields,
    require_plain,
    shown,
    symmetric,
)  # fmt: skip
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.identification import ParameterTracker

#: What each field of the two structures is.
_MEANT: Final = {
    "F": "theta(k+1) = F theta(k) + w(k)",
    "Q": "covariance of a step of theta",
    "alpha_sq": "1/forgetting: P is multiplied by it at each sample",
    "windup": "trace from which on P grows no more",
    "R": "variance of the ordinary noise",
    "R_memory": "number of samples that R remembers",
    "R_mean": "mean of min(e^2, 4) where R is right",
    "R_rounding": "steps of the sensor; R is what they make at least",
    "readings": "what is known of the steps of y",
    "centre": "taken off y, so that the constant is small",
    "theta": "the parameters",
    "P": "their covariance, symmetric",
    "R_samples": "how many samples R stands on",
    "outputs": "outputs, then disturbances, as they stand in phi, with their minus sign",
    "measured": "the same, as they were measured",
    "inputs": "inputs",
    "residuals": "residuals",
    "undisturbed": "what the inputs alone did, with its minus sign",
    "prefiltered": "past phi through 1/F",
    "gradients": "derivatives of past predictions",
}


def described_tracker(tracker: ParameterTracker, name: str) -> Described:
    """Return what the C of a tracker is made of, or raise."""
    kf = tracker.filter
    if type(kf) is not RobustKalmanFilter:
        raise TypeError(f"model.filter: expected a RobustKalmanFilter, of which there is C, got {type(kf).__name__}")
    require_plain(kf, "model.filter")
    if tracker.now.starts:
        raise ValueError(
            "model: expected a tracker whose start is over, got one that still looks for a model of its first samples; "
            "take them with run(y, u) before the export, or make it with start=0"
        )
    choices = kf.choices
    if choices.scaling == "learnt":
        raise ValueError(
            "scaling: expected 'innovation', 'unit' or 'bounded' of a tracker, got 'learnt': R follows the noise; "
            "set scaling='innovation' before the export"
        )
    model, start = _model(tracker), _start(tracker)
    return Described(
        f"{name}: ParameterTracker({tracker.structure}), {shown(choices)}",
        ("real", "psi", "prediction", "correction", "mend", "repeats", "tracker"), "tracker", "tracker",
        {
            **choice_values(choices, name), **_values(tracker, model, start),
            "model_fields": _declared(model, name), "state_fields": _declared(start, name),
        },
        {**model, **influence_fields(choices)}, {**start, "enabled": int(tracker.enabled)},
    )  # fmt: skip


def _model(tracker: ParameterTracker) -> dict[str, Any]:
    """Return the table of what stays."""
    kf, n = tracker.filter, tracker.form.layout.n
    model: dict[str, Any] = {}
    if not np.array_equal(kf.F, np.eye(n)):
        model["F"] = finite("F", kf.F, (n, n))
    model["Q"] = symmetric("Q", process_noise(kf.Q, None, n))
    alpha_sq = float(tracker.state()["alpha_sq"])
    if alpha_sq != 1.0:
        model |= {"alpha_sq": alpha_sq, "windup": float(tracker.now.windup[0])}
    _, _, mean, memory, rounding = tracker.now.scale[0].tolist()
    if memory:
        model |= {"R_memory": memory, "R_mean": mean, "R_rounding": rounding}
    else:
        model["R"] = tracker.R
    return model | ({"centre": float(tracker.now.centre[0])} if tracker.form.has_offset else {})


def _start(tracker: ParameterTracker) -> dict[str, Any]:
    """Return the table of what moves."""
    state = tracker.state()
    start: dict[str, Any] = {"theta": state["theta"], "P": symmetric("P", state["P"])}
    if tracker.now.scale[0, 3]:
        start |= {"R": tracker.R, "R_samples": float(tracker.now.scale[0, 1])}
    filtered = tracker.form.layout.is_filtered and tracker.gradient == "filtered"
    if tracker.form.judges:
        start["readings"] = state["readings"]
    past = ("outputs", "measured", "inputs", "residuals", "undisturbed", *(("prefiltered", "gradients") * filtered))
    return start | {name: state[name] for name in past if state[name].size}


def _declared(table: dict[str, Any], name: str) -> str:
    """Return the fields of a table as C declares them."""
    sizes = {field: "" if np.ndim(value) == 0 else f"[{np.size(value)}]" for field, value in table.items()}
    return "\n".join(f"    {name}_real {field}{size}; /* {_MEANT[field]} */" for field, size in sizes.items())


def _values(tracker: ParameterTracker, model: dict[str, Any], start: dict[str, Any]) -> dict[str, Any]:
    """Return what the text of a tracker names, besides its choices."""
    structure, name = tracker.structure, list(tracker.structure.names)
    if tracker.form.has_offset:
        name.insert(structure.constant_place, "constant")
    counts, places = np.split(tracker.form.layout.numbers, [12])
    parts = np.split(places, [counts[11], 2 * counts[11]])
    lists = dict(zip(("start", "used", "source"), (", ".join(map(str, one.tolist())) for one in parts), strict=True))
    return {
        **lists, "layout": ", ".join([*map(str, counts.tolist()), *(one if lists[one] else "NULL" for one in lists)]),
        "n": tracker.form.layout.n, "inputs": structure.n_inputs, "names": ", ".join(name),
        "inputs_or_one": max(structure.n_inputs, 1), "guard": f"GUARD_{tracker.guard.upper()}",
        "filtered": int("prefiltered" in start or "gradients" in start), "cleans": int(tracker.form.cleans),
        "judges": int(tracker.form.judges), "follows": "R_memory" in model, "fades": "alpha_sq" in model,
        "moves": "F" in model,
        "fields": "\n".join(f"    next.{one} = state->{one};" for one in start if one not in ("R", "R_samples")),
        "minus_centre": " - model->centre" * tracker.form.has_offset,
        "plus_centre": " + model->centre" * tracker.form.has_offset,
    }  # fmt: skip
