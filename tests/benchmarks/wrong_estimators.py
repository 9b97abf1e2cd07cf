"""Which wrong filters are caught, and by which name? A table, and whether the targets are met.

    python tests/benchmarks/wrong_estimators.py [--seeds 3] [--first 0]

A wrong estimator counts as caught if a check fails whose name fits its fault. The last columns tell whether that check
is the first one that is named, and how many others fail.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "testing"))

from filterpy.kalman import KalmanFilter
from wrong_filters import WRONG_FILTERS

from robust_filterpy.testing import ChecksFailed, check_filter

CAUGHT, SECONDS = 0.95, 10.0


def failed(check: Any, cls: Any, seed: int) -> list[str]:
    """Return the names of the checks that a wrong estimator fails, in their order."""
    try:
        check(cls, not_claimed=cls.not_claimed, seed=seed)
    except ChecksFailed as error:
        return [result.name for result in error.results if result.status == "failed"]
    return []


def table(check: Any, classes: list[Any], seeds: range) -> float:
    """Print a line for each class and return the share that was caught."""
    caught = first = 0
    for cls in classes:
        found = [failed(check, cls, seed) for seed in seeds]
        named = [bool(set(names) & set(cls.caught_by)) for names in found]
        leading = [bool(names) and names[0] in cls.caught_by for names in found]
        caught, first = caught + sum(named), first + sum(leading)
        others = max(len(set(names) - set(cls.caught_by)) for names in found)
        verdict = "caught" if all(named) else f"caught in {sum(named)} of {len(seeds)}"
        place = "named first" if all(leading) else f"first in {sum(leading)} of {len(seeds)}"
        print(f"  {cls.__name__:34} {verdict:16} by {cls.caught_by[0]:52} {place}, {others} others", flush=True)
    total = len(classes) * len(seeds)
    print(f"  {len(classes)} classes, {len(seeds)} seeds: {caught / total:.1%} caught, {first / total:.1%} named first")
    return caught / total


def main() -> None:
    """Print the tables and the verdicts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0)
    args = parser.parse_args()
    seeds = range(args.first, args.first + args.seeds)
    share = table(check_filter, WRONG_FILTERS, seeds)
    print(f"wrong filters caught: {share:.3f} (target {CAUGHT}) {'met' if share >= CAUGHT else 'MISSED'}\n")
    start = time.perf_counter()
    check_filter(KalmanFilter, not_claimed=("robust", "nan", "validates"))
    seconds = time.perf_counter() - start
    verdict = "met" if seconds < SECONDS else "MISSED"
    print(f"check_filter of filterpy's: {seconds:.2f} s (target {SECONDS:g}) {verdict}")


if __name__ == "__main__":
    main()
