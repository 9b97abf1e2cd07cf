"""What several studies share: durations, whether a target is met, whether a covariance is that of the error."""

from __future__ import annotations

import datetime
import shlex
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

#: Heads of the two columns that `consistency` fills.
CONSISTENCY = "NEES / n | within 95 %"


def least_time(call: Callable[[], Any], repeats: int = 3) -> float:
    """Return the least of several durations of a call, in s."""
    durations = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        durations.append(time.perf_counter() - start)
    return min(durations)


def consistency(truth: np.ndarray, xs: np.ndarray, Ps: np.ndarray, first: int = 0) -> tuple[float, float]:
    """Return the mean of d' P^-1 d / n from a step on, which is 1 if P is the error's, and the share within 95 %."""
    d = (np.asarray(xs).reshape(truth.shape) - truth)[first:]
    squares = np.einsum("ki,ki->k", d, np.linalg.solve(np.asarray(Ps)[first:], d[..., None])[..., 0])
    n = truth.shape[1]
    return float(squares.mean() / n), float(np.mean(squares < chi2.ppf(0.95, n)))


def target(what: str, value: float, limit: float, least: bool = False) -> None:
    """Print one line: a measured value against its target, which is the least or the most that it may be."""
    met = value >= limit if least else value <= limit
    print(f"  {'met    ' if met else 'NOT MET'}  {value:.4g} {'>=' if least else '<='} {limit}  {what}", flush=True)


def on_page(page: str, name: str, made: str) -> None:
    """Put what this program has made between the marks of that name on a page, with the command and the date."""
    path, program = Path(__file__).parents[2] / "docs" / page, f"tests/benchmarks/{Path(sys.argv[0]).name}"
    begin, end = f"% {name}: made by {program}", f"% {name}: end"
    before, rest = path.read_text(encoding="utf-8").split(begin)
    command = shlex.join(["python", program, *sys.argv[1:]])
    note = f"`{command}`, {datetime.date.today()}:"
    path.write_text(f"{before}{begin}\n\n{note}\n\n{made}\n\n{end}{rest.split(end)[1]}", encoding="utf-8")
