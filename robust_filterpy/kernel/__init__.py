"""The kernel: the package's recursions in C, one concept a header, and the extension module around them.

What is written in numpy (`robust_filterpy.correction` above all) is the definition; the kernel does the same work
faster and is held to it by tests. Where it declines, the definition serves; where it could not be built, that serves
everywhere. ``ROBUST_FILTERPY_KERNEL=off`` in the environment makes that so, for tests.

The headers (``real.h`` says how they are written) know nothing of Python and are what `robust_filterpy.edge.export_c`
writes for microcontrollers: C99, sizes as arguments, workspaces from the caller, no allocation, no state of their own.

* `series`: series and recordings, from Python, by psi and under a mixture (``learnt.h``), half a step of it.
* ``steps.c``: a step of one filter as one call; ``online.h``: what such a step reads and sets.
* `moments`: a correction of arrays, also by an innovation of which only moments are known; what one correction left.
* ``real.h``: the number type. ``psi.h``: psi, psi', rho.
* ``prediction.h``, ``correction.h`` (``joint.h`` where all sensors fail together): one step. ``series.h``: many of
  many. ``smoother.h``: a smoother's pass.
* ``hypotheses.c``: what may be the matter with a sensor of a fusion, side by side.

The extension is written by hand against Python's stable interface and numpy's. ``glue.h`` has what all its functions
need: arrays that are checked when taken, attributes read and set, references held during a call. The functions are in
one ``.c`` file for each group, with a table ``<group>_functions``; a new group is named in ``glue.h`` and in
``module.c``. A function that does a step returns True where it has done it, and False, with nothing changed, where that
is for the definition: another dtype, shape or order than usual, a subclass of ndarray, numbers that are not finite, a
matrix that is no covariance, an overflow, a variance that cancels. What Python code raises on the way is passed on.

``python setup.py build_ext --inplace`` builds it in a checkout.

Imports from below: `robust_filterpy.influence`, `robust_filterpy.correction`.
"""

from __future__ import annotations

import logging
import os
import zlib
from functools import lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

__all__ = ["available"]


@lru_cache(maxsize=1)
def extension() -> Any:
    """Return the extension module, None (after one line in the log that says so) if the definition is to serve."""
    loaded = _loaded()
    if not isinstance(loaded, str):
        return loaded
    if not _switched_off():
        words = "robust_filterpy: the definition in numpy serves, several times slower; %s"
        logging.getLogger("robust_filterpy").info(words, loaded)
    return None


def missing() -> str | None:
    """Return why the kernel does not serve, None if it does."""
    loaded = _loaded()
    return loaded if isinstance(loaded, str) else None


def _switched_off() -> bool:
    """Return whether the environment leaves the kernel aside."""
    return os.environ.get("ROBUST_FILTERPY_KERNEL") == "off"


def _loaded() -> Any:
    """Return the extension module, or why there is none."""
    if _switched_off():
        return "ROBUST_FILTERPY_KERNEL=off in the environment leaves the kernel in C aside"
    try:
        from robust_filterpy.kernel import _extension  # type: ignore[attr-defined]
    except ImportError as error:
        built = find_spec("robust_filterpy.kernel._extension") is not None
        why = f"cannot be loaded ({error})" if built else "is not built"
        return f"the kernel in C {why}; install again where there is a C compiler"
    if not _is_current(_extension):
        return "the kernel in C is of other sources than these; python setup.py build_ext --inplace builds it again"
    return _extension


def _is_current(built: Any) -> bool:
    """Return whether it was built from the sources of a checkout; elsewhere there are none."""
    room = Path(__file__).parent
    if not (room / "module.c").exists():
        return True
    sources = b"".join(path.read_bytes() for path in sorted(room.glob("*.[ch]")))
    return getattr(built, "built_from", None) == zlib.crc32(sources) >> 1


def available() -> bool:
    """Return whether the kernel serves.

    Returns
    -------
    bool
    """
    return extension() is not None
