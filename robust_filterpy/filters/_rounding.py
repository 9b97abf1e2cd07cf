"""A P that rounding has made indefinite: the nearest covariance takes its place, and the correction goes on."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._warning import RobustFilterWarning, warn
from robust_filterpy.correction.standardization import SingularInnovationError


def without_rounding(
    kf: Any, correct: Callable[[Any, Array], Any], known: Any, P: Array, H: Array | None, R: Array
) -> Any:  # fmt: skip
    """Return the correction of P, of what the policy knows; where rounding has left S no inverse, of a mended P."""
    try:
        return correct(known, P)
    except SingularInnovationError:
        kept, stack = known.kept, P[None]
        if hasattr(kept, "covariances") and kept.P.tobytes() == P.tobytes():
            stack = np.concatenate([stack, kept.covariances])
        mended = None if H is None else _mended(stack, H, R)
        if mended is None:
            raise
        if len(mended) > 1:
            known = known._replace(kept=kept._replace(covariances=mended[1:], P=mended[0]))
        found = correct(known, mended[0])
    name = type(kf).__name__
    warn(
        f"{name}: H P H' is negative by rounding, since P holds numbers as large as {np.abs(P).max():.3g}; the nearest "
        f"covariance took the place of P; leave out states that no sensor sees, or begin with a smaller P",
        RobustFilterWarning,
        of=name,
    )
    return found


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
