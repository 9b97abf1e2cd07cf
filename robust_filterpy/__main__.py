"""``python -m robust_filterpy compile``: fill numba's cache, so that nothing waits for a compilation later."""

from __future__ import annotations

import argparse
import logging
import os
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from robust_filterpy.compiled import dispatch, stamp


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return its exit status."""
    parser = argparse.ArgumentParser(prog="python -m robust_filterpy", description=(__doc__ or "").split(": ", 1)[1])
    parser.add_argument("command", choices=["compile"], help="compile every kernel that is not in the cache")
    parser.parse_args(arguments)
    if stamp.numba_version() is None:
        print('numba is not installed: pip install "robust_filterpy[fast]"; without it numpy does everything')
        return 1
    if dispatch.loops() is None:
        return 1
    folder = stamp.cache_folder()
    if folder is None:
        print("no folder that can be written to: set NUMBA_CACHE_DIR to one")
        return 1
    start = time.perf_counter()
    names = list(_kernels())
    # Those for series share most of what numba does before LLVM.
    groups = [name for name in names if name.startswith("series")], [name for name in names if "series" not in name]
    with ProcessPoolExecutor(min(len(groups), os.cpu_count() or 1)) as pool:
        list(pool.map(_compile, groups))
    print(f"done in {time.perf_counter() - start:.0f} s; cached in {folder}")
    return 0


def _kernels() -> dict[str, Callable[[], object]]:
    """Return what compiles each kernel, by its name."""
    from robust_filterpy.compiled import warm
    from robust_filterpy.identification import _compiled_dispatch
    from robust_filterpy.smoothing import linear_pass

    passes = {linear_pass.kernel_name(size): partial(linear_pass.compile_kernel, size) for size in linear_pass.SIZES}
    return {**warm.kernels(), dispatch.TRACKING: _compiled_dispatch.compile_kernel, **passes}


def _compile(names: list[str]) -> None:
    """Compile some kernels, with a line for each."""
    # The warnings are for those who did not ask for a compilation.
    logging.getLogger("robust_filterpy").setLevel(logging.ERROR)
    calls = _kernels()
    for name in names:
        if name in stamp.cached():
            print(f"{name}: in the cache", flush=True)
            continue
        start = time.perf_counter()
        calls[name]()
        stamp.remember(name)
        print(f"{name}: {time.perf_counter() - start:.1f} s", flush=True)


if __name__ == "__main__":
    sys.exit(main())
