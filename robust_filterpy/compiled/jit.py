"""How the kernel is compiled."""

from __future__ import annotations

from typing import Any

import numba

# numba annotates fewer options than it takes.
_njit: Any = numba.njit

# Sums may be reordered into vectors, and products fused with sums; NaN and infinity keep their meaning.
_FLAGS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}
#: For functions that become part of their caller, where sizes and arrays that do not overlap are known.
inlined = _njit(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False, **_FLAGS)
#: For what is rare, or the same for every size: compiled once and called.
called = _njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, _nrt=False, **_FLAGS)
#: For inner functions that return arrays: these must count references to them.
allocating = _njit(forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True, **_FLAGS)
#: For what Python calls.
entry = _njit(cache=True, **_FLAGS)
