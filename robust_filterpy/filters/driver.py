"""The one driver of recordings: the kernel until it declines a step, that step by the definition, the kernel again.

Where rounding has made a P indefinite, the nearest covariance takes its place, and the correction goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from robust_filterpy._arrays import measured, regardless, require_finite_prediction
from robust_filterpy._checks import Array, entries, shown
from robust_filterpy._warning import RobustFilterWarning, warn
from robust_filterpy.correction.result import SingularInnovationError
from robust_filterpy.filters.policies import Carried, Policy, Prior
from robust_filterpy.filters.snapshot import unchanged_if_refused
from robust_filterpy.kernel.series import Rows, State

__all__ = ["at_step", "columns_of", "require_finite_correction", "run", "take_steps", "without_rounding"]


def run(
    policy: Policy, state: State, zs: Array, model: tuple[Any, ...], into: Rows,
    *, of: str, first: int = 0, last: int | None = None, alpha_sq: float = 1.0, update_first: bool = False,
    every: int = 1,
) -> None:  # fmt: skip
    """Take steps of a recording, in place; what is raised names the step, and has its number as ``step``.

    model: F, Q, H, R, B u, one a step or one for all; of: whose steps they are, for a warning; every: distance of the
    steps that have a row in what is into.
    """
    last = len(zs) if last is None else last
    how = {"alpha_sq": alpha_sq, "update_first": update_first, "every": every}
    while first < last:
        first = policy.advance(state, zs, model, into, first=first, last=last, **how)
        if first == last:
            return
        matrices = tuple(None if part is None else part[first % len(part)] for part in model)
        row = (first + 1) // every - 1 if (first + 1) % every == 0 else None
        with at_step(first):
            regardless(_step, policy, state, zs[first], (*matrices, alpha_sq), update_first, into, row, of)
        first += 1


@contextmanager
def at_step(step: int) -> Iterator[None]:
    """Name the step in what is raised, and let it have its number as ``step``, unless it has one."""
    try:
        yield
    except (TypeError, ValueError, np.linalg.LinAlgError) as error:
        if not hasattr(error, "step"):
            error.args, error.step = (f"step {step}: {error}", *error.args[1:]), step  # type: ignore[union-attr]
        raise


def take_steps(kf: Any, places: Iterable[int], take: Callable[[int], None], saver: Any) -> None:
    """Take steps of a recording by a filter's own methods, all of them or none."""
    if saver is not None and not callable(getattr(saver, "save", None)):
        raise TypeError(
            f"saver: expected an object with save(), such as filterpy.common.Saver(kf), got {type(saver).__name__}"
        )
    with unchanged_if_refused(kf):
        for k in places:
            with at_step(k):
                take(k)
                if saver is not None:
                    saver.save()


def columns_of(given: dict[str, Any]) -> list[Any]:
    """Return the columns of a recording, each with an entry for every step; None and a number are all of them."""
    given = {name: entries(name, values) for name, values in given.items()}
    try:
        n = len(given["zs"])
    except TypeError:
        raise TypeError(f"zs: expected a sequence of measurements, got {shown(given['zs'])}") from None
    columns: list[Any] = []
    for name, values in given.items():
        if values is None or (name == "dts" and np.ndim(values) == 0):
            columns.append([values] * n)
            continue
        require_entries(name, values, n, "measurements in zs")
        # An iterator reads what has a length but no places, as the values of a dictionary or a data frame's column.
        columns.append(values if isinstance(values, np.ndarray) else list(values))
    return columns


def require_entries(name: str, values: Any, steps: int, of: str) -> None:
    """Raise unless there is an entry for each step, or nothing at all."""
    if values is not None and (not hasattr(values, "__len__") or len(values) < steps):
        got = len(values) if hasattr(values, "__len__") else shown(values)
        raise ValueError(f"{name}: expected an entry for each of the {steps} {of}, got {got}")


def _step(
    policy: Policy, state: State, z: Array, model: tuple[Any, ...], update_first: bool, into: Rows, row: int | None,
    of: str,
) -> None:  # fmt: skip
    """Take one step by the definition and show it in a row, if it has one."""
    F, Q, H, R, Bu, alpha_sq = model
    weights, outlying, log_density = np.full(len(z), np.nan), 0.0, 0.0
    x, P, memory, carried = state.x, state.P, state.learnt, None
    if len(state.means) > 1:
        carried = Carried(*(part.copy() for part in (*state[:3], x, P)))
    for predicts in (not update_first, update_first):
        if predicts:
            x, P, carried = policy.predicted(carried, x, P, F, Q, Bu, alpha_sq)
            require_finite_prediction(x, P)
            _show(into.means_p, into.covariances_p, row, x, P)
            continue
        if measured(z, len(z)) is not None:
            at = x

            def correct(before: Prior, P: Array, at: Array = at) -> Any:
                """Correct with this P."""
                return policy.corrected(before, at, P, z, H, R, None, False)

            correction, carried = without_rounding(of, correct, Prior(memory, carried), P, H, R)
            require_finite_correction(correction)
            x, P, weights, log_density = correction.x, correction.P, correction.weights, correction.log_density
            memory = memory if correction.memory is None else correction.memory
            outlying = getattr(correction, "outlier_probabilities", 0.0)
        _show(into.means, into.covariances, row, x, P)
    state.x[:], state.P[:], state.learnt[:] = x, P, memory
    if len(state.means):
        for whole, now in zip(state[:3], policy.current(carried, x, P), strict=False):
            whole[:] = now
    if into.log_likelihood is not None:
        into.log_likelihood[:] += log_density
    for column, value in ((into.weights, weights), (into.outlying, outlying)):
        if column is not None and row is not None:
            column[row] = value
    if into.scale is not None and row is not None:
        into.scale[row] = policy.process_scale(carried, len(x))


def _show(means: Array | None, covariances: Array | None, row: int | None, x: Array, P: Array) -> None:
    """Write a state into a row, the whole of P or its diagonal."""
    if means is not None and row is not None:
        means[row] = x
    if covariances is not None and row is not None:
        covariances[row] = P.ravel() if covariances.shape[1] == P.size else P.diagonal()


def require_finite_correction(correction: Any) -> None:
    """Raise unless x and P of a correction are finite."""
    if not (np.isfinite(correction.x).all() and np.isfinite(correction.P).all()):
        raise ValueError("update: expected a finite x and P, got NaN or infinity; check z, P and R, or units")


def without_rounding(
    name: str, correct: Callable[[Any, Array], Any], before: Any, P: Array, H: Array | None, R: Array
) -> Any:  # fmt: skip
    """Return the correction of P, of what the policy knows; where rounding has left S no inverse, of a mended P."""
    try:
        return correct(before, P)
    except SingularInnovationError:
        carried, stack = before.carried, P[None]
        if hasattr(carried, "covariances") and carried.P.tobytes() == P.tobytes():
            stack = np.concatenate([stack, carried.covariances])
        mended = None if H is None else _mended(stack, H, R)
        if mended is None:
            raise
        if len(mended) > 1:
            before = before._replace(carried=carried._replace(covariances=mended[1:], P=mended[0]))
        correction = correct(before, mended[0])
    warn(
        f"{name}: H P H' is negative by rounding, since P holds numbers as large as {np.abs(P).max():.3g}; the nearest "
        f"covariance took the place of P; leave out states that no sensor sees, or begin with a smaller P",
        RobustFilterWarning,
        of=name,
    )
    return correction


def _mended(stack: Array, H: Array, R: Array) -> Array | None:
    """Return the nearest covariances; None if sensors see nothing negative, or rounding is no match for their noise."""
    variances, noise = np.diagonal(stack, axis1=1, axis2=2), R.diagonal()
    seen = H @ stack @ H.T
    if not (np.isfinite(stack).all() and np.isfinite(seen).all() and np.linalg.eigvalsh(seen).min() < 0.0):
        return None
    rounding = stack.shape[1] ** 2 * np.finfo(float).eps
    if not (0.0 < noise).all() or not (rounding * H**2 @ variances.T > noise[:, None]).any():
        return None
    unit = np.sqrt(np.maximum(np.abs(variances), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(stack / unit[:, None] / unit[:, :, None])
    root = unit[:, :, None] * vectors * np.sqrt(np.maximum(values, rounding))[:, None]
    return np.asarray(root @ root.swapaxes(1, 2))
