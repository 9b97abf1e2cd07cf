"""Both forms of the smoothing pass."""

import pytest
import support


@pytest.fixture(params=["kernel", "definition"])
def form(request, monkeypatch):
    if request.param == "definition":
        support.without_kernel(monkeypatch)
    else:
        support.needs_kernel()
    return request.param
