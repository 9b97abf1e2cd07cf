"""Which Kalman filter in Python keeps which promise? The checks of `check_filter` on five packages and on ours.

    python tests/benchmarks/who_keeps_what.py [--seed 0] [--without-other] [--messages]

filterpy is tried in the version that is installed and, from a temporary directory that pip fills, in the other one of
1.4.5 and 2.0.0. A promise that a package never made is in brackets: (no) is no fault. --messages prints why.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import filterpy
import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy import RobustKalmanFilter
from robust_filterpy.influence import Linear
from robust_filterpy.testing import ChecksFailed, check_filter
from robust_filterpy.testing.checks import FILTER_PROMISES as PROMISES

WORDS = {"passed": "yes", "failed": "no", "skipped": "-"}


class Adapter:
    """x, P, F, H, Q and R for packages that keep none of them."""

    def __init__(self, dim_x: int, dim_z: int) -> None:
        self.dim_x, self.dim_z = dim_x, dim_z
        self.x, self.P, self.F, self.Q = np.zeros(dim_x), np.eye(dim_x), np.eye(dim_x), np.eye(dim_x)
        self.H, self.R = np.zeros((dim_z, dim_x)), np.eye(dim_z)


class PyKalman(Adapter):
    """pykalman, by its filter_update: first a step without a measurement, then a measurement without a step."""

    def predict(self) -> None:
        self.x, self.P = self._step(None, self.F, self.Q)

    def update(self, z: Any) -> None:
        if z is not None:
            z = np.ma.masked_invalid(np.atleast_1d(z))
            self.x, self.P = self._step(z, np.eye(self.dim_x), np.zeros((self.dim_x, self.dim_x)))

    def _step(self, z: Any, F: Any, Q: Any) -> Any:
        import pykalman

        kf = pykalman.KalmanFilter(F, self.H, Q, self.R, n_dim_state=self.dim_x, n_dim_obs=self.dim_z)
        return kf.filter_update(self.x, self.P, z)


class SimdKalman(Adapter):
    """simdkalman, by its primitives."""

    def predict(self) -> None:
        from simdkalman.primitives import predict

        self.x, self.P = (a.reshape(b.shape) for a, b in zip(predict(self.x, self.P, self.F, self.Q), (self.x, self.P)))  # noqa: B905

    def update(self, z: Any) -> None:
        from simdkalman.primitives import update_with_nan_check

        z = np.full(self.dim_z, np.nan) if z is None else np.atleast_1d(np.asarray(z, dtype=float))
        x, P = update_with_nan_check(self.x, self.P, self.H, self.R, z)[:2]
        self.x, self.P = x.reshape(self.x.shape), P.reshape(self.P.shape)


def bayesian_filters(dim_x: int, dim_z: int) -> Any:
    """Return the filter of bayesian-filters, a continuation of filterpy."""
    from bayesian_filters.kalman import KalmanFilter as Continued

    return Continued(dim_x, dim_z)


def without_psi(dim_x: int, dim_z: int) -> RobustKalmanFilter:
    """Return ours without a threshold."""
    return RobustKalmanFilter(dim_x, dim_z, influence=Linear())


PLAIN = ("robust", "nan", "validates")
#: Name: factory, what the package never promised.
PEERS: dict[str, tuple[Callable[[int, int], Any], tuple[str, ...]]] = {
    f"filterpy {filterpy.__version__}": (KalmanFilter, PLAIN),
    "bayesian-filters": (bayesian_filters, PLAIN),
    "pykalman": (PyKalman, PLAIN),
    "simdkalman": (SimdKalman, PLAIN),
    "ours, Linear": (without_psi, ("robust",)),
    "ours, Huber": (RobustKalmanFilter, ()),
}


def results(make: Any, not_claimed: Iterable[str], seed: int) -> dict[str, tuple[str, str]]:
    """Return status and message of each check; what is not claimed is tried too, and put into brackets."""
    found: dict[str, tuple[str, str]] = {}
    for left_out in (tuple(not_claimed), ("robust",), ()):
        try:
            tried = check_filter(make, not_claimed=left_out, seed=seed)
        except ChecksFailed as error:
            tried = error.results
        for result in tried:
            claimed = left_out == tuple(not_claimed)
            word = WORDS[result.status]
            found.setdefault(result.name, (word if claimed or word == "-" else f"({word})", result.message))
    return found


def other_version(seed: int) -> tuple[str, dict[str, tuple[str, str]]] | None:
    """Return the column of the other filterpy, None if pip cannot get it."""
    version = "1.4.5" if filterpy.__version__ != "1.4.5" else "2.0.0"
    with tempfile.TemporaryDirectory() as folder:
        pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", folder]
        if subprocess.run([*pip, f"filterpy=={version}"], capture_output=True).returncode:
            return None
        path = os.pathsep.join([folder, str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
        command = [sys.executable, __file__, "--seed", str(seed), "--column", f"filterpy {version}"]
        environment = {**os.environ, "PYTHONPATH": path}
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return f"filterpy {version}", {name: (word, why) for name, (word, why) in json.loads(done.stdout).items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--without-other", action="store_true")
    parser.add_argument("--messages", action="store_true")
    parser.add_argument("--column", help="print one column as JSON")
    args = parser.parse_args()
    if args.column:
        print(json.dumps(results(*PEERS[args.column], args.seed)))
        return
    columns: dict[str, dict[str, tuple[str, str]]] = {}
    if not args.without_other:
        other = other_version(args.seed)
        columns |= dict([other]) if other else {}
    for name, (make, not_claimed) in PEERS.items():
        columns[name] = results(make, not_claimed, args.seed)
    print("| promise | " + " | ".join(columns) + " |\n" + "|---" * (len(columns) + 1) + "|")
    for name in (entry.name for entry in PROMISES):
        print(f"| {name} | " + " | ".join(column.get(name, ("-", ""))[0] for column in columns.values()) + " |")
    if args.messages:
        for peer, column in columns.items():
            print("\n".join([f"\n{peer}", *(why for word, why in column.values() if word == "no")]))


if __name__ == "__main__":
    main()
