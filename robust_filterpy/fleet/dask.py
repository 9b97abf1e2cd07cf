"""Dask: a fleet's table on the cores of a machine or of a cluster."""

from __future__ import annotations

from typing import Any

from robust_filterpy.fleet.models import Model
from robust_filterpy.fleet.table import filter_table

__all__ = ["filter_frame"]


def filter_frame(
    frame: Any, model: Model, *, key: str = "device", partitioned: bool = False, npartitions: int | None = None
) -> Any:
    """Filter a Dask data frame of many keys, each from the model's start; `filter_table` on every partition.

    Parameters
    ----------
    frame : dask.dataframe.DataFrame
        A row for each sample.
    model, key
        As in `filter_table`.
    partitioned : bool, default False
        Whether each key's samples are already in one partition, and in order. Otherwise the frame is shuffled by key,
        and the samples of each key are put in order of time.
    npartitions : int, optional
        Partitions after the shuffle; as many as the frame has if not given. One has to fit a worker's memory a few
        times.

    Returns
    -------
    dask.dataframe.DataFrame
        What `filter_table` returns, not yet computed.

    Raises
    ------
    ValueError, TypeError
        As in `filter_table`; also if the frame is to be shuffled and has no times.

    Notes
    -----
    A task is a pure function of its partition, so that what a lost worker had done is done again by another, with the
    same result to the last bit. ``pip install "robust_filterpy[dask]"``.

    Examples
    --------
    ``filter_frame(dask.dataframe.read_parquet("samples"), model).to_parquet("estimates")``
    """
    if not partitioned:
        if model.time is None:
            raise ValueError(
                "time: expected the column of times, since a shuffle does not keep the order, got None; or "
                "partitioned=True, if each key's samples are in one partition, in order"
            )
        frame = frame.shuffle(on=key, npartitions=npartitions)
    meta = filter_table(model, frame._meta_nonempty, key=key).iloc[:0]

    def advance(part: Any) -> Any:
        """Filter the keys of a partition."""
        return filter_table(model, part, key=key, sort=not partitioned)

    return frame.map_partitions(advance, meta=meta, enforce_metadata=False)
