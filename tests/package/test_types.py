"""A type checker knows the public names, their arguments and their options, although most are imported late."""

import re
import subprocess
import sys

import pytest

pytest.importorskip("mypy")

RIGHT = """
import numpy as np

import robust_filterpy as rf
from filterpy.common import Q_discrete_white_noise

from robust_filterpy import ARX, Huber, OutputError, ParameterTracker, RobustKalmanFilter, filter_series
from robust_filterpy.common import Saver, kinematic_kf
from robust_filterpy.kalman import IMMEstimator, KalmanFilter, MerweScaledSigmaPoints
from robust_filterpy.kalman.kalman_filter import KalmanFilter as SameFilter

kf = RobustKalmanFilter(dim_x=2, dim_z=1, influence=Huber(1.5), scaling="bounded", information="weight")
kf.predict()
kf.update(1.0)
weights = kf.weights.sum()
tracker = ParameterTracker(OutputError(2, 2), R=0.25, guard="reject", gradient="filtered")
result = tracker.run(np.zeros(10), np.zeros(10))
theta: float = float(result.theta[-1, 0])
interval = tracker.confidence_intervals(0.9).lower
series = filter_series(np.zeros((1, 2, 1)), np.eye(1), np.eye(1), np.eye(1), np.eye(1), np.zeros(1), np.eye(1))
series.x.sum()
kf.x = [0.0, 1.0]
kf.R = 5
kf.Q = Q_discrete_white_noise(2, dt=0.1, var=0.5)
kf.P *= 10.0
kf.F[0, 1] = 0.1
kf.B = None
position: float = float(kf.x[0, 0])
imm: IMMEstimator = IMMEstimator([kf, KalmanFilter(2, 1)], [0.5, 0.5], np.eye(2))
imm.update(1.0)
MerweScaledSigmaPoints(2, 0.1, 2.0, 1.0)
Saver(kinematic_kf(2, 1)).save()
rf.diagnose(tracker, np.zeros(10), us=np.zeros(10))
kf.scaling = "unit"
"""
WRONG = {
    "ParameterTracker(ARX(1, 1), Rr=0.25)": "Rr", "tracker.runn(np.zeros(10))": "runn",
    'RobustKalmanFilter(2, 1, scaling="foo")': "scaling", 'ParameterTracker(ARX(1, 1), guard="maybe")': "guard",
    "kf.updat(1.0)": "updat", "SameFilter(2, 1).RR": '"RR"', "kf.R = object()": "R|expression has type|[Ii]ncompatible",
    "kf.predict(v=1.0)": '"v"', "rf.no_such_name": "no_such_name", "series.y": '"y"',
    'kf.scaling = "foo"': "scaling|foo|expression has type",
}  # fmt: skip


def test_right_use_passes_and_wrong_use_fails(tmp_path):
    program = tmp_path / "program.py"
    program.write_text(RIGHT + "\n".join(WRONG) + "\n")
    options = ["--strict", "--follow-imports=silent", "--cache-dir", str(tmp_path / "cache")]
    command = [sys.executable, "-m", "mypy", *options, str(program)]
    found = subprocess.run(command, capture_output=True, text=True).stdout
    errors = dict(re.findall(r"program\.py:(\d+): error: (.*)", found))
    first = RIGHT.count("\n") + 1
    for line, (statement, reason) in enumerate(WRONG.items(), first):
        assert re.search(reason, errors.pop(str(line), "")), f"{statement}: {found}"
    assert not errors, found
