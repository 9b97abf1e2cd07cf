"""`export_c`: a filter or a tracker as one C99 file and its header."""

from __future__ import annotations

import math
import os
import re
import textwrap
from collections.abc import Iterator, Mapping
from pathlib import Path
from string import Template
from typing import Any, Final, Literal, NamedTuple, TypeAlias

import numpy as np

from robust_filterpy import _checks, kernel
from robust_filterpy._checks import Array
from robust_filterpy._filterpy import ExtendedKalmanFilter
from robust_filterpy._version import __version__
from robust_filterpy.edge.models import Described, described_filter, described_tracker, is_extended, mixes
from robust_filterpy.filters.conversion import AdaptiveKalmanFilter
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.identification import Model, ParameterTracker

__all__ = ["Exported", "Precision", "export_c"]

Precision: TypeAlias = Literal["double", "single"]

_TEXTS: Final = Path(__file__).parent / "texts"
_WIDTH: Final = 110
_INDENT: Final = " " * 4

# Headers of C, before which one of the same name next to the source would be taken.
_STANDARD = frozenset(
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic "
    "stdbool stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype".split()
)


class Exported(NamedTuple):
    """The two files that were written."""

    #: The C99 source.
    source: Path
    #: Its header, which explains how to use it.
    header: Path


def export_c(
    model: RobustKalmanFilter | AdaptiveKalmanFilter | RobustExtendedKalmanFilter | ParameterTracker,
    path: str | os.PathLike[str], *, precision: Precision = "double",
) -> Exported:  # fmt: skip
    """Write one C99 file and its header that step exactly this filter or tracker, from its present state.

    The C predicts and corrects as `RobustKalmanFilter` does, with its psi, scaling and information, or with noise that
    is given or learned (``noise=Contaminated()``, ``Learnt()``, ``process=Scales()``), or takes a sample as
    `ParameterTracker.update` does. It allocates nothing, needs no library but math.h, and says by a status what Python
    says by an exception; a refused call changes nothing there either. NaN in a measurement is a missing component, an
    infinite one is refused.

    Parameters
    ----------
    model : RobustKalmanFilter, AdaptiveKalmanFilter, RobustExtendedKalmanFilter or ParameterTracker
        What to export, with its present state; a tracker's start must be over. The measurement function of an extended
        filter and its Jacobian are C functions of yours, which its header declares; so is the motion, where
        `predict_x` is overridden.
    path : path-like
        The C file, such as "cart.c", in a folder that exists; the header stands next to it. Its stem is the prefix of
        all names in C.
    precision : {"double", "single"}
        Type of every number in C: double or float. Noise that is given or learned needs double.

    Returns
    -------
    Exported
        source, header.

    Raises
    ------
    TypeError
        If model is another kind of filter, or is made of one.
    ValueError
        If psi is not one of this package's own, the start of a tracker is not over, a matrix does not fit, precision
        cannot hold a number, or path makes no name in C. Nothing has been written then.

    Notes
    -----
    Not exported are the log-likelihood, a tracker's warnings, R of a single sample, and `update_correlated`. The
    threshold (or another parameter of psi) is a field of the model in C, and may be changed at run time. Under noise
    that is given or learned a step that the package's kernel leaves to the definition (a state 1e6 times less certain
    than its sensor) is refused by the C.

    Examples
    --------
    >>> import tempfile
    >>> from robust_filterpy import RobustKalmanFilter
    >>> from robust_filterpy.edge import export_c
    >>> kf = RobustKalmanFilter(dim_x=2, dim_z=1)
    >>> kf.F[0, 1], kf.H[0, 0] = 0.1, 1.0
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     source, header = export_c(kf, f"{folder}/cart.c")
    ...     source.name, header.name, "cart_update" in header.read_text()
    ('cart.c', 'cart.h', True)
    """
    precision = _checks.option("precision", precision, ("double", "single"))
    source = _source(path)
    name = source.stem
    is_filter = type(model) in (RobustKalmanFilter, AdaptiveKalmanFilter) or is_extended(model)
    if is_filter and precision == "single" and mixes(model):  # type: ignore[arg-type]
        raise ValueError(
            'precision: expected "double" for noise that is given or learned, whose probabilities are smaller than a '
            'float can be, got "single"'
        )
    if is_filter:
        form = described_filter(model, name)  # type: ignore[arg-type]
    elif type(model) is ParameterTracker:
        form = described_tracker(model, name)
    else:
        raise TypeError(
            f"model: expected a RobustKalmanFilter or a ParameterTracker, got {_checks.shown(type(model).__name__)}; "
            f"{_remedy(model)}"
        )
    values = {
        **form.values, "text": form.text, "title": _comment(form.title), "name": name, "NAME": name.upper(),
        "remark": _comment(form.values.get("remark", "")), "real": "double" if precision == "double" else "float",
        "largest": "1e150" if precision == "double" else "1e15", "version": __version__,
    }  # fmt: skip
    exported = Exported(source, source.with_suffix(".h"))
    texts = (_code(form, values, name, precision), _rendered("header.h", values))
    own = set(re.findall(rf"\b(?:{name}|{name.upper()})_\w+", re.sub(r"/\*.*?\*/", "", texts[1], flags=re.DOTALL)))
    if taken := own.intersection(re.findall(r"\w+", _kernel(form.headers))):
        raise ValueError(
            f"path: expected a name that the kernel does not use, got {source.name!r}, which makes {min(taken)}; "
            f"use my_{source.name}"
        )
    # Both or none, where a disk is full: a header and a source of two models compile.
    parts = [file.with_name(f"{file.name}.part") for file in exported]
    try:
        for part, text in zip(parts, texts, strict=True):
            part.write_text(text, encoding="ascii")
        for part, file in zip(parts, exported, strict=True):
            part.replace(file)
    finally:
        for part in parts:
            part.unlink(missing_ok=True)
    return exported


def _code(form: Described, values: Mapping[str, Any], name: str, precision: str) -> str:
    """Return the C file."""
    tables = (
        _table(f"const {name}_model {name}_default", form.model, precision),
        _table(f"const {name}_state {name}_start", form.start, precision),
    )
    define = "#define ROBUST_FILTERPY_FLOAT\n" if precision == "single" else ""
    start = f'/*\n * {values["title"]}\n *\n * See {name}.h.\n */\n#include "{name}.h"\n\n{define}'
    return "\n".join([start, _kernel(form.headers), *tables, _rendered(f"{form.text}.c", values)])


def _kernel(headers: tuple[str, ...]) -> str:
    """Return headers of the kernel, each as it is but for its includes of the others."""
    room = Path(kernel.__file__).parent
    texts = ((room / f"{header}.h").read_text(encoding="ascii") for header in headers)
    return "\n".join(re.sub(r'^#include "\w+\.h"\n', "", text, flags=re.M) for text in texts)


def _rendered(name: str, values: Mapping[str, Any]) -> str:
    """Return a text with its $names filled in."""
    return re.sub(r"\n{3,}", "\n\n", "\n".join([*_lines(name, values), ""]))


def _lines(name: str, values: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a text; what begins with $?name is there where that is true, with $!name where it is not."""
    for line in (_TEXTS / name).read_text(encoding="ascii").splitlines():
        *conditions, text = re.split(r"^((?:\$[?!]\w+ )+)", line)[-2:] if line[:2] in ("$?", "$!") else (line,)
        if all(bool(values.get(one[2:])) == (one[1] == "?") for one in "".join(conditions).split()):
            filled = Template(text.removeprefix("$include ")).substitute(values)
            yield from _lines(filled, values) if text.startswith("$include ") else [filled]


def _table(declaration: str, entries: Mapping[str, Any], precision: str) -> str:
    """Return the definition of a constant structure."""
    lines = [f"{declaration} = {{"]
    for name, value in entries.items():
        if isinstance(value, int):
            lines.append(f"{_INDENT}.{name} = {value},")
        elif np.ndim(value) == 0:
            lines.append(f"{_INDENT}.{name} = {_number(name, value, precision)},")
        else:
            lines += [f"{_INDENT}.{name} = {{", *_rows(name, np.atleast_2d(value), precision), f"{_INDENT}}},"]
    return "\n".join([*lines, "};\n"])


def _rows(name: str, matrix: Array, precision: str) -> list[str]:
    """Return the numbers of a matrix, each row on lines of its own."""
    return [
        textwrap.fill(
            " ".join(f"{_number(name, value, precision)}," for value in row), _WIDTH - 1,
            initial_indent=_INDENT * 2, subsequent_indent=_INDENT * 2, break_on_hyphens=False,
        )
        for row in matrix
    ]  # fmt: skip


def _number(name: str, value: float, precision: str) -> str:
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


def _comment(text: str) -> str:
    """Return a text that stands in a comment, wrapped with its stars."""
    return "\n * ".join(textwrap.wrap(text, _WIDTH + 1, break_long_words=False, break_on_hyphens=False))


def _source(path: Any) -> Path:
    """Return the path of the C file, or raise."""
    try:
        source = Path(path)
    except TypeError:
        raise TypeError(f"path: expected a path such as 'filter.c', got {_checks.shown(path)}") from None
    if source.suffix not in ("", ".c"):
        raise ValueError(f"path: expected a file that ends in .c, got {str(source)!r}")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", source.stem):
        raise ValueError(
            f"path: expected a file name that is a name in C, a letter and then letters, digits and _, "
            f"got {source.name!r}"
        )
    if source.stem.lower() in _STANDARD:
        raise ValueError(
            f"path: expected another name than a header of C has, got {source.name!r}; use my_{source.stem}.c"
        )
    if not source.parent.is_dir():
        raise ValueError(f"path: expected a folder that exists, got {str(source.parent)!r}; make it first")
    return source.with_suffix(".c")


def _remedy(model: Any) -> str:
    """Say what to export in the place of something that has no C."""
    linear = "export a RobustKalmanFilter with the same x, P, F, H, Q, R and B; with influence=Linear() it is the "
    curved = "export a RobustExtendedKalmanFilter, or a RobustKalmanFilter with the F and H of a working point"
    remedies = (
        (isinstance(model, type), "pass an instance of it"),
        (hasattr(model, "filters"), "export each of its filters"),
        (isinstance(model, ParameterTracker), "a subclass may do anything: pass the tracker that it is made of"),
        (isinstance(model, RobustExtendedKalmanFilter),
         "a subclass may override predict_x alone: its update or predict is not the C's"),
        (isinstance(model, ExtendedKalmanFilter), "export a RobustExtendedKalmanFilter with the same x, P, F, Q and R"),
        (hasattr(model, "points_fn") or hasattr(model, "sigmas_f"), curved),
        (all(hasattr(model, matrix) for matrix in "FHQR"), f"{linear}plain Kalman filter"),
        (isinstance(model, Model), "export a tracker that goes on from it, ParameterTracker(model)"),
        (hasattr(model, "tracker"), "export a tracker of it, model.tracker(..)"),
        (True, "export a RobustKalmanFilter with constant matrices in its place"),
    )  # fmt: skip
    return next(words for applies, words in remedies if applies)
