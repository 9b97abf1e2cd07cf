"""From a `ParameterTracker` to the tables and sections of its C, or the reason why there is none."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy._arrays import process_noise
from robust_filterpy.edge.filter_model import (
    finite,
    influence_fields,
    require_plain,
    shown,
    symmetric,
)
from robust_filterpy.edge.template import Described, rendered
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.identification import ParameterTracker


def described_tracker(tracker: ParameterTracker, name: str) -> Described:
    """Return what the C of a tracker is made of, or raise."""
    kf = tracker.filter
    if type(kf) is not RobustKalmanFilter:
        raise TypeError(
            f"model.filter: expected a RobustKalmanFilter, got {type(kf).__name__}; "
            f"influence=Linear() makes the same tracker with the plain Kalman filter"
        )
    require_plain(kf, "model.filter")
    if tracker.form.layout.na and tracker.form.layout.nf + tracker.form.layout.nd:
        raise TypeError(f"model.structure: expected no A beside an F or D, got {tracker.structure}")
    if tracker.now.starts:
        raise ValueError(
            "model: expected a tracker whose start is over, got one that still looks for a model of its first samples; "
            "take them with run(y, u) before the export, or make it with start=0"
        )
    state = tracker.state()
    model, sections = _model(tracker, state)
    start = _start(tracker, state, sections)
    values = _values(tracker)
    choices = kf._choices
    if choices.scaling == "learnt":
        raise ValueError(
            "scaling: expected 'innovation', 'unit' or 'bounded' of a tracker, got 'learnt': R follows the noise; "
            "set scaling='innovation' before the export"
        )
    sections |= {choices.pointwise[0].__name__, choices.scaling, choices.information, "alone"}  # type: ignore[index]
    guard = ""
    if {"guarded", "unguarded"} & sections:
        guard = rendered("guard.c", sections, {name: values[name] for name in ("longest", "stable_calls")})
    several = tracker.form.layout.n > 1
    still = "random_walk" in sections
    return Described(
        f"{name}: ParameterTracker({tracker.structure}), {shown(kf._choices)}",
        (
            "psi.c", *(("eigen.c",) if several else ()), "whitening.c", "correction.c",
            *(() if still else ("predict.c",)), "tracker.c", "step.c",
        ),
        frozenset(sections),
        {**values, "guard_code": guard.rstrip()},
        model,
        start,
    )  # fmt: skip


def _model(tracker: ParameterTracker, state: dict[str, Any]) -> tuple[dict[str, Any], set[str]]:
    """Return the table of what stays, and the sections that belong to it."""
    kf, layout = tracker.filter, tracker.form.layout
    sections = {"tracker"} | ({"several"} if layout.n > 1 else set())
    model: dict[str, Any] = {}
    if np.array_equal(kf.F, np.eye(layout.n)):
        sections.add("random_walk")
    else:
        model["F"] = finite("F", kf.F, (layout.n, layout.n))
    model["Q"] = symmetric("Q", process_noise(kf.Q, None, layout.n))
    if kf._alpha_sq != 1.0:
        sections.add("fading")
        model |= {"alpha_sq": kf._alpha_sq, "windup": float(tracker.now.windup[0])}
    _, _, mean, memory = tracker.now.scale[0].tolist()
    if memory:
        sections.add("followed")
        model |= {"R_memory": memory, "R_mean": mean}
    else:
        sections.add("told")
        model["R"] = tracker.R
    if tracker.form.has_offset:
        sections.add("offset")
        model["centre"] = float(tracker.now.centre[0])
    return model | influence_fields(kf._choices), sections


def _start(tracker: ParameterTracker, state: dict[str, Any], sections: set[str]) -> dict[str, Any]:
    """Return the table of what moves, and add the sections that belong to it."""
    layout, structure = tracker.form.layout, tracker.structure
    start: dict[str, Any] = {"theta": state["theta"], "P": symmetric("P", state["P"])}
    if "followed" in sections:
        start |= {"R": tracker.R, "R_samples": float(tracker.now.scale[0, 1])}
    if layout.na + layout.nd:
        sections |= {"outputs"} | ({"whitened"} if layout.nd else set())
        start["outputs"] = state["outputs"]
    if tracker.form.cleans:
        sections.add("cleaned")
        start["measured"] = state["measured"]
    if layout.length:
        sections.add("inputs")
        start["inputs"] = state["inputs"]
    if layout.nc:
        sections.add("residuals")
        start["residuals"] = state["residuals"]
    if structure.n_inputs:
        sections.add("external")
    if any(i < structure.n_inputs for i in layout.used.tolist()):
        sections.add("reads_u")
    if layout.nf:
        sections.add("undisturbed")
        start["undisturbed"] = state["undisturbed"]
    if layout.stable and tracker.guard != "none":
        sections |= {tracker.guard, "guarded"}
    if layout.is_filtered and tracker.gradient == "filtered":
        sections |= {"filtered"} | ({"unguarded"} if layout.stable and tracker.guard == "none" else set())
        for name in ("prefiltered", "gradients"):
            if state[name].size:
                sections.add(name)
                start[name] = state[name]
    return start | {"enabled": int(tracker.enabled)}


def _values(tracker: ParameterTracker) -> dict[str, str]:
    """Return the sizes and places that the templates name."""
    layout, structure = tracker.form.layout, tracker.structure
    names = list(structure.names)
    if tracker.form.has_offset:
        names.insert(structure.constant_place, "constant")
    outputs = layout.d if layout.nd else layout.a
    calls = [f"(is_stable(&theta[{part.start}], {part.stop - part.start}) != 0)" for part in layout.stable]
    newest = [
        f"    inputs[{place}] = {f'u[{i}]' if i < structure.n_inputs else 'REAL(1.0); /* the constant */'};"
        for place, i in zip(layout.starts.tolist(), layout.used.tolist(), strict=True)
    ]
    sizes = {
        "n": layout.n, "m": 1, "size": layout.n, "na": layout.na + layout.nd, "nc": layout.nc, "nf": layout.nf,
        "length": layout.length, "lags": len(layout.picks), "rows": max(layout.nf, layout.nd),
        "outputs_at": outputs.start, "c_at": layout.c.start, "f_at": layout.f.start,
        "inputs_at": layout.inputs_in_phi[0] if len(layout.inputs_in_phi) else 0,
        "through_at": layout.through.start, "through_end": layout.through.stop,
        "longest": max((part.stop - part.start for part in layout.stable), default=1),
        "inputs": structure.n_inputs, "inputs_or_one": max(structure.n_inputs, 1),
    }  # fmt: skip
    return {
        **{name: str(size) for name, size in sizes.items()},
        "names": ", ".join(names),
        "stable_calls": f"({' && '.join(calls)}) ? 1 : 0",
        "picks": ", ".join(map(str, layout.picks.tolist())),
        "newest_inputs": "\n".join(line.replace("*/;", "*/") for line in newest),
    }
