"""What a filter is given of noise: how measurements fail, and how the process does.

`Contaminated` and `Learnt` are for ``noise=``, `Contaminated` and `Scales` for ``process=``. They say what there is;
`robust_filterpy.correction.learnt` corrects under it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from robust_filterpy import _checks
from robust_filterpy.correction.contaminated import Contaminated
from robust_filterpy.correction.learning import SCALES, NoiseClasses
from robust_filterpy.correction.options import Grouping
from robust_filterpy.correction.side_by_side import Scales

__all__ = ["Contaminated", "Learnt", "Scales", "noise_classes", "noise_policy", "process_policy", "process_scales"]


@dataclass(frozen=True)
class Learnt:
    """Say that the measurement noise is to be learned: how large it is, how often, how far and how long it is exceeded.

    Parameters
    ----------
    scales : sequence of float, default (1, 10, 100, 1000)
        Factors of the covariance R that noise may have, ascending from 1.
    memory : float, default 300
        Samples for which it is remembered how often each scale occurs, > 1.
    r_memory : float, default 50
        Ordinary samples for which the size of the noise is remembered, > 1: a longer memory is quieter, a shorter one
        follows a noise that changes.

    Raises
    ------
    ValueError, TypeError
        If one is out of range.
    """

    scales: Sequence[float] = SCALES
    memory: float = 300.0
    r_memory: float = 50.0

    def __post_init__(self) -> None:
        """Check the parameters."""
        checked = NoiseClasses(self.scales, "component", self.memory, self.r_memory)
        for name in ("scales", "memory", "r_memory"):
            object.__setattr__(self, name, getattr(checked, name))


def noise_policy(value: Any) -> Contaminated | Learnt | None:
    """Return what ``noise=`` says, "learnt" for `Learnt` with its defaults, or raise."""
    if isinstance(value, str) and _checks.option("noise", value, ("learnt",)):
        return Learnt()
    if value is not None and not isinstance(value, (Contaminated, Learnt)):
        raise TypeError(
            f"noise: expected None (bounded by psi), Contaminated(..), Learnt(..) or 'learnt', got {value!r}"
        )
    _require_unit("noise", "R", value)
    return value


def process_policy(value: Any) -> Contaminated | Scales | None:
    """Return what ``process=`` says, "scales" for `Scales`, "given" for `Contaminated` without outliers, or raise."""
    if isinstance(value, str) and _checks.option("process", value, ("scales", "given")):
        return Scales() if value == "scales" else Contaminated(0.0)
    if value is not None and not isinstance(value, (Contaminated, Scales)):
        raise TypeError(f"process: expected None, 'given', 'scales', Contaminated(..) or Scales(..), got {value!r}")
    _require_unit("process", "Q", value)
    return value


def _require_unit(name: str, matrix: str, value: Any) -> None:
    """Raise for a noise with a size of its own, which a filter has a matrix for."""
    if getattr(value, "scale", 1.0) != 1.0:
        raise ValueError(
            f"{name}: expected scale=1, got {_checks.shown(value)}; set {matrix} to scale**2 and say "
            f"Contaminated({value.contamination}, {value.scale_ratio})"
        )


def noise_classes(noise: Contaminated | Learnt, grouping: Grouping) -> NoiseClasses:
    """Return the classes of measurement noise that a policy speaks of."""
    if isinstance(noise, Learnt):
        return NoiseClasses(noise.scales, grouping, noise.memory, noise.r_memory)
    scales, probabilities = noise.classes
    return NoiseClasses(scales, grouping, probabilities=probabilities)


def process_scales(process: Contaminated | Scales | None) -> Scales:
    """Return the models of a filter that a policy speaks of; one that trusts its process is the one model of itself."""
    if isinstance(process, Scales):
        return process
    if process is None or process.is_ordinary:
        return Scales((1.0,), jump=0.0)
    scales, probabilities = process.classes
    return Scales(scales, jump=0.0, probabilities=probabilities)
