"""``python -m robust_filterpy``: say what is installed, what serves, and where the documentation is."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from robust_filterpy import __version__, kernel

_NEEDED = ("numpy", "scipy", "filterpy", "control")
_EXTRAS = ("matplotlib", "pandas", "narwhals", "pyarrow")


def status() -> str:
    """Return what is installed, what serves and where the documentation is."""
    here = Path(__file__).parent
    why = kernel.missing()
    serves = "the kernel in C" if why is None else f"the definition in numpy, several times slower: {why}"
    extras = ", ".join(_versions(_EXTRAS)) or "none of " + ", ".join(_EXTRAS)
    pages = here.parent / "docs"
    source = f"{pages}" if (pages / "index.md").exists() else "README.md and docs/ of the source"
    return (
        f"robust_filterpy {__version__} in {here}\n"
        f"with {', '.join(_versions(_NEEDED))}, Python {platform.python_version()}; besides: {extras}\n"
        f"what serves: {serves}\n"
        f"documentation: {source}, and help(robust_filterpy)"
    )


def _versions(names: tuple[str, ...]) -> list[str]:
    """Return the packages that are there, with their versions."""
    versions = []
    for name in names:
        try:
            versions.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return versions


if __name__ == "__main__":
    print(status())
