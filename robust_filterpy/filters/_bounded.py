"""Bounded influence: psi says how much of an innovation counts; patience, how long one that is refused may insist."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._state import Shape
from robust_filterpy.correction import spread
from robust_filterpy.correction.definition import Innovation, correct, correct_by_custom, innovation_moments
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.whitening import Inverse
from robust_filterpy.filters._insistence import Insistence, jump_of, nothing_refused, watched
from robust_filterpy.kernel import moments, series
from robust_filterpy.kernel.records import Kept as Rows
from robust_filterpy.kernel.records import State

__all__ = ["Bounded", "finite_product"]


@dataclass(frozen=True)
class Bounded:
    """Correct by psi; how a filter uses it: `robust_filterpy.filters._policy`."""

    choices: Choices
    patience: int | None = None
    noise: ClassVar[None] = None
    process: ClassVar[None] = None
    rule: ClassVar[None] = None

    def __post_init__(self) -> None:
        """Check what stands against what."""
        if self.patience is None:
            return
        _checks.count("patience", self.patience, 2)
        if self.choices.scaling == "learnt":
            raise ValueError(
                "patience: expected scaling 'innovation', 'unit' or 'bounded' with it, got 'learnt', which believes "
                "four innovations in a row that agree; leave one of the two out"
            )

    def __deepcopy__(self, memo: dict[int, Any]) -> Bounded:
        """Return self: nothing in here changes."""
        return self

    # Asked for at every step.
    @cached_property
    def by_kernel(self) -> bool:
        """Whether the kernel's steps are these."""
        return self.patience is None

    @cached_property
    def unwatched(self) -> bool:
        """Whether nothing is looked at after a step of the kernel: whether innovations insist, or clip."""
        return self.by_kernel and self.choices.scaling != "innovation" and self.choices.kernel_psi is not None

    @property
    def learns(self) -> bool:
        """Whether thresholds are in units of the spread; the Kalman filter has none."""
        return self.choices.by_custom

    def begin(self, sensors: int) -> Array:
        """Return the memory of sensors of which nothing is known."""
        return spread.begin(sensors)

    def start(self, x: Array, P: Array, sensors: int) -> Insistence | None:
        """Return the count, if there is one."""
        return None if self.patience is None else nothing_refused(sensors)

    def predicted(
        self, kept: Any, x: Array, P: Array, F: Array, Q: Array, Bu: Array | None, alpha_sq: float
    ) -> tuple[Array, Array, Any]:
        """Return x = F x + B u, P = alpha^2 F P F' + Q."""
        x = F.dot(x)
        if Bu is not None:
            x = x + Bu
        P = F.dot(P).dot(F.T)
        if alpha_sq != 1.0:
            P *= alpha_sq
        P += Q
        return x, 0.5 * (P + P.T), kept

    def corrected(
        self, known: Any, x: Array, P: Array, z: Array, H: Array, R: Array, M: Array | None, inv: Inverse | None
    ) -> tuple[Correction | moments.Taken, Any]:
        """Return the correction by a linear sensor."""
        if self.by_kernel and inv is None:
            taken = moments.correct_linear(self.choices, known.memory, x, P, z, H, R, M)
            if taken is not None:
                return taken, known.kept
        y = z - finite_product(H, x)
        return self.corrected_by_moments(known, x, P, Innovation(z, y, *innovation_moments(P, H, R, M), R, H), inv)

    def corrected_by_moments(
        self, known: Any, x: Array, P: Array, innovation: Innovation, inv: Inverse | None,
        difference: Callable[[Array, Array], Array] = np.subtract,
    ) -> tuple[Correction, Any]:  # fmt: skip
        """Return the correction, P widened where refused innovations have insisted for long enough."""
        if self.learns:
            last = correct_by_custom(known.memory, x, P, innovation, self.choices, inv is not None)
        else:
            _, y, C, S, _, _ = innovation
            last = correct(x, P, y, C, S, self.choices, skip_singular=inv is not None)
        if self.patience is None or known.kept is None:
            return last, known.kept
        kept, full = watched(known.kept, self.patience, last, difference)
        if not full:
            return last, kept
        _, _, C, S, R, H = innovation
        C = C if H is None else P @ H.T
        jump = jump_of(last, C, S - R if H is None else H @ C)
        return (last, kept) if jump is None else (last._replace(P=last.P + jump), kept.recovered())

    def standing(self, kept: Any, x: Array, P: Array, memory: Array) -> State:
        """Return where a recording begins, in arrays of its own."""
        none = np.empty((0, len(x)))
        return State(none, none[:, :, None], none, memory.copy(), x.copy(), P.copy())

    def kept_of(self, kept: Any, state: State) -> Any:
        """Return what is kept besides where a recording has come to."""
        return kept

    def advance(self, state: State, zs: Array, model: tuple[Any, ...], into: Rows, **how: Any) -> int:
        """Take the steps of a recording as far as the kernel can, and return the first that was not taken."""
        return series.run(self.choices, state, zs, model, into, **how)

    def entries(self, kept: Insistence | None, x: Array, P: Array) -> dict[str, Array]:
        """Return the count and the refused innovation that the next one is compared with."""
        if kept is None:
            return {}
        return {"counts": np.array([kept.refused, kept.recoveries], dtype=float), "insisting": kept.insisting}

    def shapes(self, n: int) -> dict[str, Shape]:
        """Return the shapes of these."""
        return {} if self.patience is None else {"counts": (2,), "insisting": (None,)}

    def resumed(self, found: dict[str, Array], x: Array, P: Array) -> Insistence | None:
        """Return the count of a state, if it is one."""
        if self.patience is None:
            return None
        counts = found["counts"]
        if (counts < 0).any() or (counts != np.floor(counts)).any():
            raise ValueError(f"state: expected whole counts >= 0, got {counts}")
        return Insistence(int(counts[0]), int(counts[1]), found["insisting"])


def finite_product(H: Array, x: Array) -> Array:
    """Return H x, shape (m,), or raise: NaN would pass for a missing measurement."""
    predicted = H.dot(x)
    if not np.isfinite(predicted).all():
        if not np.isfinite(H).all():
            raise ValueError("H: expected finite numbers, got NaN or infinity")
        raise ValueError(f"x: expected finite numbers, got H x = {predicted}")
    return np.asarray(predicted)
