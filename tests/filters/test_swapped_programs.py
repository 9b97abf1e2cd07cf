"""Other people's programs with the class swapped: the tests of filterpy and of its successor.

They are fetched by pip when a test runs, and go in processes of their own: with `KalmanFilter` as it is, and replaced.
Without a threshold what passes the first time passes the second time.
"""

import json
import os
import re
import shutil
import subprocess
import sys

import pytest

# A plugin of pytest: swaps the class or not, seeds each test, notes what becomes of it and how many filters it builds.
PLUGIN = """
import importlib
import json
import os

import numpy as np
import pytest

kalman, options, results, built = importlib.import_module(os.environ["PACKAGE"] + ".kalman"), {}, {}, 0
base = kalman.KalmanFilter
if os.environ["SWAP"]:
    from robust_filterpy import RobustKalmanFilter as base
    from robust_filterpy.influence import Linear

    options["influence"] = Linear()


class KalmanFilter(base):
    def __init__(self, dim_x, dim_z, dim_u=0):
        global built
        built += 1
        super().__init__(dim_x, dim_z, dim_u, **options)


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
SUITES = [
    pytest.param(("filterpy==1.4.5", "filterpy"), id="filterpy-1.4.5", marks=pytest.mark.nightly),
    pytest.param(("filterpy==2.0.0", "filterpy"), id="filterpy-2.0.0", marks=pytest.mark.slow),
    pytest.param(("bayesian-filters", "bayesian_filters"), id="bayesian-filters", marks=pytest.mark.slow),
]
#: Compares numbers of the size of 1e5 within 1e-12, a tenth of what rounding leaves of them: it holds for filterpy
#: with its own order of multiplications alone, and P - g g' is another one.
TO_THE_LAST_BIT = {"test_kf.py::test_procedure_form"}


def source_tests(requirement, directory, cache):
    """Copy the test files that use the class out of the source distribution, without the package itself."""
    if not list(cache.iterdir()):
        command = ["-m", "pip", "download", "--quiet", "--no-deps", "--no-binary", ":all:", "--dest", str(cache)]
        done = subprocess.run([sys.executable, *command, requirement], capture_output=True, text=True, timeout=300)
        if done.returncode:
            pytest.skip(f"pip cannot download {requirement}: {done.stderr[-300:]}")
    shutil.unpack_archive(next(cache.iterdir()), directory.parent / "unpacked")
    for path in (directory.parent / "unpacked").glob("**/tests/test_*.py"):
        text = path.read_text(encoding="utf-8")
        if re.search(r"\b(KalmanFilter|kinematic_kf)\b", text):
            (directory / path.name).write_text(text, encoding="utf-8")


@pytest.mark.core
@pytest.mark.parametrize("suite", SUITES)
def test_what_passes_with_its_class_passes_with_the_robust_one(suite, request, tmp_path):
    (requirement, package), name = suite, suite[0].replace("==", "-")
    pytest.importorskip(package)
    cache = getattr(request.config, "cache", None)
    directory, archive = tmp_path / "tests", tmp_path / "archive"
    directory.mkdir(), archive.mkdir()
    source_tests(requirement, directory, cache.mkdir(name) if cache else archive)
    (directory / "swap_plugin.py").write_text(PLUGIN)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "swap_plugin", "-p", "no:cacheprovider", "-c", os.devnull]
    command += ["--rootdir", str(directory), "-k", "not outer_product"]

    def outcomes(swap, *names):
        results = directory / f"results{swap}.json"
        environment = {**os.environ, "PACKAGE": package, "SWAP": swap, "RESULTS": str(results), "MPLBACKEND": "Agg"}
        environment["PYTHONPATH"] = os.pathsep.join([str(directory), *filter(None, [os.environ.get("PYTHONPATH")])])
        # Some of these tests compare to the last bit what is rounded otherwise in the kernel.
        environment["ROBUST_FILTERPY_KERNEL"] = "off"
        done = subprocess.run(
            [*command, *names], env=environment, cwd=directory, capture_output=True, text=True, timeout=500
        )
        assert results.exists(), done.stdout[-3000:] + done.stderr[-3000:]
        return json.loads(results.read_text())

    plain = {name: result for name, result in outcomes("", ".").items() if result["built"]}
    swapped = outcomes("linear", *plain)
    passing = [name for name, result in plain.items() if result["passed"]]
    # So that the comparison is not empty.
    assert len(passing) >= 20, passing
    for file in ("test_kf.py", "test_imm.py", "test_mmae.py", "test_rts.py", "test_sensor_fusion.py"):
        assert any(file in name for name in passing), file
    assert all(swapped[name]["built"] for name in passing)
    broken = [name for name in passing if not swapped[name]["passed"] and name not in TO_THE_LAST_BIT]
    assert not broken, "\n".join(f"{name}\n{swapped[name]['why']}" for name in broken)
