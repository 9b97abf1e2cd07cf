"""Whole recordings: filterpy's batch_filter, which leaves the filter alone if a step is refused."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from robust_filterpy._checks import Array

__all__: list[str] = []


def filter_recording(
    kf: Any, zs: Any, Fs: Any, Qs: Any, Hs: Any, Rs: Any, Bs: Any, us: Any, update_first: bool, saver: Any
) -> tuple[Array, Array, Array, Array]:
    """Advance kf through a recording; see `RobustKalmanFilter.batch_filter`."""
    steps = _steps(zs, Fs=Fs, Qs=Qs, Hs=Hs, Rs=Rs, Bs=Bs, us=us)
    n, dim_x = len(steps), kf.dim_x
    shape = (n, dim_x) if np.ndim(kf.x) == 1 else (n, dim_x, 1)
    means, means_p = np.zeros(shape), np.zeros(shape)
    covariances, covariances_p = np.zeros((n, dim_x, dim_x)), np.zeros((n, dim_x, dim_x))
    before = _snapshot(kf)
    k = 0
    try:
        for k, (z, F, Q, H, R, B, u) in enumerate(steps):
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
    except (TypeError, ValueError, np.linalg.LinAlgError) as error:
        _restore(kf, before)
        error.args = (f"step {k}: {error}", *error.args[1:])
        raise
    return means, covariances, means_p, covariances_p


def _steps(zs: Any, **per_step: Any) -> list[tuple[Any, ...]]:
    """Return (z, F, Q, H, R, B, u) of every step."""
    try:
        n = len(zs)
    except TypeError:
        raise TypeError(f"zs: expected a sequence of measurements, got {zs!r}") from None
    columns = [zs]
    for name, values in per_step.items():
        if values is None:
            values = [None] * n
        elif not hasattr(values, "__len__") or len(values) < n:
            found = len(values) if hasattr(values, "__len__") else repr(values)
            raise ValueError(f"{name}: expected an entry for each of the {n} measurements in zs, got {found}")
        columns.append(values)
    return list(zip(*columns, strict=False))


def _snapshot(kf: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what it takes to put a filter back: arrays are replaced, never written into, by a correction."""
    slots = {name: getattr(kf, name) for name in ("_last", "_y", "_S", "_SI") if hasattr(kf, name)}
    return copy.copy(kf.__dict__), slots


def _restore(kf: Any, before: tuple[dict[str, Any], dict[str, Any]]) -> None:
    """Put a filter back."""
    attributes, slots = before
    kf.__dict__.clear()
    kf.__dict__.update(attributes)
    for name, value in slots.items():
        setattr(kf, name, value)
