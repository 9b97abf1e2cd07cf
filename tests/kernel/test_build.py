"""The kernel builds in little time and memory: forced inlining once took 176 s and 1.3 GB, and gained nothing."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
# Runs what it is given, then prints processor time in s and the largest process in MB of all that were started.
MEASURED = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:])
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss / (2**20 if sys.platform == "darwin" else 2**10))
sys.exit(done.returncode)
"""


@pytest.mark.skipif(not shutil.which("cc") or sys.platform == "win32", reason="no compiler whose use can be read")
@pytest.mark.nightly
def test_the_extension_takes_little_to_build(tmp_path):
    """About 10 s and 150 MB; the bounds leave room for slower compilers and machines."""
    if not (ROOT / "setup.py").exists():
        pytest.skip("no sources")
    pytest.importorskip("setuptools")
    build = ["setup.py", "--quiet", "build_ext", f"--build-lib={tmp_path}", f"--build-temp={tmp_path / 'objects'}"]
    environment = {name: value for name, value in os.environ.items() if name != "ROBUST_FILTERPY_CFLAGS"}
    command = [sys.executable, "-c", MEASURED, sys.executable, *build]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.rglob("_extension*")), done.stdout + done.stderr
    seconds, megabytes = map(float, done.stdout.split()[-2:])
    assert 0.5 < seconds < 60.0 and 10.0 < megabytes < 500.0, f"{seconds:.1f} s, {megabytes:.0f} MB"
