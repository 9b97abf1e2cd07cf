"""Our filters in the shapes that other libraries expect: thin classes, each imported with its library or not at all.

* `sktime`: `RobustKalmanTransformer`, a transformer of series with fit and transform.
* `darts`: `RobustKalmanModel`, a filtering model of Darts.
* `river`: `RiverTracker`, a tracker as a regressor of river.
* `series`: what the first two share: a model where none was given, its noises, the estimates.

Nothing imports these modules::

    from robust_filterpy.adapters.sktime import RobustKalmanTransformer

Imports from below: `filters`, `smoothing`, `noise`, `identification`.
"""

__all__: list[str] = []
