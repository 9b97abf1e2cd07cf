"""Plants to test estimators on: linear ones whose parameters may drift, and a pneumatic servo.

The only part of the package that uses python-control, and it imports it when a plant asks for it.
"""

from __future__ import annotations

import importlib
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


def _owner(name: str) -> Any:
    """Find the module that has a public name, or None."""
    for module in _MODULES:
        found = importlib.import_module(f"{__name__}.{module}")
        if name in found.__all__:
            return found
    return None


def __getattr__(name: str) -> Any:
    """Import a name of one of the modules when it is first asked for (PEP 562)."""
    if name in _MODULES:
        return importlib.import_module(f"{__name__}.{name}")
    owner = None if name.startswith("_") else _owner(name)
    if owner is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(owner, name)


def __dir__() -> list[str]:
    """List the lazily imported names too."""
    public = [name for module in _MODULES for name in importlib.import_module(f"{__name__}.{module}").__all__]
    return sorted({*globals(), *public})
