"""The live page of the site computes what Python computes, by the kernel in C as it is today."""

import ctypes
import importlib.util
import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from browsing import BROWSER, after_scripts, served
from filterpy.kalman import KalmanFilter

from robust_filterpy import AdaptiveKalmanFilter, Huber, RobustKalmanFilter

DOCS = Path(__file__).parents[2] / "docs"
SCRIPT = DOCS / "_static" / "live_filter.js"


@pytest.fixture(scope="module")
def build():
    spec = importlib.util.spec_from_file_location("live_build", DOCS / "_live" / "build.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def embedded(name):
    return json.loads(re.search(rf"^  {name}: (.*?),?$", SCRIPT.read_text(), flags=re.M).group(1))


def test_the_compiled_kernel_is_todays(build):
    message = "the kernel is another one by now: run `python docs/_live/build.py` (needs clang and lld)"
    assert build.fingerprint() == embedded("made_from"), message
    assert SCRIPT.stat().st_size < 30_000


def test_the_recording_is_the_scripts(build):
    for name, signal in zip(("truth", "clean", "measured"), build.recording(), strict=True):
        assert np.array_equal(signal, embedded(name))


def root_mean_square(kf, truth, measured):
    """Error of the position, in m."""
    found = []
    for z in measured:
        kf.predict()
        kf.update(z)
        found.append(kf.x[0, 0])
    return np.sqrt(np.mean((np.array(found) - truth) ** 2))


def errors(build, measured):
    """Errors of the three filters, to two digits."""
    classes = {KalmanFilter: {}, RobustKalmanFilter: {"influence": Huber(1.35)}, AdaptiveKalmanFilter: {}}
    truth = build.recording()[0]
    filters = [build.live_filter(cls, **options) for cls, options in classes.items()]
    return [f"{root_mean_square(kf, truth, measured):.2f}" for kf in filters]


def test_the_text_has_the_errors_without_outliers(build):
    kalman, default, learnt = errors(build, build.recording()[1])
    said = f"The Kalman filter's error is {kalman} m then, the default's {default} m, that of learned noise {learnt} m"
    assert said in " ".join((DOCS / "live.md").read_text().split())


@pytest.mark.skipif(shutil.which("cc") is None, reason="no compiler")
@pytest.mark.parametrize("spoilt", [False, True])
def test_the_pages_c_finds_the_errors_that_python_finds(build, tmp_path, spoilt):
    (tmp_path / "numbers.h").write_text(build.numbers())
    library = tmp_path / "live.so"
    command = ["cc", "-std=c99", "-shared", "-fPIC", "-O1", f"-I{tmp_path}", f"-I{build.KERNEL}", "-o", library]
    subprocess.run([*command, build.HERE / "live.c", "-lm"], check=True, timeout=120)
    page = ctypes.CDLL(str(library))
    truth, *recordings = build.recording()
    readings = recordings[spoilt]
    room = (ctypes.c_double * 1000).in_dll  # STEPS of live.c
    one, steps, found = ctypes.c_double(1.0), len(readings), []
    for name, options in (("kalman", ()), ("default", (ctypes.c_double(1.35),)), ("learnt", ())):
        room(page, "live_z")[:steps] = readings.tolist()
        assert getattr(page, f"live_{name}")(steps, one, *options) == steps
        found.append(np.sqrt(np.mean((np.array(room(page, "live_position")[:steps]) - truth) ** 2)))
    assert [f"{error:.2f}" for error in found] == errors(build, readings)


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no browser")
def test_the_page_shows_the_errors_that_python_finds(build):
    html = re.search(r"```\{raw\} html\n(.*?)```", (DOCS / "live.md").read_text(), flags=re.S).group(1)
    html = html.replace("_static/", "")
    with served(DOCS / "_static", live=f'<!doctype html><meta charset="utf-8"><body>{html}</body>') as address:
        page = after_scripts(f"{address}/live", seconds=3)
    kalman, default, learnt = errors(build, build.recording()[2])
    assert f"Root-mean-square error: Kalman {kalman} m, default {default} m, learnt noise {learnt} m" in page
