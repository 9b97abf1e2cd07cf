"""compare: which of several models agrees best with a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._brief import Pictured
from robust_filterpy._checks import Array
from robust_filterpy.identification.judging.validate import any_model
from robust_filterpy.identification.models.grey_box import GreyBoxModel
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.noise import ordinary_fit, ordinary_samples
from robust_filterpy.identification.models.recording import ANY_TIMES
from robust_filterpy.identification.models.signals import recorded_output, recording, table
from robust_filterpy.identification.models.state_space import StateSpaceModel

if TYPE_CHECKING:
    import control


class Compared(NamedTuple):
    """One model of a comparison.

    Attributes
    ----------
    name : str
        Its name.
    fit : float
        Fit of the output from inputs alone, in percent on ordinary samples; without input that of one step ahead. Of
        several outputs the mean of their fits.
    one_step : float
        Fit one step ahead on ordinary samples.
    all : float
        The first fit on all samples.
    """

    name: str
    fit: float
    one_step: float
    all: float


@dataclass(frozen=True, eq=False)
class Comparison(Pictured):
    """Models on one recording, the best first.

    Attributes
    ----------
    rows : tuple of Compared
        Sorted by their fit on ordinary samples.
    measured : ndarray, shape (N,) or (N, n_outputs)
        Measured output; NaN where it is missing.
    outputs : dict of str to ndarray, of the shape of `measured`
        Output of each model that its fit is of, the best first.
    samples : int
        How many measured samples all of them predict.
    ordinary : int
        How many of these are ordinary: within three standard deviations of the noise of the model with the least.
    index : pandas.Index or None
        When the samples were taken, if the recording was a pandas object.
    """

    picture = "workbench.plot_comparison"

    rows: tuple[Compared, ...]
    measured: Array
    outputs: dict[str, Array]
    samples: int
    ordinary: int
    index: Any = None

    def to_frame(self) -> Any:
        """Return the table as a pandas DataFrame, a row for each model.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        columns = {field: [getattr(row, field) for row in self.rows] for field in Compared._fields[1:]}
        return table(columns, [row.name for row in self.rows], "model")

    def to_text(self) -> str:
        """Return the table.

        Returns
        -------
        str
        """
        width = max(10, *(len(row.name) for row in self.rows)) + 2
        lines = [f"{'model':<{width}}{'fit, %':>10}{'1 step':>10}{'all':>10}"]
        lines += [f"{row.name:<{width}}{row.fit:>10.2f}{row.one_step:>10.2f}{row.all:>10.2f}" for row in self.rows]
        return "\n".join([*lines, f"fits on {self.ordinary} ordinary samples, and on all {self.samples}"])

    __str__ = to_text


def compare(
    models: Mapping[str, Model | StateSpaceModel | GreyBoxModel | control.TransferFunction],
    y: ArrayLike,
    u: ArrayLike | None = None,
    t: ArrayLike | None = None,
) -> Comparison:
    """Rank models by their fit on the ordinary samples of one recording.

    Parameters
    ----------
    models : mapping of str to Model, StateSpaceModel, GreyBoxModel or control.TransferFunction
        Models by name, all of the same outputs; transfer functions as `validate` takes them.
    y : array_like, shape (N,) or (N, n_outputs)
        Measured output; NaN where it is missing.
    u : array_like, shape (N,) or (N, n_inputs), optional
        Input.
    t : array_like, shape (N,), optional
        Times in s, for a `GreyBoxModel`; with a model in discrete time their steps are equal. Default: those of the
        index.

    Returns
    -------
    Comparison

    Raises
    ------
    ValueError
        If there is no model, or y, u or t does not fit one of them.
    TypeError
        If models is no mapping to such models.

    Notes
    -----
    Every model is judged on the same samples: those that all predict, and of these the ones that are ordinary to the
    model whose residuals have the least median size.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.identification import FIR, identify
    >>> rng = np.random.default_rng(1)
    >>> u = rng.choice([-1.0, 1.0], 300)
    >>> y = np.concatenate(([0.0], 2.0 * u[:-1])) + 0.1 * rng.normal(size=300)
    >>> y[::20] += 30.0
    >>> found = compare({"right": identify(y, u, FIR(1)), "late": identify(y, u, FIR(1, nk=2))}, y, u)
    >>> [row.name for row in found.rows]
    ['right', 'late']
    """
    if not isinstance(models, Mapping):
        raise TypeError(f'models: expected {{"name": model, ..}}, got {_checks.shown(models)}')
    if not models:
        raise ValueError("models: expected at least one model, got none")
    candidates = {str(name): any_model(f"models[{name!r}]", model, y, u) for name, model in models.items()}
    given = np.shape(y)
    counts, asked = {name: _n_outputs(model) for name, model in candidates.items()}, given[1] if len(given) == 2 else 1
    if set(counts.values()) != {asked} and given[:1] != (1,):
        each = ", ".join(f"models[{name!r}] of {count}" for name, count in counts.items())
        raise ValueError(
            f"models: expected models of as many outputs as y has, {asked}, got {each}; compare the models of the same "
            "outputs, and of y those columns"
        )
    index, residuals, outputs = recording(ANY_TIMES, y=y, u=u)[0].index, {}, {}
    for name, model in candidates.items():
        residuals[name] = _columns(model.residuals(y, u, t))
        measured = np.column_stack([recorded_output(column) for column in _columns(_checks.numbers("y", y)).T])
        alone = not isinstance(model, Model) or model.structure.n_inputs
        outputs[name] = _columns(model.free_run(y, u, t)) if alone else measured - residuals[name]
    shared = ~np.any(np.isnan(list(residuals.values())), axis=0)
    if not shared.any(axis=0).all():
        raise ValueError("y: expected measured samples that all models predict, got none; record more")
    for j, (own, good) in enumerate(zip(measured.T, shared.T, strict=True)):
        if np.ptp(own[good]) == 0.0:
            which = f" of output {j}" if measured.shape[1] > 1 else ""
            raise ValueError(f"y: expected samples{which} that differ, found a constant: its fit is undefined")
    ordinary = np.zeros(shared.shape, dtype=bool)
    for j, good in enumerate(shared.T):
        closest = min(residuals.values(), key=lambda left: float(np.median(np.abs(left[good, j]))))
        ordinary[:, j] = ordinary_samples(np.where(good, closest[:, j], np.nan), measured[:, j])
    rows = []
    for name, output in outputs.items():
        pairs = ((output, ordinary), (measured - residuals[name], ordinary), (output, shared))
        rows.append(Compared(name, *(_fit(measured, *pair) for pair in pairs)))
    rows.sort(key=lambda row: -row.fit if np.isfinite(row.fit) else np.inf)
    one = measured.shape[1] == 1
    shown = {row.name: outputs[row.name][:, 0] if one else outputs[row.name] for row in rows}
    measured = measured[:, 0] if one else measured
    return Comparison(tuple(rows), measured, shown, int(shared.sum()), int(ordinary.sum()), index)


def _n_outputs(model: Any) -> int:
    """Return how many outputs a model has."""
    return 1 if isinstance(model, Model) else len(model.noise)


def _columns(signal: Any) -> Array:
    """Return signals of outputs as columns."""
    values = np.asarray(signal, dtype=float)
    return values.reshape(-1, 1) if values.ndim == 1 or values.shape[0] == 1 else values


def _fit(measured: Array, output: Array, counts: Any) -> float:
    """Return the mean over the outputs of the fit on the samples that count."""
    return float(np.mean([ordinary_fit(*columns) for columns in zip(measured.T, output.T, counts.T, strict=True)]))
