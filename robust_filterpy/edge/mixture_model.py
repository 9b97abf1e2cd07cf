"""From a filter whose noise is told or learnt to the tables and sections of its C."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from typing import Any

import numpy as np

from robust_filterpy._arrays import state_of
from robust_filterpy.correction.copies import start as start_of_copies
from robust_filterpy.correction.policies import process_scales
from robust_filterpy.edge.filter_model import finite, matrices, matrix_values, require_own, sensor_memory, symmetric
from robust_filterpy.edge.text import Described
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
from robust_filterpy.filters.kalman import RobustKalmanFilter

# Numbers of a rule before its scales: copies, classes, stay, jump, two memories, whether it learns.
_HEAD = 9


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
    one = start_of_copies(x.ravel(), P, process_scales(None))
    kept: dict[str, Any] = {"means": one.x, "covariances": one.P, "belief": one.belief} | kf.state()
    copies, width = len(kept["means"]), len(begin)
    for covariance in (P, *kept["covariances"]):
        symmetric("P", covariance)
    # As they stand: what is symmetric but for the last bit has to go on as it would in Python.
    start = {
        "x": finite("x", x.ravel(), (n,)), "P": P, "means": finite("x", kept["means"], (copies, n)),
        "covariances": np.concatenate(kept["covariances"]),
        "belief": kept["belief"].ravel(),
        "memory": finite("memory", sensor_memory(kf, "learnt"), (m, width)),
    }  # fmt: skip
    stay, jump, remembered, r_remembered = rule[2:6]
    return Described(
        f"{name}: {type(kf).__name__}(dim_x={n}, dim_z={m}), noise={kf.noise!r}, process={kf.process!r}",
        ("real", "repeats", "learnt"), "mixture",
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
                    f"belief[{copies + 2} * {n}]; /* for each state: how likely each copy, a jump; its part */",
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
