"""Programs that other people built on filterpy: the same tracks without a threshold, no exception with one.

Each is installed by pip into a directory of its own when the test runs, and driven in a process of its own with
`filterpy.kalman.KalmanFilter` as it is, and replaced.
"""

import json
import os
import subprocess
import sys
import textwrap

import pytest

pytestmark = pytest.mark.slow

SWAP = """
import os
import sys
import warnings

import filterpy.kalman
import numpy as np

sys.path.append(os.environ["CLIENT"])
built = 0
if os.environ["FILTER"] != "filterpy":
    from robust_filterpy import Huber, RobustKalmanFilter
    from robust_filterpy.filters import OutlierShareWarning
    from robust_filterpy.influence import Linear

    # A tracker of boxes tells its filter guesses of the noise; that this is said is another test's business.
    warnings.simplefilter("ignore", OutlierShareWarning)
    influence = Linear() if os.environ["FILTER"] == "linear" else Huber()

    class KalmanFilter(RobustKalmanFilter):
        def __init__(self, dim_x, dim_z, dim_u=0):
            global built
            built += 1
            super().__init__(dim_x, dim_z, dim_u, influence=influence)

    filterpy.kalman.KalmanFilter = KalmanFilter


def boxes(frames=60):
    # Three objects on their ways, one unseen for a while, one seen wrongly now and then.
    rng = np.random.default_rng(3)
    for k in range(frames):
        corners = np.array([[10.0 + 3.0 * k, 20.0], [300.0 - 2.0 * k, 40.0 + k], [150.0, 10.0 + 4.0 * k]])
        corners += rng.normal(scale=0.8, size=corners.shape)
        if k % 17 == 11:
            corners[2] += 60.0
        yield [[*corner, *(corner + [30.0, 20.0])] for i, corner in enumerate(corners) if i or not 20 <= k < 24]
"""

REPORT = """
import json

assert built or os.environ["FILTER"] == "filterpy"
with open(os.environ["RESULTS"], "w") as file:
    json.dump(tracks, file)
"""

# The distributions to install, and a program that leaves one list of numbers a frame in `tracks`.
CLIENTS = {
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
    found = tracker.update([Detection(np.array(box).reshape(2, 2)) for box in frame])
    tracks.append([float(v) for one in found for v in (one.id, *one.estimate.ravel())])
""",
}


@pytest.fixture(scope="module", params=CLIENTS)
def client(request, tmp_path_factory):
    directory = tmp_path_factory.mktemp(request.param)
    # norfair's metadata ask for older releases of numpy and filterpy than it needs.
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(directory)]
    done = subprocess.run([*command, request.param, "rich"], capture_output=True, text=True, timeout=300)
    if done.returncode:
        pytest.skip(f"pip cannot install {request.param}: {done.stderr[-300:]}")
    return request.param, directory


def tracks(client, which, directory):
    """Run the client with one kind of filter and return its tracks."""
    name, installed = client
    results = directory / f"{which}.json"
    program = directory / "client.py"
    program.write_text(SWAP + textwrap.dedent(CLIENTS[name]) + REPORT)
    environment = dict(os.environ, CLIENT=str(installed), FILTER=which, RESULTS=str(results))
    done = subprocess.run(
        [sys.executable, str(program)], env=environment, cwd=directory, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(results.read_text())


def test_without_a_threshold_the_tracks_are_the_same(client, tmp_path):
    theirs, ours = tracks(client, "filterpy", tmp_path), tracks(client, "linear", tmp_path)
    assert sum(map(len, theirs)) > 300
    for one, other in zip(theirs, ours, strict=True):
        assert other == pytest.approx(one, rel=1e-9)


def test_with_huber_every_frame_is_tracked(client, tmp_path):
    ours = tracks(client, "huber", tmp_path)
    assert len(ours) == 60 and all(ours[-10:])
