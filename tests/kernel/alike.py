"""What a filter shows after each step, and how that by the kernel and that by the definition are held together."""

import numpy as np
import support

SHOWN = (
    *support.STATE, "z", "y", "S", "SI", "K", "T", "e", "weights", "clipped", "y_bounded", "spread", "log_likelihood",
    "mahalanobis",
)  # fmt: skip


def shown(kf, *more):
    """What a filter shows, by name, with copies of other attributes."""
    found = {name: np.array(getattr(kf, name), dtype=float) for name in SHOWN}
    return found | {name: np.array(getattr(kf, name), dtype=float) for name in more}


def assert_alike(ours, theirs, rtol, looser=()):
    """Hold rows of attributes together, each in the size of its largest number; some as near as is said of them.

    What is learned of a sensor has numbers of many units: each is held on its own.
    """
    for k, (one, two) in enumerate(zip(ours, theirs, strict=True)):
        for name, b in two.items():
            a, near = np.nan_to_num(one[name], nan=-7.0), dict(looser).get(name, rtol)
            b = np.nan_to_num(b, nan=-7.0)
            assert a.shape == b.shape, (k, name)
            size = 1.0 + (np.abs(b) if name in ("_memory", "information") else np.abs(b).max(initial=0.0))
            assert np.all(np.abs(a - b) <= near * size), f"step {k}, {name}: {a} instead of {b}"
