"""Kafka and the like, sample by sample, with the states in the stream's store: for quixstreams, or any such library.

Of the libraries that keep a state for each key in Python, quixstreams is the one with regular releases; bytewax, the
other one, has had none since November 2024.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from robust_filterpy.fleet.models import Model
from robust_filterpy.fleet.packing import pack, unpack
from robust_filterpy.fleet.stepping import step

__all__ = ["StreamStep"]

_REFUSED = (ValueError, TypeError, KeyError, np.linalg.LinAlgError)


class StreamStep:
    """Take one message of one key: what ``StreamingDataFrame.apply(.., stateful=True)`` of quixstreams calls.

    Parameters
    ----------
    model : FilterModel or TrackerModel
        What all keys have in common; it names the measurements, and the inputs if it has any.
    time, measurements, inputs : optional
        Entries of a message, as in `Model`; as the model has them if not given.
    name : str, default "robust_filterpy"
        Name of the state in the store.

    Raises
    ------
    ValueError, TypeError
        If the model does not say which entries are measured.

    Notes
    -----
    A message is a mapping, ``{"t": 12.0, "z": 0.3}``; an entry that is absent or None is a missing measurement. What
    comes back has the message's time, ``model.columns`` and ``error``, None for NaN, so that it can be written as
    JSON; a message that is refused leaves the state as it was and has the reason in ``error``. One that is dropped
    because it is late (``late="drop"``) gives None.

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

    def __init__(
        self,
        model: Model,
        *,
        time: str | None = None,
        measurements: Sequence[str] | None = None,
        inputs: Sequence[str] | None = None,
        name: str = "robust_filterpy",
    ) -> None:
        """Keep the model."""
        if not isinstance(model, Model):
            raise TypeError(f"model: expected a FilterModel or a TrackerModel, got {type(model).__name__}")
        self.model, self.name = model.reading(time=time, measurements=measurements, inputs=inputs), name
        if self.model.measurements is None:
            raise ValueError("measurements: expected the names of the entries that are measured, got None")

    def __call__(self, message: Mapping[str, Any], state: Any) -> dict[str, Any] | None:
        """Take a message, with a store that has ``get_bytes(name)`` and ``set_bytes(name, value)``."""
        model = self.model
        time = {} if model.time is None else {model.time: message.get(model.time)}
        try:
            kept = state.get_bytes(self.name)
            after, found = step(model, None if kept is None else unpack(kept), self._row(message))
        except _REFUSED as error:
            return {**time, **dict.fromkeys(model.columns), "error": str(error)}
        columns = {name: values.tolist() for name, values in found.items()}
        if not columns[model.columns[0]]:
            return None
        if after is not None:
            state.set_bytes(self.name, pack(after))
        numbers = {name: None if math.isnan(values[0]) else values[0] for name, values in columns.items()}
        return {**time, **numbers, "error": None}

    def _row(self, message: Mapping[str, Any]) -> np.ndarray:
        """Return a message as an array of one sample, or raise."""
        model = self.model
        row = [] if model.time is None else [message[model.time]]
        row += [math.nan if message.get(name) is None else message[name] for name in model.measurements or ()]
        return np.array([row + [message[name] for name in model.inputs or ()]])
