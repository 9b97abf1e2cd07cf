"""One step of one filter by the kernel, where that serves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from robust_filterpy import kernel
from robust_filterpy.correction.result import Correction
from robust_filterpy.filters._correlated import judges, look_at_signs
from robust_filterpy.filters._held import Held
from robust_filterpy.filters._outlier_share import EVERY
from robust_filterpy.filters.snapshot import put_back, snapshot

_extension = kernel.extension()
# What a subclass may do in its own way; then the kernel's is not that filter's.
_METHODS = ("_predicted", "_transition", "_correct", "_measurement", "_corrected", "_inverse")


def is_own(cls: type, base: type) -> bool:
    """Return whether a subclass predicts and corrects as its base does."""
    return all(getattr(cls, name) is getattr(base, name) for name in _METHODS)


class StepMixin(Held):
    """Take a step by the kernel and say whether it was taken; where not, nothing has changed."""

    __slots__ = ()

    #: Whether the kernel's linear steps are this class's.
    _by_kernel = False
    #: Whether a nonlinear correction may be: an ensemble asks for more than a record of the kernel keeps.
    _by_moments = True
    #: Whether nobody else watches how often the filter clips.
    _counts_clipped = True

    _arrays: Callable[[], Correction | None]

    def _predict_by_kernel(self, u: Any, B: Any, F: Any, Q: Any) -> bool:
        """Predict by F."""
        if _extension is None or not self._by_kernel:
            return False
        predict = _extension.predict if self._policy.noise is None else _extension.predict_mixture
        return bool(predict(self, u, B, F, Q))

    def _predict_extended(self, u: Any, moves: bool) -> bool:
        """Predict by F, or P alone where x has been moved by a function."""
        if _extension is None:
            return False
        return bool(_extension.predict(self, u, None, None, None) if moves else _extension.predict_covariance(self))

    def _correct_by_kernel(self, z: Any, R: Any, H: Any, M: Any) -> bool:
        """Correct by a linear sensor."""
        if _extension is None or not self._by_kernel:
            return False
        if self._policy.noise is not None:
            return self._watched(_extension.correct_mixture, z, R, H, M)
        if not self._policy.by_kernel:
            return False
        if self._choices.scaling == "innovation":
            return self._counted(_extension.correct, z, R, H, M)
        taken: bool = _extension.correct(self, z, R, H, M)
        return taken

    def _stepped(self, z: Any, predicted: Any, y: Any, C: Any, S: Any, R: Any) -> bool:
        """Correct by a nonlinear sensor, by z and its prediction or by y; C and S, or H and None."""
        if _extension is None or not self._by_moments:
            return False
        if self._policy.noise is not None:
            return self._watched(_extension.correct_mixture_innovation, z, predicted, y, C, S, R)
        if not self._policy.by_kernel:
            return False
        if self._choices.scaling == "innovation":
            return self._counted(_extension.correct_innovation, z, predicted, y, C, S, R)
        taken: bool = _extension.correct_innovation(self, z, predicted, y, C, S, R)
        return taken

    def _watched(self, step: Any, *given: Any) -> bool:
        """Take a correction under ``noise=``, and look now and then at the signs of innovations."""
        before = snapshot(self) if judges(self._updates + 1) else None
        if not step(self, *given):
            return False
        self._updates += 1
        if self._counts_clipped:
            self._signs = self._looked(before, look_at_signs, self, self._signs, self._last, self._updates)
        return True

    def _counted(self, step: Any, *given: Any) -> bool:
        """Take a correction, and look now and then whether most of them clip."""
        if not self._counts_clipped:
            return bool(step(self, *given))
        looks = (self._updates + 1) % EVERY == 0
        before = snapshot(self) if looks and self._share.fills(self.dim_z) else None
        if not step(self, *given):
            return False
        self._updates += 1
        if looks:
            self._looked(before, lambda: self._share.look(self, self._arrays()))
        return True

    def _looked(self, before: tuple[Any, ...] | None, look: Callable[..., Any], *given: Any) -> Any:
        """Look at a correction; a warning that is made an error refuses the call, and then nothing has changed."""
        try:
            return look(*given)
        except BaseException:
            if before is not None:
                put_back(self, before)
            raise
