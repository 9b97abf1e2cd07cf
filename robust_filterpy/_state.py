"""States as plain arrays: the label that says what one belongs to, the checks before it is taken over, and as bytes.

As bytes a state is one record in numpy's .npy format, without pickle.
"""

from __future__ import annotations

import io
import math
import zlib
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array

#: Version of what `state` returns; a state of an older one is always taken.
FORMAT: Final = 1
#: Name of the label among a state's arrays.
LABEL: Final = "format"

#: Name of the last field of a state's record.
_CHECKSUM: Final = "checksum"
#: Shape of an array: sizes, and None for any.
Shape = tuple[int | None, ...]

# Arrays of a state that are covariances, or stacks of them, and what `_checks.covariance` is given for them.
_MOVING: Final = {"slack": _checks.GATHERED, "gathered": _checks.ROUNDING}
_COVARIANCES: Final[dict[str, dict[str, float]]] = {
    **{name: _MOVING for name in ("P", "R", "covariances")},
    "Q": {"slack": math.inf},
}


# Arrays of as many sensors, steps or numbers as there are.
_ANY_LENGTH: Final = ("learnt", "random", "window", "regressions")


class StateError(ValueError):
    """A state that nothing can go on from: damaged, of something else, or of a newer format."""


def labelled(kind: str, arrays: Mapping[str, Any]) -> dict[str, Array]:
    """Return copies of arrays as a state, the label first."""
    return {
        LABEL: spelt(kind, FORMAT),
        **{name: np.array(value, dtype=float, order="C") for name, value in arrays.items()},
    }


def schema(arrays: Mapping[str, Any]) -> dict[str, Shape]:
    """Return the shapes that another state like this one has."""
    shapes = {name: np.shape(value) for name, value in arrays.items()}
    return {name: (None, *shape[1:]) if name in _ANY_LENGTH else shape for name, shape in shapes.items()}


def spelt(text: str, *before: float) -> Array:
    """Return a text as the numbers of its characters, after other numbers."""
    return np.array([*before, *map(ord, text)], dtype=float)


def read(numbers: Array) -> str:
    """Return the text of such numbers."""
    return "".join(chr(int(number)) for number in np.ravel(numbers))


def kind_of(state: Any) -> str:
    """Return what a state says it belongs to, empty if it has no label; raise if it is of a newer format or none."""
    if not (hasattr(state, "keys") and hasattr(state, "__getitem__")):
        raise TypeError(
            f"state: expected what state() returned, or what numpy.load makes of a file that holds it, "
            f"got {type(state).__name__}"
        )
    if LABEL not in state:
        return ""
    label = _numbers(LABEL, state[LABEL])
    if label.ndim != 1 or not label.size or not ((label >= 0) & (label < 0x110000) & (label % 1 == 0)).all():
        raise StateError(f"state: expected {LABEL} to be a version and a name, got {_checks.shown(label)}")
    if label[0] > FORMAT:
        raise StateError(
            f"state: expected format {FORMAT} or older, got {label[0]:g}; it comes from a newer robust_filterpy, "
            f"update this one"
        )
    return read(label[1:])


def require_kind(state: Any, kind: str) -> None:
    """Raise unless a state belongs to this kind, or does not say what it belongs to."""
    given = kind_of(state)
    if given and given != kind:
        raise StateError(f"state: expected one of a {kind}, got one of a {given}")


def checked(
    state: Any, kind: str | None, needed: Mapping[str, Shape], optional: Mapping[str, Shape], gaps: tuple[str, ...] = ()
) -> dict[str, Array]:
    """Return a state's arrays, copied, or raise; those named in gaps may hold NaN.

    Without a kind its label has been looked at. x may be a vector or a column, an optional matrix a number that stands
    for itself times I.
    """
    if kind is not None:
        require_kind(state, kind)
    entries = {}
    for name, shape in {**needed, **optional}.items():
        if name not in state:
            if name in optional:
                continue
            raise StateError(f"state: expected {name}, of shape {_text(shape)}, got none")
        value = _numbers(name, state[name]).copy()
        if value.size == 0 and len(shape) != value.ndim and math.prod(size or 0 for size in shape) == 0:
            # Text formats, JSON among them, do not keep the shape of what is empty.
            value = value.reshape([size or 0 for size in shape])
        column = name == "x" and value.shape == (*shape, 1)
        fits = len(value.shape) == len(shape) and all(b in (None, a) for a, b in zip(value.shape, shape, strict=True))
        if not (fits or column or (name in optional and value.ndim == 0)):
            raise StateError(f"state: expected {name} of shape {_text(shape)}, got {value.shape}")
        if not (np.isfinite(value) | (np.isnan(value) & (name in gaps))).all():
            raise StateError(f"state: expected finite numbers in {name}, got NaN or infinity")
        if name in _COVARIANCES and value.ndim >= 2:
            require_covariance(name, value)
        entries[name] = value
    return entries


def require_covariance(name: str, stack: Array) -> None:
    """Raise unless a matrix of a state, or every one of a stack, is a covariance, up to what a recursion gathers."""
    try:
        _checks.covariance(name, stack, **_COVARIANCES.get(name, _MOVING))
    except ValueError as error:
        raise StateError(f"state: {error}") from None


def _numbers(name: str, value: Any) -> Array:
    """Return an array of a state, or raise."""
    try:
        return _checks.numbers(name, value)
    except (TypeError, ValueError, OverflowError) as error:
        raise StateError(f"state: {error}") from None


def _text(shape: Shape) -> str:
    """Return a shape as a message shows it."""
    return str(shape).replace("None", "any")


def pack(state: Any) -> bytes:
    """Return a state as bytes, for a file, a database or a message.

    Parameters
    ----------
    state : mapping of str to ndarray
        What ``state()`` of a filter or tracker, or `step`, returned.

    Returns
    -------
    bytes
        A file in numpy's .npy format (version 1.0) with one record: a field of float64 for each array of the state, of
        uint8 (uint32 for a name beyond Latin-1) for ``format``, and ``checksum``, the CRC-32 of the bytes before it.
        ``numpy.load(.., allow_pickle=False)`` reads it.

    Raises
    ------
    TypeError, ValueError
        If state is no mapping, has no label, or holds something else than numbers.

    Examples
    --------
    >>> from robust_filterpy import RobustKalmanFilter
    >>> kf = RobustKalmanFilter(1, 1)
    >>> kf.restore(unpack(pack(kf.state())))
    """
    if not kind_of(state):
        raise StateError(f"state: expected what state() or step returned, with {LABEL}, got {list(state)}")
    arrays = {name: np.asarray(state[name]) for name in state}
    for name, array in arrays.items():
        if array.dtype.kind not in "fiub":
            raise TypeError(f"state: expected numbers in {name}, got dtype {array.dtype}")
    label = "u1" if arrays[LABEL].max() < 256 else "<u4"
    kinds = (label if name == LABEL else "<f8" for name in arrays)
    shapes = (array.shape for array in arrays.values())
    header, dtype = _header(tuple(zip(arrays, kinds, shapes, strict=True)))
    record = np.zeros((), dtype)
    for name, array in arrays.items():
        record[name] = array
    body = record.tobytes()[:-4]
    return header + body + zlib.crc32(header + body).to_bytes(4, "little")


def unpack(data: bytes) -> dict[str, Array]:
    """Return the state that `pack` made bytes of.

    Parameters
    ----------
    data : bytes
        From `pack`.

    Returns
    -------
    dict of str to ndarray
        The state, to the last bit.

    Raises
    ------
    ValueError
        If it is damaged, no packed state, or of a newer format.
    TypeError
        If data is no bytes.
    """
    if not isinstance(data, (bytes, bytearray, memoryview)):
        raise TypeError(f"data: expected bytes from pack, got {type(data).__name__}")
    data = bytes(data)
    size = 10 + int.from_bytes(data[8:10], "little")
    if data[:8] != b"\x93NUMPY\x01\x00" or len(data) < size + 4:
        raise StateError(f"data: expected a packed state, got {len(data)} bytes of something else, or cut off")
    if zlib.crc32(data[:-4]) != int.from_bytes(data[-4:], "little"):
        raise StateError("data: expected a packed state, got a damaged one: its checksum does not fit")
    dtype = _dtype_of(data[:size])
    if dtype.names is None or dtype.names[-1:] != (_CHECKSUM,) or dtype.itemsize != len(data) - size:
        raise StateError(f"data: expected one record of a state, got {dtype}")
    record = np.frombuffer(data, dtype, count=1, offset=size)[0]
    try:
        state = {name: np.array(record[name], dtype=float) for name in dtype.names[:-1]}
    except (TypeError, ValueError) as error:
        raise StateError(f"data: expected numbers in a state, {error}") from None
    if not kind_of(state):
        raise StateError(f"data: expected a packed state with {LABEL}, got {list(state)}")
    return state


@lru_cache(maxsize=256)
def _header(fields: tuple[tuple[str, str, tuple[int, ...]], ...]) -> tuple[bytes, np.dtype[Any]]:
    """Return the head of the file for a record of such arrays, and the record's type."""
    dtype = np.dtype([*fields, (_CHECKSUM, "<u4")])
    file = io.BytesIO()
    description = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": ()}
    np.lib.format.write_array_header_1_0(file, description)
    return file.getvalue(), dtype


@lru_cache(maxsize=256)
def _dtype_of(header: bytes) -> np.dtype[Any]:
    """Return the type of the record that a head announces."""
    file = io.BytesIO(header[8:])
    try:
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    except Exception as error:
        # The header is parsed as Python text: what is none raises whatever the parser raises.
        raise StateError(f"data: expected the head of a packed state, {type(error).__name__}: {error}") from None
    if shape != ():
        raise StateError(f"data: expected one record, got shape {shape}")
    return np.dtype(dtype)
