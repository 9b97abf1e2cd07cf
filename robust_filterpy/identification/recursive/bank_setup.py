"""Argument checks of `TrackerBank`: options and samples, shared by all actuators or with an axis of n."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy import _checks, _state
from robust_filterpy._checks import Array, described, numbers
from robust_filterpy.correction.options import Choices
from robust_filterpy.identification.models.regressor import LARGEST, are_stable
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive import setup
from robust_filterpy.identification.recursive.returning import checked
from robust_filterpy.identification.recursive.state import Form


def actuators(where: np.ndarray) -> str:
    """Name the actuators of a mask."""
    found = np.flatnonzero(where).tolist()
    names = ", ".join(map(str, found[:5])) + (f" and {len(found) - 5} more" if len(found) > 5 else "")
    return f"actuator{'s' if len(found) > 1 else ''} {names}"


# Options.


def each(name: str, value: Any, n: int) -> list[Any]:
    """Return an option that is no number as a list, of one if it is shared by all."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        return [value.item()]
    if not isinstance(value, (list, tuple, np.ndarray)):
        return [value]
    if len(value) != n:
        raise ValueError(f"{name}: expected one for all or a list of {n}, got {len(value)}")
    return list(value)


def options(name: str, value: Any, n: int, allowed: tuple[str, ...]) -> np.ndarray:
    """Return an option of each actuator, shape (n,)."""
    chosen = each(name, value, n)
    shared = not isinstance(value, (list, tuple)) and np.ndim(value) == 0
    found = [_checks.option(name if shared else f"{name}[{i}]", entry, allowed) for i, entry in enumerate(chosen)]
    return np.array(np.broadcast_to(found, n), order="C")


def choices(n: int, given: dict[str, Any]) -> tuple[Choices, ...]:
    """Return the options of the correction, one for all actuators or one each."""
    lists = {name: each(name, value, n) for name, value in given.items() if value is not None}
    several = any(len(entries) > 1 for entries in lists.values())
    return tuple(
        Choices(**{name: entries[i if len(entries) > 1 else 0] for name, entries in lists.items()})
        for i in range(n if several else 1)
    )


def given(name: str, value: Any) -> Array:
    """Return numbers, or raise; None is none."""
    if value is None:
        raise TypeError(f"{name}: expected numbers, got None; leave {name} out for its default")
    return numbers(name, value)


def parameters(structure: Structure, theta: Any, n: int) -> Array:
    """Return the parameters to start from, shape (n, n_theta), or raise."""
    d = structure.n_theta
    values = given("theta", theta)
    if values.shape not in ((), (d,), (n, d)):
        raise ValueError(
            f"theta: expected shape ({d},) or ({n}, {d}) for {structure} and n={n}, got {described(values)}"
        )
    values = np.array(np.broadcast_to(values, (n, d)), order="C")
    require("theta: expected finite numbers, got NaN or infinity", np.isfinite(values).all(axis=1))
    require(
        "theta: expected a stable model to start from, got coefficients that feed back with roots outside the unit "
        "circle",
        np.array([are_stable(row, structure.stable_parts) for row in values]),
    )
    return values


def covariances(name: str, value: Any, n: int, d: int) -> Array:
    """Return a covariance of the parameters, shape (d, d), or (n, d, d) for one of each actuator; or raise."""
    found = given(name, value)
    if found.ndim in (0, 2):
        return setup.covariance(name, found[()], d)
    if found.shape not in ((n,), (n, d, d)):
        raise ValueError(
            f"{name}: expected a number, shape ({d}, {d}), ({n},) or ({n}, {d}, {d}), got {described(found)}"
        )
    return np.stack([setup.covariance(f"{name}[{i}]", entry, d) for i, entry in enumerate(found)])


def matrices(name: str, value: Any, n: int, d: int) -> Array:
    """Return square matrices, shape (d, d) or (n, d, d), or raise."""
    found = numbers(name, value)
    if found.shape not in ((d, d), (n, d, d)):
        raise ValueError(f"{name}: expected shape ({d}, {d}) or ({n}, {d}, {d}), got {described(found)}")
    return setup.finite(name, found)


def variances(value: Any, n: int, length: int | None = None) -> Array:
    """Return R of each actuator, shape (n,), or (length, n) of each sample of a recording too; or raise."""
    found = numbers("R", value)
    shapes = [(), (n,)] if length is None else [(), (length,), (length, n)]
    if found.shape not in shapes:
        raise ValueError(f"R: expected shape {shapes[-1]}, or {shapes[-2]} for all, got {described(found)}")
    found = np.broadcast_to(found[:, None] if found.ndim < len(shapes[-1]) and found.ndim else found, shapes[-1])
    good = (found > 0.0) & (found < np.inf)
    if not good.all():
        raise ValueError(
            f"R: expected variances > 0 (NaN in y is for a sample that is missing), got {found[~good][0]}"
            f"{_where(~good)}"
        )
    return found


def factors(value: Any, n: int) -> Array:
    """Return the forgetting factor of each actuator, shape (n,), or raise."""
    found = numbers("forgetting", 1.0 if value is None else value)
    if found.shape not in ((), (n,)):
        raise ValueError(f"forgetting: expected shape ({n},), or one number for all, got {described(found)}")
    found = np.array(np.broadcast_to(found, n), order="C")
    require("forgetting: expected numbers in (0, 1]", (found > 0.0) & (found <= 1.0))
    return found


def require(sentence: str, good: Any) -> None:
    """Raise ValueError with the sentence and the actuators unless all are good."""
    if not good.all():
        raise ValueError(f"{sentence}: {actuators(~good)}")


def checked_state(state: Any, form: Form, n: int) -> dict[str, Array]:
    """Return the arrays of a bank's state, copied, or raise; the message names the actuators."""
    d = len(form.own)
    own = {name: (n, d, d) if name in state and np.ndim(state[name]) == 3 else (d, d) for name in ("Q", "F")}
    optional = {"kept": (n,)} if "kept" in state else {}
    try:
        return checked(state, form, (n,), {"R": (n,), "alpha_sq": (n,), **own}, optional)
    except _state.StateError as error:
        refused = np.array([not _is_state(state, form, i, n) for i in range(n)])
        raise _state.StateError(f"{error}{'' if refused.all() else f': {actuators(refused)}'}") from None


def _is_state(state: Any, form: Form, i: int, n: int) -> bool:
    """Tell whether what a state holds of one actuator is that of a tracker."""
    whole = {name: np.asarray(state[name]) for name in state if name not in ("Q", "F")}
    rows = {name: value[i] for name, value in whole.items() if value.shape[:1] == (n,)}
    try:
        checked(rows, form._replace(guard=form.guard[i : i + 1]), (), {"R": (), "alpha_sq": ()}, {})
    except _state.StateError:
        return False
    return True


# Samples.


def outputs(y: Any, n: int, recorded: bool) -> Array:
    """Return measured outputs, shape (n,) or (N, n), NaN where they are missing, or raise."""
    values = numbers("y", np.full(n, np.nan) if y is None and not recorded else y)
    if values.ndim != 1 + recorded or values.shape[-1] != n or values.size == 0:
        shape = f"(N, {n}), N >= 1," if recorded else f"({n},)"
        raise ValueError(f"y: expected shape {shape} for n={n}, got {described(values)}")
    infinite = np.isinf(values)
    if infinite.any():
        raise ValueError(f"y: expected finite numbers or NaN (missing), got infinity{_where(infinite)}")
    return np.clip(values, -LARGEST, LARGEST)


def inputs(structure: Structure, u: Any, n: int, length: int | None = None) -> Array:
    """Return inputs, shape (n, n_inputs), or (N, n, n_inputs) for a recording of a given length; or raise."""
    width, time = structure.n_inputs, () if length is None else (length,)
    if u is None:
        if width:
            what = "phi" if structure.takes_phi else "input"
            raise ValueError(f"u: expected the {what} of each sample, {width} number(s) for {structure}, got None")
        return np.zeros((*time, n, 0))
    found = numbers("u", u)
    values = found[..., None] if width == 1 and found.shape in (time, (*time, n)) else found
    if values.shape == (*time, width):
        values = values[..., None, :]
    elif values.shape != (*time, n, width):
        forms = [time, (*time, n)] if width == 1 else [(*time, width), (*time, n, width)]
        raise ValueError(
            f"u: expected shape {forms[0]} for all or {forms[1]} for {structure} and n={n}, got {described(found)}"
        )
    bad = ~(np.abs(values) <= LARGEST).all(axis=-1)
    if bad.any():
        raise ValueError(
            f"u: expected finite numbers up to {LARGEST:g} in size (an input cannot be missing), got "
            f"{values[bad][0]}{_where(np.broadcast_to(bad, (*time, n)))}"
        )
    return np.broadcast_to(values, (*time, n, width))


def _where(bad: np.ndarray) -> str:
    """Name the first sample and its actuators, of a mask (n,) or (N, n)."""
    if bad.ndim == 1:
        return f" from {actuators(bad)}"
    k = int(bad.any(axis=1).argmax())
    return f" in sample {k} from {actuators(bad[k])}"
