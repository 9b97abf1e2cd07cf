"""``python -m robust_filterpy``: say what is installed, what serves, and where the documentation is."""

from __future__ import annotations

import argparse
import logging
import platform
import sys
import time
from collections.abc import Callable
from functools import partial
from importlib.metadata import version
from pathlib import Path

from robust_filterpy import __version__, kernel
from robust_filterpy.compiled import dispatch, stamp


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m robust_filterpy", description=(__doc__ or "").split(": ", 1)[1])
    parser.add_argument("command", nargs="?", choices=["compile"], help="compile what numba still does beforehand")
    if parser.parse_args(arguments).command is None:
        print(status())
        return 0
    if stamp.numba_version() is None:
        print('numba is not installed: pip install "robust_filterpy[fast]"; without it numpy does everything')
        return 1
    if not dispatch.usable_numba():
        return 1
    folder = stamp.cache_folder()
    if folder is None:
        print("no folder that can be written to: set NUMBA_CACHE_DIR to one")
        return 1
    start = time.perf_counter()
    _compile()
    print(f"done in {time.perf_counter() - start:.0f} s; cached in {folder}")
    return 0


def status() -> str:
    """Return what is installed, what serves and where the documentation is."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "scipy", "filterpy", "control"))
    without = "the definition in numpy (the kernel is switched off or not built)"
    serves = "the kernel in C" if kernel.available() else without
    return (
        f"robust_filterpy {__version__} in {Path(__file__).parent}\n"
        f"with {packages}, Python {platform.python_version()}\n"
        f"what serves: {serves}\ndocumentation: the docstrings, README.md and docs/ of the source"
    )


def _kernels() -> dict[str, Callable[[], object]]:
    """Return what compiles each kernel, by its name."""
    from robust_filterpy.smoothing import linear_pass

    return {linear_pass.kernel_name(size): partial(linear_pass.compile_kernel, size) for size in linear_pass.SIZES}


def _compile() -> None:
    """Compile every kernel, with a line for each."""
    # The warnings are for those who did not ask for a compilation.
    logging.getLogger("robust_filterpy").setLevel(logging.ERROR)
    for name, call in _kernels().items():
        if name in stamp.cached():
            print(f"{name}: in the cache", flush=True)
            continue
        start = time.perf_counter()
        call()
        stamp.remember(name)
        print(f"{name}: {time.perf_counter() - start:.1f} s", flush=True)


if __name__ == "__main__":
    sys.exit(main())
