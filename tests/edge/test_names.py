"""Names of exported C: none that a compiler trips over."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from support import by_night

import robust_filterpy
from robust_filterpy import RobustKalmanFilter
from robust_filterpy.edge import export_c
from robust_filterpy.filters import AdaptiveKalmanFilter

KERNEL = Path(robust_filterpy.__file__).parent / "kernel"
PREFIXES = sorted({name.partition("_")[0] for header in KERNEL.glob("*.h")
                   for name in re.findall(r"\b[a-z]\w*_\w+", header.read_text())})  # fmt: skip
STANDARD = ["stddef", "math", "float", "string", "stdint", "assert", "Math", "limits"]


def made(kind):
    kf = kind(2, 1)
    kf.F[0, 1], kf.H[0, 0], kf.Q, kf.R = 1.0, 1.0, 0.1 * np.eye(2), np.eye(1)
    return kf


@pytest.mark.parametrize("name", STANDARD)
def test_a_header_of_c_is_no_name(name, tmp_path):
    with pytest.raises(ValueError, match=f"path: expected another name than a header of C has.*use my_{name}.c"):
        export_c(made(RobustKalmanFilter), tmp_path / f"{name}.c")
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not shutil.which("cc"), reason="there is no compiler")
@pytest.mark.parametrize("kind", by_night([RobustKalmanFilter, AdaptiveKalmanFilter], AdaptiveKalmanFilter))
def test_a_prefix_of_the_kernel_is_refused_or_compiles(kind, tmp_path):
    sources, refused = [], []
    for name in [*PREFIXES, "learnt", "cart", "model", "state", "main", "int"]:
        try:
            sources.append(export_c(made(kind), tmp_path / f"{name}.c").source)
        except ValueError as error:
            assert "path: expected" in str(error) and f"use my_{name}.c" in str(error)
            refused.append(name)
    # Learnt noise has names of its own in C; nothing else is refused for nothing.
    assert set(refused) == ({"learnt"} if kind is AdaptiveKalmanFilter else set())
    done = subprocess.run(["cc", "-std=c99", "-fsyntax-only", "-I", tmp_path, *sources], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:2000]
