"""Results of many runs, of one structure, as arrays with a leading axis of runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def stack_leaves(values: Sequence[Any], indices: NDArray[np.intp], name: str) -> Any:
    """Stack one branch of the results; name says where it is."""
    first = values[0]
    parts = _parts(first)
    if parts is None:
        leaves = [np.asarray(value) for value in values]
        for leaf, index in zip(leaves, indices, strict=True):
            if leaf.shape != leaves[0].shape:
                raise ValueError(
                    f"{name}: expected equal shapes, run {indices[0]} has {leaves[0].shape} and run {index} has "
                    f"{leaf.shape}; work on .results instead"
                )
        return np.stack(leaves)
    for value, index in zip(values, indices, strict=True):
        other = _parts(value)
        if type(value) is not type(first) or other is None or other.keys() != parts.keys():
            raise ValueError(
                f"{name}: expected the same structure in all runs, run {indices[0]} has {_describe(first)} and "
                f"run {index} has {_describe(value)}"
            )
    rows = [_parts(value) for value in values]
    stacked = {key: stack_leaves([row[key] for row in rows if row], indices, f"{name}[{key!r}]") for key in parts}
    if isinstance(first, tuple):
        return type(first)(*stacked.values()) if hasattr(first, "_fields") else tuple(stacked.values())
    return stacked


def _parts(value: Any) -> dict[Any, Any] | None:
    """Take a container apart by key; None for a leaf."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, tuple):
        return dict(zip(getattr(value, "_fields", range(len(value))), value, strict=True))
    if dataclasses.is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    return None


def _describe(value: Any) -> str:
    """Name a branch's type and keys."""
    parts = _parts(value)
    return type(value).__name__ + ("" if parts is None else f" with {list(parts)}")
