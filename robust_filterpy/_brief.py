"""What `print` shows of a result, a line for each part, of large arrays shape, range and median; and its `plot`."""

from __future__ import annotations

import importlib
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

import numpy as np

_SMALL, _WIDE = 9, 100


def brief(record: Any) -> str:
    """Return a named tuple or dataclass as text that fits a screen."""
    names = getattr(record, "_fields", None) or [n for n in record.__dataclass_fields__ if not n.startswith("_")]
    return "\n".join([type(record).__name__, *lines_of({name: getattr(record, name) for name in names})])


def wrapped(text: str, indent: str = "    ") -> str:
    """Return a sentence on lines that a screen holds."""
    return textwrap.fill(text, _WIDE, subsequent_indent=indent, break_on_hyphens=False, break_long_words=False)


def lines_of(parts: dict[str, Any]) -> list[str]:
    """Return a line for each part, names and values in columns."""
    width = max(map(len, parts))
    indent = " " * (width + 4)
    return [
        textwrap.fill(f"  {name:{width}}  {_part(value)}", _WIDE, subsequent_indent=indent, break_on_hyphens=False)
        for name, value in parts.items()
    ]


def tabulated(heads: dict[str, int], rows: Iterable[Sequence[str]], *after: str) -> str:
    """Return rows of cells below their heads, of these widths, left of 0 from the left; a last cell may stand out."""
    widths = [f"<{-width}" if width < 0 else f">{width}" for width in heads.values()]
    lines = [
        "".join([*(f"{cell:{width}}" for cell, width in zip(cells, widths, strict=False)), *cells[len(widths) :]])
        for cells in (tuple(heads), *rows)
    ]
    return "\n".join([*lines, *after])


def _part(value: Any) -> str:
    """Return one part as a line."""
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, dict) and all(isinstance(one, float) for one in value.values()):
        return ", ".join(f"{name} {one:.4g}" for name, one in value.items())
    if isinstance(value, dict):
        return ", ".join(map(str, value))
    if isinstance(value, tuple) and value and all(isinstance(one, np.ndarray) for one in value):
        return ", ".join(map(_array, value))
    text = f"{value:.6g}" if isinstance(value, float) else " ".join(str(value).split())
    return text if len(text) <= 2 * _WIDE else f"{text[: 2 * _WIDE - 3]}..."


def _array(value: np.ndarray) -> str:
    """Return numbers, or what they are like where there are many."""
    if value.dtype == bool and value.size > _SMALL:
        return f"shape {value.shape}, {np.count_nonzero(value)} of {value.size} true"
    if value.size <= _SMALL or value.dtype.kind not in "fiu":
        text = " ".join(np.array2string(value, precision=5, suppress_small=True, threshold=_SMALL).split())
        return text if len(text) <= _WIDE else f"shape {value.shape}"
    finite = value[np.isfinite(value)]
    if not finite.size:
        return f"shape {value.shape}, all missing"
    missing = f", {value.size - finite.size} missing" if finite.size < value.size else ""
    low, middle, high = (f"{number:.4g}" for number in (finite.min(), np.median(finite), finite.max()))
    return f"shape {value.shape}, {low} .. {high}, median {middle}{missing}"


class Pictured:
    """A result that can be drawn."""

    __slots__ = ()

    #: Module and name of the function of `robust_filterpy.plotting` that draws it.
    picture: ClassVar[str]

    def plot(self, **options: Any) -> Any:
        """Draw it, by that function of `robust_filterpy.plotting` which its ``picture`` names.

        Parameters
        ----------
        **options : dict, optional
            Of that function.

        Returns
        -------
        matplotlib.axes.Axes, or ndarray of them
        """
        module, _, name = self.picture.partition(".")
        return getattr(importlib.import_module(f"robust_filterpy.plotting.{module}"), name)(self, **options)
