"""Plants to test estimators on: linear ones whose parameters may drift, and a pneumatic servo.

* `linear`: ARX and output-error data from a transfer function or from drifting parameters.
* `drift`: parameters on a random walk that stays stable.
* `parameters`: what stands for a linear plant, and its orders.
* `pneumatic`: the servo of the paper's section 2; everything public about it can be imported from there.
* `servo_parameters`, `servo_equations`, `coefficients`: its constants, its equations, its uncertain alpha and beta.
* `steady_motion`, `servo_linearization`: its steady motions, and linear models about them.
* `loop_design`, `position_loop`, `servo_observer`: a position loop, stable by its gains; the loop simulated, and what
  estimates the motion in it from sensors that err.
* `servo_inputs`, `servo_recording`: what drives an experiment, and its recording, with files of it for other tools.

The only room that uses python-control, which is imported when a plant asks for it. Imports from below: `_checks` alone.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .drift import THETA_BAR as THETA_BAR
    from .drift import random_walk as random_walk
    from .drift import stable as stable
    from .linear import Simulation as Simulation
    from .linear import simulate_arx as simulate_arx
    from .linear import simulate_output_error as simulate_output_error
    from .parameters import LinearParameters as LinearParameters
    from .parameters import linear_parameters as linear_parameters
    from .pneumatic import *  # noqa: F403

_MODULES = ("linear", "drift", "parameters", "pneumatic")


def _public() -> Iterator[tuple[str, Any]]:
    """Yield each public name with its module; what comes late in the list is imported late."""
    for module in _MODULES:
        found = importlib.import_module(f"{__name__}.{module}")
        yield from ((name, found) for name in found.__all__)


def __getattr__(name: str) -> Any:
    """Import a name of one of the modules when it is first asked for (PEP 562)."""
    if name in _MODULES:
        return importlib.import_module(f"{__name__}.{name}")
    if name == "__all__":
        return sorted(public for public, _ in _public())
    # Probing for a special name, as inspect and doctest do, should not import every plant.
    if not name.startswith("_"):
        for public, module in _public():
            if public == name:
                return getattr(module, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the lazily imported names too."""
    return sorted({*globals(), *(public for public, _ in _public())})
