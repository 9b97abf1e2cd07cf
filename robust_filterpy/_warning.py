"""Warnings that point at the user's line, some only once, and at sections of the documentation, by their names."""

from __future__ import annotations

import inspect
import warnings
import weakref
from typing import Any, Final

__all__ = ["RobustFilterWarning", "mute", "pointer", "warn", "was_said"]

# filterpy's loops call the filters' methods.
_PASSED_ON = {"robust_filterpy", "filterpy"}
#: Classes of warning, and of what each was said: a kind of filter by its name, an object, which may not be hashable, by
#: its id for as long as it lives.
_said: set[tuple[type[Warning], Any]] = set()


class RobustFilterWarning(UserWarning):
    """Say that what a filter, a tracker or a fusion shows is not what it was meant to be.

    Its kinds are `OutlierShareWarning`, ``filters.CorrelatedInnovationsWarning``, ``filters.StuckSensorWarning``,
    ``fusion.FusionWarning`` and ``identification.LostTrackerWarning``. To switch all of them off, in a fleet say:
    ``warnings.simplefilter("ignore", robust_filterpy.RobustFilterWarning)``.
    """


def warn(message: str, category: type[Warning] = UserWarning, *, of: Any = None) -> None:
    """Warn at the innermost line that is neither this package's nor filterpy's; of a thing that is named, once."""
    if of is not None and was_said(category, of):
        return
    frame, level = inspect.currentframe(), 1
    while frame is not None and frame.f_globals.get("__name__", "").partition(".")[0] in _PASSED_ON:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, category, stacklevel=level)
    # Where a warning is an error, the call is refused, and may be made again.
    if of is not None:
        mute(category, of)


def mute(category: type[Warning], of: Any) -> None:
    """Note that this was said of a kind of filter, by name, or of an object: somebody else says it better."""
    _said.add(key := _key(category, of))
    if not isinstance(of, (str, tuple)):
        weakref.finalize(of, _said.discard, key)


def was_said(category: type[Warning], of: Any) -> bool:
    """Return whether this was said of a kind of filter, by name, or of an object."""
    return _key(category, of) in _said


def _key(category: type[Warning], of: Any) -> tuple[type[Warning], Any]:
    """Return under which key it is noted."""
    return category, of if isinstance(of, (str, tuple)) else id(of)


#: Sections of "Troubleshooting by symptom".
FOLLOWS, STOPPED, SMALL = "It follows outliers", "It stopped following", "All weights are small"
PAGE: Final = "Troubleshooting by symptom"


def pointer(*sections: str) -> str:
    """Return where to read on, as "see "All weights are small" in "Troubleshooting by symptom"."""
    names = " and ".join(f'"{section}"' for section in dict.fromkeys(sections))
    return f'see {names} in the documentation\'s "{PAGE}"'
