"""Other people's programs with the class swapped: the tests of filterpy and of its successor, and two trackers.

They are fetched by pip when a test runs, and go in processes of their own: with `KalmanFilter` as it is, and replaced.
Without a threshold what passes the first time passes the second time and tracks are the same; with one none is lost.
"""

import json
import os
import re
import shutil
import subprocess
import sys

import pytest

# Imported first in each of these processes: swaps the class, and counts the filters that are built.
SWAPPED = """
import importlib
import os
import warnings

kalman, options, built = importlib.import_module(os.environ["PACKAGE"] + ".kalman"), {}, 0
base = kalman.KalmanFilter
if os.environ["SWAP"] != "none":
    from robust_filterpy import Huber, RobustKalmanFilter as base
    from robust_filterpy.filters import OutlierShareWarning
    from robust_filterpy.influence import Linear

    # A tracker of boxes tells its filter guesses of the noise; that this is said is another test's business.
    warnings.simplefilter("ignore", OutlierShareWarning)
    options["influence"] = {"linear": Linear, "huber": Huber}[os.environ["SWAP"]]()


class KalmanFilter(base):
    def __init__(self, dim_x, dim_z, dim_u=0):
        global built
        built += 1
        super().__init__(dim_x, dim_z, dim_u, **options)


kalman.KalmanFilter = importlib.import_module(kalman.__name__ + ".kalman_filter").KalmanFilter = KalmanFilter
"""


def pip(command, *arguments):
    done = subprocess.run(
        [sys.executable, "-m", "pip", command, "--quiet", "--no-deps", *arguments],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    if done.returncode:
        pytest.skip(f"pip cannot {command} {arguments[-1]}: {done.stderr[-300:]}")


def run(command, directory, swap, package="filterpy", **environment):
    """Run a command with the class swapped, or not, and return what it leaves in the file of results."""
    (directory / "swapped.py").write_text(SWAPPED)
    results = directory / f"results-{swap}.json"
    environment |= {"PACKAGE": package, "SWAP": swap, "RESULTS": str(results), "MPLBACKEND": "Agg"}
    environment["PYTHONPATH"] = os.pathsep.join([str(directory), *filter(None, [os.environ.get("PYTHONPATH")])])
    done = subprocess.run(
        [sys.executable, *command], env={**os.environ, **environment}, cwd=directory, capture_output=True, text=True,
        timeout=500,
    )  # fmt: skip
    assert results.exists(), done.stdout[-3000:] + done.stderr[-3000:]
    return json.loads(results.read_text())


# Suites of tests: seeded, with what becomes of each and how many filters it builds.

PLUGIN = """
import json
import os

import numpy as np
import pytest
import swapped

results = {}


@pytest.fixture(autouse=True)
def seeded():
    swapped.built = 0
    np.random.seed(12345)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item, call):
    report = (yield).get_result()
    if report.when == "call":
        results[item.nodeid] = {"passed": report.passed, "built": swapped.built, "why": report.longreprtext[-1500:]}


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
        pip("download", "--no-binary", ":all:", "--dest", str(cache), requirement)
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
    command = ["-m", "pytest", "-q", "-p", "swap_plugin", "-p", "no:cacheprovider", "-c", os.devnull]
    command += ["--rootdir", str(directory), "-k", "not outer_product"]

    def outcomes(swap, *names):
        # Some of these tests compare to the last bit what is rounded otherwise in the kernel.
        return run([*command, *names], directory, swap, package, ROBUST_FILTERPY_KERNEL="off")

    plain = {name: result for name, result in outcomes("none", ".").items() if result["built"]}
    swapped = outcomes("linear", *plain)
    passing = [name for name, result in plain.items() if result["passed"]]
    # So that the comparison is not empty.
    assert len(passing) >= 20, passing
    for file in ("test_kf.py", "test_imm.py", "test_mmae.py", "test_rts.py", "test_sensor_fusion.py"):
        assert any(file in name for name in passing), file
    assert all(swapped[name]["built"] for name in passing)
    broken = [name for name in passing if not swapped[name]["passed"] and name not in TO_THE_LAST_BIT]
    assert not broken, "\n".join(f"{name}\n{swapped[name]['why']}" for name in broken)


# Trackers of boxes, which leave one list of numbers a frame.

TRACKED = """
import json
import os

import swapped
import numpy as np


def boxes(frames=60):
    # Three objects on their ways, one unseen for a while, one seen wrongly now and then.
    rng = np.random.default_rng(3)
    for k in range(frames):
        corners = np.array([[10.0 + 3.0 * k, 20.0], [300.0 - 2.0 * k, 40.0 + k], [150.0, 10.0 + 4.0 * k]])
        corners += rng.normal(scale=0.8, size=corners.shape)
        if k % 17 == 11:
            corners[2] += 60.0
        yield [[*corner, *(corner + [30.0, 20.0])] for i, corner in enumerate(corners) if i or not 20 <= k < 24]

{program}
assert swapped.built
with open(os.environ["RESULTS"], "w") as file:
    json.dump(tracks, file)
"""
TRACKERS = {
    "motpy": """
from motpy import Detection, MultiObjectTracker

tracker, tracks = MultiObjectTracker(dt=0.1), []
for frame in boxes():
    tracker.step([Detection(box=box) for box in frame])
    tracks.append([float(v) for track in tracker.active_tracks() for v in track.box])
""",
    "norfair": """
from norfair import Detection, Tracker
from norfair.filter import FilterPyKalmanFilterFactory

tracker = Tracker("euclidean", distance_threshold=50, filter_factory=FilterPyKalmanFilterFactory())
tracks = []
for frame in boxes():
    objects = tracker.update([Detection(np.array(box).reshape(2, 2)) for box in frame])
    tracks.append([float(v) for one in objects for v in (one.id, *one.estimate.ravel())])
""",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", TRACKERS)
def test_a_tracker_has_the_same_tracks_and_with_huber_tracks_in_every_frame(name, tmp_path):
    # norfair's metadata ask for older releases of numpy and filterpy than it needs.
    pip("install", "--target", str(tmp_path), name, "rich")
    (tmp_path / "client.py").write_text(TRACKED.replace("{program}", TRACKERS[name]))
    theirs, ours, huber = (run(["client.py"], tmp_path, swap) for swap in ("none", "linear", "huber"))
    assert sum(map(len, theirs)) > 300
    for one, other in zip(theirs, ours, strict=True):
        assert other == pytest.approx(one, rel=1e-9)
    assert len(huber) == 60 and all(huber[-10:])
