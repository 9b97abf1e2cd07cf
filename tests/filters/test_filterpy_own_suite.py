"""filterpy's own tests, and those of its successor bayesian-filters, with the class swapped in at infinite threshold.

They come from source distributions, fetched with pip when the test runs and kept in pytest's cache: wheels do not ship
them. They run twice in a process of their own, first as they are and then with the package's `KalmanFilter` replaced;
what passes the first time must pass the second time.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import textwrap

import pytest

pytestmark = pytest.mark.core

# Each archive, and the package in it.
SUITES = [
    pytest.param(("filterpy==1.4.5", "filterpy"), id="filterpy-1.4.5", marks=pytest.mark.nightly),
    pytest.param(("filterpy==2.0.0", "filterpy"), id="filterpy-2.0.0", marks=pytest.mark.slow),
    pytest.param(("bayesian-filters", "bayesian_filters"), id="bayesian-filters", marks=pytest.mark.slow),
]

# Runs inside those processes: seeds every test, counts the filters that each one builds, and swaps the class.
PLUGIN = """
import importlib
import json
import os

import numpy as np
import pytest

kalman = importlib.import_module(os.environ["PACKAGE"] + ".kalman")
plain = kalman.KalmanFilter
if os.environ["SWAP"] == "yes":
    from robust_filterpy import RobustKalmanFilter
    from robust_filterpy.influence import Linear

    class KalmanFilter(RobustKalmanFilter):
        def __init__(self, dim_x, dim_z, dim_u=0):
            super().__init__(dim_x, dim_z, dim_u, influence=Linear())
else:
    class KalmanFilter(plain):
        pass

built, results = 0, {}
original = KalmanFilter.__init__


def counting(self, *args, **kwargs):
    global built
    built += 1
    original(self, *args, **kwargs)


KalmanFilter.__init__ = counting
kalman.KalmanFilter = importlib.import_module(kalman.__name__ + ".kalman_filter").KalmanFilter = KalmanFilter


@pytest.fixture(autouse=True)
def seeded():
    global built
    built = 0
    np.random.seed(12345)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    report = (yield).get_result()
    if report.when == "call":
        results[item.nodeid] = {"passed": report.passed, "built": built, "why": report.longreprtext[-1500:]}


def pytest_sessionfinish(session):
    with open(os.environ["RESULTS"], "w") as file:
        json.dump(results, file)
"""


def source_distribution(requirement, directory):
    """Download the archive with pip into the directory, unless it is there."""
    if not list(directory.iterdir()):
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:"]
        done = subprocess.run(
            [*command, "--dest", str(directory), requirement], capture_output=True, text=True, timeout=300
        )
        if done.returncode:
            pytest.skip(f"pip cannot download the source distribution of {requirement}: {done.stderr[-300:]}")
    return next(directory.iterdir())


def extract_tests(archive, directory):
    """Copy the test files that use the class out of the archive, without the package itself."""
    unpacked = directory.parent / "unpacked"
    shutil.unpack_archive(archive, unpacked)
    for path in unpacked.glob("**/tests/test_*.py"):
        text = path.read_text(encoding="utf-8")
        if re.search(r"\b(KalmanFilter|kinematic_kf)\b", text):
            (directory / path.name).write_text(text, encoding="utf-8")


def run(package, tests, directory, swap, names=()):
    """Run the tests, or those named, in a new process and return what became of each."""
    results = directory / f"results-{swap}.json"
    (directory / "swap_plugin.py").write_text(textwrap.dedent(PLUGIN))
    # Some of these tests compare to the last bit what is rounded otherwise in the kernel.
    environment = dict(os.environ, PACKAGE=package, SWAP=swap, RESULTS=str(results), MPLBACKEND="Agg")
    environment["ROBUST_FILTERPY_KERNEL"] = "off"
    environment["PYTHONPATH"] = os.pathsep.join([str(directory), *filter(None, [os.environ.get("PYTHONPATH")])])
    command = [sys.executable, "-m", "pytest", "-q", "-p", "swap_plugin", "-p", "no:cacheprovider", "-c", os.devnull]
    done = subprocess.run(
        [*command, "--rootdir", str(tests), "-k", "not outer_product", *(names or ["."])],
        env=environment,
        cwd=tests,
        capture_output=True,
        text=True,
        timeout=500,
    )
    assert results.exists(), done.stdout[-3000:] + done.stderr[-3000:]
    return json.loads(results.read_text())


@pytest.fixture(scope="module", params=SUITES)
def outcomes(request, tmp_path_factory):
    requirement, package = request.param
    pytest.importorskip(package)
    name, cache = requirement.replace("==", "-"), getattr(request.config, "cache", None)
    archive = source_distribution(requirement, cache.mkdir(name) if cache else tmp_path_factory.mktemp(name))
    directory = tmp_path_factory.mktemp(package)
    tests = directory / "tests"
    tests.mkdir()
    extract_tests(archive, tests)
    plain = run(package, tests, directory, "no")
    using = [name for name, result in plain.items() if result["built"]]
    return plain, run(package, tests, directory, "yes", using)


#: Compares numbers of the size of 1e5 within 1e-12, a tenth of what rounding leaves of them: it holds for filterpy
#: with its own order of multiplications alone, and P - g g' is another one.
TO_THE_LAST_BIT = {"test_kf.py::test_procedure_form"}


def passing(results):
    """The tests that build at least one Kalman filter and pass."""
    return [name for name, result in results.items() if result["built"] and result["passed"]]


def test_most_of_its_own_tests_pass(outcomes):
    """So that the comparison below is not empty."""
    plain, swapped = outcomes
    using = passing(plain)
    assert len(using) >= 20, using
    for file in ("test_kf.py", "test_imm.py", "test_mmae.py", "test_rts.py", "test_sensor_fusion.py"):
        assert any(file in name for name in using), file
    assert all(swapped[name]["built"] for name in using)


def test_what_passes_with_its_class_passes_with_the_robust_one(outcomes):
    plain, swapped = outcomes
    broken = {name: swapped[name]["why"] for name in passing(plain) if not swapped[name]["passed"]}
    broken = {name: why for name, why in broken.items() if name not in TO_THE_LAST_BIT}
    assert not broken, "\n".join(f"{name}\n{why}" for name, why in broken.items())
