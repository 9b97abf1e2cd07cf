"""Values that no program means to pass: other arrays than expected, other things, sequences and numbers that lie."""

import copy

import numpy as np


class Sub(np.ndarray):
    """A subclass of ndarray."""


class Fleeting:
    """A sequence that makes its entries when asked for them, and may lie about how many there are."""

    def __init__(self, entries, length):
        self.entries, self.length = list(entries), length

    def __len__(self):
        return self.length

    def __getitem__(self, place):
        return copy.copy(self.entries[place])


class Resizing:
    """A number that frees arrays when it is asked what it is."""

    def __init__(self, victims):
        self.victims = victims

    def __index__(self):
        for array in self.victims:
            array.resize(0, refcheck=False)
        return 1

    __bool__ = __float__ = __index__


ARRAYS = (
    lambda a, g: np.round(np.nan_to_num(a)).astype(int), lambda a, g: a.astype(np.float32), lambda a, g: a.tolist(),
    lambda a, g: np.repeat(a, 2, axis=0)[::2] if a.ndim else a, lambda a, g: a.view(Sub), lambda a, g: a.astype(">f8"),
    lambda a, g: a[None], lambda a, g: a[:-1] if a.ndim else a, lambda a, g: a.T.copy(), lambda a, g: a.copy("F"),
    lambda a, g: np.concatenate((a, a)) if a.ndim else a, lambda a, g: a[..., :0], lambda a, g: a.ravel().copy(),
    lambda a, g: a.astype(object), lambda a, g: np.empty((0,) * a.ndim), lambda a, g: np.ma.masked_invalid(a),
    lambda a, g: np.lib.stride_tricks.as_strided(a, strides=(0,) * a.ndim), lambda a, g: a.astype(complex),
    lambda a, g: np.frombuffer(b"\0" + a.tobytes(), np.uint8)[1:].view(a.dtype).reshape(a.shape),
    lambda a, g: frozen(a), lambda a, g: np.zeros_like(a), lambda a, g: -a, lambda a, g: a.copy(),
    lambda a, g: a * 1e-320,
    *(lambda a, g, bad=bad: placed(a, bad, g)
      for bad in (np.nan, np.inf, -np.inf, 1e300, -1e18, 1e-310, -0.5, 3.0, 99.0)),
    *(lambda a, g, bad=bad: np.full_like(a, bad, dtype=a.dtype if a.dtype.kind == "f" else float)
      for bad in (np.nan, np.inf, 1e300, 1e18, 7.0)),
)  # fmt: skip
OTHERS = (
    None, object(), "text", b"bytes", -1, 0, 1, 2, 10**6, 2**31, 2**62, -(2**62), 10**400, np.nan, 1e300, True, (),
    (1, 2), [], [1.0, None], {}, np.float64(1.0), np.zeros(()), np.empty(0), np.zeros((1, 1)), np.ones(8), 1j,
    np.zeros((0, 5, 1)), np.empty((10**9, 0)), np.array("x"), range(3), type, lambda: None,
)  # fmt: skip


def frozen(a):
    a = a.copy()
    a.setflags(write=False)
    return a


def placed(a, bad, g):
    """Put a number anywhere."""
    a = a.copy()
    if a.size:
        if a.dtype.kind != "f":
            most = min(2.0**40, float(np.iinfo(a.dtype).max)) if a.dtype.kind in "iu" else 2.0**40
            bad = np.clip(bad, -most, most) if np.isfinite(bad) else most
        a.reshape(-1)[g.integers(a.size)] = bad
    return a


def spoilt(value, g, all_arrays):
    """Something else in place of a value."""
    if isinstance(value, np.ndarray) and g.random() < 0.7:
        with np.errstate(all="ignore"):
            return ARRAYS[g.integers(len(ARRAYS))](value, g)
    draw = g.random()
    if draw < 0.1 and all_arrays:
        return all_arrays[g.integers(len(all_arrays))]
    if draw < 0.15:
        return Resizing(all_arrays)
    return OTHERS[g.integers(len(OTHERS))]


def leaves(tree):
    return [leaf for part in tree for leaf in leaves(part)] if isinstance(tree, tuple) else [tree]


def mutated(tree, g, chance, every):
    """Arguments with some leaves spoilt and some tuples shorter, longer or another sequence."""
    if not isinstance(tree, tuple):
        return spoilt(tree, g, every) if g.random() < chance else tree
    found = tuple(mutated(part, g, chance, every) for part in tree)
    draw = g.random() / chance
    if draw > 0.3:
        return found
    return (found[:-1], (*found, None), list(found), Fleeting(found, len(found)), Fleeting(found, 3))[g.integers(5)]


def guarded(tree, kept):
    """Copies of the arrays, each in the middle of a longer one, of which the ends are to stay."""
    if isinstance(tree, tuple):
        return tuple(guarded(part, kept) for part in tree)
    if not isinstance(tree, np.ndarray):
        return tree
    longer = np.full(tree.size + 64, 77, dtype=tree.dtype)
    kept.append(longer)
    inner = longer[32 : 32 + tree.size].reshape(tree.shape)
    inner[...] = tree
    return inner
