"""One step of one filter by the kernel, where that serves."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from robust_filterpy import _checks, kernel
from robust_filterpy._checks import Array
from robust_filterpy.filters._mixin import Snapshot
from robust_filterpy.filters._outlier_share import EVERY

_extension = kernel.extension()
# What a subclass may do in its own way; then the kernel's is not that filter's.
_METHODS = ("_predicted", "_transition", "_update", "_measurement", "_corrected", "_inverse")


def is_own(cls: type, base: type) -> bool:
    """Return whether a subclass predicts and corrects as its base does."""
    return all(getattr(cls, name) is getattr(base, name) for name in _METHODS)


def predict(kf: Any, u: Any) -> bool:
    """Predict if that is ordinary, return whether it was; nothing has changed if not."""
    if _extension is None or not kf._by_kernel:
        return False
    if kf._policy.by_kernel:
        return bool(_extension.predict(kf, u))
    return kf._policy.rule is not None and _extension.predict_mixture(kf, u)


def predicted(x: Array, P: Array, F: Array, Q: Array, B: Any, u: Any) -> tuple[Array, Array] | None:
    """Return F x + B u and F P F' + Q if that is ordinary."""
    if _extension is None or (np.ndim(B) and len(B) != len(P)):
        return None
    still = u is None or not np.ndim(B) or (np.ndim(u) == 0 and u == 0)
    now = SimpleNamespace(dim_x=len(P), x=x, P=P, F=F, Q=Q, _alpha_sq=1.0, B=B)
    given = None if still else np.atleast_1d(_checks.numbers("u", u))
    return (now.x, now.P) if _extension.predict(now, given) else None


def correct(kf: Any, z: Any, R: Any, H: Any, M: Any) -> bool:
    """Correct if that is ordinary, return whether it was; nothing has changed if not."""
    if _extension is None or not kf._by_kernel:
        return False
    if not kf._policy.by_kernel:
        own = R is None and H is None and M is None and kf._policy.rule is not None
        return own and _extension.correct_mixture(kf, z)
    counts = kf._choices.scaling == "innovation" and kf._counts_clipped
    looks = counts and (kf._updates + 1) % EVERY == 0
    # A warning that is made an error refuses the call: nothing may have changed then.
    before = Snapshot(kf) if looks and kf._share.fills(kf.dim_z) else None
    if not _extension.correct(kf, z, R, H, M):
        return False
    kf._updates += counts
    if looks:
        try:
            kf._share.look(kf, kf._arrays())
        except BaseException:
            if before is not None:
                before.put_back(kf)
            raise
    return True
