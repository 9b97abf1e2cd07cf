"""From a filter that weighs its noise, or an extended one, to the tables and sections of its C."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from dataclasses import replace
from string import Template
from typing import Any

import numpy as np

from robust_filterpy._arrays import state_of
from robust_filterpy.correction.copies import start as start_of_copies
from robust_filterpy.correction.policies import process_scales
from robust_filterpy.edge.filter_model import (
    described_filter,
    finite,
    matrices,
    matrix_values,
    require_own,
    sensor_memory,
    symmetric,
)
from robust_filterpy.edge.text import Described
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
from robust_filterpy.filters.kalman import RobustKalmanFilter

# Numbers of a rule before its scales: copies, classes, stay, jump, two memories, whether it learns.
_HEAD = 9
_HEADERS = "real", "psi", "correction", "spread", "update", "repeats", "learnt"


def mixes(kf: RobustKalmanFilter | RobustExtendedKalmanFilter) -> bool:
    """Return whether the kernel weighs what this filter's noise may have been."""
    rule = kf.policy.rule
    return rule is not None and not rule[7:_HEAD].any()


def memory_field(shape: tuple[int, ...], name: str) -> str:
    """Return the field of what is known of the sensors, memory of this shape."""
    sensors, width = shape
    meant = "/* what is known of each sensor; the first is the factor of its R */"
    return f"    {name}_real memory[{sensors} * {width}]; {meant}"


def described_mixture(kf: RobustKalmanFilter | RobustExtendedKalmanFilter, name: str) -> Described:
    """Return what the C of a filter is made of that weighs what its noise may have been, or raise."""
    require_own(kf, "model")
    x, P = state_of(kf)
    n, m = len(x), kf.dim_z
    rule: Any = kf.policy.rule
    q, K = int(rule[0]), int(rule[1])
    process, scales, begin = np.split(rule[_HEAD:], [q, q + K])
    model = matrices(kf)
    # One copy, which is x and P themselves, is not kept apart.
    one = start_of_copies(x.ravel(), P, process_scales(None)).packed
    state: dict[str, Any] = dict(zip(("means", "covariances", "belief"), one, strict=True)) | kf.state()
    copies, width = len(state["means"]), len(begin)
    for covariance in (P, *state["covariances"]):
        symmetric("P", covariance)
    # As they stand: what is symmetric but for the last bit has to go on as it would in Python.
    start = {
        "x": finite("x", x.ravel(), (n,)), "P": P, "means": finite("x", state["means"], (copies, n)),
        "covariances": np.concatenate(state["covariances"]),
        "belief": state["belief"].ravel(),
        "memory": finite("memory", sensor_memory(kf, "learnt"), (m, width)),
    }  # fmt: skip
    stay, jump, remembered, r_remembered = rule[2:6]
    return Described(
        f"{name}: {type(kf).__name__}(dim_x={n}, dim_z={m}), noise={kf.noise!r}, process={kf.process!r}",
        _HEADERS, "mixture",
        matrix_values(model, name)
        | {
            "copies": str(copies), "q": str(q), "K": str(K), "process": _numbers(process), "scales": _numbers(scales),
            "begin": _numbers(begin), "numbers": _numbers((stay, jump, remembered, r_remembered)),
            "learns": str(int(rule[6])), "expected_field": "", "influence_fields": "",
            "memory_field": "    /* The copies that x and P are merged from; who writes x or P writes them all. */",
            "copies_fields": "\n".join(
                f"    {name}_real {declared};"
                for declared in (
                    f"means[{copies} * {n}]", f"covariances[{copies} * {n} * {n}]",
                    f"belief[{len(state['belief'])} * {n}]; /* for each state: how likely each copy, a jump; part */",
                )
            ).replace("*/;", "*/") + "\n" + memory_field((m, width), name),
            "remark": f"A step that Python leaves to its definition is refused, {name.upper()}_SINGULAR.",
            "shown_fields": f"""    {name}_real outlying[{m}]; /* probability that it was an outlier, 0 where missing */
    {name}_real weight[{m}];   /* 1 is full trust; NaN where missing */""",
        },
        model, start, "filter", {"classes": "classes.c"},
    )  # fmt: skip


def _numbers(values: Iterable[float]) -> str:
    """Return numbers as C writes them, of its own type."""
    written = ", ".join(f"REAL({float(value)!r})" for value in values)
    return textwrap.fill(written, 110, initial_indent=" " * 4, subsequent_indent=" " * 4)


# What a subclass may not do in its own way; `predict_x` is the motion, which is a function in C.
_METHODS = ("predict", "update", "_checked", "_correct", "_corrected", "_keep", "_skip")


def is_extended(model: Any) -> bool:
    """Return whether the C of an extended filter steps this one."""
    own = RobustExtendedKalmanFilter
    return isinstance(model, own) and all(getattr(type(model), name) is getattr(own, name) for name in _METHODS)


def described_extended(kf: RobustExtendedKalmanFilter, name: str) -> Described:
    """Return what the C of an extended filter is made of, or raise."""
    base = _mixed(kf, name) if mixes(kf) else _bounded(kf, name)
    moves = type(kf).predict_x is not RobustExtendedKalmanFilter.predict_x or "predict_x" in vars(kf)
    has_control = bool(base.values["inputs_define"])
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
        "remark": f"{base.values['remark']} h, f and their Jacobians are yours: see {name}_sensor and {name}_motion.",
    }  # fmt: skip
    return replace(
        base, text="extended", header="filter", parts={**base.parts, "functions": "functions.h"},
        values={**base.values, **values},
    )  # fmt: skip


def _bounded(kf: RobustExtendedKalmanFilter, name: str) -> Described:
    """Return what a correction by psi needs."""
    base = described_filter(kf, name)
    needs = """$grouping
    correction_rule rule = {{$kind, 0, 0, 0, NULL, NULL}, $scaling, $information, 1, 0, $joint};
    correction c;
    real work[update_moments_work(N, M)] = {0};
    int seen = 0;"""
    return replace(
        base, headers=(*base.headers, "moments"),
        parts={**base.parts, "correction": "bounded.c"},
        values={**base.values, "classes": "", "correction_needs": Template(needs).substitute(base.values)},
    )  # fmt: skip


def _mixed(kf: RobustExtendedKalmanFilter, name: str) -> Described:
    """Return what a correction by the score of a mixture needs: one copy, which is x and P themselves."""
    base = described_mixture(kf, name)
    needs = """    learnt_state s;
    real work[learnt_correct_work(N, M, 1, CLASSES)] = {0};
    real weights[M], outlying[M], belief[3 * N] = {0}, likelihood = 0;"""
    return replace(
        base, headers=("real", "prediction", *_HEADERS[1:]), parts={**base.parts, "correction": "mixed.c"},
        start={field: base.start[field] for field in ("x", "P", "memory")},
        values={
            **base.values, "correction_needs": needs, "rule": "", "refusal": "", "copies_fields": "",
            "memory_field": memory_field(base.start["memory"].shape, name),
        },
    )  # fmt: skip


_NEEDED = """    /* This filter's predict_x is its own: f alone knows the motion. */
    if (motion == NULL) {{
        return {}_BAD_ARGUMENT;
    }}"""
