"""One step of one filter by the kernel, where that serves."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from robust_filterpy import kernel
from robust_filterpy._arrays import noise_covariance
from robust_filterpy._checks import Array
from robust_filterpy.correction.result import Correction
from robust_filterpy.filters._correlated import judges, look_at_signs
from robust_filterpy.filters._held import Held
from robust_filterpy.filters._insistence import is_near, jump_of, watched
from robust_filterpy.filters._outlier_share import EVERY
from robust_filterpy.filters.snapshot import put_back, snapshot
from robust_filterpy.filters.stuck import look_for_repeats
from robust_filterpy.kernel.record import judged_of

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
        if self._policy.patience is not None and M is not None:
            return False
        return self._counted(_extension.correct, z, R, H, M, R=R)

    def _stepped(
        self, z: Any, predicted: Any, y: Any, C: Any, S: Any, R: Any,
        difference: Callable[[Array, Array], Array] = np.subtract,
    ) -> bool:  # fmt: skip
        """Correct by a nonlinear sensor, by z and its prediction or by y; C and S, or H and None."""
        if _extension is None:
            return False
        if self._policy.noise is not None:
            return self._watched(_extension.correct_mixture_innovation, z, predicted, y, C, S, R)
        return self._counted(_extension.correct_innovation, z, predicted, y, C, S, R, R=R, difference=difference)

    def _watched(self, step: Any, *given: Any) -> bool:
        """Take a correction under ``noise=``, and look now and then at the signs of innovations."""
        before = snapshot(self) if judges(self._updates + 1) else None
        if not step(self, *given):
            return False
        self._updates += 1
        if self._counts_clipped:
            self._signs = self._looked(before, look_at_signs, self, self._signs, self._last, self._updates)
        return True

    def _counted(self, step: Any, *given: Any, R: Any, difference: Any = np.subtract) -> bool:
        """Take a correction, see whether refused ones insist, and look now and then whether most of them clip."""
        if self._policy.unwatched:
            return self._repeated(step(self, *given))
        insists = self._policy.patience is not None
        counts = self._counts_clipped and self._choices.scaling == "innovation"
        looks = counts and (self._updates + 1) % EVERY == 0
        # Psi of the user's may write into anything before it raises.
        called = self._choices.kernel_psi is None
        before = snapshot(self) if insists or called or (looks and self._share.fills(self.dim_z)) else None
        return self._looked(before, self._judged, step, given, insists, counts, looks, R, difference)

    def _judged(self, step: Any, given: Any, insists: bool, counts: bool, looks: bool, R: Any, difference: Any) -> bool:
        """Take a correction and look at it, as one: what interrupts or refuses it undoes both."""
        if not self._repeated(step(self, *given)):
            return False
        self._updates += counts
        # As it was judged, before P grows.
        judged = judged_of(self._last) if looks else None
        if insists:
            self._insist(R, difference)
        if looks:
            self._share.look(self, judged)
        return True

    def _repeated(self, taken: int) -> bool:
        """Return whether a step was taken; say it where a far reading repeats the one before."""
        if taken > 1:
            look_for_repeats(self, self._memory)
        return bool(taken)

    def _insist(self, R: Any, difference: Callable[[Array, Array], Array]) -> None:
        """Count a correction that the kernel took, and widen P where refused ones have insisted for long enough."""
        if is_near(self._last):
            self._kept = self._kept.nearer()
            return
        last: Any = self._arrays()
        kept, full = watched(self._kept, self._policy.patience, last, difference)
        jump = None
        if full:
            kf: Any = self
            jump = jump_of(last, last.C, last.S - noise_covariance(kf.R, R, len(last.y)))
        if jump is not None:
            self.P = last.P + jump
            self.P_post, self._last, kept = self.P.copy(), last._replace(P=self.P), kept.recovered()
        self._kept = kept

    def _looked(self, before: tuple[Any, ...] | None, look: Callable[..., Any], *given: Any) -> Any:
        """Look at a correction; a warning that is made an error refuses the call, and then nothing has changed."""
        try:
            return look(*given)
        except BaseException:
            if before is not None:
                put_back(self, before)
            raise
