"""The test bench as a page of the site, made from the code: every scenario, every assertion, every check's theorem.

python docs/testing_page.py > docs/testing.md
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping, Sequence

from robust_filterpy import testing
from robust_filterpy.testing import contamination, models, plants
from robust_filterpy.testing.bench import FILTER_TAGS, Check
from robust_filterpy.testing.checks import FILTER_PROMISES

__all__ = ["page"]

INTRODUCTION = """\
# Test your own filter

```{index} ! unit test, ! test my filter
```

`robust_filterpy.testing` tests a state estimator as scikit-learn's `check_estimator` tests a classifier. A filter is
whatever has `x, P, F, H, Q, R`, `predict()` and `update(z)`. For a recursive identifier, whatever has `theta` and
`update(y, u)`, there are scenarios and assertions. pytest is not needed.

```python
from filterpy.kalman import KalmanFilter
from robust_filterpy import testing

testing.check_filter(KalmanFilter, not_claimed=("robust", "nan", "validates"))
```

`KalmanFilter` stands for a function of dim_x and dim_z that returns a new filter, whose x, P, F, H, Q and R are then
set by name. A class that is made in another way goes into one:
`lambda n, m: MyFilter(F=np.eye(n), H=np.zeros((m, n)), ..)`.

What an estimator does not claim it is not tested for (`not_claimed`); what is known to be broken is listed with its
reason (`expected_failures={"name": "reason"}`). The error has both names, that of a check and in brackets its claim's.
Under pytest each check is a test of its own:

```python
import pytest
from robust_filterpy import testing


@pytest.mark.parametrize("check", testing.filter_checks(not_claimed=("robust",)))
def test_my_filter(check):
    check(MyFilter)
```
"""


def page() -> str:
    """Return the page, in Markdown.

    Returns
    -------
    str
    """
    assertions = [name for name in testing.__all__ if name.startswith("assert_")]
    parts = [
        INTRODUCTION,
        "## Scenarios: `draw(name, steps, contamination=..., rng=...)`\n",
        _table(models.__doc__),
        _table(plants.__doc__),
        "Ways in which a recording goes wrong (`contamination`), alone or several after one another, with options as\n"
        '`contamination={"bursts": {"length": 8}}`:\n',
        _table(contamination.__doc__),
        "## Assertions\n",
        "Theorems about one estimator alone, such as a bounded influence, are the checks below.\n",
        _rows(("assertion", "what it asserts"), [(f"`{name}`", _first_line(name)) for name in assertions]),
        *_checks("Checks of a filter: `check_filter(make)`", FILTER_PROMISES, FILTER_TAGS),
    ]
    return "\n".join(parts)


def _checks(title: str, promises: Sequence[Check], tags: Mapping[str, str]) -> list[str]:
    """Return a section: what can be claimed, and every check with its theorem."""
    rows = [
        (f"`{entry.name}`", entry.theorem, ", ".join(sorted(entry.needs)), "yes" if entry.stochastic else "")
        for entry in promises
    ]
    return [
        f"## {title}\n",
        _rows(("claim", "meaning"), [(f"`{tag}`", meaning) for tag, meaning in tags.items()]),
        _rows(("check", "theorem", "tested if claimed", "may fail by chance"), rows),
    ]


def _first_line(name: str) -> str:
    """Return the first sentence of an assertion's docstring."""
    text = (inspect.getdoc(getattr(testing, name)) or "").splitlines()[0]
    return text.removeprefix("Assert that ")


def _table(docstring: str | None) -> str:
    """Return the simple table of a module's docstring."""
    lines = (docstring or "").splitlines()
    edges = [k for k, line in enumerate(lines) if line.startswith("===")]
    head, *rows = (
        re.split(r"\s{2,}", lines[k].strip()) for k in range(edges[0] + 1, edges[-1]) if not lines[k].startswith("===")
    )
    return _rows(head, rows)


def _rows(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table, in Markdown."""
    lines = ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in (head, *rows)]
    return "\n".join([lines[0], "|---" * len(head) + "|", *lines[1:], ""])


if __name__ == "__main__":
    print(page(), end="")
