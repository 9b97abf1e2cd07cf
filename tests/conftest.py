"""Compile the kernels once, and let property tests draw the same examples in every run."""

import subprocess
import sys

from hypothesis import settings

# A run that fails must fail again; `pytest --hypothesis-profile search` draws others, and finds new defects.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("search", derandomize=False)
settings.load_profile("repeatable")


def pytest_configure(config):
    if not hasattr(config, "workerinput"):
        # Before the tests are spread over processes, so that they see what a user sees.
        subprocess.run([sys.executable, "-m", "robust_filterpy", "compile"], check=False, capture_output=True)
