"""Estimator unit tests: scenarios with everything known, assertions that are theorems, and checks with a name.

People who filter with something else can use them too: a filter is whatever has ``x, P, F, H, Q, R``, ``predict()`` and
``update(z)``, a tracker whatever has ``theta`` and ``update(y, u)``.

* `scenarios`: recordings with everything known, and what a filter or a tracker makes of them.
* `assertions`: theorems about such runs, and about what a program relies on.
* `checks`: every promise of a filter, by name: `check_filter`, a list for pytest.
* `studies`: a trial repeated with other random numbers, and how far its figures can be trusted.

Imports from below: `influence`, `diagnostics`, `identification`, `plants`. pytest is not needed.
"""

from __future__ import annotations

from robust_filterpy._lazy import elsewhere
from robust_filterpy.identification.models.noise import fit_percent
from robust_filterpy.testing import assertions, checks, scenarios, studies
from robust_filterpy.testing.assertions import *  # noqa: F403
from robust_filterpy.testing.checks import *  # noqa: F403
from robust_filterpy.testing.scenarios import *  # noqa: F403
from robust_filterpy.testing.studies import *  # noqa: F403

# Each package lists its own names, and each of its modules its own.
__all__: list[str] = ["fit_percent"]
__all__ += assertions.__all__
__all__ += checks.__all__
__all__ += scenarios.__all__
__all__ += studies.__all__

__getattr__ = elsewhere(__name__)
