"""Both forms of the smoothing pass."""

import pytest

from robust_filterpy.smoothing import linear_pass


@pytest.fixture(params=["compiled", "definition"])
def form(request, monkeypatch):
    if request.param == "definition":
        monkeypatch.setattr(linear_pass, "available", lambda: False)
    else:
        pytest.importorskip("numba")
    return request.param
