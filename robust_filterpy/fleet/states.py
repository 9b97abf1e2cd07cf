"""States of many keys in columns: an array for each entry of a state, with a row for each key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import islice, pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from robust_filterpy import _state
from robust_filterpy._checks import Array
from robust_filterpy.fleet.reading import seconds

if TYPE_CHECKING:
    from robust_filterpy.fleet.models import Model


class States(Mapping[Any, dict[str, Array]]):
    """States of many keys, as `step` returns them; a mapping of key to state, and a table.

    Parameters
    ----------
    label : ndarray, shape (k,)
        What they belong to, their ``format``.
    keys : sequence
        Whose they are.
    columns : mapping of str to ndarray
        An array for each entry of a state with a row for each key; NaN where a key has none.
    odd : mapping, optional
        States that are none, as they were given, of keys that are refused.

    Notes
    -----
    A million devices of two states and one sensor take 64 MB, or 1.4 GB as a dictionary of states. ``to_arrow`` gives
    an Arrow table, for Parquet and the like; `step` takes it back as it is.

    Examples
    --------
    >>> from robust_filterpy import RobustKalmanFilter
    >>> from robust_filterpy.fleet import FilterModel, step
    >>> import pandas as pd
    >>> table = pd.DataFrame({"device": ["a", "b", "a"], "z": [0.1, 0.2, 0.3]})
    >>> states, _ = step(FilterModel(RobustKalmanFilter(1, 1)), None, table, key="device")
    >>> list(states), states["a"]["x"].shape, states.to_arrow().num_rows
    (['a', 'b'], (1, 1), 2)
    """

    def __init__(
        self, label: Array, keys: Sequence[Any], columns: Mapping[str, np.ndarray], odd: Mapping[Any, Any] | None = None
    ) -> None:
        """Keep the columns."""
        self.label, self.columns = label, dict(columns)
        self.keys_of_rows: list[Any] = keys.tolist() if isinstance(keys, np.ndarray) else list(keys)
        self.odd: dict[Any, Any] = dict(odd or {})

    def __repr__(self) -> str:
        """Say of how many keys, and of whom."""
        shown = ", ".join(map(str, islice(self, 3)))
        return f"States({len(self)} keys{': ' if len(self) else ''}{shown}{', ..' if len(self) > 3 else ''})"

    def __len__(self) -> int:
        """Return how many keys there are."""
        return len(self.keys_of_rows) + len(self.odd)

    def __iter__(self) -> Iterator[Any]:
        """Return the keys one after the other."""
        yield from self.keys_of_rows
        yield from self.odd

    def __getitem__(self, key: Any) -> dict[str, Array]:
        """Return the state of a key, as `step` takes it."""
        if key in self.odd:
            return self.odd[key]  # type: ignore[no-any-return]
        return self.row(self._rows[key])

    @cached_property
    def _rows(self) -> dict[Any, int]:
        """Row of each key."""
        return {key: i for i, key in enumerate(self.keys_of_rows)}

    def row(self, i: int) -> dict[str, Array]:
        """Return the state in a row.

        Parameters
        ----------
        i : int
            Row.

        Returns
        -------
        dict of str to ndarray
        """
        state = {_state.LABEL: self.label}
        for name, column in self.columns.items():
            value = np.array(column[i], dtype=float)
            if name not in FLEET or not np.isnan(value).all():
                state[name] = value
        return state

    def find(self, names: Sequence[Any]) -> np.ndarray:
        """Return the rows of some keys, -1 for those that are not there.

        Parameters
        ----------
        names : sequence
            Keys.

        Returns
        -------
        ndarray of int
        """
        return np.fromiter((self._rows.get(name, -1) for name in names), int, len(names))

    def newer(self, time: Any) -> States:
        """Return the states of keys that have been heard of since, for a fleet whose devices come and go.

        Parameters
        ----------
        time : float or instant
            As the samples' times are. Of keys without times all are kept, and so is what is no state.

        Returns
        -------
        States

        Raises
        ------
        ValueError
            If time is none.
        """
        said: dict[int, str] = {}
        (since,) = seconds(np.array([time], dtype=object), said)
        if said:
            raise ValueError(said[0])
        return self._of_rows(np.flatnonzero(~(self.columns["time"][:, 0] < since)), self.odd)

    def _of_rows(self, rows: np.ndarray, odd: Mapping[Any, Any]) -> States:
        """Return the states in some rows."""
        keys = [self.keys_of_rows[i] for i in rows.tolist()]
        return States(self.label, keys, {name: column[rows] for name, column in self.columns.items()}, odd)

    def updated(self, names: Sequence[Any], rows: np.ndarray, entries: Mapping[str, np.ndarray]) -> States:
        """Return other states, some of them new; these are as they were.

        Parameters
        ----------
        names : sequence of length K
            Keys.
        rows : ndarray of int, shape (K,)
            Their rows here, -1 for new ones.
        entries : mapping of str to ndarray
            Their states, a row for each.

        Returns
        -------
        States
        """
        new, size = np.flatnonzero(rows < 0), len(self.keys_of_rows)
        old = np.flatnonzero(rows >= 0)
        columns = {}
        for name, values in entries.items():
            whole = np.full((size + len(new), *values.shape[1:]), np.nan, dtype=values.dtype)
            before = self.columns.get(name)
            if before is not None:
                whole[:size] = before
            whole[rows[old]], whole[size:] = values[old], values[new]
            columns[name] = whole
        added = [names[i] for i in new.tolist()]
        return States(self.label, self.keys_of_rows + added, columns, self.odd)

    def to_arrow(self, key: str = "device") -> Any:
        """Return the states as an Arrow table, a row for each key; those that are none are left out.

        Parameters
        ----------
        key : str, default "device"
            Name of the column of keys.

        Returns
        -------
        pyarrow.Table
            The key, ``kind`` (what the states belong to), and a list of numbers for each entry of a state.
        """
        import pyarrow as pa

        n = len(self.keys_of_rows)
        kind = pa.array([_state.read(self.label[1:])], pa.string())
        columns = {
            key: pa.array(self.keys_of_rows),
            "kind": pa.DictionaryArray.from_arrays(pa.array(np.zeros(n, dtype=np.int32)), kind),
        }
        for name, column in self.columns.items():
            if column.dtype == object:
                columns[name] = pa.array([np.ravel(value) for value in column], pa.list_(pa.float64()))
            else:
                size = int(np.prod(column.shape[1:], dtype=int))
                if not size:
                    continue
                flat = pa.array(np.ascontiguousarray(column).reshape(-1))
                columns[name] = flat if column.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, size)
        return pa.table(columns)


#: Entries that a state may lack: nothing has been learned of a sensor yet.
_UNKNOWN = ("spread", "sensors", "sensors_spread", "named", "named_spread", "filter_spread")
#: Entries that a fleet adds to a state, and their shapes.
FLEET: dict[str, _state.Shape] = {
    "time": (1,), "grid": (2,), "elsewhere": (2,), "input": (None,), "dropped": (1,), "model": (1,),
}  # fmt: skip


def taken(states: Any, model: Model) -> States:
    """Return states in columns, from a mapping of key to state, from an Arrow table, or from nothing."""
    if states is None:
        return States(model.label, [], {name: empty(0, shape) for name, shape in model.shapes.items()})
    if isinstance(states, States) and np.array_equal(states.label, model.label):
        return states
    return _stacked(states, model) if isinstance(states, Mapping) else _from_table(states, model)


def empty(n: int, shape: _state.Shape) -> np.ndarray:
    """Return a column without numbers."""
    sizes = [size for size in shape if size is not None]
    return np.full(n, None, dtype=object) if None in shape else np.full((n, *sizes), np.nan)


def _stacked(states: Mapping[Any, Any], model: Model) -> States:
    """Return states in columns, from a mapping."""
    good, rows, odd = [], [], {}
    for key, state in states.items():
        try:
            rows.append(checked(state, model))
            good.append(key)
        except (TypeError, ValueError):
            odd[key] = state
    columns = {name: empty(len(rows), shape) for name, shape in model.shapes.items()}
    for name, column in columns.items():
        for i, row in enumerate(rows):
            if name in row:
                column[i] = row[name]
    return States(model.label, good, columns, odd)


def checked(state: Any, model: Model) -> dict[str, Array]:
    """Return the entries of one state, packed or not, in their shapes, or raise."""
    state = _state.unpack(bytes(state)) if isinstance(state, (bytes, bytearray, memoryview)) else state
    shapes = model.shapes
    unknown = {name: np.zeros([size or 0 for size in shapes[name]]) for name in _UNKNOWN if name in shapes}
    needed = {name: shape for name, shape in shapes.items() if name not in FLEET and name not in unknown}
    optional = {name: shape for name, shape in shapes.items() if name not in needed}
    # x may come as a vector or as a column.
    vectors = {name: shape[:1] if name == "x" else shape for name, shape in needed.items()}
    entries = {**unknown, **_state.checked(state, model.kind, vectors, optional, model.gaps)}
    return {name: value if None in shapes[name] else value.reshape(shapes[name]) for name, value in entries.items()}


def _ragged(column: Any, width: list[int]) -> np.ndarray:
    """Return an array of arrays, of rows of this width, from a column of lists."""
    import pyarrow as pa

    arrays, size = np.full(len(column), None, dtype=object), max(int(np.prod(width)), 1)
    plain = pa.types.is_list(column.type) and pa.types.is_floating(column.type.value_type)
    lengths = column.value_lengths().fill_null(0).to_numpy() if plain else np.ones(1, dtype=int)
    if plain and not (lengths % size).any():
        numbers = np.asarray(column.flatten().to_numpy(zero_copy_only=False), dtype=float).reshape(-1, *width)
        ends = [0, *(np.cumsum(lengths) // size).tolist()]
        for i, (begin, end) in enumerate(pairwise(ends)):
            arrays[i] = numbers[begin:end]
    else:
        for i, value in enumerate(column):
            arrays[i] = np.reshape(np.asarray(value.as_py(), dtype=float), (-1, *width))
    return arrays


def _from_table(table: Any, model: Model) -> States:
    """Return states in columns, from what pyarrow makes a table of."""
    import pyarrow as pa

    try:
        table = table if isinstance(table, pa.Table) else pa.table(table)
    except (TypeError, ValueError):
        raise TypeError(f"states: expected a mapping or a table of states, got {type(table).__name__}") from None
    shapes = model.shapes
    needed = ("kind", *(name for name, shape in shapes.items() if name not in FLEET and 0 not in shape))
    missing = [name for name in needed if name not in table.column_names]
    if missing:
        raise _state.StateError(
            f"states: expected the columns {missing} of a {model.kind}, got {table.column_names}; "
            "begin with None, or take the model that these states were made with"
        )
    (key,) = [name for name in table.column_names if name not in shapes and name not in FLEET and name != "kind"][:1]
    keys, n = table.column(key).to_numpy().tolist(), table.num_rows
    columns = {}
    for name, shape in shapes.items():
        if name not in table.column_names:
            columns[name] = empty(n, shape)
            continue
        column = table.column(name).combine_chunks()
        if None in shape:
            columns[name] = _ragged(column, [size or 0 for size in shape[1:]])
        else:
            flat = column if pa.types.is_floating(column.type) else column.flatten()
            columns[name] = np.asarray(flat.to_numpy(zero_copy_only=False), dtype=float).reshape(n, *shape)
    kinds = table.column("kind").to_pylist() if n and table.column("kind").unique().to_pylist() != [model.kind] else []
    states = States(model.label, keys, columns)
    odd = [i for i, other in enumerate(kinds) if other != model.kind]
    return states if not odd else _without(states, odd, kinds)


def _without(states: States, rows: Sequence[int], kinds: Sequence[str]) -> States:
    """Return states without those of something else, which become odd ones."""
    odd = {}
    for i in rows:
        odd[states.keys_of_rows[i]] = {**states.row(i), _state.LABEL: _state.spelt(kinds[i] or "", _state.FORMAT)}
    return states._of_rows(np.setdiff1d(np.arange(len(states.keys_of_rows)), rows), odd)
