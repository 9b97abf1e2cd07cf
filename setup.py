"""Build the kernel, where there is a C compiler; everything else is in setup.cfg."""

import os
import subprocess
import sys
import sysconfig
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

ROOM = Path("robust_filterpy/kernel")
# Never -ffast-math: loading a library built with it makes the whole process flush subnormal numbers.
# Python itself is compiled with -fwrapv, under which loops over the sizes of small matrices are a third as fast.
# Of what -O3 adds, only vectorised loops make the kernel faster; the rest makes compiling longer.
FLAGS = ["-std=c99", "-g0", "-O2", "-fno-wrapv", "-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math"]
# clang, which gcc is on macOS, does so by itself and refuses to be asked.
GCC_ONLY = ["-ftree-loop-vectorize", "-ftree-slp-vectorize", "-fvect-cost-model=dynamic"]
# One binary for all versions of Python, except those without the interpreter's lock.
STABLE = not sysconfig.get_config_var("Py_GIL_DISABLED") and sys.implementation.name == "cpython"


def is_clang(compiler):
    """Tell whether it says so."""
    try:
        said = subprocess.run([compiler.compiler_so[0], "--version"], capture_output=True, text=True, check=False)
    except OSError:
        return False
    return "clang" in said.stdout


class BuildExtension(build_ext):
    """Add what depends on the compiler and on numpy, which may be absent."""

    def build_extensions(self):
        """Set flags and directories, then build."""
        import numpy

        for extension in self.extensions:
            extension.include_dirs.append(numpy.get_include())
            if self.compiler.compiler_type == "msvc":
                extension.extra_compile_args = ["/O2", "/std:c11", "/fp:precise"]
            else:
                # For a build with sanitizers, say.
                flags = FLAGS if is_clang(self.compiler) else FLAGS + GCC_ONLY
                extension.extra_compile_args = flags + os.environ.get("ROBUST_FILTERPY_CFLAGS", "").split()
        compile_in_turn = self.compiler.compile

        def compile_side_by_side(sources, **options):
            with ThreadPoolExecutor() as pool:
                found = pool.map(lambda source: compile_in_turn([source], **options), sources)
                return [compiled for objects in found for compiled in objects]

        if self.compiler.compiler_type == "unix":
            self.compiler.compile = compile_side_by_side
        super().build_extensions()


# A checkout whose sources have moved on is not to call functions that take other arguments: `kernel` compares.
built_from = zlib.crc32(b"".join(path.read_bytes() for path in sorted(ROOM.glob("*.[ch]")))) >> 1
macros = [("NPY_TARGET_VERSION", "NPY_1_23_API_VERSION"), ("ROBUST_FILTERPY_BUILT_FROM", str(built_from))]
setup(
    ext_modules=[
        Extension(
            "robust_filterpy.kernel._extension",
            sources=sorted(path.as_posix() for path in ROOM.glob("*.c")),
            depends=sorted(path.as_posix() for path in ROOM.glob("*.h")),
            define_macros=[*macros, ("Py_LIMITED_API", "0x030A0000")] if STABLE else macros,
            py_limited_api=STABLE,
            # Without it numpy serves everywhere; releases check that it is there.
            optional=True,
        )
    ],
    cmdclass={"build_ext": BuildExtension},
    options={"bdist_wheel": {"py_limited_api": "cp310"}} if STABLE else {},
)
