"""States as bytes: one record in numpy's .npy format, without pickle.

The record has a field for each array of the state, and a checksum. An .npz file of the same arrays, which has a header
for each, is several times as large and slower to write and read (``python tests/benchmarks/fleet.py`` prints both).
"""

from __future__ import annotations

import io
import zlib
from functools import lru_cache
from typing import Any

import numpy as np

from robust_filterpy import _state
from robust_filterpy._checks import Array
from robust_filterpy._state import StateError

_CHECKSUM = "checksum"


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
    if not _state.kind_of(state):
        raise StateError(f"state: expected what state() or step returned, with {_state.LABEL}, got {list(state)}")
    arrays = {name: np.asarray(state[name]) for name in state}
    for name, array in arrays.items():
        if array.dtype.kind not in "fiub":
            raise TypeError(f"state: expected numbers in {name}, got dtype {array.dtype}")
    label = "u1" if arrays[_state.LABEL].max() < 256 else "<u4"
    kinds = (label if name == _state.LABEL else "<f8" for name in arrays)
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
    if not _state.kind_of(state):
        raise StateError(f"data: expected a packed state with {_state.LABEL}, got {list(state)}")
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
