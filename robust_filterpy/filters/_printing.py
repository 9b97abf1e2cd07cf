"""What `print` and `repr` show of a filter."""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.common import pretty_str

from robust_filterpy._brief import lines_of


class PrintingMixin:
    """Show a filter on a screen, and in full."""

    __slots__ = ()

    def __str__(self) -> str:
        """Show where the filter stands, how it judges and what it has learnt; `repr` shows every matrix."""
        kf: Any = self
        parts = {"x": np.ravel(kf.x), "std": np.sqrt(np.maximum(np.diag(kf.P), 0.0))}
        z = np.ravel(kf.z)
        if not all(value is None for value in z):
            parts["last z"] = z
            parts["its weights"] = np.ravel(kf.weights)
        return "\n".join(
            [
                f"{type(kf).__name__}: {kf.dim_x} states, {kf.dim_z} measured; repr() shows every matrix",
                *lines_of({**parts, **_judgement(kf)}),
            ]
        )

    def __repr__(self) -> str:
        """Show the choices and everything that filterpy shows."""
        kf: Any = self
        lines = super().__repr__().split("\n")
        names = ["influence", "scaling", "information", "grouping", "spread", "weights", "clipped", "e", "T"]
        if kf.noise is not None:
            names[:3] = "noise", "process"
            names[3:4] = "R_learnt", "noise_learnt", "process_scale", "outlier_probability"
        elif kf.patience is not None:
            names[4:4] = "patience", "refused", "recoveries"
        return "\n".join(
            [f"{type(kf).__name__} object", *lines[1:], *(pretty_str(name, getattr(kf, name)) for name in names)]
        )


def _judgement(kf: Any) -> dict[str, Any]:
    """Return how a filter judges measurements, and what it has learnt of them."""
    if kf.noise is None:
        names = ["influence", "scaling", "information", "grouping"]
        if kf.patience is not None:
            names += ["patience", "refused", "recoveries"]
        parts = {name: getattr(kf, name) for name in names}
        return {**parts, "spread, learned": kf.spread} if np.isfinite(kf.spread).any() else parts
    parts = {name: getattr(kf, name) for name in ("noise", "process", "grouping")}
    if kf.noise_learnt is not None:
        parts["variances of ordinary noise, learned"] = np.diag(kf.R_learnt)
        parts["share of outliers, learned"] = kf.noise_learnt.contamination
        parts["their size over ordinary noise"] = kf.noise_learnt.scale_ratio
    if kf.process is not None:
        parts["factor of Q, learned"] = kf.process_scale
    return parts
