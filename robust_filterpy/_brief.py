"""What `print` shows of a result: a line for each part, small arrays in full, of large ones shape, median and range."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["brief"]

_SMALL, _WIDE = 9, 100


def brief(record: Any) -> str:
    """Return a named tuple or dataclass as text that fits a screen."""
    names = getattr(record, "_fields", None) or record.__dataclass_fields__
    width = max(map(len, names))
    lines = [f"  {name:{width}}  {_part(getattr(record, name))}" for name in names]
    return "\n".join([type(record).__name__, *lines])


def _part(value: Any) -> str:
    """Return one part as a line."""
    if isinstance(value, np.ndarray):
        return _array(value)
    text = f"{value:.6g}" if isinstance(value, float) else " ".join(str(value).split())
    return text if len(text) <= _WIDE else f"{text[: _WIDE - 3]}..."


def _array(value: np.ndarray) -> str:
    """Return numbers, or what they are like where there are many."""
    if value.size <= _SMALL or value.dtype.kind not in "fiu":
        text = " ".join(np.array2string(value, precision=5, suppress_small=True, threshold=_SMALL).split())
        return text if len(text) <= _WIDE else f"shape {value.shape}"
    known = value[np.isfinite(value)]
    if not known.size:
        return f"shape {value.shape}, all missing"
    missing = f", {value.size - known.size} missing" if known.size < value.size else ""
    low, middle, high = (f"{number:.4g}" for number in (known.min(), np.median(known), known.max()))
    return f"shape {value.shape}, {low} .. {high}, median {middle}{missing}"
