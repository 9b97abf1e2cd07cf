"""Numbers, tables and comments as C writes them, and the texts around a kernel, with $names to fill in."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from string import Template
from typing import Any, Final

import numpy as np

from robust_filterpy._checks import Array

_TEXTS: Final = Path(__file__).parent / "texts"
_WIDTH: Final = 110
_INDENT: Final = " " * 4

#: The name of C's type, by precision.
REALS: Final = {"double": "double", "single": "float"}


@dataclass(frozen=True)
class Described:
    """What the C of a filter or tracker is made of."""

    title: str
    #: Headers of the kernel in their order, and the text that steps by them.
    headers: tuple[str, ...]
    text: str
    #: What $names stand for.
    values: Mapping[str, str]
    #: Entries of the two tables, in the order of their fields.
    model: Mapping[str, Any] = field(default_factory=dict)
    start: Mapping[str, Any] = field(default_factory=dict)
    #: The text of its header, if that is another one's.
    header: str = ""
    #: Names that stand for texts of their own.
    parts: Mapping[str, str] = field(default_factory=dict)


def rendered(name: str, values: Mapping[str, str]) -> str:
    """Return a text with its names filled in."""
    return Template((_TEXTS / name).read_text(encoding="ascii")).substitute(values)


def table(declaration: str, entries: Mapping[str, Any], precision: str) -> str:
    """Return the definition of a constant structure."""
    lines = [f"{declaration} = {{"]
    for name, value in entries.items():
        if isinstance(value, int):
            lines.append(f"{_INDENT}.{name} = {value},")
        elif np.ndim(value) == 0:
            lines.append(f"{_INDENT}.{name} = {number(name, value, precision)},")
        else:
            lines += [f"{_INDENT}.{name} = {{", *_rows(name, np.atleast_2d(value), precision), f"{_INDENT}}},"]
    return "\n".join([*lines, "};\n"])


def _rows(name: str, matrix: Array, precision: str) -> list[str]:
    """Return the numbers of a matrix, each row on lines of its own."""
    return [
        textwrap.fill(
            " ".join(f"{number(name, value, precision)}," for value in row), _WIDTH - 1,
            initial_indent=_INDENT * 2, subsequent_indent=_INDENT * 2, break_on_hyphens=False,
        )
        for row in matrix
    ]  # fmt: skip


def number(name: str, value: float, precision: str) -> str:
    """Return a number as C writes it, so that it is read back exactly; or raise, where its type cannot hold it."""
    if name == "threshold" and math.isinf(value):
        return "INFINITY"
    if not math.isfinite(value):
        raise ValueError(f"{name}: expected finite numbers, got {value!r} among them")
    if precision == "double":
        return repr(float(value))
    with np.errstate(over="ignore", under="ignore"):
        single = np.float32(value)
    if not np.isfinite(single) or (single == 0.0 and value != 0.0):
        raise ValueError(
            f'{name}: expected numbers that "single" precision can hold, got {value!r}; choose other units, '
            f'or precision="double"'
        )
    text = str(single)
    return f"{text}F" if "." in text or "e" in text else f"{text}.0F"


def comment(text: str) -> str:
    """Return a text that stands in a comment, wrapped with its stars."""
    return "\n * ".join(textwrap.wrap(text, _WIDTH + 1, break_long_words=False, break_on_hyphens=False))
