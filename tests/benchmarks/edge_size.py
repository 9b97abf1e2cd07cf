"""What the C of some filters and trackers takes: bytes of state, model, code and stack.

    python tests/benchmarks/edge_size.py
    python tests/benchmarks/edge_size.py --size llvm-size \\
        --cc "clang --target=thumbv7em-none-eabihf -mcpu=cortex-m4 -mfpu=fpv4-sp-d16 -ffreestanding"

With -ffreestanding the compiler needs no math.h of its target.
The stack is that of the deepest chain of calls, of `predict` or `update`, without what a function of math.h takes.
"""

import argparse
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from robust_filterpy import Contaminated, Learnt, RobustExtendedKalmanFilter, RobustKalmanFilter
from robust_filterpy.edge import export_c
from robust_filterpy.identification import ARX, OutputError, ParameterTracker

MATH = """
#define INFINITY __builtin_inff()
#define NAN __builtin_nanf("")
#define isnan(x) __builtin_isnan(x)
#define isinf(x) __builtin_isinf(x)
#define isfinite(x) __builtin_isfinite(x)
double sqrt(double), fabs(double), exp(double), log(double), hypot(double, double), copysign(double, double);
float sqrtf(float), fabsf(float), expf(float), logf(float), hypotf(float, float), copysignf(float, float);
"""


def kinematic(axes, **choices):
    """A position and velocity for each axis, positions measured."""
    kf = RobustKalmanFilter(2 * axes, axes, **choices)
    for i in range(axes):
        kf.F[2 * i, 2 * i + 1] = 0.1
        kf.H[i, 2 * i] = 1.0
    kf.Q *= 0.01
    return kf


def lighthouse(**options):
    """A position and velocity of which the distance to a point is measured."""
    kf = RobustExtendedKalmanFilter(2, 1, **options)
    kf.F[0, 1] = 0.1
    return kf


MODELS = {
    "position and velocity": kinematic(1),
    "the same in the plane": kinematic(2),
    "the same in space": kinematic(3),
    "position and velocity, extended": lighthouse(),
    "the same, noise learnt": lighthouse(noise=Learnt()),
    "position and velocity, noise given": kinematic(1, noise=Contaminated()),
    "position and velocity, noise learnt": kinematic(1, noise=Learnt()),
    "ARX(2, 2), R given": ParameterTracker(ARX(2, 2), start=0, R=1.0),
    "OutputError(2, 2), R followed": ParameterTracker(OutputError(2, 2), start=0, offset=True),
    "OutputError(4, 4), R followed": ParameterTracker(OutputError(4, 4), start=0, offset=True),
}


def measured(model, precision, arguments):
    """Bytes of state, model, code and stack."""
    with tempfile.TemporaryDirectory() as folder:
        source, header = export_c(model, Path(folder) / "f.c", precision=precision)
        compiler = [*arguments.cc.split(), "-std=c99", "-Os", "-fstack-usage"]
        if "-ffreestanding" in compiler:
            (Path(folder) / "math.h").write_text(MATH)
            compiler.append("-I.")
        subprocess.run([*compiler, "-c", "f.c"], cwd=folder, check=True)
        sizes = subprocess.run([*arguments.size.split(), "-A", "f.o"], cwd=folder, check=True, capture_output=True)
        code = sum(int(n) for n in re.findall(r"^\.text\S*\s+(\d+)", sizes.stdout.decode(), flags=re.M))
        stack = deepest(source.read_text(), (Path(folder) / "f.su").read_text())
        width = 8 if precision == "double" else 4
        text = header.read_text()
        return (*(structure(text, f"f_{name}", width) for name in ("state", "model")), code, stack)


def structure(header, name, width):
    """Bytes of a structure of the header, from its fields."""
    body = re.search(rf"typedef struct {{\n([^}}]*)}} {name};", header).group(1)
    numbers = [
        np.prod([int(n) for n in re.findall(r"\d+", size)] or [1]) for size in re.findall(r"f_real \w+(.*?);", body)
    ]
    return int(sum(numbers)) * width + (width if "int32_t" in body else 0)


def deepest(code, usage):
    """Bytes of stack of the deepest chain of calls; a function that was put into its caller takes none."""
    own = {line.split("\t")[0].split(":")[-1]: int(line.split("\t")[1]) for line in usage.splitlines()}
    bodies = dict(re.findall(r"^(?:static )?\w+ (\w+)\([^;{]*?\)\n\{\n(.*?)^\}", code, flags=re.M | re.S))

    def chain(name):
        called = {other for other in re.findall(r"\b(\w+)\(", bodies[name]) if other in bodies and other != name}
        return own.get(name, 0) + max((chain(other) for other in called), default=0)

    return max(chain(name) for name in bodies if name.startswith("f_"))


def main():
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--cc", default="cc")
    parser.add_argument("--size", default="size")
    arguments = parser.parse_args()
    print("| | numbers | state | model | code | stack |\n|---|---|---|---|---|---|")
    for name, model in MODELS.items():
        for precision, real in (("double", "double"), ("single", "float")):
            if precision == "single" and "noise" in name:
                continue
            print(f"| {name} | {real} | {' | '.join(str(v) for v in measured(model, precision, arguments))} |")


if __name__ == "__main__":
    main()
