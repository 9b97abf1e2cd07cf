"""Compare what identification gives, of two dozen small recordings, with what it gave before.

``python tests/benchmarks/golden_identification.py write FILE`` with the code before (PYTHONPATH), ``.. compare FILE``
with the code after: exit code 1 if a number differs by more than ``--tolerance`` (1e-9) of the largest of its array, or
a text at all. ``--only PART`` takes the cases whose name has it, ``--times`` prints how long each took. Under a minute.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from golden import difference

from robust_filterpy import StudentT, fleet
from robust_filterpy.identification import (
    AR,
    ARMA,
    ARMAX,
    ARX,
    FIR,
    BoxJenkins,
    GreyBox,
    LinearRegression,
    OutputError,
    ParameterTracker,
    StateSpace,
    TrackerBank,
    compare,
    identify,
    select_structure,
    validate,
)
from robust_filterpy.identification.models.regressor import GUARDS
from robust_filterpy.plants import simulate_arx, simulate_output_error

N = 300


def drawn(seed: int, n: int = N, columns: int | None = None) -> tuple[np.random.Generator, np.ndarray]:
    """Return random numbers and a binary input."""
    rng = np.random.default_rng(seed)
    return rng, rng.choice([-1.0, 1.0], n if columns is None else (n, columns))


def output_error(seed: int, n: int = N, noise: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """Return a recording of order 2, with a level and a tenth of outliers."""
    rng, u = drawn(seed, n)
    y = simulate_output_error([-1.5, 0.7, 1.0, 0.5], u, na=2, nb=2).y + 3.0 + noise * rng.normal(size=n)
    y[rng.random(n) < 0.1] += 4.0
    return y, u


def of_model(model: Any, y: Any, u: Any, new: int = 40) -> dict[str, Any]:
    """Return everything that a model tells."""
    told: dict[str, Any] = {"repr": repr(model), "str": str(model), "summary": str(model.summary(0.9))}
    for name in ("theta", "P", "std", "R", "noise", "weights", "log_likelihood", "warning", "findings", "offset",
                 "offset_std", "offset_covariance", "level", "level_std", "levels", "operating_point", "trend",
                 "trends", "colour", "evidence", "profiled", "sampled", "own_fit", "dt", "endings", "memory", "A",
                 "B", "C", "D", "K", "end", "orders", "starts", "p", "unidentifiable", "coefficients"):  # fmt: skip
        told[name] = tried(lambda n=name: getattr(model, n, None))
    told["intervals"] = model.confidence_intervals(0.9)
    told["frame"] = model.to_frame(0.9)
    signals = (y, u)
    calls = {
        "predict": lambda: model.predict(*signals),
        "predict 5": lambda: model.predict(*signals, steps=5),
        "free_run": lambda: model.free_run(*signals),
        "residuals": lambda: model.residuals(*signals),
        "fit": lambda: model.fit(*signals),
        "simulate": lambda: model.simulate(None if u is None else u[:new]),
        "continued": lambda: model.simulate(u[:new], start="continued"),
        "after": lambda: model.simulate(u[:new], start=signals),
        "poles": lambda: model.poles(),
        "poles at 0.9": lambda: model.poles(level=0.9),
        "zeros": lambda: model.zeros(),
        "step": lambda: model.step_response(20),
        "frequency": lambda: model.frequency_response(np.linspace(0.01, 3.0, 15)),
        "spectrum": lambda: model.noise_spectrum(np.linspace(0.01, 3.0, 15)),
        "tf": lambda: model.transfer_function(),
        "continuous": lambda: model.poles(dt=0.1),
        "validate": lambda: shown(validate(model, *signals)),
        "compare": lambda: shown(compare({"it": model}, *signals)),
    }
    return told | {name: tried(call) for name, call in calls.items()}


def shown(result: Any) -> dict[str, Any]:
    """Return a report, as it prints and as a table."""
    found = {"text": str(result), "repr": repr(result), "frame": tried(lambda: result.to_frame()), "fields": result}
    return found | {name: tried(lambda n=name: getattr(result, n)) for name in ("verdict", "dynamics", "noise")}


def tried(call: Any) -> Any:
    """Return what a call gives, or the error that it raises."""
    try:
        return call()
    except AttributeError:
        return "none"
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def single_cases():
    """Yield models of one output."""

    def of(y, u, structure, **options):
        return lambda: of_model(identify(y, u, structure, **options), y, u)

    y, u = output_error(1)
    yield "output error", of(y, u, OutputError(2, 2))
    yield (
        "output error, limits",
        of(y, u, OutputError(2, 2), fixed={"b1": 1.0}, bounds={"a2": (0.5, 0.9)}, trend="line"),
    )
    gaps = y.copy()
    gaps[40:44] = np.nan
    gaps[100] = gaps[200] = gaps[201] = -999.0
    gaps[250] = -999.0
    yield "output error, gaps and fills", of(gaps, u, OutputError(2, 2))
    steps = y + 3.0 * (np.arange(N) > 170)
    yield "output error, step of the level", of(steps, u, OutputError(2, 2))
    dates = pd.date_range("2024-01-01", periods=N, freq="10s")
    frame = pd.DataFrame({"u": u}, index=dates)
    yield "output error, dates", of(pd.Series(y, dates), frame, OutputError(2, 2))
    yield "output error, told", of(y, u, OutputError(2, 2), influence=StudentT(4.0), R=0.01, offset=False)
    rng, two = drawn(2, N, 2)
    y2 = simulate_output_error([-0.8, 1.0], two[:, 0], na=1, nb=1).y
    y2 += simulate_output_error([-0.8, 0.5], two[:, 1], na=1, nb=1).y + 0.1 * rng.normal(size=N)
    yield "output error, two inputs", of(y2, two + (0.0, 50.0), OutputError(1, (1, 1)))
    ya = simulate_arx([-1.5, 0.7, 1.0, 0.5], u, na=2, nb=2, noise=0.2 * np.random.default_rng(3).normal(size=N)).y
    spoilt = np.where(np.random.default_rng(4).random(N) < 0.05, ya + 10.0, ya)
    yield "ARX", of(spoilt, u, ARX(2, 2))
    yield "ARX, a reading of 1e9", of(np.where(np.arange(N) == 99, 1e9, ya), u, ARX(2, 2))
    yield "ARMAX", of(spoilt, u, ARMAX(2, 2, 1))
    yield "ARX, integrated", of(np.cumsum(ya) * 0.1, u, ARX(1, 2, integrated=True))
    yield "Box Jenkins", of(y, u, BoxJenkins(2, 0, 1, 2))
    yield "FIR", of(y, u, FIR(6))
    yield "AR", of(ya, None, AR(2))
    yield "ARMA", of(ya, None, ARMA(2, 1))
    rows = np.random.default_rng(5).normal(size=(N, 3))
    z = rows @ [1.0, -2.0, 0.5] + 0.1 * np.random.default_rng(6).standard_t(2, N)
    yield "regression", of(z, rows, LinearRegression(3))
    yield "several recordings", lambda: several([(y[:150], u[:150]), (y[150:] + 2.0, u[150:])], OutputError(2, 2))


def several(recordings, structure):
    """Return a model of several recordings, tried on the last."""
    model = identify([y for y, _ in recordings], [u for _, u in recordings], structure)
    return of_model(model, *recordings[-1])


def of_states():
    """Yield models of several outputs, and of physics."""
    rng, u = drawn(7)
    A, B, C = np.array([[0.8, 0.2], [-0.2, 0.7]]), np.array([1.0, 0.3]), np.array([[1.0, 0.0], [0.5, 1.0]])
    x, y = np.zeros(2), np.zeros((N, 2))
    for k in range(N):
        y[k] = C @ x + (1.0, -2.0)
        x = A @ x + B * u[k] + 0.02 * rng.normal(size=2)
    y += 0.05 * rng.normal(size=y.shape)
    y[rng.random(y.shape) < 0.05] += 3.0
    y[60:64, 1] = np.nan

    def models():
        return identify(y, u, StateSpace(2))

    yield "states", lambda: of_model(models(), y, u)
    yield (
        "states, without disturbance",
        lambda: of_model(identify(y, u, StateSpace(2, disturbance=False, feedthrough=True)), y, u),
    )
    yield "states, several", lambda: several_states(y, u)

    def f(x, u, p):
        return [(p[0] * u[0] - x[0]) / p[1]]

    t = 0.1 * np.arange(150)
    v = np.repeat(np.random.default_rng(8).choice([-1.0, 1.0], 15), 10)
    level = np.zeros(150)
    for k in range(149):
        level[k + 1] = np.exp(-0.1 / 0.7) * level[k] + 2.0 * (1 - np.exp(-0.1 / 0.7)) * v[k]
    z = level + 0.05 * np.random.default_rng(9).standard_t(2, 150)
    box = GreyBox(f, {"gain": 1.0, "T": 1.0}, x0=[0.0])

    def physics():
        model = identify(z, v, box, t=t)
        told = of_model(model, pd.Series(z, t), pd.DataFrame({"v": v}, index=t))
        return told | {
            "by times": [one(z, v, t=t) for one in (model.predict, model.free_run, model.residuals, model.fit)],
            "run": model.simulate(v, t), "from": model.simulate(v, t, x0=[1.0]),
            "validated": shown(validate(model, z, v, t=t)), "compared": shown(compare({"m": model}, z, v, t=t)),
        }  # fmt: skip

    yield "physics", physics


def several_states(y, u):
    """Return a model of two recordings of states."""
    return of_model(identify([y[:150], y[150:]], [u[:150], u[150:]], StateSpace()), y[150:], u[150:])


def judged():
    """Yield what judges models."""
    y, u = output_error(11, 400)

    def reports():
        models = {"right": identify(y, u, OutputError(2, 2)),
                  "small": identify(y, u, OutputError(1, 1))}  # fmt: skip
        other, acted = output_error(12, 400)
        both = compare(models | {"tf": models["right"].transfer_function()}, other, acted)
        told = {name: shown(validate(model, *pair))
                for name, model in models.items() for pair in ((y, u), (other, acted))}  # fmt: skip
        told["fresh"] = shown(validate(models["small"], other, acted, lags=10, level=0.95, steps=3))
        told["tf"] = shown(validate(models["right"].transfer_function(), other, acted))
        return told | {"compared": shown(both)}

    yield "validate and compare", reports
    yield "select_structure", lambda: shown(select_structure(y, u, OutputError, na=(1, 2), nb=(1, 2), nk=(0, 1)))
    yield "select_structure, no input", lambda: shown(select_structure(y, None, AR, na=(1, 2, 3)))
    yield "refusals", lambda: {name: tried(call) for name, call in {
        "validate": lambda: validate(3, y, u), "compare": lambda: compare([], y, u),
        "short": lambda: validate(identify(y, u, FIR(1)), y[:20], u[:20]),
        "structure": lambda: identify(y, u, "ARX"), "u": lambda: identify(y, u[:-1], ARX(1, 1)),
        "nothing": lambda: identify(np.zeros(50), u[:50], ARX(1, 1)),
        "trend": lambda: identify(y, u, ARX(1, 1), trend=1),
        "inf": lambda: identify(np.where(np.arange(400) == 9, np.inf, y), u, ARX(1, 1)),
        "states": lambda: identify(y, u, StateSpace(1), R=1.0), "kind": lambda: select_structure(y, u, GreyBox),
        "focus": lambda: identify(y, u, StateSpace(1), fixed={"A[0,0]": 1.0}),
    }.items()}  # fmt: skip


def of_tracker(tracker: Any, y: Any, u: Any, half: int) -> dict[str, Any]:
    """Return what a tracker gives over half a recording, sample by sample after that, and of its model then."""
    told: dict[str, Any] = {"run": tracker.run(y[:half], u[:half])}
    kept = tracker.state()
    told["update"] = [tracker.update(a, b) for a, b in zip(y[half:], u[half:], strict=True)]
    last = {
        name: tried(lambda n=name: getattr(tracker, n)) for name in ("theta", "P", "std", "R", "Q", "offset", "level")
    }
    told |= {"last": last, "state": tracker.state(), "text": str(tracker), "repr": repr(tracker)}
    if isinstance(tracker, ParameterTracker):
        told |= {name: tried(call) for name, call in {
            "summary": lambda: str(tracker.summary()), "step": lambda: tracker.step_response(15),
            "frequency": lambda: tracker.frequency_response([0.1, 1.0]), "poles": lambda: tracker.poles(),
            "zeros": lambda: tracker.zeros(), "tf": lambda: tracker.transfer_function(0.1),
            "spectrum": lambda: tracker.noise_spectrum([0.1, 1.0]),
            "simulate": lambda: tracker.simulate(u[:20]),
            "continued": lambda: tracker.simulate(u[:20], continued=True), "predict": lambda: tracker.predict(u[0]),
        }.items()}  # fmt: skip
    tracker.restore(kept)
    return told | {"again": tracker.run(y[half:], u[half:]), "state again": tracker.state()}


def tracked():
    """Yield trackers, banks, and a fleet of trackers."""
    y, u = output_error(21, 400)
    jumped = y + np.concatenate((np.zeros(250), 2.0 * simulate_output_error([-0.9, 1.0], u[250:], na=1, nb=1).y))
    ya = simulate_arx([-1.5, 0.7, 1.0, 0.5], u, na=2, nb=2, noise=0.2 * np.random.default_rng(3).normal(size=400)).y
    ya[60:63], ya[200] = np.nan, 60.0
    theta = [-1.5, 0.7, 1.0, 0.5]
    for name, options in (
        ("output error", {"start": 100}), ("paper", {"start": 0, "R": 0.01}),
        ("forgetting", {"theta": theta, "P": 0.1, "forgetting": 0.99, "offset": True}),
        ("pseudolinear", {"theta": 0.1, "gradient": "pseudolinear", "guard": "reject", "Q": 1e-5}),
    ):  # fmt: skip
        yield f"tracker, {name}", lambda o=options: of_tracker(ParameterTracker(OutputError(2, 2), **o), y, u, 300)
    yield "tracker, another plant", lambda: of_tracker(ParameterTracker(OutputError(2, 2), start=100), jumped, u, 390)
    for name, structure in (("ARX", ARX(2, 2)), ("ARMAX", ARMAX(2, 2, 1)), ("Box Jenkins", BoxJenkins(2, 1, 1, 2))):
        yield f"tracker, {name}", lambda s=structure: of_tracker(ParameterTracker(s, start=100, Q=1e-6), ya, u, 300)
    long = np.concatenate((y, np.full(40, y[7]), y))
    acted = np.concatenate((u, u[:40], u))
    yield (
        "tracker, stuck and moved",
        lambda: of_tracker(ParameterTracker(ARX(2, 2), start=200), long + 5.0 * (np.arange(840) > 600), acted, 830),
    )
    yield (
        "tracker, from a model",
        lambda: of_tracker(ParameterTracker(identify(y[:200], u[:200], OutputError(2, 2))), y[200:], u[200:], 100),
    )
    for Q in (0.0, 1e-6, 1e-4):
        yield (
            f"tracker, likelihood of Q = {Q}",
            lambda Q=Q: ParameterTracker(ARX(2, 2), start=100, Q=Q).run(ya, u).log_likelihood(),
        )
    both = np.stack([ya, y, jumped], axis=1)
    yield "bank", lambda: of_tracker(TrackerBank(3, ARX(2, 2), start=100, Q=1e-6), both, u, 300)
    for guard in GUARDS:
        options = {"theta": [-1.4, 0.6, 1.0, 0.5], "R": 0.01, "guard": guard}
        yield (
            f"bank, given, {guard}",
            lambda options=options: of_tracker(TrackerBank(3, OutputError(2, 2), **options), both, u, 300),
        )

    def stepped():
        model = fleet.TrackerModel(OutputError(2, 2), {"start": 100}, measurements=["y"], inputs=["u"])
        state, rows = None, []
        for part in np.array_split(np.column_stack([y, u]), 5):
            state, out = fleet.step(model, state, part)
            rows.append({name: np.asarray(out[name]) for name in model.columns})
        return rows

    yield "fleet of trackers", stepped


def leaves(value: Any, name: str = "") -> dict[str, Any]:
    """Return the numbers and texts that a result is made of, by their places."""
    if isinstance(value, str) or value is None:
        return {name: str(value)}
    if isinstance(value, pd.DataFrame):
        return leaves({str(c): value[c].to_numpy() for c in value} | {"index": str(list(value.index))}, name)
    if isinstance(value, pd.Series):
        return leaves(value.to_numpy(), name) | {f"{name}.index": str((value.name, value.index[0], value.index[-1]))}
    if hasattr(value, "num_list"):
        return leaves([value.num_list, value.den_list, value.dt], name)
    if all(hasattr(value, part) for part in ("A", "B", "C", "D", "dt", "nstates")):
        return leaves([value.A, value.B, value.C, value.D, value.dt], name)
    if isinstance(value, Mapping):
        return {k: v for key, each in value.items() for k, v in leaves(each, f"{name}.{key}").items()}
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return leaves(dict(zip(value._fields, value, strict=True)), name)
    fields = getattr(type(value), "__dataclass_fields__", None)
    if fields is not None:
        return leaves({field: getattr(value, field) for field in fields}, name)
    try:
        array = np.asarray(value)
        if array.dtype.kind in "bcfiu":
            array = np.stack([array.real, array.imag]) if array.dtype.kind == "c" else array
            return {name: array.astype(float)}
        if array.dtype.kind == "U":
            return {name: str(array.tolist())}
    except ValueError:
        pass
    if isinstance(value, (list, tuple)):
        return leaves({str(i): each for i, each in enumerate(value)}, name)
    return {name: str(value).split(" at 0x")[0]}


def gathered(part: str, times: bool) -> dict[str, dict[str, Any]]:
    """Return what each case gives; warnings count."""
    results = {}
    for cases in (single_cases(), of_states(), judged(), tracked()):
        for name, case in cases:
            if part not in name:
                continue
            began = time.perf_counter()
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always")
                value = tried(case)
            texts = [f"{w.category.__name__}: {w.message}" for w in said]
            results[name] = leaves({"result": value, "said": "\n".join(texts)})
            if times:
                print(f"{time.perf_counter() - began:6.1f} s  {name}", flush=True)
    return results


def main() -> int:
    """Write or compare."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=("write", "compare"))
    parser.add_argument("file")
    parser.add_argument("--only", default="", help="part of the names of the cases to take")
    parser.add_argument("--tolerance", type=float, default=1e-9)
    parser.add_argument("--times", action="store_true")
    arguments = parser.parse_args()
    found = {f"{case}|{leaf}": np.asarray(v) for case, each in gathered(arguments.only, arguments.times).items()
             for leaf, v in each.items()}  # fmt: skip
    flat = {name.replace("/", "|"): value for name, value in found.items()}
    if arguments.action == "write":
        np.savez_compressed(arguments.file, **flat)
        print(f"{len(flat)} results")
        print(*sorted({f"{k}: {v}" for k, v in flat.items() if k.endswith("|.result")}), sep="\n")
        return 0
    with np.load(arguments.file) as before:
        stored = {name: before[name] for name in before.files if arguments.only in name.split("|")[0]}
    bad = 0
    for name in sorted(set(stored) | set(flat)):
        if name not in stored or name not in flat:
            bad += 1
            print(f"{'gone' if name in stored else 'new':>9s}  {name}")
            continue
        empty = stored[name].dtype.kind != "U" and stored[name].shape == flat[name].shape and not stored[name].size
        off = 0.0 if empty else difference(stored[name], flat[name])
        if off > arguments.tolerance:
            bad += 1
            texts = f":\n  {stored[name]}\n  {flat[name]}" if stored[name].dtype.kind == "U" else ""
            print(f"{off:9.1e}  {name}{texts}")
    print(f"{len(stored)} results compared, {bad} differ")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
