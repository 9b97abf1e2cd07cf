"""What tests of the kernel share."""

import pytest
import support

from robust_filterpy.filters.policies import Bounded, Mixture


@pytest.fixture
def by_kernel_alone(monkeypatch):
    """Let no filter ask the definition."""
    support.needs_kernel()

    def not_asked(*args, **kwargs):
        raise AssertionError("the definition was asked")

    for name in ("predicted", "corrected", "corrected_by_moments"):
        for policy in (Bounded, Mixture):
            monkeypatch.setattr(policy, name, not_asked)


@pytest.fixture
def both(monkeypatch):
    """Run a program by the kernel, and by the definition, and return what each makes of it."""
    support.needs_kernel()

    def run(program):
        ours = program()
        monkeypatch.undo()
        support.without_kernel(monkeypatch)
        theirs = program()
        monkeypatch.undo()
        return ours, theirs

    return run
