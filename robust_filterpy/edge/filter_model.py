"""From a `RobustKalmanFilter` to the tables and sections of its C, or the reason why there is none."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._arrays import noise_covariance, process_noise, state_of
from robust_filterpy._checks import Array
from robust_filterpy.compiled.dispatch import can_compile, encoded
from robust_filterpy.correction.options import Choices
from robust_filterpy.edge.template import Described
from robust_filterpy.filters.kalman import RobustKalmanFilter

# Parameters of each psi, by the name of its scalar form.
_FIELDS: Final[dict[str, tuple[str, ...]]] = {
    "linear": (),
    "huber": ("threshold",),
    "hampel": ("a", "b", "c"),
    "tukey": ("threshold",),
    "student_t": ("df",),
}

# Rounding that a symmetric matrix may have gathered.
_SLACK: Final = 1e-12


def described_filter(kf: RobustKalmanFilter, name: str) -> Described:
    """Return what the C of a filter is made of, or raise."""
    require_plain(kf, "model")
    x, P = state_of(kf)
    n, m = len(x), kf.dim_z
    F, H = finite("F", kf.F, (n, n)), finite("H", kf.H, (m, n))
    B = _control(kf.B, n)
    model: dict[str, Any] = {"F": F}
    if B is not None:
        model["B"] = B
    model |= {
        "Q": symmetric("Q", process_noise(kf.Q, None, n)),
        "H": H,
        "R": symmetric("R", noise_covariance(kf.R, None, m)),
    }
    sections = {"control"} if B is not None else set()
    if kf._alpha_sq != 1.0:
        sections.add("fading")
        model["alpha_sq"] = kf._alpha_sq
    model |= influence_fields(kf._choices, m)
    sections |= choice_sections(kf._choices, m)
    eigen = m > 2 or (m == 2 and kf.scaling == "bounded")
    inputs = 0 if B is None else B.shape[1]
    return Described(
        f"{name}: RobustKalmanFilter(dim_x={n}, dim_z={m}), {shown(kf._choices)}",
        ("psi.c", *(("eigen.c",) if eigen else ()), "whitening.c", "correction.c", "predict.c", "filter.c"),
        frozenset(sections),
        {"n": str(n), "m": str(m), "size": str(m), "inputs": str(inputs), "example_u": ", u" if inputs else ""},
        model,
        {"x": finite("x", x.ravel(), (n,)), "P": symmetric("P", P)},
    )


def require_plain(kf: Any, name: str) -> None:
    """Raise unless a filter does what the C of a `RobustKalmanFilter` does."""
    wrapped = {"predict", "update"} & vars(kf).keys()
    if wrapped:
        raise ValueError(f"{name}: expected the filter's own {sorted(wrapped)[0]}(), got one that was put in its place")
    if not can_compile(kf._choices):
        raise ValueError(
            f"influence: expected Huber, Hampel, TukeyBiweight, StudentT or Linear, got {kf.influence!r}, of which "
            f"there is no C; set the nearest of these, such as StudentT(4), before the export"
        )
    if kf._inverse is not None:
        raise ValueError(
            f"inv: expected numpy's inverse of S, got {kf.inv!r}; make R positive definite and set inv=numpy.linalg.inv"
        )


def choice_sections(choices: Choices, m: int) -> set[str]:
    """Return the sections of a filter's choices."""
    joint = {"joint"} if choices.grouping == "joint" and m > 1 else set()
    count = "alone" if m == 1 else "pair" if m == 2 else "many"
    return {_kind(choices), choices.scaling, choices.information, count, *joint}


def influence_fields(choices: Choices, m: int) -> dict[str, Any]:
    """Return the parameters of psi, and E[psi'] where that is asked for."""
    code = encoded(choices, m)
    found: dict[str, Any] = dict(zip(_FIELDS[_kind(choices)], code[1:4].tolist(), strict=False))
    if choices.information == "expected":
        found["expected"] = code[7 : 8 + m]
    return found


def influence_declarations(choices: Choices, name: str) -> str:
    """Return the fields of a model that are psi's."""
    meant = {"threshold": "standard deviations", "df": "degrees of freedom"}
    return "\n".join(
        f"    {name}_real {field}; /* of psi: {meant.get(field, 'a corner, in standard deviations')} */"
        for field in _FIELDS[_kind(choices)]
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
    found = _checks.numbers(name, value)
    if found.shape != shape or not np.isfinite(found).all():
        raise ValueError(f"{name}: expected finite numbers of shape {shape}, got {_checks.shown(value)}")
    return found


def _control(B: Any, n: int) -> Array | None:
    """Return the control matrix, shape (n, dim_u), None if there is none."""
    if B is None or (np.ndim(B) == 0 and B == 0.0) or np.size(B) == 0:
        return None
    found = _checks.numbers("B", B)
    if found.size % n or (found.ndim and len(found) != n):
        raise ValueError(f"B: expected shape ({n}, dim_u) for dim_x={n}, got {_checks.described(found)}")
    return finite("B", found.reshape(n, -1), (n, found.size // n))


def _kind(choices: Choices) -> str:
    """Return the name of a psi's scalar form."""
    return str(choices.pointwise[0].__name__)  # type: ignore[index]
