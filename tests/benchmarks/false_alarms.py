"""How often do right estimators fail a check? One line for each; the target is never, in a thousand seeds.

    python tests/benchmarks/false_alarms.py [--seeds 1000] [--first 0] [--all] [--only Huber]

Only the stochastic checks are run, unless --all asks for the others too. Each runs with its false-alarm probability of
1e-6.
"""

from __future__ import annotations

import argparse
import sys
import unittest
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "testing"))

from filters.test_filter_promises import FILTERS
from wrong_filters import RIGHT_FILTERS

from robust_filterpy.testing import filter_checks
from robust_filterpy.testing.bench import Check


def failures(checks: Sequence[Check], make: Any, seeds: range) -> Counter[str]:
    """Count the failures of each check over the seeds."""
    found: Counter[str] = Counter()
    for check in checks:
        for seed in seeds:
            try:
                check(make, seed=seed)
            except unittest.SkipTest:
                break
            except AssertionError as error:
                found[check.name] += 1
                if found[check.name] == 1:
                    print(f"    seed {seed}: {error}", flush=True)
    return found


def main() -> None:
    """Print what failed, and whether the target is met."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--all", action="store_true")
    parser.add_argument("--only", help="names of estimators that begin so")
    args = parser.parse_args()
    seeds, total = range(args.first, args.first + args.seeds), 0
    for name, (make, not_claimed) in {**RIGHT_FILTERS, **FILTERS}.items():
        if args.only and not name.startswith(args.only):
            continue
        checks = [check for check in filter_checks(not_claimed=not_claimed) if args.all or check.stochastic]
        found = failures(checks, make, seeds)
        total += sum(found.values())
        given = ", ".join(f"{check} {count}" for check, count in found.items()) or "none"
        print(f"filter {name}: {len(checks)} checks x {args.seeds} seeds, failures: {given}", flush=True)
    print(f"failures in all: {total} (target 0) {'met' if total == 0 else 'MISSED'}")


if __name__ == "__main__":
    main()
