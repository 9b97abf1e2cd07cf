"""Compile the kernels once, and let property tests draw the same examples in every run."""

import subprocess
import sys
import time

import pytest
from hypothesis import settings

# A run that fails must fail again; `pytest --hypothesis-profile search` draws others, and finds new defects.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("search", derandomize=False)
settings.load_profile("repeatable")


# Last, when there is a reporter.
@pytest.hookimpl(trylast=True)
def pytest_configure(config):
    if hasattr(config, "workerinput"):
        return
    reporter, start = config.pluginmanager.get_plugin("terminalreporter"), time.monotonic()
    reporter.write("compiling what is not in the cache, for some minutes if that is empty ... ", flush=True)
    # Before the tests are spread over processes, so that they see what a user sees.
    subprocess.run([sys.executable, "-m", "robust_filterpy", "compile"], check=False, capture_output=True)
    reporter.write_line(f"done in {time.monotonic() - start:.0f} s", flush=True)
