"""From a filter or a tracker to the tables and names of its C, or the reason why there is none."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping
from typing import Any, Final, NamedTuple, cast

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._arrays import control_matrix, noise_covariance, process_noise, state_of
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.policies import process_scales
from robust_filterpy.correction.side_by_side import start as start_of_models
from robust_filterpy.correction.spread import NUMBERS
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
from robust_filterpy.filters.kalman import RobustKalmanFilter, replaced
from robust_filterpy.identification import ParameterTracker
from robust_filterpy.kernel.series import JOINT_MOST, Head, rule

# Rounding that a symmetric matrix may have gathered.
_SLACK: Final = 1e-12
# What a subclass may not do in its own way; `predict_x` is the motion, which is a function in C.
_METHODS = ("predict", "update", "_checked", "_correct", "_corrected", "_keep", "_skip")


class Described(NamedTuple):
    """What the C of a filter or tracker is made of."""

    title: str
    #: Of the kernel, in their order.
    headers: tuple[str, ...]
    #: That steps by them, and its header.
    text: str
    #: What $names stand for, and which lines are there.
    values: Mapping[str, Any]
    #: Entries of the table of what stays, in the order of their fields.
    model: Mapping[str, Any]
    #: Of what moves.
    start: Mapping[str, Any]


def is_extended(model: Any) -> bool:
    """Return whether the C of an extended filter steps this one."""
    own = RobustExtendedKalmanFilter
    return isinstance(model, own) and all(getattr(type(model), name) is getattr(own, name) for name in _METHODS)


def mixes(kf: RobustKalmanFilter | RobustExtendedKalmanFilter) -> bool:
    """Return whether the kernel weighs what this filter's noise may have been."""
    return kf.noise is not None and not any(Head(*kf.policy.rule[: len(Head._fields)])[-2:])


def described_filter(kf: RobustKalmanFilter | RobustExtendedKalmanFilter, name: str) -> Described:
    """Return what the C of a filter is made of, or raise."""
    mixed, extended = mixes(kf), isinstance(kf, RobustExtendedKalmanFilter)
    require_own(kf, "model") if mixed else require_plain(kf, "model")
    if extended and mixed and kf._kept is not None:
        raise ValueError(
            f"process: expected 'given' for an extended filter, of whose models there is no C, got {kf.process!r}; set "
            f"process='given', which trusts Q and the start, before the export"
        )
    x, P = state_of(kf)
    n, m = len(x), kf.dim_z
    model = _matrices(kf)
    inputs = model["B"].shape[1] if "B" in model else 0
    own_motion = isinstance(kf, RobustExtendedKalmanFilter) and (
        type(kf).predict_x is not RobustExtendedKalmanFilter.predict_x or "predict_x" in vars(kf)
    )  # fmt: skip
    values = {
        "n": n, "m": m, "inputs": inputs, "extended": extended, "mixes": mixed, "fades": "alpha_sq" in model,
        "moves": own_motion, "or": "never" if own_motion else "or",
        "alpha_sq": "model->alpha_sq" if "alpha_sq" in model else "REAL(1.0)",
        "innovation": "residual(z, h(x))" if extended else "z - H x",
        "example_u": ", u" * bool(inputs), "example_sensor": ", &sensor" * extended,
        "example_motion": (", &motion" if own_motion else ", NULL") * extended,
        "motion_parameter": f", const {name}_motion *motion" * extended,
        "sensor_parameter": f", const {name}_sensor *sensor" * extended,
        "predict_parameter": f", const {name}_real u[{inputs}]" * bool(inputs),
        "control_given": "u != NULL ? control : NULL" if inputs else "NULL",
        "control_too": " || u != NULL" * bool(inputs),
        "matrix": "motion != NULL ? F : model->F" if extended else "model->F",
        "blind": " || sensor == NULL || sensor->h == NULL || sensor->jacobian == NULL" * extended,
        "compared": ("y, z, H" if mixed else "z, y, H") if extended else "z, z, model->H",
        "hypotheses": "1" if extended else "MODELS",
        "innovation_shown": "y[i]" if extended else "z[i] - real_dot(N, &model->H[i * N], state->x)",
    }  # fmt: skip
    part = _mixture if mixed else _bounded
    headers, said, own, start, shown, remark = part(kf, name, x, P, model)
    if extended:
        start = {field: value for field, value in start.items() if field in ("x", "P", "memory")}
        own = {**own, "models": ""}
        remark += f" h, f and their Jacobians are yours: see {name}_sensor and {name}_motion."
    title = f"{name}: {type(kf).__name__}(dim_x={n}, dim_z={m}), {said}"
    values = {**values, **own, "remark": f"A component of z that is NaN is missing. {remark}"}
    return Described(title, headers, "filter", values, {**model, **shown}, start)


# Fields of a tracker's state that its text writes itself.
_BY_HAND = "R", "R_samples", "readings"
_Part = tuple[tuple[str, ...], str, dict[str, Any], dict[str, Any], dict[str, Any], str]


def _bounded(kf: Any, name: str, x: Array, P: Array, model: dict[str, Any]) -> _Part:
    """Return headers, choices in words, names, start, fields and a remark of a filter that corrects by psi."""
    choices, m = kf.choices, kf.dim_z
    joint = m > 1 and choices.grouping != "component"
    if joint:
        _require_joint(choices, model["R"])
    values = choice_values(choices, name)
    start = {"x": _checks.finite("x", x.ravel(), x.shape[:1]), "P": symmetric("P", P)}
    if values["learns"]:
        start["memory"] = _checks.finite("memory", _sensor_memory(kf, "spread"), (m, NUMBERS))
    headers = "real", "psi", "prediction", "correction", *(("joint",) if joint else ()), "spread", "update"
    values |= {"width": NUMBERS, "models": "", "joint": joint, "normalizers": "normalizers" if joint else "NULL"}
    values["patience"] = choices.patience or 0
    remark = f"For another threshold at run time change a copy of {name}_default."
    return headers, shown(choices), values, start, influence_fields(choices), remark


def _mixture(kf: Any, name: str, x: Array, P: Array, model: dict[str, Any]) -> _Part:
    """Return the same of a filter that weighs what its noise may have been."""
    n, m, numbers = len(x), kf.dim_z, kf.policy.rule
    head = Head(*numbers[: len(Head._fields)])
    q, K = int(head.models), int(head.classes)
    process, scales, begin = np.split(numbers[len(head) :], [q, q + K])
    # One model, which is x and P themselves, is not kept apart.
    one = start_of_models(x.ravel(), P, process_scales(None)).packed
    state: dict[str, Any] = dict(zip(("means", "covariances", "belief"), one, strict=True)) | kf.state()
    models = len(state["means"])
    for covariance in (P, *state["covariances"]):
        symmetric("P", covariance)
    # As they stand: what is symmetric but for the last bit has to go on as it would in Python.
    start = {
        "x": _checks.finite("x", x.ravel(), (n,)), "P": P, "means": _checks.finite("x", state["means"], (models, n)),
        "covariances": np.concatenate(state["covariances"]), "belief": state["belief"].ravel(),
        "memory": _checks.finite("memory", _sensor_memory(kf, "learnt"), (m, len(begin))),
    }  # fmt: skip
    values = {
        "models": models, "parts": len(state["belief"]), "width": len(begin), "q": q, "K": K, "learns": "",
        "process": _listed(process), "scales": _listed(scales), "begin": _listed(begin),
        "numbers": _listed(head[2:6]), "adapts": int(head.learns), "influence_fields": "",
    }  # fmt: skip
    remark = f"A step that Python leaves to its definition is refused, {name.upper()}_SINGULAR."
    headers = "real", "psi", "prediction", "correction", "spread", "update", "repeats", "learnt"
    return headers, f"noise={kf.noise!r}, process={kf.process!r}", values, start, {}, remark


def _listed(values: Iterable[float]) -> str:
    """Return numbers as C writes them, of its own type."""
    written = ", ".join(f"REAL({float(value)!r})" for value in values)
    return textwrap.fill(written, 110, initial_indent=" " * 4, subsequent_indent=" " * 4)


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


def _matrices(kf: RobustKalmanFilter | RobustExtendedKalmanFilter) -> dict[str, Any]:
    """Return the matrices of a filter, as the model in C has them, or raise."""
    n, m, B = kf.dim_x, kf.dim_z, control_matrix(0.0 if kf.B is None else kf.B, kf.dim_x)
    F = _checks.finite("F", kf.F, (n, n))
    H = {"H": _checks.finite("H", kf.H, (m, n))} if isinstance(kf, RobustKalmanFilter) else {}
    Q, R = symmetric("Q", process_noise(kf.Q, None, n)), symmetric("R", noise_covariance(kf.R, None, m))
    alpha_sq = float(kf.state().get("alpha_sq", 1.0))
    model = {"F": F, **({"B": _checks.finite("B", B, B.shape)} if B.size else {}), "Q": Q, **H, "R": R}
    return model if alpha_sq == 1.0 else model | {"alpha_sq": alpha_sq}


def _sensor_memory(kf: RobustKalmanFilter | RobustExtendedKalmanFilter, name: str) -> Array:
    """Return what a filter knows of its sensors, by its name in a state: nothing before the first correction."""
    nothing = kf.policy.begin(kf.dim_z)
    memory = kf.state().get(name, nothing)
    return memory if len(memory) == len(nothing) else nothing


def choice_values(choices: Choices, name: str) -> dict[str, Any]:
    """Return the choices of a filter as the kernel names them."""
    kind, numbers = cast("tuple[str, dict[str, float]]", choices.kernel_psi)
    # Linear, which cannot become anything else at run time, has no thresholds to learn for.
    learns = choices.scaling == "learnt" and kind != "linear"
    scaling = choices.scaling if learns or choices.scaling != "learnt" else "innovation"
    meant = {"threshold": "standard deviations", "df": "degrees of freedom"}
    return {
        "kind": f"PSI_{kind.upper()}", "scaling": f"SCALING_{scaling.upper()}",
        "information": f"INFORMATION_{choices.information.upper()}",
        "rule": "\n".join(f"    rule.psi.{own} = model->{field};" for own, field in zip("abc", numbers, strict=False)),
        "influence_fields": "\n".join(
            f"    {name}_real {field}; /* of psi: {meant.get(field, 'a corner, in standard deviations')} */"
            for field in numbers
        ),
        "expected": choices.information == "expected", "learns": learns,
        # The definition's way: without a threshold it is the Kalman filter.
        "may_be_linear": learns and kind == "huber",
        "memory": "(spread_memory *)next.memory" if learns else "NULL",
    }  # fmt: skip


def require_own(kf: Any, name: str) -> None:
    """Raise unless a filter's methods are its own, and its inverse numpy's."""
    if (part := replaced(kf)) == "inv":
        raise ValueError(
            f"inv: expected numpy's inverse of S, got {kf.inv!r}; make R positive definite and set inv=numpy.linalg.inv"
        )
    if part:
        raise ValueError(f"{name}: expected the filter's own {part}(), got one that was put in its place")


def require_plain(kf: Any, name: str) -> None:
    """Raise unless a filter does what the C of a `RobustKalmanFilter` does."""
    require_own(kf, name)
    if kf.noise is not None:
        off = ", ".join(f"{word}=None" for word in ("noise", "process") if getattr(kf, word) is not None)
        raise ValueError(
            f"{name}: expected bounded influence, or, of a linear filter, noise given or learned sensor by sensor with "
            f"process='given' or Scales, of which there is C, got noise={kf.noise!r}, process={kf.process!r}; "
            f"set {off} before the export"
        )
    if kf.choices.kernel_psi is None:
        raise ValueError(
            f"influence: expected Huber, Hampel, TukeyBiweight, StudentT or Linear, got {kf.influence!r}, of which "
            f"there is no C; set the nearest of these, such as StudentT(4), before the export"
        )


def influence_fields(choices: Choices) -> dict[str, Any]:
    """Return the parameters of psi, and E[psi'] where that is asked for."""
    expected = {"expected": float(choices.expected)} if choices.information == "expected" else {}
    return {**cast("tuple[str, dict[str, float]]", choices.kernel_psi)[1], **expected}


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
        ("real", "psi", "prediction", "correction", "mend", "repeats", "tracker"), "tracker",
        {
            **choice_values(choices, name), **_values(tracker, model, start),
            **{f"has_{field}": np.size(value) for field, value in (model | start).items()},
        },
        {**model, **influence_fields(choices)}, {**start, "enabled": int(tracker.enabled)},
    )  # fmt: skip


def _model(tracker: ParameterTracker) -> dict[str, Any]:
    """Return the table of what stays."""
    kf, n = tracker.filter, tracker.form.layout.n
    model: dict[str, Any] = {}
    if not np.array_equal(kf.F, np.eye(n)):
        model["F"] = _checks.finite("F", kf.F, (n, n))
    model["Q"] = symmetric("Q", process_noise(kf.Q, None, n))
    alpha_sq = float(tracker.state()["alpha_sq"])
    if alpha_sq != 1.0:
        model |= {"alpha_sq": alpha_sq, "windup": float(tracker.now.part("windup")[0])}
    _, _, mean, memory, rounding = tracker.now.scale[0].tolist()
    if memory:
        model |= {"R_memory": memory, "R_mean": mean, "R_rounding": rounding}
    else:
        model["R"] = tracker.R
    return model | ({"centre": float(tracker.now.part("centre")[0])} if tracker.form.has_offset else {})


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
        "fields": "\n".join(f"    next.{one} = state->{one};" for one in start if one not in _BY_HAND),
        "minus_centre": " - model->centre" * tracker.form.has_offset,
        "plus_centre": " + model->centre" * tracker.form.has_offset,
    }  # fmt: skip
