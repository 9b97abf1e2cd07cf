"""Public names from one list: the stub next to a package's first page, which type checkers read too (PEP 562, SPEC 1).

Each line of the stub ``__init__.pyi`` is ``from package.module import name as name``; a line more is a name more. A
name that is not in the list is looked for on the first pages of its sister packages, and its error says where it is.
"""

from __future__ import annotations

import ast
import importlib
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

#: Names that were public, and what does the same.
_GONE = {
    "tune": "kf = estimate_noise(kf, zs).apply(kf) fits a filter's noises, noise=Learnt() learns them while it runs",
    "check_tracker": "draw('arx', ..), run_tracker(tracker, scenario), assert_tracks and its like test a tracker",
    "mean_square_error": "((x_hat - x) ** 2).sum(axis=2).mean(axis=0), of arrays (runs, steps, n)",
    **dict.fromkeys(
        ("assert_bounded_influence", "assert_missing_is_no_information", "assert_recovers_from_jump",
         "assert_same_filter", "assert_sensor_order_irrelevant", "assert_state_round_trip", "assert_unit_equivariant"),
        "check_filter(make) tests it; filter_checks() has each check by name",
    ),
    "step_table": 'fleet.step(model, states, table, key="device")',
    "plot_parameters": "plot_states, or plot() of what tracker.run returned",
    "plot_fit": "compare({\"name\": model}, y, u).plot() draws models over what was measured",
    "plot_tuning": "to_frame() of what tracker.tuned returned has the values and their log-likelihoods",
    "assert_efficient": "assert_tracks(runs) tests filters and trackers",
    "assert_interval_coverage": "assert_consistent(runs) tests the errors of filters and trackers against their P",
    "ServoObserver": "it is examples/servo/observer.py; simulate_servo(.., observer=) takes any",
    "simulate_actuator": "control.input_output_response(pneumatic_servo(), t, [valve, load], x) runs it without a loop",
    "random_coefficient": "plants.linear.random_walk(start, variance, n, accept=) keeps a path within bounds",
    "batch": "filter_series is in robust_filterpy, and in robust_filterpy.filters",
    "FilterBank": "filter_series(z[:, None], .., state=result.state) takes one step of many filters",
}

#: Names that front pages had, by the module that has them now: found there for one release, with a warning.
_HOMES = (
    "correction Scales", "influence Linear",
    "filters RobustCubatureKalmanFilter RobustEnsembleKalmanFilter OutlierShareWarning",
    "correction.definition correct", "correction.options Choices", "correction.result Correction",
    "testing.studies Interval", "fleet.models Model", "fusion.motion Motion",
    "identification.models.grey_box GreyBoxModel", "identification.models.regressor Coefficients",
    "identification.models.results TrackingResult",
    "identification.models.state_space StateSpaceModel", "identification.models.structures Structure",
    "influence.functions Influence", "plants.linear Simulation random_walk stable",
    "plants.excitation bandlimited_pink_spectrum sample_autocovariance",
    "plants.servo.equations beta_coefficient", "plants.servo.linearization linearize_servo",
    "plants.servo.equations valve_opening",
    "plants.servo.position_loop ServoRecording", "plants.servo.linearization operating_point",
    "plotting.models plot_noise_spectrum plot_step",
    "plotting.models plot_comparison plot_structure_selection plot_validation",
    "testing.consistency assert_covariance_stays_one",
    "testing.checks assert_refused_call_changes_nothing",
    "testing.drawing Scenario",
    "testing.models StateModel", "testing.plants Plant PlantScenario",
)  # fmt: skip
_MOVED = {name: f"robust_filterpy.{home}" for home, *names in map(str.split, _HOMES) for name in names}


def attach(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package whose names are imported when asked for."""
    homes = _names(Path(file).with_suffix(".pyi"))

    def __getattr__(name: str) -> Any:
        """Import a name of another module, or a package, when it is first asked for."""
        if name in homes or (Path(file).parent / name / "__init__.py").exists():
            room = importlib.import_module(homes.get(name, f"{package}.{name}"))
            value = getattr(room, name) if name in homes else room
            # Found without this function from now on.
            setattr(sys.modules[package], name, value)
            return value
        if _has_moved(package, name):
            return _moved(package, name)
        rooms = [] if name.startswith("_") else _rooms(Path(file).parent, name)
        if not rooms:
            refuse(package, name)
        refuse(package, name, f"it is in {' and in '.join(f'{package}.{room}' for room in rooms)}")

    return __getattr__, lambda: sorted(homes), sorted(homes)


def elsewhere(package: str) -> Callable[[str], Any]:
    """Return ``__getattr__`` of a front page: a name that has moved is found, with a warning, another is refused."""
    return lambda name: _moved(package, name) if _has_moved(package, name) else refuse(package, name)


def _has_moved(package: str, name: str) -> bool:
    """Return whether a front page had a name: of the root's only what other front pages have now."""
    home = _MOVED.get(name, "")
    return home.startswith(f"{package}.") and (package.count(".") > 0 or home.count(".") == 1)


def _moved(package: str, name: str) -> Any:
    """Return a name that has moved from a front page, and say where it is."""
    sentence = f"{package}.{name} has moved: from {_MOVED[name]} import {name}"
    warnings.warn(sentence, DeprecationWarning, stacklevel=3)
    return getattr(importlib.import_module(_MOVED[name]), name)


def refuse(package: str, name: str, mend: str = "") -> NoReturn:
    """Raise for a name that a package does not have, and say where it is or what has taken its place."""
    mend = mend or _GONE.get(name, "")
    if not mend:
        raise AttributeError(f"module {package!r} has no attribute {name!r}")
    asking = sys._getframe(1)
    if asking.f_globals.get("__name__") == __name__ and asking.f_back is not None:
        asking = asking.f_back
    # An import statement asks first, and would put words of its own in the place of an AttributeError's.
    imported = asking.f_globals.get("__name__") == "importlib._bootstrap"
    error = ImportError if imported else AttributeError
    raise error(f"{package} has no `{name}`; {mend}")


def _names(page: Path) -> dict[str, str]:
    """Return the names that a first page imports from this package or filterpy, and the module of each."""
    lines = (node for node in ast.parse(page.read_text(encoding="utf-8")).body if isinstance(node, ast.ImportFrom))
    return {
        name.asname or name.name: str(node.module)
        for node in lines
        if "filterpy" in str(node.module)
        for name in node.names
    }


def _rooms(folder: Path, name: str) -> list[str]:
    """Return the packages in a folder whose first page has a name: its stub, where it has one."""
    pages = {page.parent.name: page for suffix in ("py", "pyi") for page in folder.glob(f"[a-z]*/__init__.{suffix}")}
    return sorted(room for room, page in pages.items() if name in _names(page))
