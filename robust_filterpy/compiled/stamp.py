"""Which kernels are compiled and cached on this machine: a list in a file, so that asking takes no import of numba."""

from __future__ import annotations

import os
import platform
import sys
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from zlib import crc32

_PACKAGE = Path(__file__).parents[1]


def sources() -> int:
    """Return a number that changes with the source of what is compiled: numba itself looks at one file a function."""
    rooms = (_PACKAGE / name for name in ("compiled", "smoothing"))
    return crc32(b"".join(path.read_bytes() for room in rooms for path in sorted(room.glob("*.py"))))


def numba_version() -> str | None:
    """Return the version of numba, None if it is not installed or switched off by ROBUST_FILTERPY_KERNEL=off."""
    if os.environ.get("ROBUST_FILTERPY_KERNEL") == "off":
        return None
    return _installed()


@lru_cache(maxsize=1)
def _installed() -> str | None:
    """Return the version of numba; reading it takes a millisecond, which a recursion asks for at every batch."""
    try:
        return version("numba")
    except PackageNotFoundError:
        return None


def cache_folder() -> Path | None:
    """Return where the list of cached kernels is kept, None if no folder can be written to.

    The choice is numba's own: NUMBA_CACHE_DIR, else beside the sources, else the user's cache. Where numba could not
    write it would not look for what somebody else compiled, either.
    """
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen)
    beside = Path(__file__).parent / "__pycache__"
    if os.access(beside if beside.is_dir() else beside.parent, os.W_OK):
        return beside
    try:
        user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "robust_filterpy"
    except RuntimeError:
        return None
    nearest = next((folder for folder in (user, *user.parents) if folder.is_dir()), None)
    return user if nearest is not None and os.access(nearest, os.W_OK) else None


def _list_name() -> str:
    """Return the name of the list, which belongs to one processor, Python, numba and version of the sources."""
    try:
        processor = next(line for line in Path("/proc/cpuinfo").read_text().split("\n") if line.startswith("flags"))
    except (OSError, StopIteration):
        processor = platform.processor()
    machine = f"{platform.machine()} {processor} {sys.version} {numba_version()}"
    return f"robust_filterpy-kernels-{sources():08x}-{crc32(machine.encode()):08x}.txt"


def cached() -> frozenset[str]:
    """Return the names of the kernels that are in numba's cache."""
    folder = cache_folder()
    if numba_version() is None or folder is None:
        return frozenset()
    try:
        return frozenset((folder / _list_name()).read_text().split("\n")) - {""}
    except OSError:
        return frozenset()


def remember(*kernels: str) -> None:
    """Add kernels to the list."""
    folder = cache_folder()
    if folder is None:
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with open(folder / _list_name(), "a") as file:
            # One write, so that processes that compile at the same time do not tear each other's lines.
            file.write("".join(f"{name}\n" for name in kernels))
    except OSError:
        return
