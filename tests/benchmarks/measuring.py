"""What several studies share: how long a call takes, and a line that says whether a target is met."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any


def least_time(call: Callable[[], Any], repeats: int = 3) -> float:
    """Return the least of several durations of a call, in s."""
    durations = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        durations.append(time.perf_counter() - start)
    return min(durations)


def target(what: str, value: float, limit: float, least: bool = False) -> None:
    """Print one line: a measured value against its target, which is the least or the most that it may be."""
    met = value >= limit if least else value <= limit
    print(f"  {'met    ' if met else 'NOT MET'}  {value:.4g} {'>=' if least else '<='} {limit}  {what}", flush=True)
