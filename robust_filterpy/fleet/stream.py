"""Kafka and the like, sample by sample, with the states in the stream's store: for quixstreams, or any such library.

Of the libraries that keep a state for each key in Python, quixstreams is the one with regular releases; bytewax, the
other one, has had none since November 2024.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from robust_filterpy._checks import shown
from robust_filterpy._state import pack
from robust_filterpy.fleet._advancing import REFUSED
from robust_filterpy.fleet.models import Model
from robust_filterpy.fleet.table import step

__all__ = ["StreamStep"]


class StreamStep:
    """Take one message of one key: what ``StreamingDataFrame.apply(.., stateful=True)`` of quixstreams calls.

    Parameters
    ----------
    model : FilterModel or TrackerModel
        What all keys have in common; it names the entries of a message that are measured, and the
        time and the inputs if there are any.
    name : str, default "robust_filterpy"
        Name of the state in the store.

    Raises
    ------
    ValueError, TypeError
        If the model does not say which entries are measured.

    Notes
    -----
    A message is a mapping, ``{"t": 12.0, "z": 0.3}``, the time a number of seconds or a text as ISO 8601 has it; an
    entry that is absent or None is a missing measurement. What comes back has the message's time, ``model.columns``,
    ``error`` and ``dropped``, None for NaN, so that it can be written as JSON. No message stops a stream: of one that
    is no mapping, or has no time or no number, ``error`` says so. One that is late or comes again is dropped, gives
    None, and is counted in ``dropped``; with ``late="refuse"`` it is named.

    The state is what `pack` makes of it. quixstreams keeps it in RocksDB, with a changelog in Kafka, from which a
    worker that takes over goes on to the last bit. ``pip install "robust_filterpy[stream]"``.

    Examples
    --------
    Where ``app`` is a ``quixstreams.Application``::

        samples = app.dataframe(app.topic("samples"))
        samples = samples.apply(StreamStep(model), stateful=True).filter(lambda found: found is not None)
        samples.to_topic(app.topic("estimates"))
        app.run()
    """

    def __init__(self, model: Model, *, name: str = "robust_filterpy") -> None:
        """Keep the model."""
        if not isinstance(model, Model):
            raise TypeError(f"model: expected a FilterModel or a TrackerModel, got {type(model).__name__}")
        self.model, self.name = replace(model, late=model.late or "drop"), name
        if self.model.measurements is None:
            raise ValueError("measurements: expected the names of the entries that are measured, got None")

    def __call__(self, message: Any, state: Any) -> dict[str, Any] | None:
        """Take a message, with a store that has ``get_bytes(name)`` and ``set_bytes(name, value)``."""
        model = self.model
        row, time, wrong = self._row(message)
        try:
            after, output = step(model, state.get_bytes(self.name), row)
        except (*REFUSED, KeyError) as error:
            return {**time, **dict.fromkeys(model.columns), "error": str(error), "dropped": 0}
        dropped = 0 if after is None or "dropped" not in after else int(after["dropped"][0])
        if after is not None:
            state.set_bytes(self.name, pack(after))
        if not len(output["error"]):
            return None
        columns = {name: output[name][0].item() for name in model.columns}
        numbers = {name: None if math.isnan(value) else value for name, value in columns.items()}
        said = "; ".join(one for one in (wrong, output["error"][0]) if one) or None
        return {**time, **numbers, "error": said, "dropped": dropped}

    def _row(self, message: Any) -> tuple[np.ndarray, dict[str, Any], str]:
        """Return a message as an array of one sample, its time, and what is wrong with it as a whole."""
        model = self.model
        wrong = "" if isinstance(message, Mapping) else f"message: expected a mapping, got {shown(message)}"
        entries = {} if wrong else message
        names = [*([] if model.time is None else [model.time]), *(model.measurements or ()), *(model.inputs or ())]
        row = np.full((1, len(names)), None, dtype=object)
        for j, name in enumerate(names):
            row[0, j] = entries.get(name)
        return row, {} if model.time is None else {model.time: entries.get(model.time)}, wrong
