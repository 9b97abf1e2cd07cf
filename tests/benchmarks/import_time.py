"""Time `import robust_filterpy`, and its filter, against `import filterpy.kalman`, in fresh processes in turn.

Run ``python tests/benchmarks/import_time.py``; with ``--check`` the exit code is 1 if the target is missed. Each number
is the least of several processes, so that other work on the machine does not matter.
"""

from __future__ import annotations

import argparse
import subprocess
import sys

TARGET = 1.1
PROCESSES = 15
THEIRS = "import filterpy.kalman"
OURS = ("import robust_filterpy", "from robust_filterpy import RobustKalmanFilter")
CODE = "import time; start = time.perf_counter(); {}; print(time.perf_counter() - start)"


def duration(statement):
    """Return the seconds that an import takes in a process of its own."""
    return float(subprocess.run([sys.executable, "-c", CODE.format(statement)], capture_output=True, check=True).stdout)


def main():
    """Print the ratios, and say whether the target is met."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="exit with 1 if the target is missed")
    check = parser.parse_args().check
    turns = [[duration(statement) for statement in (THEIRS, *OURS)] for _ in range(PROCESSES)]
    theirs, *ours = map(min, zip(*turns, strict=True))
    ratios = [seconds / theirs for seconds in ours]
    print(f"{THEIRS}: {theirs:.3f} s")
    for statement, seconds, ratio in zip(OURS, ours, ratios, strict=True):
        verdict = "met" if ratio <= TARGET else "MISSED"
        print(f"{statement}: {seconds:.3f} s, ratio {ratio:.2f}, target {TARGET:.2f}: {verdict}")
    sys.exit(int(check and max(ratios) > TARGET))


if __name__ == "__main__":
    main()
