"""Spark: a fleet's table in a batch query, and its samples in a streaming one that keeps the states."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from robust_filterpy import _checks
from robust_filterpy._state import pack
from robust_filterpy.fleet.models import Model
from robust_filterpy.fleet.table import filter_table, step

__all__ = ["filter_frame", "step_stream"]


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
        Seconds of the cluster's clock without a sample of a key after which the next micro-batch without one takes its
        state out of the checkpoint, so that the key begins anew. Default: states are kept for ever.

    Returns
    -------
    pyspark.sql.DataFrame
        A streaming one, for output mode "append": key, time, ``model.columns`` and ``error`` for each sample.

    Raises
    ------
    ValueError, TypeError
        As in `filter_table`; if ``forget_after`` is not above 0.

    Notes
    -----
    The state of each key is what `pack` makes of it, in the query's checkpoint; a query that is started again from it
    goes on to the last bit. A micro-batch that a key's model refuses leaves the key's state as it was and has the
    reason in ``error``.
    """
    model = _timed(model)
    model = replace(model, late=model.late or "drop")
    if forget_after is not None:
        _checks.positive("forget_after", forget_after)

    def advance(name: tuple[Any, ...], parts: Iterator[Any], stored: Any) -> Iterator[Any]:
        """Take one key's samples of a micro-batch, or forget a key that has sent none for long."""
        if stored.hasTimedOut:
            stored.remove()
            return
        import pandas as pd

        table = pd.concat(list(parts), ignore_index=True)
        # The name as the table has it: Spark hands over another type.
        own = table[key].tolist()[0]
        before = {own: stored.get[0]} if stored.exists else None
        states, output = step(model, before, table, key=key, sort=True)
        if own in states and own not in states.odd:
            stored.update((pack(states[own]),))
        # A sample that is refused is a sign of life too.
        if forget_after is not None and stored.exists:
            stored.setTimeoutDuration(max(round(1e3 * forget_after), 1))
        yield output

    schema, timeout = _schema(frame, model, key), "NoTimeout" if forget_after is None else "ProcessingTimeTimeout"
    return frame.groupBy(key).applyInPandasWithState(advance, schema, "state binary", "append", timeout)


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
