"""What a long call is at: a bar at a terminal, else a line now and then; nothing in the first 2 s."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, Final

# What takes less is not waited for.
_SHORT: Final = 2.0
# What comes next is said once the time has grown by this share: a call of an hour tells some 20 lines.
_GROWN: Final = 0.5


def progress_bar(total: int | None, progress: bool | None, unit: str, name: str) -> Any:
    """Return tqdm's bar, lines instead off a terminal, or something that takes their calls and shows nothing."""
    if progress is False or sys.stderr is None:
        return _NoBar()
    if progress or sys.stderr.isatty():
        try:
            from tqdm import tqdm

            return tqdm(total=total, unit=unit, delay=0.0 if progress else _SHORT)
        except ImportError as error:
            if progress:
                raise ImportError("progress=True needs tqdm; use pip install tqdm") from error
    return _Lines(name, total, unit)


class _NoBar:
    """Stand in for a progress bar, whose total may be set as it turns out."""

    total: int | None = None

    def update(self) -> None:
        """Ignore a finished run."""

    def set_postfix(self, **_: Any) -> None:
        """Ignore a count."""

    def close(self) -> None:
        """Have nothing to close."""


class _Lines(_NoBar):
    """A line on standard error, less and less often."""

    def __init__(self, name: str, total: int | None = None, unit: str = "", after: float = _SHORT) -> None:
        """Begin to count."""
        self.name, self.unit, self.total = name, unit.strip(), total
        self.count, self.start = 0, time.monotonic()
        self.next = after

    def update(self) -> None:
        """Count, and say so if it is time."""
        self.count += 1
        self.stage(f"{self.count}{'' if self.total is None else f' of {self.total}'} {self.unit}")

    def stage(self, text: str) -> None:
        """Write a line if it is time for one; standard error may have been closed."""
        elapsed = time.monotonic() - self.start
        if elapsed >= self.next and sys.stderr is not None:
            self.next = (1.0 + _GROWN) * elapsed
            print(f"{self.name}: {elapsed:.0f} s, {text}", file=sys.stderr, flush=True)


_running: ContextVar[_Lines | None] = ContextVar("stages", default=None)


@contextmanager
def stages(name: str, progress: bool | None) -> Iterator[None]:
    """Let `stage` tell what the call is at: from 2 s on, with True from the beginning, not with False.

    A call inside another one has nothing to tell: what it is for is what the outer one says.
    """
    silent = _running.get() is not None or progress is False
    token = _running.set(_Lines(name, after=math.inf if silent else 0.0 if progress else _SHORT))
    try:
        yield
    finally:
        _running.reset(token)


def stage(text: str) -> None:
    """Say what begins now, if somebody waits for it."""
    lines = _running.get()
    if lines is not None:
        lines.stage(text)
