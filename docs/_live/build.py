"""Write docs/_static/live_filter.js: the exported C of one filter as WebAssembly, and a recording for it.

Needs clang and lld for wasm32: ``python docs/_live/build.py`` after a change of what `export_c` writes for this filter.
"""

import base64
import hashlib
import json
import subprocess
import tempfile
from pathlib import Path

import numpy as np

from robust_filterpy import Huber, RobustKalmanFilter, __version__, export_c

TARGET = Path(__file__).parents[1] / "_static" / "live_filter.js"
# sqrt and fabs are instructions of the machine, so that no library is needed.
MATH = """
#define INFINITY __builtin_inff()
#define NAN __builtin_nanf("")
#define isnan(x) __builtin_isnan(x)
#define isinf(x) __builtin_isinf(x)
#define isfinite(x) __builtin_isfinite(x)
double sqrt(double);
double fabs(double);
double exp(double), log(double), hypot(double, double), copysign(double, double);
"""
FLAGS = (
    "--target=wasm32 -std=c99 -O2 -fno-math-errno -mbulk-memory -nostdlib -Wl,--no-entry -Wl,--strip-all "
    "-Wl,--export=live_predict,--export=live_update,--export=live_default,--export=live_start,--export=__heap_base"
)


def live_filter() -> RobustKalmanFilter:
    """Return the filter of the page: position and velocity of a vehicle, its position measured each second."""
    kf = RobustKalmanFilter(2, 1, influence=Huber(), scaling="innovation")
    kf.F = np.array([[1.0, 1.0], [0.0, 1.0]])
    kf.H = np.array([[1.0, 0.0]])
    kf.Q = 0.02 * np.array([[1.0 / 3.0, 0.5], [0.5, 1.0]])
    kf.R, kf.P = np.array([[1.0]]), np.diag([4.0, 1.0])
    return kf


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


def exported(folder: Path) -> tuple[Path, str]:
    """Write the C of the filter and return it with its fingerprint, which is the same in every version."""
    source, header = export_c(live_filter(), folder / "live.c")
    text = (source.read_text() + header.read_text()).replace(__version__, "")
    return source, hashlib.sha256(text.encode()).hexdigest()


def main() -> None:
    """Compile, and write the script."""
    with tempfile.TemporaryDirectory() as name:
        source, fingerprint = exported(Path(name))
        (Path(name) / "math.h").write_text(MATH)
        subprocess.run(["clang", *FLAGS.split(), f"-I{name}", "-o", f"{name}/live.wasm", str(source)], check=True)
        wasm = base64.b64encode((Path(name) / "live.wasm").read_bytes()).decode()
    signals = dict(zip(("truth", "clean", "measured"), (signal.tolist() for signal in recording()), strict=True))
    values = {"c": fingerprint, "wasm": wasm, **signals}
    lines = ",\n".join(f"  {key}: {json.dumps(value)}" for key, value in values.items())
    TARGET.write_text(f"// Written by docs/_live/build.py from what export_c writes.\nconst LIVE = {{\n{lines}\n}};\n")


if __name__ == "__main__":
    main()
