"""``python -m robust_filterpy``: say what is installed, what serves, and where the documentation is."""

from __future__ import annotations

import argparse
import platform
import sys
from importlib.metadata import version
from pathlib import Path

from robust_filterpy import __version__, kernel


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m robust_filterpy", description=(__doc__ or "").split(": ", 1)[1])
    parser.parse_args(arguments)
    print(status())
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


if __name__ == "__main__":
    sys.exit(main())
