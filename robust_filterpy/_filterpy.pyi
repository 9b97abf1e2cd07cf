from collections.abc import Callable
from typing import Any, Protocol

from numpy.typing import ArrayLike

from robust_filterpy._checks import Array

class Shaped(Protocol):
    """An array as scipy's functions return it."""

    @property
    def shape(self) -> Any: ...

class Assigned:
    """An array that takes whatever numpy makes one of: ``kf.R = 5``."""

    def __get__(self, instance: Any, owner: Any = None) -> Array: ...
    def __set__(self, instance: Any, value: ArrayLike | Shaped) -> None: ...

class _Filter:
    """What all of them have."""

    dim_x: int
    dim_z: int
    x: Assigned
    P: Assigned
    Q: Assigned
    R: Assigned
    z: Any
    x_prior: Array
    P_prior: Array
    x_post: Array
    P_post: Array
    inv: Callable[[Array], Array]
    _log_likelihood: float | None
    _likelihood: float | None
    _mahalanobis: float | None

class KalmanFilter(_Filter):
    dim_u: int
    B: Any
    F: Assigned
    H: Assigned
    M: Assigned
    alpha: float
    _alpha_sq: float
    _I: Array
    def __init__(self, dim_x: int, dim_z: int, dim_u: int = 0) -> None: ...
    def predict(
        self, u: ArrayLike | None = None, B: ArrayLike | None = None, F: ArrayLike | None = None, Q: Any = None
    ) -> None: ...
    def update(self, z: ArrayLike | None, R: Any = None, H: ArrayLike | None = None) -> None: ...
    def measurement_of_state(self, x: ArrayLike) -> Array: ...
    def rts_smoother(
        self, Xs: Array, Ps: Array, Fs: Any = None, Qs: Any = None, inv: Any = ...
    ) -> tuple[Array, Array, Array, Array]: ...
    def test_matrix_dimensions(
        self, z: Any = None, H: Any = None, R: Any = None, F: Any = None, Q: Any = None
    ) -> None: ...

class ExtendedKalmanFilter(_Filter):
    dim_u: int
    B: Any
    F: Assigned
    _I: Array
    def __init__(self, dim_x: int, dim_z: int, dim_u: int = 0) -> None: ...

class UnscentedKalmanFilter(_Filter):
    dt: float
    hx: Callable[..., Any]
    fx: Callable[..., Any]
    points_fn: Any
    msqrt: Callable[..., Any]
    x_mean: Any
    z_mean: Any
    residual_x: Any
    residual_z: Any
    state_add: Any
    sigmas_f: Array
    sigmas_h: Array
    Wm: Array
    Wc: Array
    _dim_x: int
    _dim_z: int
    _dt: float
    _num_sigmas: int
    def __init__(
        self, dim_x: int, dim_z: int, dt: float, hx: Any, fx: Any, points: Any, *args: Any, **kwargs: Any
    ) -> None: ...
    def predict(self, dt: float | None = None, UT: Any = None, fx: Any = None, **fx_args: Any) -> None: ...
    def compute_process_sigmas(self, dt: float, fx: Any = None, **fx_args: Any) -> None: ...
    def cross_variance(self, x: Array, z: Array, sigmas_f: Array, sigmas_h: Array) -> Array: ...
    def rts_smoother(
        self, Xs: Array, Ps: Array, Qs: Any = None, dts: Any = None, UT: Any = None
    ) -> tuple[Array, Array, Array]: ...

class CubatureKalmanFilter(_Filter):
    hx: Callable[..., Any]
    fx: Callable[..., Any]
    x_mean: Any
    z_mean: Any
    residual_x: Any
    residual_z: Any
    sigmas_f: Array
    sigmas_h: Array
    _dt: float
    _num_sigmas: int
    def __init__(self, dim_x: int, dim_z: int, dt: float, hx: Any, fx: Any, *args: Any, **kwargs: Any) -> None: ...
    def predict(self, dt: float | None = None, fx_args: Any = ()) -> None: ...

class EnsembleKalmanFilter(_Filter):
    dt: float
    N: int
    hx: Callable[..., Any]
    fx: Callable[..., Any]
    sigmas: Array
    _mean: Array
    _mean_z: Array
    def __init__(self, x: Any, P: Any, dim_z: int, dt: float, N: int, hx: Any, fx: Any) -> None: ...
    def initialize(self, x: ArrayLike, P: ArrayLike) -> None: ...

class FixedLagSmoother:
    dim_x: int
    dim_z: int
    N: int | None
    x: Assigned
    x_s: Array
    P: Assigned
    Q: Assigned
    R: Assigned
    F: Assigned
    H: Assigned
    K: Array
    B: Any
    y: Array
    S: Array
    count: int
    xSmooth: list[Array]
    def __init__(self, dim_x: int, dim_z: int, N: int | None = None) -> None: ...
