"""What serves depends on the installation alone, and is said."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import support

import robust_filterpy

FILTER = (
    "import logging, numpy as np; logging.basicConfig(level='INFO', format='%(message)s')\n"
    "from robust_filterpy import RobustKalmanFilter, kernel\n"
    "kf = RobustKalmanFilter(2, 1); kf.H[:] = 1.0\n"
    "for z in (1.0, 2.0): kf.predict(); kf.update(z)\n"
    "kf.batch_filter(np.ones(100)); print(kernel.available(), kf.x.sum().round(9))"
)


def python(*arguments, **environment):
    """Run Python in a process of its own; return what it printed and what it said."""
    environment = {**os.environ, **environment}
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, env=environment, check=True)
    return done.stdout, done.stderr


OTHER = "from robust_filterpy.kernel import _extension; _extension.built_from += 1\n"
WITHOUT = "import sys; sys.modules['robust_filterpy.kernel._extension'] = None\n"


@pytest.mark.parametrize(("arguments", "switch", "words"), [
    (("-m", "robust_filterpy"), "on", ["kernel in C"]),
    (("-m", "robust_filterpy"), "off", ["definition in numpy", "ROBUST_FILTERPY_KERNEL=off in the environment"]),
    (("-c", OTHER + "from robust_filterpy.__main__ import status; print(status())"), "on",
     ["several times slower: the kernel in C is of other sources", "build_ext --inplace"]),
    (("-c", WITHOUT + "from robust_filterpy.__main__ import status; print(status())"), "on",
     ["several times slower: the kernel in C", "install again where there is a C compiler"]),
], ids=["kernel", "switched off", "other sources", "not built"])  # fmt: skip
def test_the_command_says_what_is_installed_what_serves_and_why_and_where_to_read(arguments, switch, words):
    if words == ["kernel in C"] or OTHER in arguments[1]:
        support.needs_kernel()
    said, _ = python(*arguments, ROBUST_FILTERPY_KERNEL=switch)
    for word in (robust_filterpy.__version__, "numpy", "filterpy", "documentation", *words):
        assert word in said
    assert ("compiler" in said) == ("install again where there is a C compiler" in words)


def test_it_can_be_switched_off_with_the_same_result():
    support.needs_kernel()
    (on, _), (off, _) = (python("-c", FILTER, ROBUST_FILTERPY_KERNEL=switch) for switch in ("on", "off"))
    assert on.split()[0] == "True" and off.split()[0] == "False" and on.split()[1] == off.split()[1]


def test_a_kernel_that_cannot_be_loaded_is_said_once_in_the_log_and_the_definition_serves():
    found, said = python("-c", WITHOUT + FILTER)
    assert found.split()[0] == "False" and said.count("the definition in numpy serves") == 1


# It builds in little time and memory: forced inlining once took 176 s and 1.3 GB, and gained nothing.


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
