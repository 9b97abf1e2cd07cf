"""Whole recordings: filterpy's batch_filter, which leaves the filter alone if a step is refused."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from robust_filterpy._checks import Array, entries, shown
from robust_filterpy.compiled import dispatch
from robust_filterpy.filters import _batch_arrays
from robust_filterpy.filters._mixin import RobustFilterMixin

__all__: list[str] = []


def filter_recording(
    kf: Any,
    zs: Any,
    Fs: Any,
    Qs: Any,
    Hs: Any,
    Rs: Any,
    Bs: Any,
    us: Any,
    update_first: bool,
    saver: Any,
    own: bool = False,
) -> tuple[Array, Array, Array, Array]:
    """Advance a filter through a recording: by the compiled loops where they can, else by its own methods.

    Parameters
    ----------
    kf : RobustKalmanFilter
        The filter.
    zs, Fs, Qs, Hs, Rs, Bs, us, update_first, saver
        As in `RobustKalmanFilter.batch_filter`.
    own
        Whether nobody has put methods of his own in the place of the filter's.

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
        As the filter's own methods do, with the step named; the filter is then as it was.
    """
    if saver is not None and not callable(getattr(saver, "save", None)):
        raise TypeError(
            f"saver: expected an object with save(), such as filterpy.common.Saver(kf), got {type(saver).__name__}"
        )
    given = {"zs": zs, "Fs": Fs, "Qs": Qs, "Hs": Hs, "Rs": Rs, "Bs": Bs, "us": us}
    zs, Fs, Qs, Hs, Rs, Bs, us = (entries(name, values) for name, values in given.items())
    columns = _columns(zs, Fs=Fs, Qs=Qs, Hs=Hs, Rs=Rs, Bs=Bs, us=us)
    n, dim_x = len(zs), kf.dim_x
    shape = (n, dim_x) if np.ndim(kf.x) == 1 else (n, dim_x, 1)
    means, means_p = np.zeros(shape), np.zeros(shape)
    covariances, covariances_p = np.zeros((n, dim_x, dim_x)), np.zeros((n, dim_x, dim_x))
    before = _snapshot(kf)
    compiled = None
    if own and n >= dispatch.LONG and saver is None and dispatch.can_compile(kf._choices):
        kept = dispatch.Kept(
            means.reshape(1, n, dim_x), covariances[None], means_p.reshape(1, n, dim_x), covariances_p[None],
            np.empty((1, 0, 0)), np.zeros(1),
        )  # fmt: skip
        compiled = _batch_arrays.prepared(kf, zs, Fs, Qs, Hs, Rs, Bs, us, kept, bool(update_first))
    k = 0
    try:
        while k < n:
            if compiled is not None:
                k = compiled.advance(kf, k)
            z, F, Q, H, R, B, u = (None if column is None else column[k] for column in columns)
            if update_first:
                kf.update(z, R=R, H=H)
                means[k], covariances[k] = kf.x, kf.P
            kf.predict(u=u, B=B, F=F, Q=Q)
            means_p[k], covariances_p[k] = kf.x, kf.P
            if not update_first:
                kf.update(z, R=R, H=H)
                means[k], covariances[k] = kf.x, kf.P
            if saver is not None:
                saver.save()
            k += 1
    except (TypeError, ValueError, np.linalg.LinAlgError) as error:
        _restore(kf, before)
        error.args = (f"step {k}: {error}", *error.args[1:])
        raise
    return means, covariances, means_p, covariances_p


def _columns(zs: Any, **per_step: Any) -> list[Any]:
    """Return zs, F, Q, H, R, B, u, each with an entry for every step, or None."""
    try:
        n = len(zs)
    except TypeError:
        raise TypeError(f"zs: expected a sequence of measurements, got {shown(zs)}") from None
    columns = [zs]
    for name, values in per_step.items():
        if values is not None and (not hasattr(values, "__len__") or len(values) < n):
            found = len(values) if hasattr(values, "__len__") else shown(values)
            raise ValueError(f"{name}: expected an entry for each of the {n} measurements in zs, got {found}")
        columns.append(values)
    # An iterator reads what has a length but no places, such as the values of a dictionary or a data frame's column.
    return [
        None if column is None else column if isinstance(column, np.ndarray) else list(column) for column in columns
    ]


def _snapshot(kf: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what it takes to put a filter back: arrays are replaced, never written into, by a correction."""
    slots = {name: getattr(kf, name) for name in RobustFilterMixin.__slots__ if hasattr(kf, name)}
    return copy.copy(kf.__dict__), slots


def _restore(kf: Any, before: tuple[dict[str, Any], dict[str, Any]]) -> None:
    """Put a filter back."""
    attributes, slots = before
    kf.__dict__.clear()
    kf.__dict__.update(attributes)
    for name, value in slots.items():
        setattr(kf, name, value)
