"""Compile the kernels once, before the tests are spread over processes, so that the tests see what a user sees."""

import subprocess
import sys


def pytest_configure(config):
    if not hasattr(config, "workerinput"):
        subprocess.run([sys.executable, "-m", "robust_filterpy", "compile"], check=False, capture_output=True)
