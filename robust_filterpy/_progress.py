"""What a long call is at: a line on standard error now and then; nothing in the first 2 s."""

from __future__ import annotations

import math
import sys
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Final

# What takes less is not waited for.
_SHORT: Final = 2.0
# What comes next is said once the time has grown by this share: a call of an hour tells some 20 lines.
_GROWN: Final = 0.5


class _Lines:
    """Lines on standard error, less and less often."""

    def __init__(self, name: str, after: float) -> None:
        """Begin to count the time."""
        self.name, self.start, self.next = name, time.monotonic(), after

    def stage(self, text: str) -> None:
        """Write a line if it is time for one; standard error may have been closed."""
        elapsed = time.monotonic() - self.start
        if elapsed >= self.next and sys.stderr is not None:
            self.next = (1.0 + _GROWN) * elapsed
            print(f"{self.name}: {elapsed:.0f} s, {text}", file=sys.stderr, flush=True)


# A weak reference: where an interrupt falls before a call has left, nobody speaks for it any more.
_running: ContextVar[Callable[[], _Lines | None]] = ContextVar("stages", default=lambda: None)


@contextmanager
def stages(name: str, progress: bool | None) -> Iterator[None]:
    """Let `stage` tell what the call is at: from 2 s on, with True from the beginning, not with False.

    A call inside another one has nothing to tell: what it is for is what the outer one says.
    """
    silent = _running.get()() is not None or progress is False
    lines = _Lines(name, math.inf if silent else 0.0 if progress else _SHORT)
    token = _running.set(weakref.ref(lines))
    try:
        yield
    finally:
        _running.reset(token)


def stage(text: str) -> None:
    """Say what begins now, if somebody waits for it."""
    lines = _running.get()()
    if lines is not None:
        lines.stage(text)
