"""A recording of a linear filter: read once, from a filter and lists, to arrays; taken by filterpy's batch_filter."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._arrays import control_term, measurement_rows, process_noise, stack, state_of
from robust_filterpy._checks import Array, all_covariances, entries
from robust_filterpy.correction.mixed import lags, ordinary_noise
from robust_filterpy.filters.driver import columns_of, require_entries, run, take_steps
from robust_filterpy.filters.notices import look_at_recording, look_for_repeats, look_for_stuck
from robust_filterpy.filters.shell import Shell
from robust_filterpy.kernel.series import Rows

__all__ = ["Problem", "RecordingMixin", "finite", "read"]


class Problem(NamedTuple):
    """A linear model with its data; matrices that stay have a first axis of length 1, the others of length N."""

    #: Measurements, NaN where missing, shape (N, m).
    zs: Array
    #: Shape (1 or N, n, n).
    F: Array
    #: Shape (1 or N, n, n).
    Q: Array
    #: Shape (1 or N, m, n).
    H: Array
    #: Shape (1 or N, m, m).
    R: Array
    #: What inputs add to the state, shape (1 or N, n).
    Bu: Array
    #: State before the first prediction, shape (n,).
    x: Array
    #: Its covariance, shape (n, n).
    P: Array
    #: Fading memory, >= 1.
    alpha_sq: float = 1.0
    #: What is added to a log-likelihood where P is narrower than the filter's.
    log_narrowed: float = 0.0

    def first(self, steps: int) -> Problem:
        """Return the beginning of the recording."""
        zs, F, Q, H, R, Bu = (part[:steps] for part in self[:6])
        return self._replace(zs=zs, F=F, Q=Q, H=H, R=R, Bu=Bu)


def read(
    kf: Any, zs: Any, Fs: Any = None, Qs: Any = None, Hs: Any = None, Rs: Any = None, Bs: Any = None, us: Any = None
) -> Problem:
    """Return the model and the data of a filter with x, P, F, H, Q, R as arrays, or raise and name what does not fit.
    """
    absent = [name for name in ("x", "P", "F", "H", "Q", "R") if not hasattr(kf, name)]
    if absent:
        raise TypeError(f"filter: expected a linear filter of filterpy's kind, got {type(kf).__name__}: no {absent[0]}")
    x, P = state_of(kf)
    n = len(x)
    m = stack("H", kf.H, Hs, None, (None, n)).shape[1]
    z = measurement_rows(zs, m)
    shapes = {"F": (Fs, (n, n)), "Q": (Qs, (n, n)), "H": (Hs, (m, n)), "R": (Rs, (m, m))}
    F, Q, H, R = (stack(name, getattr(kf, name), each, len(z), shape) for name, (each, shape) in shapes.items())
    Bu = _inputs(getattr(kf, "B", None), Bs, us, n, len(z))
    return Problem(z, F, Q, H, R, Bu, x.ravel(), P, float(getattr(kf, "_alpha_sq", 1.0)))


def finite(problem: Problem) -> Problem:
    """Return a problem, or raise if something was measured that is infinite."""
    infinite = np.isinf(problem.zs).any(axis=1)
    if infinite.any():
        raise ValueError(f"zs: expected finite numbers or NaN (missing), got infinity at step {infinite.argmax()}")
    return problem


def _inputs(B: Any, Bs: Any, us: Any, n: int, steps: int) -> Array:
    """Return B u of each step, (N or 1, n); None in us or Bs is no input, or the filter's own B."""
    if us is None:
        return np.zeros((1, n))
    us, Bs = entries("us", us), entries("Bs", Bs)
    for name, values in (("us", us), ("Bs", Bs)):
        require_entries(name, values, steps, "measurements")
    if B is None and Bs is None:
        raise ValueError("us: expected no inputs for a filter without B; set kf.B")
    matrices: Any
    us = us[:steps] if isinstance(us, np.ndarray) else list(us)[:steps]
    width = np.size(us[0])
    alike = np.ndim(B if Bs is None else Bs[0]) == 2 and all(u is not None and np.size(u) == width for u in us)
    if alike and (Bs is None or all(np.shape(one) == (n, width) for one in Bs)):
        matrices = stack("B", B, Bs, steps, (n, width))
        terms = np.einsum("kij,kj->ki", np.broadcast_to(matrices, (steps, n, width)), measurement_rows(us, width, "us"))
    else:
        matrices = [B] * steps if Bs is None else [B if one is None else one for one in list(Bs)[:steps]]
        pairs = zip(matrices, (0.0 if u is None else u for u in us), strict=True)
        terms = np.array([np.zeros(n) + control_term(b, u, (n,)) for b, u in pairs])
    if not np.isfinite(terms).all():
        raise ValueError("us: expected finite numbers, got NaN or infinity")
    return terms


class RecordingMixin(Shell):
    """Advance a linear filter through a recording: by the compiled loops where they can, else by its own methods."""

    __slots__: tuple[str, ...] = ()

    predict: Callable[..., None]
    update: Callable[..., None]
    _alpha_sq: float

    def _filter_recording(
        self, given: dict[str, Any], update_first: bool, saver: Any, by_kernel: bool, scales: Array | None
    ) -> tuple[Array, Array, Array, Array]:
        """Return what `RobustKalmanFilter.batch_filter` does; whatever is raised, the filter is then as it was."""
        columns = columns_of(given)
        n, dim_x = len(columns[0]), self.dim_x
        shape = (n, dim_x) if np.ndim(self.x) == 1 else (n, dim_x, 1)
        means, means_p = np.zeros(shape), np.zeros(shape)
        covariances, covariances_p = np.zeros((n, dim_x, dim_x)), np.zeros((n, dim_x, dim_x))
        rows = self._read(**given) if by_kernel and n else None
        # The filter's own are the last step and the last with a measurement: what they leave in it stays.
        own: Iterable[int] = range(n)
        begins: dict[int, int] = {}
        if rows is not None:
            shown = Rows(*(a.reshape(n, -1) for a in (means, covariances, means_p, covariances_p)))
            shown = shown._replace(weights=np.full(rows.zs.shape, np.nan), scale=scales)
            seen = np.flatnonzero(~np.isnan(rows.zs).all(axis=1))
            own = sorted({*seen[-1:].tolist(), n - 1})
            begins = dict(zip(own, [0, *(k + 1 for k in own)], strict=False))

        def take(k: int) -> None:
            """Take a step, after those before it that are the kernel's."""
            if rows is not None and begins[k] < k:
                self._run(rows, shown, bool(update_first), begins[k], k)
            z, F, Q, H, R, B, u = (column[k] for column in columns)
            for corrects in (bool(update_first), not update_first):
                if corrects:
                    self.update(z, R=R, H=H)
                    means[k], covariances[k] = self.x, self.P
                else:
                    self.predict(u=u, B=B, F=F, Q=Q)
                    means_p[k], covariances_p[k] = self.x, self.P
            if scales is not None:
                scales[k] = self.process_scale

        take_steps(self, own, take, saver)
        return means, covariances, means_p, covariances_p

    def _read(self, zs: Any, Fs: Any, Qs: Any, Hs: Any, Rs: Any, Bs: Any, us: Any) -> Problem | None:
        """Return a recording as arrays, None if the call is for the filter's own methods."""
        kf: Any = self
        # Sensors of an H that is passed are identified by its rows, which the filter's own methods look up.
        if Hs is not None and self._policy.learns:
            return None
        try:
            # As in filterpy, without a B there is no input.
            rows = read(kf, zs, Fs, Qs, Hs, Rs, Bs, None if kf.B is None and Bs is None else us)
            if Hs is None and rows.H.shape[1] != self.dim_z:
                return None
            symmetric = _symmetric(rows.Q) and _symmetric(rows.R) and _symmetric(rows.P[None])
            if not (symmetric and all_covariances(rows.R) and (Qs is None or all_covariances(rows.Q))):
                return None
            if Qs is None:
                process_noise(kf.Q, None, len(rows.x))
        except (TypeError, ValueError, AttributeError, np.linalg.LinAlgError):
            # Let the filter's own methods say what is wrong, and at which step.
            return None
        return rows

    def _run(self, rows: Problem, shown: Rows, update_first: bool, first: int, last: int) -> None:
        """Take steps of a recording at once."""
        policy, (x, P), m = self._policy, state_of(self), rows.zs.shape[1]
        memory = self._prior(m).memory
        state = policy.standing(self._kept, x.ravel(), P, memory)
        run(
            policy, state, rows.zs, rows[1:6], shown, of=type(self).__name__, first=first, last=last,
            alpha_sq=float(self._alpha_sq), update_first=update_first,
        )  # fmt: skip
        # What else a step leaves in the filter, the filter's own next step sets anew.
        self.x, self.P = state.x.reshape(x.shape).copy(), state.P.copy()
        self._kept = policy.carried_of(self._kept, state)
        if policy.noise is None and policy.learns:
            look_for_repeats(self, state.learnt, memory)
        self._learn(state.learnt, len(state.learnt))
        weights: Any = shown.weights[first:last]  # type: ignore[index]
        if policy.noise is not None:
            look_for_stuck(self, weights, first)
        if not (policy.looks and self._counts_clipped):
            return
        y = _innovations(rows, shown, update_first, first, last)
        H, R = (np.broadcast_to(a, (len(rows.zs), *a.shape[1:]))[first:last] for a in (rows.H, rows.R))
        covariances: Any = shown.covariances_p

        def lagging(some: list[int]) -> Array:
            """Return the innovations of some steps; under noise those that tell, as it is learned at the end."""
            if policy.noise is None:
                return y[some]
            P = covariances[first:last][some].reshape(-1, *self.P.shape)
            S = H[some] @ P @ H[some].swapaxes(1, 2) + ordinary_noise(R[some], state.learnt)
            return lags(y[some], np.diagonal(S, axis1=1, axis2=2))

        look_at_recording(self, weights, y, first, lagging)


def _innovations(rows: Problem, shown: Rows, update_first: bool, first: int, last: int) -> Array:
    """Return the innovations of steps that have been taken, but for what was missing."""
    means: Any = shown.means_p[first:last]  # type: ignore[index]
    if update_first:
        # A step's prediction comes after its correction, and the next corrects it.
        means = np.concatenate([means[:1], means[:-1]])
    H = np.broadcast_to(rows.H, (len(rows.zs), *rows.H.shape[1:]))[first:last]
    return rows.zs[first:last] - np.einsum("kij,kj->ki", H, means)


def _symmetric(stack: Array) -> bool:
    """Return whether every matrix is symmetric to rounding, since the loops look at one half."""
    transposed = stack.transpose(0, 2, 1)
    return bool((np.abs(stack - transposed) <= 1e-13 * (np.abs(stack) + np.abs(transposed))).all())
