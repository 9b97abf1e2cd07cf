"""Write docs/_static/live_filter.js: the kernel with the numbers of one problem as WebAssembly, and a recording for it.

Needs clang and lld for wasm32, and binaryen: ``python docs/_live/build.py`` after a change of the kernel.
"""

import base64
import gzip
import hashlib
import json
import re
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import robust_filterpy
from robust_filterpy.correction import learning, side_by_side
from robust_filterpy.correction.learning import NoiseClasses
from robust_filterpy.correction.side_by_side import Scales

HERE = Path(__file__).parent
TARGET = HERE.parent / "_static" / "live_filter.js"
KERNEL = Path(robust_filterpy.__file__).parent / "kernel"
# sqrt and fabs are instructions of the machine; the others the page has in Math.
MATH = """
#define INFINITY __builtin_inff()
#define NAN __builtin_nanf("")
double sqrt(double), fabs(double), exp(double), log(double), hypot(double, double), copysign(double, double);
"""
EXPORTS = ("kalman", "default", "learnt", "z", "position")
COMPILE = "clang --target=wasm32 -std=c99 -Os -fno-math-errno -mbulk-memory -nostdlib -c -o live.o"
LINK = "wasm-ld --no-entry --strip-all --allow-undefined live.o -o live.wasm " + " ".join(
    f"--export=live_{name}" for name in EXPORTS
)
SHRINK = "wasm-opt -Oz --enable-bulk-memory live.wasm -o live.wasm"


def live_filter(cls, **options):
    """Return a filter of the page: position and velocity of a vehicle, its position measured each second."""
    kf = cls(2, 1, **options)
    kf.F = np.array([[1.0, 1.0], [0.0, 1.0]])
    kf.H = np.array([[1.0, 0.0]])
    kf.Q = 0.02 * np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]])
    kf.R, kf.P = np.array([[1.0]]), np.diag([4.0, 1.0])
    return kf


def numbers() -> str:
    """Return numbers.h: the problem, and what the filter that learns begins with."""
    kf, noise, process = live_filter(robust_filterpy.RobustKalmanFilter), NoiseClasses(), Scales()
    begun = side_by_side.start(kf.x.ravel(), kf.P, process)
    arrays = {"F": kf.F, "Q": kf.Q, "H": kf.H, "START": kf.P, "PROCESS": process.scales}
    arrays |= {"SCALES": noise.scales, "BELIEF": begun.packed[2]}
    arrays["BEGIN"] = learning.start(len(noise.scales), noise.probabilities)
    defined = {"Q": len(process.scales), "K": len(noise.scales), "STAY": process.stay, "JUMP": process.jump}
    defined |= {"MEMORY": noise.memory, "R_MEMORY": noise.r_memory}
    lines = [f"#define LEARNT_{name} {value!r}" for name, value in defined.items()]
    for name, array in arrays.items():
        values = ", ".join(repr(float(value)) for value in np.ravel(array))
        lines.append(f"static const double {name}[] = {{{values}}};")
    return "\n".join([*lines, ""])


def recording() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the true positions, and their measurements without and with outliers, in m."""
    rng = np.random.default_rng(7)
    t = np.arange(120)
    truth = 8.0 * np.sin(2.0 * np.pi * t / 75.0) + 3.0 * np.sin(2.0 * np.pi * t / 31.0)
    outlying = rng.random(t.size) < 0.12
    clean = truth + rng.normal(size=t.size)
    thrown = clean + rng.choice([-1.0, 1.0], t.size) * rng.uniform(9.0, 18.0, t.size)
    measured = np.where(outlying, np.clip(thrown, -20.0, 20.0), clean)
    return truth.round(3), clean.round(3), measured.round(3)


def sources(path: Path, found: dict[str, str]) -> dict[str, str]:
    """Return the text of a file and of the kernel's headers that it includes, by name."""
    found[path.name] = path.read_text(encoding="utf-8")
    for name in re.findall(r'#include "(\w+\.h)"', found[path.name]):
        if name not in found and name != "numbers.h":
            sources(KERNEL / name, found)
    return found


def fingerprint() -> str:
    """Return the hash of what is compiled."""
    return hashlib.sha256(("".join(sources(HERE / "live.c", {}).values()) + numbers()).encode()).hexdigest()


def main() -> None:
    """Compile, and write the script."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "math.h").write_text(MATH)
        (folder / "numbers.h").write_text(numbers())
        for command in (
            [*COMPILE.split(), f"-I{folder}", f"-I{KERNEL}", HERE / "live.c"],
            LINK.split(),
            SHRINK.split(),
        ):
            subprocess.run(command, check=True, cwd=folder)
        wasm = base64.b64encode(gzip.compress((folder / "live.wasm").read_bytes(), mtime=0)).decode()
    signals = dict(zip(("truth", "clean", "measured"), (signal.tolist() for signal in recording()), strict=True))
    values = {"made_from": fingerprint(), "wasm": wasm, **signals}
    lines = ",\n".join(f"  {key}: {json.dumps(value)}" for key, value in values.items())
    TARGET.write_text(f"// Written by docs/_live/build.py from the kernel in C.\nconst LIVE = {{\n{lines}\n}};\n")


if __name__ == "__main__":
    main()
