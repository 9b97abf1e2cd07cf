"""`export_c`: a filter or a tracker as one C99 file and its header."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

from robust_filterpy import _checks, kernel
from robust_filterpy._filterpy import ExtendedKalmanFilter
from robust_filterpy._version import __version__
from robust_filterpy.edge.filter_model import described_filter
from robust_filterpy.edge.mixture_model import described_extended, described_mixture, is_extended, mixes
from robust_filterpy.edge.text import REALS, Described, comment, rendered, table
from robust_filterpy.edge.tracker_model import described_tracker
from robust_filterpy.filters.adaptive import AdaptiveKalmanFilter
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.identification import Model, ParameterTracker

__all__ = ["Exported", "Precision", "export_c"]

Precision: TypeAlias = Literal["double", "single"]

# Headers of C, before which one of the same name beside the source would be found.
_STANDARD = frozenset(
    "assert complex ctype errno fenv float inttypes iso646 limits locale math setjmp signal stdalign stdarg stdatomic "
    "stdbool stddef stdint stdio stdlib stdnoreturn string tgmath threads time uchar wchar wctype".split()
)


class Exported(NamedTuple):
    """The two files that were written."""

    source: Path
    """The C99 source."""
    header: Path
    """Its header, which explains how to use it."""


def export_c(
    model: RobustKalmanFilter | AdaptiveKalmanFilter | RobustExtendedKalmanFilter | ParameterTracker,
    path: str | os.PathLike[str],
    *,
    precision: Precision = "double",
) -> Exported:
    """Write one C99 file and its header that step exactly this filter or tracker, from its present state.

    The C predicts and corrects as `RobustKalmanFilter` does, with its psi, scaling and information, or with noise that
    is told or learned (``noise=Contaminated()``, ``Learnt()``, ``process=Scales()``), or takes a sample as
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
        The C file, such as "cart.c", in a folder that exists; the header stands beside it. Its stem is the prefix of
        all names in C.
    precision : {"double", "single"}
        Type of every number in C: double or float. Noise that is told or learned needs double.

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
    that is told or learned a step that the package's kernel leaves to the definition (a state 1e6 times less certain
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
    plain, extended = type(model) in (RobustKalmanFilter, AdaptiveKalmanFilter), is_extended(model)
    if (plain or extended) and precision == "single" and mixes(model):  # type: ignore[arg-type]
        raise ValueError(
            'precision: expected "double" for noise that is given or learned, whose probabilities are smaller than a '
            'float can be, got "single"'
        )
    if plain:
        form = (described_mixture if mixes(model) else described_filter)(model, name)  # type: ignore[arg-type]
    elif extended:
        form = described_extended(model, name)  # type: ignore[arg-type]
    elif type(model) is ParameterTracker:
        form = described_tracker(model, name)
    else:
        raise TypeError(
            f"model: expected a RobustKalmanFilter or a ParameterTracker, got {_checks.shown(type(model).__name__)}; "
            f"{_remedy(model)}"
        )
    values = {
        **form.values, "title": comment(form.title), "name": name, "NAME": name.upper(), "real": REALS[precision],
        "largest": "1e150" if precision == "double" else "1e15", "version": __version__,
    }  # fmt: skip
    if "remark" in values:
        values["remark"] = comment(f"A component of z that is NaN is missing. {values['remark']}")
    exported = Exported(source, source.with_suffix(".h"))
    values |= {part: rendered(text, values) for part, text in form.parts.items()}
    texts = (_code(form, values, name, precision), _tidy(rendered(f"{form.header or form.text}.h", values)))
    own = set(re.findall(rf"\b(?:{name}|{name.upper()})_\w+", re.sub(r"/\*.*?\*/", "", texts[1], flags=re.DOTALL)))
    if taken := own.intersection(re.findall(r"\w+", _kernel(form.headers))):
        raise ValueError(
            f"path: expected a name that the kernel does not use, got {source.name!r}, which makes {min(taken)}; "
            f"use my_{source.name}"
        )
    for file, text in zip(exported, texts, strict=True):
        file.write_text(text, encoding="ascii")
    return exported


def _code(form: Described, values: dict[str, str], name: str, precision: str) -> str:
    """Return the C file."""
    tables = (
        table(f"const {name}_model {name}_default", form.model, precision),
        table(f"const {name}_state {name}_start", form.start, precision),
    )
    define = "#define ROBUST_FILTERPY_FLOAT\n" if precision == "single" else ""
    start = f'/*\n * {values["title"]}\n *\n * See {name}.h.\n */\n#include "{name}.h"\n\n{define}'
    return _tidy("\n".join([start, _kernel(form.headers), *tables, rendered(f"{form.text}.c", values)]))


def _kernel(headers: tuple[str, ...]) -> str:
    """Return headers of the kernel, each as it is but for its includes of the others."""
    room = Path(kernel.__file__).parent
    texts = ((room / f"{header}.h").read_text(encoding="ascii") for header in headers)
    return "\n".join(re.sub(r'^#include "\w+\.h"\n', "", text, flags=re.M) for text in texts)


def _tidy(text: str) -> str:
    """Return C without the empty lines that empty names left behind."""
    return re.sub(r"\n{3,}", "\n\n", text)


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
    if isinstance(model, type):
        return "pass an instance of it"
    if hasattr(model, "filters"):
        return "export each of its filters"
    if isinstance(model, ParameterTracker):
        return "a subclass may do anything: pass the tracker that it is made of"
    if isinstance(model, RobustExtendedKalmanFilter):
        return "a subclass may override predict_x alone: its update or predict is not the C's"
    if isinstance(model, ExtendedKalmanFilter):
        return "export a RobustExtendedKalmanFilter with the same x, P, F, Q and R"
    if hasattr(model, "points_fn") or hasattr(model, "sigmas_f"):
        return "export a RobustExtendedKalmanFilter, or a RobustKalmanFilter with the F and H of a working point"
    if all(hasattr(model, matrix) for matrix in "FHQR"):
        return (
            "export a RobustKalmanFilter with the same x, P, F, H, Q, R and B; with influence=Linear() it is the plain "
            "Kalman filter"
        )
    if isinstance(model, Model):
        return "export a tracker that goes on from it, ParameterTracker(model)"
    if hasattr(model, "tracker"):
        return "export a tracker of it, model.tracker(..)"
    return "export a RobustKalmanFilter with constant matrices in its place"
