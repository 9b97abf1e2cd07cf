"""The search for a model leaves the threads of BLAS as it found them, and needs none."""

import sys

import numpy as np
import pytest

from robust_filterpy import OutputError, identify
from robust_filterpy.identification.estimation import prediction_error as _threads
from robust_filterpy.identification.estimation import search


def test_a_search_has_one_thread_and_gives_the_others_back(monkeypatch):
    threadpoolctl = pytest.importorskip("threadpoolctl")
    seen, ends = [], search.ends

    def counted():
        return [pool["num_threads"] for pool in threadpoolctl.threadpool_info() if pool["user_api"] == "blas"]

    def noted(*args):
        seen.append(counted())
        return ends(*args)

    monkeypatch.setattr(sys.modules["robust_filterpy.identification.estimation.estimate"], "ends", noted)
    rng = np.random.default_rng(0)
    u = rng.normal(size=200)
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        before = counted()
        identify(np.convolve(u, [0.0, 1.0])[:200] + 0.1 * rng.normal(size=200), u, OutputError(0, 1))
        assert counted() == before
    assert seen and set(seen[0]) == {1}


def test_without_threadpoolctl_it_goes_its_way(monkeypatch):
    monkeypatch.setattr(_threads, "_controller", lambda: None)
    with _threads.one_thread():
        pass
