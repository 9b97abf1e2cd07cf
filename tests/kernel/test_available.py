"""What serves depends on the installation alone, and is said."""

import os
import subprocess
import sys

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


@pytest.mark.parametrize(("switch", "serves"), [("on", "kernel in C"), ("off", "definition in numpy")])
def test_the_command_says_what_is_installed_what_serves_and_where_the_documentation_is(switch, serves):
    if switch == "on":
        support.needs_kernel()
    said, _ = python("-m", "robust_filterpy", ROBUST_FILTERPY_KERNEL=switch)
    for word in (robust_filterpy.__version__, "numpy", "filterpy", "documentation", serves):
        assert word in said


def test_it_can_be_switched_off_with_the_same_result():
    support.needs_kernel()
    (on, _), (off, _) = (python("-c", FILTER, ROBUST_FILTERPY_KERNEL=switch) for switch in ("on", "off"))
    assert on.split()[0] == "True" and off.split()[0] == "False" and on.split()[1] == off.split()[1]


def test_a_kernel_that_cannot_be_loaded_is_said_once_in_the_log_and_the_definition_serves():
    broken = "import sys; sys.modules['robust_filterpy.kernel._extension'] = None\n"
    found, said = python("-c", broken + FILTER)
    assert found.split()[0] == "False" and said.count("the definition in numpy serves") == 1


def test_the_command_says_why_the_kernel_does_not_serve():
    off, _ = python("-m", "robust_filterpy", ROBUST_FILTERPY_KERNEL="off")
    assert "ROBUST_FILTERPY_KERNEL=off in the environment" in off and "compiler" not in off
    without = "import sys; sys.modules['robust_filterpy.kernel._extension'] = None\n"
    said, _ = python("-c", without + "from robust_filterpy.__main__ import main; main([])", ROBUST_FILTERPY_KERNEL="on")
    assert "several times slower: the kernel in C" in said and "install again where there is a C compiler" in said
    assert len(said.splitlines()) == 4
