"""One step of one filter by the kernel, where that serves."""

from __future__ import annotations

from typing import Any

from robust_filterpy import kernel
from robust_filterpy.filters._correlated import judges, look_at_signs
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


def predict_extended(kf: Any, u: Any, moves: bool) -> bool:
    """Predict an extended filter, P alone where x does not move; as `predict`."""
    if _extension is None:
        return False
    return bool(_extension.predict(kf, u) if moves else _extension.predict_covariance(kf))


def correct(kf: Any, z: Any, R: Any, H: Any, M: Any) -> bool:
    """Correct if that is ordinary, return whether it was; nothing has changed if not."""
    if _extension is None or not kf._by_kernel:
        return False
    if not kf._policy.by_kernel:
        own = H is None and M is None and kf._policy.rule is not None
        return own and _watched(kf, z, R)
    return _counted(kf, _extension.correct, z, R, H, M)


def correct_innovation(kf: Any, z: Any, predicted: Any, y: Any, C: Any, S: Any, R: Any) -> bool:
    """Correct a nonlinear filter whose policy is the kernel's, by z and its prediction or else by y; as `correct`."""
    return _extension is not None and _counted(kf, _extension.correct_innovation, z, predicted, y, C, S, R)


def _watched(kf: Any, z: Any, R: Any) -> bool:
    """Take a correction under noise that is learnt, and look now and then whether its innovations keep their sign."""
    # A warning that is made an error refuses the call: nothing may have changed then.
    before = Snapshot(kf) if judges(kf._updates + 1) else None
    if not _extension.correct_mixture(kf, z, R):
        return False
    kf._updates += 1
    if not kf._counts_clipped:
        return True
    try:
        look_at_signs(kf, kf._last)
    except BaseException:
        if before is not None:
            before.put_back(kf)
        raise
    return True


def _counted(kf: Any, step: Any, *given: Any) -> bool:
    """Take a correction, and look now and then whether most of them clip."""
    if kf._choices.scaling != "innovation" or not kf._counts_clipped:
        return bool(step(kf, *given))
    looks = (kf._updates + 1) % EVERY == 0
    # A warning that is made an error refuses the call: nothing may have changed then.
    before = Snapshot(kf) if looks and kf._share.fills(kf.dim_z) else None
    if not step(kf, *given):
        return False
    kf._updates += 1
    if looks:
        try:
            kf._share.look(kf, kf._arrays())
        except BaseException:
            if before is not None:
                before.put_back(kf)
            raise
    return True
