"""From a `RobustExtendedKalmanFilter` to the tables and sections of its C, which asks the user's functions."""

from __future__ import annotations

from dataclasses import replace
from string import Template
from typing import Any

from robust_filterpy.edge.filter_model import described_filter
from robust_filterpy.edge.mixture_model import described_mixture, memory_field, mixes
from robust_filterpy.edge.text import Described
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter

# What a subclass may not do in its own way; `predict_x` is the motion, which is a function in C.
_METHODS = ("predict", "update", "_checked", "_correct", "_corrected", "_keep", "_skip")


def is_extended(model: Any) -> bool:
    """Return whether the C of an extended filter steps this one."""
    own = RobustExtendedKalmanFilter
    return isinstance(model, own) and all(getattr(type(model), name) is getattr(own, name) for name in _METHODS)


def described_extended(kf: RobustExtendedKalmanFilter, name: str) -> Described:
    """Return what the C of an extended filter is made of, or raise."""
    found = _mixed(kf, name) if mixes(kf) else _bounded(kf, name)
    moves = type(kf).predict_x is not RobustExtendedKalmanFilter.predict_x or "predict_x" in vars(kf)
    has_control = bool(found.values["inputs_define"])
    values = {
        "sensor_field": "", "innovation": "residual(z, h(x))",
        "example_motion": ", &motion" if moves else ", NULL", "example_sensor": ", &sensor",
        "motion_parameter": f", const {name}_motion *motion",
        "sensor_parameter": f", const {name}_sensor *sensor",
        "or_functions": ";\n                                 or one of your functions wrote what is not",
        "predict_comment": f"/* Predict the next state by f; {'or' if not moves else 'never'} by F, where motion is "
        f"NULL{', and then with the control input u, unless that is NULL' if has_control else ''}. */",
        "motion_needed": _NEEDED.format(name.upper()) if moves else "",
        "control_too": " || (u != NULL)" if has_control else "",
        "remark": f"{found.values['remark']} h, f and their Jacobians are yours: see {name}_sensor and {name}_motion.",
    }  # fmt: skip
    return replace(
        found, text="extended", header="filter", parts={**found.parts, "functions": "functions.h"},
        values={**found.values, **values},
    )  # fmt: skip


def _bounded(kf: RobustExtendedKalmanFilter, name: str) -> Described:
    """Return what a correction by psi needs."""
    found = described_filter(kf, name)
    needs = """$grouping
    correction_rule rule = {{$kind, 0, 0, 0, NULL, NULL}, $scaling, $information, 1, 0, $joint};
    correction c;
    real work[update_moments_work(N, M)] = {0};
    int seen = 0;"""
    return replace(
        found, headers=(*found.headers, "moments"),
        parts={**found.parts, "correction": "bounded.c"},
        values={**found.values, "classes": "", "correction_needs": Template(needs).substitute(found.values)},
    )  # fmt: skip


def _mixed(kf: RobustExtendedKalmanFilter, name: str) -> Described:
    """Return what a correction by the score of a mixture needs: one copy, which is x and P themselves."""
    found = described_mixture(kf, name)
    needs = """    learnt_state s;
    real work[learnt_correct_work(N, M, 1, CLASSES)] = {0};
    real weights[M], outlying[M], belief[3 * N] = {0}, likelihood = 0;"""
    return replace(
        found, headers=("real", "prediction", "repeats", "learnt"), parts={**found.parts, "correction": "mixed.c"},
        start={field: found.start[field] for field in ("x", "P", "memory")},
        values={
            **found.values, "correction_needs": needs, "rule": "", "refusal": "", "copies_fields": "",
            "memory_field": memory_field(found.start["memory"].shape, name),
        },
    )  # fmt: skip


_NEEDED = """    /* This filter's predict_x is its own: f alone knows the motion. */
    if (motion == NULL) {{
        return {}_BAD_ARGUMENT;
    }}"""
