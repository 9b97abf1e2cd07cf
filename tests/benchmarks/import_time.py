"""Time `import robust_filterpy` against `import filterpy.kalman`, in fresh processes in turn.

Run ``python tests/benchmarks/import_time.py``; with ``--check`` the exit code is 1 if the target is missed. Each number
is the least of several processes, so that other work on the machine does not matter.
"""

from __future__ import annotations

import argparse
import subprocess
import sys

TARGET = 1.3
PROCESSES = 15
MODULES = ("filterpy.kalman", "robust_filterpy")
CODE = "import time; start = time.perf_counter(); import {}; print(time.perf_counter() - start)"


def duration(module):
    """Return the seconds that an import takes in a process of its own."""
    return float(subprocess.run([sys.executable, "-c", CODE.format(module)], capture_output=True, check=True).stdout)


def main():
    """Print the ratio, and say whether the target is met."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="exit with 1 if the target is missed")
    check = parser.parse_args().check
    turns = [[duration(module) for module in MODULES] for _ in range(PROCESSES)]
    theirs, ours = map(min, zip(*turns, strict=True))
    ratio = ours / theirs
    print(f"import {MODULES[0]}: {theirs:.3f} s, import {MODULES[1]}: {ours:.3f} s")
    print(f"ratio {ratio:.2f}, target {TARGET:.2f}: {'met' if ratio <= TARGET else 'MISSED'}")
    sys.exit(int(check and ratio > TARGET))


if __name__ == "__main__":
    main()
