"""Steps of the level are those of the recording, the same for every structure that is compared."""

import numpy as np
from scipy.signal import lfilter

from robust_filterpy.identification import OutputError
from robust_filterpy.identification.judging import select


def test_every_structure_has_the_same_steps(monkeypatch):
    rng = np.random.default_rng(9101)
    u = rng.choice([-1.0, 1.0], 500)
    y = lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + 0.2 * rng.normal(size=500)
    y[300:] += 1.0
    models, levels = [], []
    identify = select.identify

    def recorded(y, *arguments, **options):
        model = identify(y, *arguments, **options)
        if model.structure.nf:
            models.append({y.size - one.place[0] for one in model.findings if one.kind == "step"})
            levels.append(options.get("trend"))
        return model

    monkeypatch.setattr(select, "identify", recorded)
    chosen = select.select_structure(y, u, na=range(1, 3), nk=range(3), held_out=0.0, progress=False)
    assert chosen.best.structure == OutputError(2, 2)
    assert [one.kind for one in chosen.best.findings] == ["step"]
    assert len(models) > 3
    assert all(one == models[0] for one in models)
    # It is looked for in the largest structure alone.
    assert sum(one is None for one in levels) == 1
