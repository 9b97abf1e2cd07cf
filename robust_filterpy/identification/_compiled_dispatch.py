"""A recording through the compiled loop, which hands what is out of the ordinary back to the definition."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.compiled import dispatch
from robust_filterpy.identification._lean import Columns, Rules
from robust_filterpy.identification._regressor import Layout, Memory
from robust_filterpy.identification.guard import GUARDS

# phi of so many samples stays in a processor's cache.
_CHUNK = 4096

# So many samples at most go to the definition before the loop has another try.
_MOST_ODD = 1024


@lru_cache(maxsize=1)
def _track() -> Any:
    """Return the compiled loop."""
    dispatch.announce_compilation()
    from robust_filterpy.identification._compiled_loop import track

    return track


def can_run(kf: Any, length: int) -> bool:
    """Return whether the loop can take a recording of this length through a `RobustKalmanFilter`."""
    return (
        length >= dispatch.LONG
        and dispatch.can_compile(kf._choices)
        and all(np.isfinite(a).all() for a in (kf.Q, kf.F))
        and all(np.abs(a - a.T).max() <= 1e-13 * np.abs(a).max() for a in (kf.P, kf.Q))
    )


def run_compiled(
    layout: Layout,
    rules: Rules,
    memory: Memory,
    kf: Any,
    y: Array,
    u: Array,
    r: Array,
    out: Columns,
    by_definition: Callable[[int, int], None],
) -> None:
    """Advance a filter and the memory through a recording and fill the columns.

    r: variance of the noise, shape (1,) or (N,). by_definition(start, stop): takes these samples one by one.
    """
    psi = dispatch.encoded(kf._choices, 1)
    part = slice(0, 0) if layout.part is None else layout.part
    # Copies, since numba would compile anew for arrays that are read only.
    F, Q = np.array(kf.F, order="C"), np.array(kf.Q, order="C")
    filtered = rules.filtered and layout.part is not None
    rule = np.array(
        [*psi.codes[:3], rules.uses_model_output, filtered, GUARDS.index(rules.guard),
         not np.array_equal(F, np.eye(layout.n)), Q.any()], dtype=np.int64,
    )  # fmt: skip
    places = np.array([layout.na, layout.nc, part.start, part.stop], dtype=np.int64)
    track, length, k, odd = _track(), len(y), 0, 1
    while k < length:
        chunk = slice(k, min(k + _CHUNK, length))
        phi, inputs = memory.regressors(layout, u[chunk])
        x, P = np.array(kf.x).ravel(), np.array(kf.P, order="C")
        done = track(
            y[chunk], phi, r[chunk] if len(r) > 1 else r, F, Q, kf._alpha_sq, rules.windup, rule, psi.parameters,
            psi.expected[1], places, x, P, memory.outputs, memory.residuals, memory.gradients,
            *(column[chunk] for column in out),
        )  # fmt: skip
        kf.x, kf.P = x.reshape(np.shape(kf.x)), P
        k += done
        if k == chunk.stop:
            memory.inputs = inputs
            continue
        # Older inputs than the memory holds need not go through it.
        for values in u[max(k - layout.length, chunk.start) : k]:
            memory.inputs = memory.with_input(layout, values)
        odd = 1 if done >= odd else min(2 * odd, _MOST_ODD)
        stop = min(k + odd, length)
        by_definition(k, stop)
        k = stop
