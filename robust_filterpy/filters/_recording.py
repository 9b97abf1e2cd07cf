"""Whole recordings: filterpy's batch_filter, which leaves the filter alone if a step is refused."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._arrays import noise_covariance, process_noise, state_of
from robust_filterpy._checks import Array, all_covariances, entries, numbers, shown
from robust_filterpy.correction.copies import Copies
from robust_filterpy.filters._correlated import look_at_recording
from robust_filterpy.filters._mixin import unchanged_if_refused
from robust_filterpy.filters._mixture import Kept
from robust_filterpy.filters._stuck import look_for_stuck
from robust_filterpy.kernel import available, learnt, series
from robust_filterpy.kernel.records import Model, Output


class Given(NamedTuple):
    """What a recording has for each step, named as in `RobustKalmanFilter.batch_filter`; None: as the filter has it."""

    zs: Any
    Fs: Any
    Qs: Any
    Hs: Any
    Rs: Any
    Bs: Any
    us: Any


def filter_recording(
    kf: Any,
    given: Given,
    update_first: bool,
    saver: Any,
    loop: CompiledLoop | None = None,
    scales: Array | None = None,
) -> tuple[Array, Array, Array, Array]:
    """Advance a filter through a recording: by the compiled loops where they can, else by its own methods.

    Parameters
    ----------
    kf : RobustKalmanFilter
        The filter.
    given : Given
        Measurements, matrices and inputs.
    update_first, saver
        As in `RobustKalmanFilter.batch_filter`.
    loop
        What takes steps by the kernel, None if all are for the filter's own methods.
    scales : ndarray, shape (N,), optional
        Where the process scale of each step is noted.

    Returns
    -------
    means : ndarray, shape (N, dim_x) or (N, dim_x, 1)
        Corrected states.
    covariances : ndarray, shape (N, dim_x, dim_x)
        Their covariances.
    means_p : ndarray, shape of means
        Predicted states.
    covariances_p : ndarray, shape (N, dim_x, dim_x)
        Their covariances.

    Raises
    ------
    ValueError, TypeError, LinAlgError
        As the filter's own methods do, with the step named. Whatever is raised, by a saver, a psi or an interrupt too,
        the filter is then as it was.
    """
    if saver is not None and not callable(getattr(saver, "save", None)):
        raise TypeError(
            f"saver: expected an object with save(), such as filterpy.common.Saver(kf), got {type(saver).__name__}"
        )
    given = Given(*(entries(name, values) for name, values in given._asdict().items()))
    columns = _columns(given)
    n, dim_x = len(given.zs), kf.dim_x
    shape = (n, dim_x) if np.ndim(kf.x) == 1 else (n, dim_x, 1)
    means, means_p = np.zeros(shape), np.zeros(shape)
    covariances, covariances_p = np.zeros((n, dim_x, dim_x)), np.zeros((n, dim_x, dim_x))
    if loop is not None and n:
        kept = Output(
            means.reshape(1, n, dim_x), covariances[None], means_p.reshape(1, n, dim_x), covariances_p[None],
            np.empty((1, 0, 0)), np.zeros(1),
        )  # fmt: skip
        loop.scales = scales
        loop = loop if loop.prepare(given, kept, bool(update_first)) else None
    k = 0
    with unchanged_if_refused(kf):
        try:
            while k < n:
                if loop is not None:
                    k = loop.advance(k)
                z, F, Q, H, R, B, u = (None if column is None else column[k] for column in columns)
                if update_first:
                    kf.update(z, R=R, H=H)
                    means[k], covariances[k] = kf.x, kf.P
                kf.predict(u=u, B=B, F=F, Q=Q)
                means_p[k], covariances_p[k] = kf.x, kf.P
                if not update_first:
                    kf.update(z, R=R, H=H)
                    means[k], covariances[k] = kf.x, kf.P
                if scales is not None:
                    scales[k] = kf.process_scale
                if saver is not None:
                    saver.save()
                k += 1
        except (TypeError, ValueError, np.linalg.LinAlgError) as error:
            error.args = (f"step {k}: {error}", *error.args[1:])
            raise
        return means, covariances, means_p, covariances_p


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


def is_own(kf: Any, cls: type, methods: tuple[str, ...]) -> bool:
    """Return whether these methods of a filter are the class's own, by class and by instance."""
    return all(getattr(type(kf), name, None) is getattr(cls, name) and name not in kf.__dict__ for name in methods)


class CompiledLoop:
    """Steps of a recording by the kernel, and what they leave in the filter."""

    #: Where the process scale of each step is noted, shape (N,), None if nowhere.
    scales: Array | None = None
    _zs: Array
    _model: Model
    _kept: Output
    _options: dict[str, Any]
    _last_seen: int

    def __init__(self, kf: Any) -> None:
        """Keep the filter."""
        self._kf = kf

    def _serves(self) -> bool:
        """Return whether the kernel serves the filter's policy."""
        return series.serves(self._kf.choices)

    def _run(self, k: int, last: int) -> int:
        """Take steps from k to last - 1 as far as the kernel can, and return the next."""
        kf = self._kf
        x, P = state_of(kf)
        state, covariance = x.reshape(1, -1).copy(), P[None].copy()
        memory = kf._known(self._zs.shape[2]).memory[None].copy() if kf._learns_spread else None
        watches = kf.choices.scaling == "innovation"
        if watches and not self._kept.weights.size:
            self._kept = self._kept._replace(weights=np.full(self._zs.shape, np.nan))
        taken = series.filter_series(
            kf.choices, self._zs, self._model, state, covariance, self._kept, memory=memory, start=k, stop=last,
            **self._options,
        )  # fmt: skip
        if taken[0] > k:
            # What else a step leaves in the filter, the filter's own next step sets anew.
            kf.x, kf.P = state[0].reshape(x.shape), covariance[0]
            if memory is not None:
                kf._learn(memory[0], len(memory[0]))
            if watches:
                kf._look_back(self._kept.weights[0, k : taken[0]], self._innovations(k, taken[0]))
        return int(taken[0])

    def _innovations(self, first: int, last: int) -> Array:
        """Return the innovations of steps, but for what was missing."""
        means = self._kept.means_p[0, first:last]
        if self._options["update_first"]:
            # A step's prediction comes after its correction, and the next corrects it.
            means = np.concatenate([means[:1], means[:-1]])
        H = np.broadcast_to(self._model.H[0], (self._zs.shape[1], *self._model.H.shape[2:]))[first:last]
        return self._zs[0, first:last] - np.einsum("kij,kj->ki", H, means)

    def advance(self, k: int) -> int:
        """Take steps from k on as far as the kernel can and return the next, which is the filter's.

        The filter's own are the last step and the last with a measurement: what they leave in it stays.
        """
        last = self._last_seen if k <= self._last_seen else self._zs.shape[1] - 1
        return k if k >= last else self._run(k, last)

    def prepare(self, given: Given, kept: Output, update_first: bool) -> bool:
        """Return whether the kernel serves a recording; if not, the call is for the filter's own methods."""
        zs, Fs, Qs, Hs, Rs, Bs, us = given
        kf = self._kf
        # Sensors of an H that is passed are known by its rows, which the filter's own methods look up.
        if Hs is not None and kf._policy.learns:
            return False
        try:
            x, P = state_of(kf)
            n, steps = len(x), len(zs)
            H = _stack(kf.H, Hs, steps, None)
            if H.ndim != 3 or H.shape[2] != n or (Hs is None and H.shape[1] != kf.dim_z):
                return False
            m = H.shape[1]
            if not self._serves():
                return False
            F = _stack(kf.F, Fs, steps, (n, n))
            Q = process_noise(kf.Q, None, n)[None] if Qs is None else _stack(None, Qs, steps, (n, n), True)
            R = noise_covariance(kf.R, None, m)[None] if Rs is None else _stack(None, Rs, steps, (m, m), True)
            if not (_symmetric(Q) and _symmetric(R) and _symmetric(P[None]) and all_covariances(R)):
                return False
            if Qs is not None and not all_covariances(Q):
                return False
            rows = _measurements(zs, m)
            control = _control(kf.B, Bs, us, n, steps)
        except (TypeError, ValueError, AttributeError, np.linalg.LinAlgError):
            # Let the filter's own methods say what is wrong, and at which step.
            return False
        self._zs, self._kept = rows[None], kept
        self._model = Model(*(np.ascontiguousarray(a, dtype=float)[None] for a in (F, Q, H, R, control)))
        self._options = {"alpha_sq": float(kf._alpha_sq), "update_first": update_first}
        seen = np.flatnonzero(~np.isnan(rows).all(axis=1))
        self._last_seen = int(seen[-1]) if len(seen) else -1
        return True


class MixtureLoop(CompiledLoop):
    """The same for a filter under ``noise=``."""

    def _serves(self) -> bool:
        """Return whether the kernel serves the filter's policy."""
        return available()

    def _run(self, k: int, last: int) -> int:
        """Take steps from k to last - 1 as far as the kernel can, and return the next."""
        kf, policy = self._kf, self._kf._policy
        x, P = state_of(kf)
        now = policy.current(kf._kept, x.ravel(), P)
        state = learnt.begin(now.copies, kf._known(self._zs.shape[2]).memory)
        means, covariances, means_p, covariances_p = (array[0] for array in self._kept[:4])
        flat, weights = (len(means), -1), np.ones(self._zs.shape[1:])
        into = learnt.Kept(
            means, covariances.reshape(flat), means_p, covariances_p.reshape(flat), weights=weights,
            scale=None if self.scales is None else self.scales[:, None],
        )  # fmt: skip
        model = tuple(array[0] for array in self._model)
        taken = learnt.run(
            state, self._zs[0], model, policy.classes, policy.scales, into, first=k, last=last, **self._options
        )
        if taken > k:
            # What else a step leaves in the filter, the filter's own next step sets anew.
            kf.x, kf.P = state.x.reshape(x.shape).copy(), state.P.copy()
            copies = Copies(*state[:3], float(state.unseen[0]))
            kf._kept = None if kf._kept is None else Kept(*copies[:3], state.x, state.P, copies.unseen)
            kf._learn(state.learnt, len(state.learnt))
            look_for_stuck(kf, weights[k:taken], k)
            if means_p.shape[1] and kf._counts_clipped:
                look_at_recording(kf, self._innovations(k, taken), k)
        return taken


def _measurements(zs: Any, m: int) -> Array:
    """Return measurements as shape (N, m), None and masked rows as NaN, or raise."""
    steps = len(zs)
    if not isinstance(zs, np.ndarray):
        gap = [np.nan] * m
        zs = [gap if z is None else np.ma.filled(np.ma.asarray(z, dtype=float), np.nan).ravel() for z in zs] if any(
            z is None or isinstance(z, np.ma.MaskedArray) for z in zs
        ) else zs  # fmt: skip
    values = numbers("zs", zs)
    if values.size != steps * m or values.ndim > 3 or (values.ndim == 3 and 1 not in values.shape[1:]):
        raise ValueError(f"zs: expected shape {(steps, m)}, got {values.shape}")
    return np.ascontiguousarray(values.reshape(steps, m))


def _stack(default: Any, values: Any, steps: int, shape: tuple[int, int] | None, scalars: bool = False) -> Array:
    """Return one matrix, or one a step, as shape (1 or N, ., .), or raise; a scalar stands for itself times I."""
    if values is None:
        found = numbers("matrix", default)[None]
    else:
        found = numbers("matrices", values if isinstance(values, np.ndarray) else list(values)[:steps])[:steps]
        if scalars and found.ndim == 1:
            found = found[:, None, None] * np.eye(shape[0])  # type: ignore[index]
    if found.ndim != 3 or (shape is not None and found.shape[1:] != shape):
        raise ValueError("matrices: expected one shape for all steps")
    return found


def _symmetric(stack: Array) -> bool:
    """Return whether every matrix is symmetric to rounding, since the loops look at one half."""
    transposed = stack.transpose(0, 2, 1)
    return bool((np.abs(stack - transposed) <= 1e-13 * (np.abs(stack) + np.abs(transposed))).all())


def _control(B: Any, Bs: Any, us: Any, n: int, steps: int) -> Array:
    """Return B u as shape (1 or N, n)."""
    if us is None or (B is None and Bs is None):
        return np.zeros((1, n))
    if Bs is None and np.ndim(B) == 0 and B == 0:
        return np.zeros((1, n))
    matrices = _stack(B, Bs, steps, None)
    width = matrices.shape[2]
    if matrices.shape[1] != n:
        raise ValueError("B: expected a row for each state")
    u = _measurements(us if isinstance(us, np.ndarray) else list(us)[:steps], width)[:steps]
    if not np.isfinite(u).all():
        raise ValueError("us: expected finite numbers")
    return np.einsum("kij,kj->ki", np.broadcast_to(matrices, (steps, n, width)), u)
