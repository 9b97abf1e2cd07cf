"""From a `RobustKalmanFilter` to the tables and sections of its C, or the reason why there is none."""

from __future__ import annotations

from typing import Any, Final, cast

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._arrays import noise_covariance, process_noise, state_of
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.spread import NUMBERS
from robust_filterpy.edge.text import Described
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.kernel.series import JOINT_MOST, rule

# Rounding that a symmetric matrix may have gathered.
_SLACK: Final = 1e-12


def described_filter(kf: RobustKalmanFilter | RobustExtendedKalmanFilter, name: str) -> Described:
    """Return what the C of a filter is made of, or raise."""
    require_plain(kf, "model")
    choices = kf.choices
    x, P = state_of(kf)
    n, m = len(x), kf.dim_z
    model = matrices(kf) | influence_fields(choices)
    joint = m > 1 and choices.grouping != "component"
    if joint:
        _require_joint(choices, model["R"])
    start = {"x": finite("x", x.ravel(), (n,)), "P": symmetric("P", P)}
    # Linear, which cannot become anything else at run time, has no thresholds to learn for.
    if choices.scaling == "learnt" and psi_of(choices)[0] != "linear":
        start["memory"] = finite("memory", sensor_memory(kf, "spread"), (m, NUMBERS))
    return Described(
        f"{name}: {type(kf).__name__}(dim_x={n}, dim_z={m}), {shown(choices)}",
        ("real", "psi", "prediction", "correction", *(("joint",) if joint else ()), "spread", "update"), "filter",
        {**matrix_values(model, name), **choice_values(choices, name)}
        | {
            "memory_field": f"    {name}_real memory[{m} * {NUMBERS}]; /* what is usual of each sensor's innovations */"
            if "memory" in start
            else "",
            "copies_fields": "",
            "grouping": "    static const real normalizers[JOINT_MOST] = {0}; /* of a likelihood nobody asks for */"
            if joint
            else "",
            "joint": "normalizers" if joint else "NULL",
            "remark": f"For another threshold at run time change a copy of {name}_default.",
            "shown_fields": f"""    {name}_real e[{m}];      /* the same, standardized */
    {name}_real weight[{m}]; /* psi(e)/e: 1 is full trust; NaN where missing */""",
            "influence_fields": influence_declarations(choices, name),
        },
        model, start, parts={"refusal": "refusal.c"},
    )  # fmt: skip


def _require_joint(choices: Choices, R: Array) -> None:
    """Raise unless the kernel judges these sensors as one whatever P becomes."""
    if choices.grouping != "joint" or rule(choices) is None or len(R) > JOINT_MOST:
        raise ValueError(
            f"grouping: expected 'component', or 'joint' of up to {JOINT_MOST} sensors with scaling='learnt' or "
            f"'innovation' and information='realized' or 'weight', got {shown(choices)}, {len(R)} sensors; set "
            f"grouping='component' before the export"
        )
    if np.count_nonzero(R - np.diag(R.diagonal())):
        raise ValueError(
            "R: expected a diagonal with grouping='joint', since C cannot tell what a sensor that sees no state says "
            "of the others; set R=numpy.diag(R.diagonal()) or grouping='component' before the export"
        )


def matrices(kf: RobustKalmanFilter | RobustExtendedKalmanFilter) -> dict[str, Any]:
    """Return the matrices of a filter, as the model in C has them, or raise."""
    n, m, B = kf.dim_x, kf.dim_z, _control(kf.B, kf.dim_x)
    F = finite("F", kf.F, (n, n))
    H = {"H": finite("H", kf.H, (m, n))} if isinstance(kf, RobustKalmanFilter) else {}
    Q, R = symmetric("Q", process_noise(kf.Q, None, n)), symmetric("R", noise_covariance(kf.R, None, m))
    alpha_sq = float(kf.state().get("alpha_sq", 1.0))
    model = {"F": F, **({} if B is None else {"B": B}), "Q": Q, **H, "R": R}
    return model if alpha_sq == 1.0 else model | {"alpha_sq": alpha_sq}


def sensor_memory(kf: RobustKalmanFilter | RobustExtendedKalmanFilter, name: str) -> Array:
    """Return what a filter knows of its sensors, by its name in a state: nothing before the first correction."""
    nothing = kf.policy.begin(kf.dim_z)
    memory = kf.state().get(name, nothing)
    return memory if len(memory) == len(nothing) else nothing


def matrix_values(model: dict[str, Any], name: str) -> dict[str, str]:
    """Return what the C of a filter with these matrices has for them."""
    fades = "alpha_sq" in model
    return _control_values(model["B"].shape[1] if "B" in model else 0, name) | {
        "n": str(n := len(model["F"])),
        "m": str(m := len(model["R"])),
        "sensor_field": f"    {name}_real H[{m} * {n}]; /* z(k) = H x(k) + v(k) */",
        "innovation": "z - H x",
        **dict.fromkeys(
            ("example_motion", "example_sensor", "motion_parameter", "sensor_parameter", "or_functions", "functions"),
            "",
        ),
        "alpha_sq": "model->alpha_sq" if fades else "REAL(1.0)",
        "alpha_field": f"    {name}_real alpha_sq; /* P is multiplied by it at each prediction */" if fades else "",
    }


def choice_values(choices: Choices, name: str) -> dict[str, str]:
    """Return the choices of a filter as the kernel names them."""
    kind, numbers = psi_of(choices)
    learns = choices.scaling == "learnt" and kind != "linear"
    scaling = f"SCALING_{choices.scaling.upper()}" if learns or choices.scaling != "learnt" else "SCALING_INNOVATION"
    fields = [f"    rule.psi.{own} = model->{field};" for own, field in zip("abc", numbers, strict=False)]
    if choices.information == "expected":
        fields.append("    rule.expected = model->expected;")
    if learns and kind == "huber":
        # The definition's way: without a threshold it is the Kalman filter.
        fields.append("    rule.scaling = real_is_finite(model->threshold) ? SCALING_LEARNT : SCALING_INNOVATION;")
    return {
        "kind": f"PSI_{kind.upper()}",
        "scaling": scaling,
        "information": f"INFORMATION_{choices.information.upper()}",
        "rule": "\n".join(fields),
        "expected_field": f"    {name}_real expected; /* E[psi'], which belongs to the psi above */"
        if choices.information == "expected"
        else "",
        "memory": "(spread_memory *)next.memory" if learns else "NULL",
    }


def _control_values(inputs: int, name: str) -> dict[str, str]:
    """Return what the C of a filter with so many control inputs has for them."""
    if not inputs:
        empty = ("inputs_define", "control_field", "example_u", "predict_parameter", "control", "control_sum")
        comment = "/* Predict the next state. */"
        return {**dict.fromkeys(empty, ""), "control_given": "NULL", "predict_comment": comment}
    return {
        "inputs_define": f"#define {name.upper()}_INPUTS {inputs}",
        "control_field": f"    {name}_real B[{name.upper()}_STATES * {inputs}];",
        "example_u": ", u",
        "predict_parameter": f", const {name}_real u[{inputs}]",
        "predict_comment": "/* Predict the next state, with the control input u, or without where u is NULL. */",
        "control": "    real control[N] = {0};",
        "control_given": "(u != NULL) ? control : NULL",
        "control_sum": f"""    for (int k = 0; (k < {inputs}) && (u != NULL); k++) {{
        if (!real_is_finite(u[k])) {{
            return {name.upper()}_BAD_ARGUMENT;
        }}
        for (int i = 0; i < N; i++) {{
            control[i] += model->B[i * {inputs} + k] * u[k];
        }}
    }}""",
    }


def require_own(kf: Any, name: str) -> None:
    """Raise unless a filter's methods are its own, and its inverse numpy's."""
    wrapped = {"predict", "update"} & vars(kf).keys()
    if wrapped:
        raise ValueError(f"{name}: expected the filter's own {sorted(wrapped)[0]}(), got one that was put in its place")
    if kf.inv is not np.linalg.inv:
        raise ValueError(
            f"inv: expected numpy's inverse of S, got {kf.inv!r}; make R positive definite and set inv=numpy.linalg.inv"
        )


def require_plain(kf: Any, name: str) -> None:
    """Raise unless a filter does what the C of a `RobustKalmanFilter` does."""
    require_own(kf, name)
    if not kf.policy.by_kernel:
        off = ", ".join(f"{word}=None" for word in ("noise", "process", "patience") if getattr(kf, word) is not None)
        raise ValueError(
            f"{name}: expected bounded influence without patience, or, of a linear filter, noise given or learned "
            f"sensor by sensor with process=None or Scales, of which there is C, got noise={kf.noise!r}, "
            f"process={kf.process!r}, patience={kf.patience!r}; set {off} before the export"
        )
    if kf.choices.kernel_psi is None:
        raise ValueError(
            f"influence: expected Huber, Hampel, TukeyBiweight, StudentT or Linear, got {kf.influence!r}, of which "
            f"there is no C; set the nearest of these, such as StudentT(4), before the export"
        )


def influence_fields(choices: Choices) -> dict[str, Any]:
    """Return the parameters of psi, and E[psi'] where that is asked for."""
    fields: dict[str, Any] = psi_of(choices)[1].copy()
    if choices.information == "expected":
        fields["expected"] = float(choices.expected)
    return fields


def influence_declarations(choices: Choices, name: str) -> str:
    """Return the fields of a model that are psi's."""
    meant = {"threshold": "standard deviations", "df": "degrees of freedom"}
    return "\n".join(
        f"    {name}_real {field}; /* of psi: {meant.get(field, 'a corner, in standard deviations')} */"
        for field in psi_of(choices)[1]
    )


def shown(choices: Choices) -> str:
    """Say which choices a filter has."""
    return f"{choices.influence!r}, scaling {choices.scaling}, information {choices.information}, {choices.grouping}"


def symmetric(name: str, matrix: Array) -> Array:
    """Return a covariance, exactly symmetric, or raise."""
    _checks.covariance(name, matrix)
    if np.abs(matrix - matrix.T).max() > _SLACK * np.abs(matrix).max():
        raise ValueError(
            f"{name}: expected a symmetric matrix, got one that differs from its transpose; use 0.5*({name} + {name}.T)"
        )
    return 0.5 * (matrix + matrix.T)


def finite(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return an array of this shape, or raise."""
    array = _checks.numbers(name, value)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"{name}: expected finite numbers of shape {shape}, got {_checks.shown(value)}")
    return array


def _control(B: Any, n: int) -> Array | None:
    """Return the control matrix, shape (n, dim_u), None if there is none."""
    if B is None or (np.ndim(B) == 0 and B == 0.0) or np.size(B) == 0:
        return None
    control = _checks.numbers("B", B)
    if control.size % n or (control.ndim and len(control) != n):
        raise ValueError(f"B: expected shape ({n}, dim_u) for dim_x={n}, got {_checks.described(control)}")
    return finite("B", control.reshape(n, -1), (n, control.size // n))


def psi_of(choices: Choices) -> tuple[str, dict[str, float]]:
    """Return the kernel's name of psi, and its numbers; of an export that was not refused it has both."""
    return cast("tuple[str, dict[str, float]]", choices.kernel_psi)
