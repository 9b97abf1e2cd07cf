"""A transformer of sktime, for its pipelines, panels and forecasters: series without their noise and their outliers.

This module imports sktime, and nothing imports this module::

    from robust_filterpy.adapters.sktime import RobustKalmanTransformer
"""

from __future__ import annotations

from typing import Any

import pandas as pd
from sktime.transformations.base import BaseTransformer

from robust_filterpy.adapters.series import SeriesModel

__all__ = ["RobustKalmanTransformer"]


class RobustKalmanTransformer(BaseTransformer):  # type: ignore[misc, unused-ignore]
    """Replace series by their estimates, without believing outliers.

    Parameters
    ----------
    filter : RobustKalmanFilter or filterpy's KalmanFilter, optional
        The model of all columns together, with x and P where each series begins. By default each column is a level with
        a slope, both wandering, whose noises `fit` learns from the series that it is given.
    smoothed : bool, default False
        Whether an estimate uses later values too, as `smooth` does. As a step in front of a forecaster leave it False.
    states : bool, default False
        Whether to return the states, in columns x0, x1, .., in place of what would have been measured.

    Attributes
    ----------
    model_ : SeriesModel
        The filters, after `fit`.

    Raises
    ------
    TypeError
        By `fit`, if the filter is not a linear one.
    ValueError
        By `fit` and `transform`, if the columns are not as many as the filter measures, or a value is infinite.

    Warns
    -----
    UserWarning
        By `fit`, if there are fewer than ten values to learn noises from.

    Notes
    -----
    Values that are NaN are missing, and are estimated like the others. Samples are taken to be equally far apart: the
    index is handed through and not looked at. ``pip install "robust_filterpy[sktime]"``.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.adapters.sktime import RobustKalmanTransformer
    >>> sold = np.cumsum(np.random.default_rng(0).normal(size=50))
    >>> sold[30] = 1000.0
    >>> bool(abs(RobustKalmanTransformer().fit_transform(sold)[30, 0] - sold[29]) < 10.0)
    True

    ``RobustKalmanTransformer() * NaiveForecaster()`` forecasts from the filtered series.
    """

    _tags = {
        "authors": ["robust_filterpy"],
        "maintainers": ["robust_filterpy"],
        "python_dependencies": "filterpy",
        "scitype:transform-input": "Series",
        "scitype:transform-output": "Series",
        "scitype:instancewise": True,
        "X_inner_mtype": "pd.DataFrame",
        "y_inner_mtype": "None",
        "capability:multivariate": True,
        "capability:missing_values": True,
        "capability:missing_values:removes": True,
        "capability:inverse_transform": False,
        # A forecast made from estimates is a forecast as it stands.
        "skip-inverse-transform": True,
        "transform-returns-same-time-index": True,
        "fit_is_empty": False,
    }

    def __init__(self, filter: Any = None, smoothed: bool = False, states: bool = False) -> None:
        """Keep the arguments, which sktime clones."""
        self.filter, self.smoothed, self.states = filter, smoothed, states
        super().__init__()

    def _fit(self, X: pd.DataFrame, y: Any = None) -> RobustKalmanTransformer:
        """Learn the noises, or check the filter."""
        self.model_ = SeriesModel.of(self.filter, X.to_numpy(dtype=float))
        return self

    def _transform(self, X: pd.DataFrame, y: Any = None) -> pd.DataFrame:
        """Return the estimates, with the index of X."""
        estimates = self.model_.estimates(X.to_numpy(dtype=float), smoothed=self.smoothed, states=self.states)
        columns = [f"x{i}" for i in range(estimates.shape[1])] if self.states else X.columns
        return pd.DataFrame(estimates, index=X.index, columns=columns)

    @classmethod
    def get_test_params(cls, parameter_set: str = "default") -> list[dict[str, Any]]:
        """Return arguments for the checks of estimators of sktime.

        Parameters
        ----------
        parameter_set : str, default "default"
            Not used: there is one set.

        Returns
        -------
        list of dict
        """
        return [{}, {"smoothed": True}, {"states": True}]
