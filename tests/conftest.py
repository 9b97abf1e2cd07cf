"""Let property tests draw the same examples in every run, and put numpy's treatment of errors back."""

import numpy as np
import pytest
from hypothesis import settings

# A run that fails must fail again; `pytest --hypothesis-profile search` draws others, and finds new defects.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("search", derandomize=False)
settings.load_profile("repeatable")


@pytest.fixture(autouse=True)
def numpy_errors_stay_as_they_were():
    """Put it back: after an interrupt within numpy.linalg every invalid number raises "Singular matrix"."""
    with np.errstate():
        yield
