"""Spark: a fleet's table in a batch query, and its samples in a streaming one that keeps the states."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from robust_filterpy import _checks
from robust_filterpy._state import pack, unpack
from robust_filterpy.fleet.models import Model
from robust_filterpy.fleet.table import filter_table, step

__all__ = ["filter_frame", "step_stream"]

_STATE = "state binary"
_PROVIDER = "spark.sql.streaming.stateStore.providerClass"


def filter_frame(frame: Any, model: Model, *, key: str = "device", groups: int | None = None) -> Any:
    """Filter a Spark data frame of many keys, each from the model's start, by ``applyInPandas``.

    Parameters
    ----------
    frame : pyspark.sql.DataFrame
        A row for each sample.
    model, key
        As in `filter_table`; the model's ``time`` is needed, since a shuffle does not keep the order.
    groups : int, optional
        How many groups of keys are handed to Python, each as one table. Default: four for each core. A group has to
        fit a worker's memory a few times.

    Returns
    -------
    pyspark.sql.DataFrame
        What `filter_table` returns.

    Raises
    ------
    ValueError, TypeError
        As in `filter_table`.

    Notes
    -----
    One call of Python for each key would cost a millisecond a key; keys are therefore handed over in groups, by their
    hash, and `filter_table` takes each group apart. ``pip install "robust_filterpy[spark]"``, and a Java runtime.
    """
    from pyspark.sql import functions

    model = _timed(model)
    groups = groups or 4 * frame.sparkSession.sparkContext.defaultParallelism

    def advance(part: Any) -> Any:
        """Filter the keys of a group."""
        return filter_table(model, part, key=key, sort=True)

    of_key = functions.pmod(functions.hash(frame[key]), functions.lit(groups))
    return frame.groupBy(of_key).applyInPandas(advance, _schema(frame, model, key))


def step_stream(frame: Any, model: Model, *, key: str = "device", forget_after: float | None = None) -> Any:
    """Take the samples of a streaming data frame as they come, by ``applyInPandasWithState``.

    Parameters
    ----------
    frame : pyspark.sql.DataFrame
        A streaming one: a row for each sample.
    model, key
        As in `filter_table`; the model's ``time`` is needed. Samples of a key that come in one micro-batch are put in
        order.
    forget_after : float, optional
        Seconds of the cluster's clock without a sample of a key after which its state leaves the checkpoint, and the
        key begins anew. By Spark 4's ``transformWithStateInPandas``, with ``protobuf`` installed and RocksDB as the
        store of states; such a query never ends by itself, not even with ``availableNow``. Default: states are kept
        for ever; ``model.expires`` judges them by the samples' own times.

    Returns
    -------
    pyspark.sql.DataFrame
        A streaming one, for output mode "append": key, time, ``model.columns`` and ``error`` for each sample.

    Raises
    ------
    ValueError, TypeError
        As in `filter_table`; if ``forget_after`` is not above 0, or Spark is older than 4 or keeps states elsewhere.

    Notes
    -----
    The state of each key is what `pack` makes of it, in the query's checkpoint; a query that is started again from it
    goes on to the last bit. A micro-batch that a key's model refuses leaves the key's state as it was and has the
    reason in ``error``.
    """
    model = _timed(model)
    model = replace(model, late=model.late or "drop")

    schema, grouped = _schema(frame, model, key), frame.groupBy(key)

    def taken(parts: Iterator[Any], stored: Any) -> tuple[bytes | None, Any]:
        """Return one key's state after a micro-batch, None if that has not changed, and the rows of the result."""
        import pandas as pd

        table = pd.concat(list(parts), ignore_index=True)
        # The name as the table has it: Spark hands over another type.
        own = table[key].tolist()[0]
        before = None if stored is None else {own: _unpacked(stored[0])}
        states, output = step(model, before, table, key=key, sort=True)
        return (pack(states[own]) if own in states and own not in states.odd else None), output

    if forget_after is not None:
        milliseconds = _lifetime(frame, forget_after)
        return grouped.transformWithStateInPandas(_processor(taken, milliseconds), schema, "append", "ProcessingTime")

    def advance(name: tuple[Any, ...], parts: Iterator[Any], state: Any) -> Iterator[Any]:
        """Take one key's samples of a micro-batch."""
        after, output = taken(parts, state.get if state.exists else None)
        if after is not None:
            state.update((after,))
        yield output

    return grouped.applyInPandasWithState(advance, schema, _STATE, "append", "NoTimeout")


def _processor(taken: Callable[[Iterator[Any], Any], tuple[bytes | None, Any]], milliseconds: int) -> Any:
    """Return what Spark 4 asks for each key; a state is forgotten so long after it was written."""
    from pyspark.sql.streaming import StatefulProcessor

    class Processor(StatefulProcessor):  # type: ignore[misc]
        """One key at a time."""

        def init(self, handle: Any) -> None:
            """Have the store make room for a state."""
            self.stored = handle.getValueState("state", _STATE, milliseconds)

        def handleInputRows(self, key: Any, rows: Iterator[Any], timerValues: Any) -> Iterator[Any]:
            """Take one key's samples of a micro-batch."""
            before = self.stored.get() if self.stored.exists() else None
            after, output = taken(rows, before)
            # A sample that is refused is a sign of life too.
            if after is not None or before is not None:
                self.stored.update(before if after is None else (after,))
            yield output

        def close(self) -> None:
            """Spark asks for it."""

    return Processor()


def _lifetime(frame: Any, seconds: float) -> int:
    """Return how long a state is kept in milliseconds, or raise."""
    from pyspark.sql import GroupedData

    _checks.positive("forget_after", seconds)
    if not hasattr(GroupedData, "transformWithStateInPandas"):
        raise ValueError(
            f"forget_after: expected Spark 4 or newer, which can forget states, got {frame.sparkSession.version}; "
            f"leave it out, and set expires= of the model"
        )
    store = frame.sparkSession.conf.get(_PROVIDER)
    if "RocksDB" not in store:
        raise ValueError(
            f"forget_after: expected states in RocksDB, got {store}; before the query, spark.conf.set({_PROVIDER!r}, "
            f'"org.apache.spark.sql.execution.streaming.state.RocksDBStateStoreProvider")'
        )
    return max(round(1e3 * seconds), 1)


def _unpacked(data: Any) -> Any:
    """Return a state, or what is none as it is, which the table then names."""
    try:
        return unpack(data)
    except (TypeError, ValueError):
        return data


def _timed(model: Model) -> Model:
    """Return a model that reads times, or raise."""
    if model.time is None:
        raise ValueError("time: expected the column of times, since Spark does not keep the order, got None")
    return model


def _schema(frame: Any, model: Model, key: str) -> Any:
    """Return the columns of the result."""
    from pyspark.sql.types import DoubleType, StringType, StructField, StructType

    copied = (key, str(model.time))
    missing = [name for name in copied if name not in frame.columns]
    if missing:
        raise ValueError(f"frame: expected the columns {missing}, got {frame.columns}")
    given = [StructField(name, frame.schema[name].dataType) for name in copied]
    numbers = [StructField(name, DoubleType()) for name in model.columns]
    return StructType([*given, *numbers, StructField("error", StringType())])
