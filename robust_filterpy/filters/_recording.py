"""Whole recordings: filterpy's batch_filter, which leaves the filter alone if a step is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._arrays import process_noise, state_of
from robust_filterpy._checks import Array, all_covariances, entries, shown
from robust_filterpy.filters.notices import look_at_recording, look_for_repeats, look_for_stuck
from robust_filterpy.filters.policies import ordinary_noise
from robust_filterpy.filters.problem import read
from robust_filterpy.filters.shell import Shell
from robust_filterpy.filters.snapshot import unchanged_if_refused
from robust_filterpy.kernel import available, series
from robust_filterpy.kernel.series import Kept


class Given(NamedTuple):
    """What a recording has for each step, named as in `RobustKalmanFilter.batch_filter`; None: as the filter has it."""

    zs: Any
    Fs: Any
    Qs: Any
    Hs: Any
    Rs: Any
    Bs: Any
    us: Any


class Steps(NamedTuple):
    """Steps of a recording as the kernel takes them, and where they leave what becomes of the filter."""

    zs: Array
    """Measurements, shape (N, m)."""
    model: tuple[Array, ...]
    """F, Q, H, R, B u, one a step or one for all."""
    kept: Any
    """A `robust_filterpy.kernel.series.Kept`."""
    options: dict[str, Any]
    """How far memory fades, and whether a step corrects first."""
    last_seen: int
    """The last step with a measurement, -1 if there is none."""


class RecordingMixin(Shell):
    """Advance a linear filter through a recording: by the compiled loops where they can, else by its own methods."""

    __slots__: tuple[str, ...] = ()

    predict: Callable[..., None]
    update: Callable[..., None]
    _alpha_sq: float

    def _filter_recording(
        self, given: Given, update_first: bool, saver: Any, by_kernel: bool, scales: Array | None
    ) -> tuple[Array, Array, Array, Array]:
        """Return what `RobustKalmanFilter.batch_filter` does; whatever is raised, the filter is then as it was."""
        if saver is not None and not callable(getattr(saver, "save", None)):
            raise TypeError(
                f"saver: expected an object with save(), such as filterpy.common.Saver(kf), got {type(saver).__name__}"
            )
        given = Given(*(entries(name, values) for name, values in given._asdict().items()))
        columns = _columns(given)
        n, dim_x = len(given.zs), self.dim_x
        shape = (n, dim_x) if np.ndim(self.x) == 1 else (n, dim_x, 1)
        means, means_p = np.zeros(shape), np.zeros(shape)
        covariances, covariances_p = np.zeros((n, dim_x, dim_x)), np.zeros((n, dim_x, dim_x))
        steps = None
        if by_kernel and n:
            rows = [a.reshape(n, -1) for a in (means, covariances, means_p, covariances_p)]
            kept = Kept(rows[0], rows[1], rows[2], rows[3], scale=scales)
            steps = self._prepared(given, kept, bool(update_first))
        k = 0
        with unchanged_if_refused(self):
            try:
                while k < n:
                    if steps is not None:
                        k = self._advance(steps, k)
                    z, F, Q, H, R, B, u = (None if column is None else column[k] for column in columns)
                    if update_first:
                        self.update(z, R=R, H=H)
                        means[k], covariances[k] = self.x, self.P
                    self.predict(u=u, B=B, F=F, Q=Q)
                    means_p[k], covariances_p[k] = self.x, self.P
                    if not update_first:
                        self.update(z, R=R, H=H)
                        means[k], covariances[k] = self.x, self.P
                    if scales is not None:
                        scales[k] = self.process_scale
                    if saver is not None:
                        saver.save()
                    k += 1
            except (TypeError, ValueError, np.linalg.LinAlgError) as error:
                error.args = (f"step {k}: {error}", *error.args[1:])
                raise
            return means, covariances, means_p, covariances_p

    def _prepared(self, given: Given, kept: Kept, update_first: bool) -> Steps | None:
        """Return the steps of a recording for the kernel, None if the call is for the filter's own methods."""
        zs, Fs, Qs, Hs, Rs, Bs, us = given
        kf: Any = self
        # Sensors of an H that is passed are known by its rows, which the filter's own methods look up.
        if Hs is not None and self._policy.learns:
            return None
        try:
            if not (series.serves(self._choices) if self._policy.by_kernel else available()):
                return None
            # As in filterpy, without a B there is no input.
            rows = read(kf, zs, Fs, Qs, Hs, Rs, Bs, None if kf.B is None and Bs is None else us)
            Q, R = rows.Q, rows.R
            if Hs is None and rows.H.shape[1] != self.dim_z:
                return None
            if not (_symmetric(Q) and _symmetric(R) and _symmetric(rows.P[None]) and all_covariances(R)):
                return None
            if Qs is None:
                process_noise(kf.Q, None, len(rows.x))
            elif not all_covariances(Q):
                return None
        except (TypeError, ValueError, AttributeError, np.linalg.LinAlgError):
            # Let the filter's own methods say what is wrong, and at which step.
            return None
        kept = kept._replace(weights=np.full(rows.zs.shape, np.nan))
        model = tuple(np.ascontiguousarray(a, dtype=float) for a in rows[1:6])
        seen = np.flatnonzero(~np.isnan(rows.zs).all(axis=1))
        options = {"alpha_sq": float(self._alpha_sq), "update_first": update_first}
        return Steps(rows.zs, model, kept, options, int(seen[-1]) if len(seen) else -1)

    def _advance(self, steps: Steps, k: int) -> int:
        """Take steps from k on as far as the kernel can and return the next, which is the filter's."""
        # The filter's own are the last step and the last with a measurement: what they leave in it stays.
        last = steps.last_seen if k <= steps.last_seen else len(steps.zs) - 1
        if k >= last:
            return k
        policy, (x, P), weights = self._policy, state_of(self), steps.kept.weights
        state = policy.standing(self._kept, x.ravel(), P, self._known(steps.zs.shape[1]).memory)
        taken: int = policy.advance(state, steps.zs, steps.model, steps.kept, first=k, last=last, **steps.options)
        if taken == k:
            return k
        # What else a step leaves in the filter, the filter's own next step sets anew.
        self.x, self.P = state.x.reshape(x.shape).copy(), state.P.copy()
        self._kept = policy.kept_of(self._kept, state)
        if policy.noise is None and policy.learns:
            look_for_repeats(self, state.learnt, self._known(steps.zs.shape[1]).memory)
        self._learn(state.learnt, len(state.learnt))
        if policy.noise is None:
            if self._choices.scaling == "innovation":
                self._look_back(weights[k:taken], _innovations(steps, k, taken))
            return taken
        look_for_stuck(self, weights[k:taken], k)
        if self._counts_clipped:
            _, _, H, R, _ = (np.broadcast_to(rows, (len(steps.zs), *rows.shape[1:]))[k:taken] for rows in steps.model)

            def variances(some: list[int]) -> Array:
                """Return those of the innovations of some steps, with the noise as it is learnt at the end."""
                P = steps.kept.covariances_p[k:taken][some].reshape(-1, *self.P.shape)
                noise = ordinary_noise(R[some], state.learnt)
                return np.diagonal(H[some] @ P @ H[some].swapaxes(1, 2) + noise, axis1=1, axis2=2)

            look_at_recording(self, _innovations(steps, k, taken), k, variances)
        return taken


def _innovations(steps: Steps, first: int, last: int) -> Array:
    """Return the innovations of steps that have been taken, but for what was missing."""
    means = steps.kept.means_p[first:last]
    if steps.options["update_first"]:
        # A step's prediction comes after its correction, and the next corrects it.
        means = np.concatenate([means[:1], means[:-1]])
    H = np.broadcast_to(steps.model[2], (len(steps.zs), *steps.model[2].shape[1:]))[first:last]
    return steps.zs[first:last] - np.einsum("kij,kj->ki", H, means)


def _columns(given: Given) -> list[Any]:
    """Return the columns, each with an entry for every step, or None."""
    try:
        n = len(given.zs)
    except TypeError:
        raise TypeError(f"zs: expected a sequence of measurements, got {shown(given.zs)}") from None
    columns = []
    for name, values in given._asdict().items():
        if values is not None and (not hasattr(values, "__len__") or len(values) < n):
            found = len(values) if hasattr(values, "__len__") else shown(values)
            raise ValueError(f"{name}: expected an entry for each of the {n} measurements in zs, got {found}")
        columns.append(values)
    # An iterator reads what has a length but no places, such as the values of a dictionary or a data frame's column.
    return [
        None if column is None else column if isinstance(column, np.ndarray) else list(column) for column in columns
    ]


def _symmetric(stack: Array) -> bool:
    """Return whether every matrix is symmetric to rounding, since the loops look at one half."""
    transposed = stack.transpose(0, 2, 1)
    return bool((np.abs(stack - transposed) <= 1e-13 * (np.abs(stack) + np.abs(transposed))).all())
