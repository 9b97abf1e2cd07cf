"""The C of a filter or a tracker makes of every sample what Python makes of it, or refuses it as that does.

It is the kernel to the last bit; that this is the definition, the tests of the kernel hold.
"""

import copy
import ctypes
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import c_programs
import filterpy.kalman
import numpy as np
import pytest
from c_programs import BAD_ARGUMENT, OK, UNDEFINED, WARNINGS, Case, InC, compiled, filter_case, filtered, tracker_case
from support import assert_close, by_night, draws, needs_kernel, of_matrices

import robust_filterpy
from robust_filterpy import (
    AdaptiveKalmanFilter,
    Contaminated,
    Huber,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    StudentT,
)
from robust_filterpy.edge import export_c
from robust_filterpy.identification import ARX, OutputError, ParameterTracker, TrackerBank
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive.recursion import repaired

needs_cc = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


def cases(seeds, **options):
    """As many filters as trackers."""
    return [filter_case(f"filter{seed}", seed, **options) for seed in seeds] + [
        tracker_case(f"tracker{seed}", seed) for seed in seeds
    ]


def plain(n=2):
    kf = RobustKalmanFilter(n, 1)
    kf.F, kf.Q = np.eye(n) + 0.1 * np.eye(n, k=1), 0.01 * np.eye(n)
    kf.H[0, 0] = 1.0
    return kf


def recorded(name, tracker, *size):
    """A tracker and white noise."""
    return Case(name, tracker, np.random.default_rng(size).normal(size=size), 1)


@needs_cc
@draws(6, 25)
def test_c_equals_the_kernel_to_the_last_bit(tmp_path, draws):
    needs_kernel()
    some = [filter_case(f"filter{seed}", seed) for seed in range(draws)]
    some += [filter_case(f"joint{seed}", seed, extremes=False, joint=True) for seed in range(62, 62 + draws // 2)]
    assert any(case.model.grouping == "joint" and case.model.dim_z > 1 for case in some)
    codes = []
    for case, found in compiled(some, tmp_path):
        expected = filtered(case)
        assert np.array_equal(found, expected, equal_nan=True), case.model
        codes += [*expected[:, :2].ravel()]
    assert BAD_ARGUMENT in codes and np.mean(np.array(codes) == OK) > 0.8


@needs_cc
@draws(6, 20)
def test_the_c_of_a_tracker_equals_the_kernel_to_the_last_bit(tmp_path, draws):
    needs_kernel()
    some = [tracker_case(f"tracker{seed}", seed) for seed in range(40, 40 + draws)]
    by_unit = {"scaling": "unit", "R": 1.0, "P": 0.01, "influence": StudentT(3.0), "start": 0, "guard": "none"}
    some += [tracker_case("begun", 1, start=64), recorded("unit", ParameterTracker(ARX(1, 1), **by_unit), 30, 2)]
    # With every polynomial that there is.
    every = Structure(na=1, nb=2, nc=1, nd=1, nf=1)
    some.append(recorded("whole", ParameterTracker(every, start=0, R=1.0, P=1.0), 60, 2))
    for case, found in compiled(some, tmp_path):
        y, u = case.samples[:, -1], case.samples[:, : case.inputs]
        taken = ~np.isinf(y) & np.isfinite(u).all(axis=1)
        assert (found[:, 1] == np.where(taken, OK, BAD_ARGUMENT)).all()
        n, run, found = case.n, copy.deepcopy(case.model).run(y[taken], u[taken]), found[taken]
        ours = np.stack((found[:, 2 : 2 + n], np.sqrt(found[:, 2 + n : -4 : n + 1])))
        if case.model.form.has_offset:
            ours = np.delete(ours, case.model.structure.constant_place, axis=2)
        shown = np.column_stack((run.prediction, run.residual, run.weights, run.guard))
        # The last sample that is measured is the definition's, which shows more of it.
        last = int(np.flatnonzero(~np.isnan(y[taken]))[-1])
        assert last > 20 and np.array_equal(ours[:, :last], np.stack((run.theta, run.std))[:, :last]), case.model
        assert np.array_equal(found[:last, -4:], shown[:last], equal_nan=True), case.model


@needs_cc
def test_very_informative_samples_are_tempered_and_mended(tmp_path):
    rng = np.random.default_rng(4)
    u = rng.normal(size=(30, 1))
    y = np.concatenate(([[0.0]], 2.0 * u[:-1]))
    y[10] = 1e7
    some = [
        Case(name, ParameterTracker(ARX(2, 1), P=P, R=0.01), np.column_stack((u, y)), 1)
        for name, P in (("tempered", 1e14), ("mended", 1e9))
    ]
    for case, found in compiled(some, tmp_path):
        expected = copy.deepcopy(case.model).run(y[:, 0], u)
        # Rounding is a larger share of what so sharp a sample leaves.
        assert np.allclose(found[:, 2:5], expected.theta, rtol=1e-4, atol=1e-6)
        assert np.allclose(found[:, 5:14:4], expected.std**2, rtol=1e-2)
        for covariance in found[:, 5:14].reshape(-1, 3, 3):
            values = np.linalg.eigvalsh(covariance)
            assert values[0] >= -1e-15 * values[-1]


@needs_cc
def test_covariance_that_lost_its_sign_is_mended_as_in_python(tmp_path):
    export_c(ParameterTracker(ARX(2, 2), start=0), tmp_path / "arx.c")
    (tmp_path / "mend.c").write_text(
        '#include "arx.c"\nvoid mended(double P[16]);\n'
        "void mended(double P[16]) { double work[mend_work(4)]; mend(4, P, work); }\n"
    )
    build = ["cc", "-std=c99", "-shared", "-fPIC", "mend.c", "-lm", "-o", "mend.so"]
    subprocess.run(build, cwd=tmp_path, check=True)
    vectors = np.linalg.qr(np.random.default_rng(5).normal(size=(4, 4)))[0]
    for values in ([-1e-9, 1e-6, 1.0, 2.0], [1e-9, 1e-6, 1.0, 2.0]):
        P = (vectors * values).dot(vectors.T)
        P = 0.5 * (P + P.T)
        found = (ctypes.c_double * 16)(*P.ravel())
        ctypes.CDLL(str(tmp_path / "mend.so")).mended(found)
        assert np.allclose(np.reshape(found, (4, 4)), repaired(P), rtol=0.0, atol=1e-14)
        assert np.array_equal(np.reshape(found, (4, 4)), P) == (values[0] > 0.0)


@pytest.mark.nightly
@needs_cc
def test_single_precision_is_near(tmp_path):
    some = [filter_case(f"filter{seed}", seed, extremes=False) for seed in range(20, 23)] + [tracker_case("one", 20)]
    both = (compiled(some, tmp_path / kind, kind) for kind in ("single", "double"))
    for (case, single), (_, double) in zip(*both, strict=True):
        for part in np.split(np.arange(2, 2 + case.n + case.n**2), [case.n]):
            assert_close(single[:, part], double[:, part], 1e-4)


@needs_cc
def test_c_needs_nothing_but_math_and_a_stack_known_beforehand(tmp_path):
    for case in cases(range(3)):
        export_c(case.model, tmp_path / f"{case.name}.c")
        command = ["cc", "-std=c99", "-O2", *WARNINGS, "-fstack-usage", "-c", f"{case.name}.c"]
        subprocess.run(command, cwd=tmp_path, check=True)
        needed = subprocess.run(["nm", "-u", f"{case.name}.o"], cwd=tmp_path, capture_output=True, text=True).stdout
        # Compilers copy and move numbers by the first three, and come with them.
        math = {"sqrt", "exp", "log", "hypot"}
        allowed = {"memcpy", "memmove", "memset", *math, "_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"}
        assert set(re.findall(r"U (\w+)", needed)) <= allowed
        stack = (tmp_path / f"{case.name}.su").read_text().splitlines()
        assert stack and all(line.endswith(("\tstatic", "\tdynamic,bounded")) for line in stack)


@needs_cc
@pytest.mark.slow
def test_a_static_analyzer_finds_nothing(tmp_path):
    if "Free Software Foundation" not in subprocess.run(["cc", "--version"], capture_output=True, text=True).stdout:
        pytest.skip("the analyzer is gcc's")
    for case in cases(range(12)):
        export_c(case.model, tmp_path / f"{case.name}.c")
        command = ["cc", "-std=c99", "-O2", "-fanalyzer", *WARNINGS, "-c", f"{case.name}.c"]
        found = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert found.returncode == 0, found.stderr[:3000]


@needs_cc
def test_threshold_changes_at_run_time(tmp_path):
    kf = plain()
    in_c = InC(kf, tmp_path)
    kf.influence, in_c.model[-1] = Huber(0.5), 0.5
    for z in (1.0, 50.0, 2.0):
        kf.predict()
        kf.update(z)
        assert in_c.predict() == in_c.update(z) == OK
    assert np.allclose(in_c.x, kf.x.ravel(), rtol=1e-12) and np.allclose(in_c.P, kf.P, rtol=1e-12)


@needs_cc
def test_wrong_use_is_refused_and_changes_nothing(tmp_path):
    in_c = InC(plain(), tmp_path)
    predict, update, state, model = in_c.library.one_predict, in_c.library.one_update, in_c.state, in_c.model
    z, start = (ctypes.c_double * 1)(1.0), list(state)
    assert predict(None, state) == predict(model, None) == BAD_ARGUMENT
    for arguments in ((None, state, z), (model, None, z), (model, state, None)):
        assert update(*arguments, None) == BAD_ARGUMENT
    singular = type(model)(*list(model)[:8], 0.0, 0.0, 0.0, 1.345)
    assert update(singular, state, z, None) == c_programs.SINGULAR and list(state) == start
    broken = type(state)(*[float("nan")] * 6)
    assert predict(model, broken) == update(model, broken, z, None) == c_programs.NOT_FINITE
    huge = type(state)(0.0, 0.0, 1e308, 0.0, 0.0, 1e308)
    assert predict(type(model)(*[1e300] * 12), huge) == c_programs.NOT_FINITE
    assert list(huge)[:6] == [0.0, 0.0, 1e308, 0.0, 0.0, 1e308]


@pytest.mark.nightly
@needs_cc
def test_odd_numbers_anywhere_do_no_harm(tmp_path):
    for case in (*cases([40]), filter_case("more7", 7), tracker_case("more", 3)):
        (tmp_path / case.name).mkdir()
        InC(case.model, tmp_path / case.name, UNDEFINED).fuzz()


@pytest.mark.nightly
@needs_cc
def test_nothing_is_read_or_written_that_is_not_there():
    """The same with every access watched, which wants a process of its own."""
    libraries = [subprocess.run(["cc", f"-print-file-name=lib{name}.so"], capture_output=True, text=True).stdout.strip()
                 for name in ("asan", "ubsan")]  # fmt: skip
    if not all(map(os.path.isfile, libraries)):
        pytest.skip("no library that watches")
    environment = {**os.environ, "LD_PRELOAD": " ".join(libraries), "ASAN_OPTIONS": "detect_leaks=0"}
    chosen = "odd_numbers or wrong_use or unit_scaling or very_informative"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", "-m", "", "-k", chosen]
    done = subprocess.run([*command, os.path.dirname(__file__)], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


@needs_cc
def test_unit_scaling_refuses_what_makes_P_indefinite(tmp_path):
    kf = plain()
    kf.scaling, kf.P = "unit", 50.0 * np.eye(2)
    with pytest.raises(np.linalg.LinAlgError):
        kf.update(0.1)
    in_c = InC(kf, tmp_path, UNDEFINED)
    assert in_c.predict() == OK and in_c.update(0.0) == c_programs.INDEFINITE
    kf.predict()
    assert np.allclose(in_c.P, kf.P)


@pytest.mark.parametrize("make", [plain, lambda: ParameterTracker(ARX(1, 1), start=0)], ids=["filter", "tracker"])
def test_the_same_model_gives_the_same_file(tmp_path, make):
    kf = make()
    texts = []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        texts.append([path.read_text() for path in export_c(kf, tmp_path / folder / "cart")])
    assert texts[0] == texts[1]
    assert max(len(line) for text in texts[0] for line in text.splitlines()) <= 120


def test_a_full_disk_leaves_the_files_of_the_model_before(tmp_path):
    resource = pytest.importorskip("resource")
    before = [path.read_text() for path in export_c(plain(), tmp_path / "cart")]
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4_000, hard))
    try:
        with pytest.raises(OSError, match=r"large|space"):
            export_c(plain(3), tmp_path / "cart")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cart.c", "cart.h"]
    assert [(tmp_path / name).read_text() for name in ("cart.c", "cart.h")] == before


class OwnHuber(Huber):
    def psi(self, e):
        return 0.5 * super().psi(e)


class OwnFilter(RobustKalmanFilter):
    """May do anything."""


class OwnUpdate(RobustExtendedKalmanFilter):
    def update(self, *args, **kwargs):
        """May do anything."""


def changed(kf=None, **attributes):
    kf = kf or plain()
    for name, value in attributes.items():
        setattr(kf, name, value)
    return kf


def extended(**attributes):
    return changed(RobustExtendedKalmanFilter(2, 1), **attributes)


def tracker(**options):
    return ParameterTracker(ARX(1, 1), **options)


def several():
    """Filters of filterpy that are more than one."""
    return filterpy.kalman.IMMEstimator([plain(), plain()], np.ones(2) / 2, np.full((2, 2), 0.5))


REFUSED = {
    "bank": (lambda: TrackerBank(2, ARX(1, 1)), r"model\.tracker\(\.\.\)"),
    "filterpy's filter": (lambda: filterpy.kalman.KalmanFilter(2, 1), "influence=Linear"),
    "unscented": (lambda: of_matrices(RobustUnscentedKalmanFilter, 1.0, np.eye(1)), "working point"),
    "several": (several, "each of its filters"),
    "a class": (lambda: RobustKalmanFilter, "instance"),
    "nothing": (lambda: None, "RobustKalmanFilter"),
    "a subclass": (lambda: OwnFilter(2, 1), "same x, P, F"),
    "psi": (lambda: changed(influence=OwnHuber()), "StudentT"),
    "groups": (lambda: RobustKalmanFilter(2, 2, grouping=((0, 1),)), "grouping='component'"),
    "joint by T = 1": (lambda: RobustKalmanFilter(2, 2, grouping="joint", scaling="unit"), "or 'joint'"),
    "joint, correlated": (lambda: of_matrices(RobustKalmanFilter, 1.0, np.eye(2), R=np.eye(2) + 0.1, grouping="joint"),
                          "R: expected a diagonal"),
    "tracker's spread": (lambda: tracker(start=0, scaling="learnt"), "scaling='innovation'"),
    "inverse": (lambda: changed(inv=np.linalg.pinv), "numpy.linalg.inv"),
    "wrapped": (lambda: changed(update=print), "update"),
    "shape": (lambda: changed(F=np.eye(3)), r"F: .*\(2, 2\)"),
    "NaN": (lambda: changed(x=np.full(2, np.nan)), "x: expected finite"),
    "asymmetric": (lambda: changed(P=np.array([[1.0, 1e-9], [0.0, 1.0]])), "P.T"),
    "negative": (lambda: changed(Q=-np.eye(2)), "Q: expected variances"),
    "indefinite": (lambda: changed(Q=np.array([[1.0, 2.0], [2.0, 1.0]])), "Q: expected a positive"),
    "tracker's filter": (lambda: tracker(filter=AdaptiveKalmanFilter), "got AdaptiveKalmanFilter"),
    "start": (tracker, r"run\(y, u\) .* start=0"),
    "noise, joint": (lambda: changed(noise="learnt", grouping="joint"), "sensor by sensor"),
    "noise, process": (lambda: changed(noise="learnt", process=Contaminated(0.1, 100.0)), "process='given' or Scales"),
    "noise, inverse": (lambda: changed(noise="learnt", inv=np.linalg.pinv), "numpy.linalg.inv"),
    "noise, negative": (lambda: changed(noise="learnt", P=-np.eye(2)), "P: expected"),
    "filterpy's extended": (lambda: filterpy.kalman.ExtendedKalmanFilter(2, 1),
                            "a RobustExtendedKalmanFilter with the same"),
    "extended of its own": (lambda: OwnUpdate(2, 1), "predict_x alone"),
    "extended, joint": (lambda: extended(noise="learnt", grouping="joint"), "set noise=None"),
    "extended, models": (lambda: extended(noise="learnt"), "set process='given'"),
    "extended, wrapped": (lambda: extended(update=print), "update"),
    "extended, negative": (lambda: extended(Q=-np.eye(2)), "Q: expected"),
    "extended, B": (lambda: extended(B=np.ones((3, 1))), "B: expected"),
}  # fmt: skip


@pytest.mark.parametrize(("make", "message"), REFUSED.values(), ids=REFUSED)
def test_what_has_no_c_is_refused_with_a_remedy(make, message, tmp_path):
    with pytest.raises((TypeError, ValueError), match=message):
        export_c(make(), tmp_path / "cart.c")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "path",
    ["2cart.c", "my cart.c", "cart.cpp", "none/cart.c", "", "wägen.c", "math.c", "Limits.c", pytest.param(3, id="3")],
)
def test_path_that_is_no_name_in_c_is_refused(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises((ValueError, TypeError), match="path: expected"):
        export_c(plain(), path)
    assert not list(tmp_path.iterdir())


def test_numbers_that_single_precision_cannot_hold_are_refused(tmp_path):
    kf = changed(R=np.array([[1e60]]))
    with pytest.raises(ValueError, match=r"R: .* units"):
        export_c(kf, tmp_path / "cart.c", precision="single")
    with pytest.raises(ValueError, match="precision"):
        export_c(kf, tmp_path / "cart.c", precision="half")
    with pytest.raises(ValueError, match='expected "double" for noise that is given or learned'):
        export_c(changed(noise="learnt"), tmp_path / "cart.c", precision="single")
    assert not list(tmp_path.iterdir())


def test_the_header_of_a_tracker_names_its_parameters(tmp_path):
    text = export_c(ParameterTracker(OutputError(1, 1), start=0), tmp_path / "c.c").header.read_text()
    assert "theta = [a1, b1]" in text


# Names of exported C: none that a compiler trips over.


KERNEL = Path(robust_filterpy.__file__).parent / "kernel"
PREFIXES = sorted({name.partition("_")[0] for header in KERNEL.glob("*.h")
                   for name in re.findall(r"\b[a-z]\w*_\w+", header.read_text())})  # fmt: skip
@pytest.mark.skipif(not shutil.which("cc"), reason="there is no compiler")
@pytest.mark.parametrize("kind", by_night([RobustKalmanFilter, AdaptiveKalmanFilter], AdaptiveKalmanFilter))
def test_a_prefix_of_the_kernel_is_refused_or_compiles(kind, tmp_path):
    sources, refused = [], []
    kf = of_matrices(kind, [[1.0, 1.0], [0.0, 1.0]], np.eye(1, 2), Q=0.1)
    for name in [*PREFIXES, "learnt", "cart", "model", "state", "main", "int"]:
        try:
            sources.append(export_c(kf, tmp_path / f"{name}.c").source)
        except ValueError as error:
            assert "path: expected" in str(error) and f"use my_{name}.c" in str(error)
            refused.append(name)
    # Learnt noise has names of its own in C; nothing else is refused for nothing.
    assert set(refused) == ({"learnt"} if kind is AdaptiveKalmanFilter else set())
    done = subprocess.run(["cc", "-std=c99", "-fsyntax-only", "-I", tmp_path, *sources], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[:2000]
