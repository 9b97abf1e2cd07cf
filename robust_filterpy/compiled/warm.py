"""Small calls that make numba compile each kernel of this room, for ``python -m robust_filterpy compile``."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robust_filterpy.compiled import dispatch
from robust_filterpy.compiled.kernel import workspace_size
from robust_filterpy.compiled.records import ADAPTIVE_SIZES, SIZES, Copies, Model, Noise, Output
from robust_filterpy.correction import adaptive_noise
from robust_filterpy.correction.options import Choices


def kernels() -> dict[str, Callable[[], object]]:
    """Return what compiles each kernel, by its name."""
    calls: dict[str, Callable[[], object]] = {
        dispatch.ONLINE: _online,
        dispatch.BANK: _bank,
        dispatch.ADAPTIVE: _adaptive,
    }
    for size in SIZES:
        calls[dispatch.series_name(size)] = lambda size=size: _series(size)  # type: ignore[misc]
    for size in ADAPTIVE_SIZES:
        calls[dispatch.adaptive_name(size)] = lambda size=size: _adaptive_series(size)  # type: ignore[misc]
    return calls


def _series(size: tuple[int, int]) -> None:
    """Filter one series of one step."""
    n, m = size[0] or 2, size[1] or 2
    four = (1, 1)
    model = Model(
        np.eye(n).reshape(*four, n, n), np.eye(n).reshape(*four, n, n), np.ones((*four, m, n)),
        np.eye(m).reshape(*four, m, m), np.zeros((*four, n)),
    )  # fmt: skip
    output = Output(
        np.empty((*four, n)), np.empty((*four, n, n)), np.empty((1, 0, n)), np.empty((1, 0, n, n)),
        np.empty((*four, m)), np.zeros(1),
    )  # fmt: skip
    dispatch.filter_series(size, Choices(), np.zeros((*four, m)), model, np.zeros((1, n)), np.eye(n)[None], output)


def _adaptive() -> None:
    """Take one step of one filter with one sensor, whose noise has one class."""
    from robust_filterpy.compiled import adaptive

    one = np.ones((1, 1))
    begin = adaptive_noise.start(1)
    copies = Copies(one.copy(), one[None].copy(), one[0].copy(), begin[None].copy(), one[0].copy(), one.copy())
    adaptive.advance(*copies[:3], *copies[4:], one, one, one[0], one[0], 1.0, 1.0)
    adaptive.merge(*copies[:3], *copies[4:])
    adaptive.correct(*copies, one[0], one, one, one[0], begin, 2.0, 2.0, one[0].copy(), one[0].copy())


def _adaptive_series(size: tuple[int, int]) -> None:
    """Filter one series of one step by one filter, whose noise has one class."""
    n, m = size[0] or 1, size[1] or 1
    four, begin, one = (1, 1), adaptive_noise.start(1), np.ones(1)
    model = Model(
        np.eye(n).reshape(*four, n, n), np.eye(n).reshape(*four, n, n), np.ones((*four, m, n)),
        np.eye(m).reshape(*four, m, m), np.zeros((*four, n)),
    )  # fmt: skip
    series = Copies(
        np.zeros((*four, n)), np.eye(n).reshape(*four, n, n), np.ones(four), np.tile(begin, (1, m, 1)),
        np.zeros((1, n)), np.eye(n)[None],
    )  # fmt: skip
    output = Output(
        np.empty((*four, n)), np.empty((*four, n, n)), np.empty((1, 0, n)), np.empty((1, 0, n, n)),
        np.empty((*four, m)), np.zeros(1),
    )  # fmt: skip
    noise = Noise(one, 1.0, one, begin, 2.0, 2.0)
    dispatch.adaptive_series(size, np.zeros((*four, m)), model, series, noise, output, np.empty(four), np.empty(four))


def _online() -> None:
    """Take one step of one filter."""
    x, P, m = np.zeros(2), np.eye(2), 1
    module = dispatch.loops()
    options = dispatch.encoded(Choices(), m)
    module.predict_step(x, P, P, P, x, 1.0, x.copy(), P.copy())
    module.correct_step(x, P, np.ones((1, 2)), np.eye(1), options, x.copy(), P.copy(), np.zeros(workspace_size(2, m)))


def _bank() -> None:
    """Take one step of a bank of one."""
    x, P, one = np.zeros((1, 2)), np.eye(2)[None], np.ones((1, 1))
    module, options = dispatch.loops(), dispatch.encoded(Choices(), 1)
    module.predict_bank(x, P, P, P, x, x.copy(), P.copy())
    module.correct_bank(
        x, P, one, np.ones((1, 1, 2)), one[None], options, one.copy(), one.copy(), one[None].copy(), one.copy(),
        np.zeros(1, dtype=np.bool_),
    )  # fmt: skip
