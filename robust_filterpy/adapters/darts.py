"""A filtering model of Darts, next to its `KalmanFilter` and `MovingAverageFilter`.

This module imports Darts, and nothing imports this module::

    from robust_filterpy.adapters.darts import RobustKalmanModel
"""

from __future__ import annotations

from typing import Any

from darts import TimeSeries
from darts.models.filtering.filtering_model import FilteringModel

from robust_filterpy.adapters.series import SeriesModel

__all__ = ["RobustKalmanModel"]


class RobustKalmanModel(FilteringModel):  # type: ignore[misc, unused-ignore]
    """Filter series without believing outliers.

    Parameters
    ----------
    filter : RobustKalmanFilter or filterpy's KalmanFilter, optional
        The model of all components together, with x and P where each series begins. By default each component is a
        level with a slope, both wandering; their noises are learned by `fit`, or from the first series filtered.
    smoothed : bool, default False
        Whether an estimate uses later values too, as `smooth` does.

    Attributes
    ----------
    model : SeriesModel or None
        The filters, once there are any.

    Notes
    -----
    ``pip install "robust_filterpy[darts]"``.

    Examples
    --------
    ``RobustKalmanModel().filter(AirPassengersDataset().load())`` is a series with the same times and components.
    """

    def __init__(self, filter: Any = None, smoothed: bool = False) -> None:
        """Keep the arguments."""
        super().__init__()
        self.filter_, self.smoothed = filter, smoothed
        self.model: SeriesModel | None = None

    def __str__(self) -> str:
        """Return the class and its arguments."""
        return f"{type(self).__name__}(filter={self.filter_}, smoothed={self.smoothed})"

    def fit(self, series: TimeSeries) -> RobustKalmanModel:
        """Learn the noises of a level with a slope for each component, or check the filter.

        Parameters
        ----------
        series : TimeSeries
            One sample of each component; NaN marks what is missing.

        Returns
        -------
        RobustKalmanModel
            Itself.

        Raises
        ------
        TypeError
            If the filter is not a linear one.
        ValueError
            If there are not as many components as the filter measures, or a value is infinite.

        Warns
        -----
        UserWarning
            If a component has fewer than ten values to learn noises from.
        """
        super().filter(series)
        self.model = SeriesModel.of(self.filter_, series.values().astype(float))
        return self

    def filter(self, series: TimeSeries) -> TimeSeries:
        """Return the estimates of a series, which begins anew.

        Parameters
        ----------
        series : TimeSeries
            One sample of each component; NaN marks what is missing, and is estimated too.

        Returns
        -------
        TimeSeries
            With the times and components of the series.

        Raises
        ------
        TypeError, ValueError
            As `fit`.
        """
        super().filter(series)
        if self.model is None:
            self.model = SeriesModel.of(self.filter_, series.values().astype(float))
        estimates = self.model.estimates(series.values().astype(float), smoothed=self.smoothed)
        return series.with_values(estimates.astype(series.dtype)[:, :, None])
