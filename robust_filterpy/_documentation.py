"""The sections of the documentation that messages point to, by their names."""

from __future__ import annotations

from typing import Final

#: Sections of "Troubleshooting by symptom".
FOLLOWS, STOPPED, SMALL = "It follows outliers", "It stopped following", "All weights are small"
PAGE: Final = "Troubleshooting by symptom"


def pointer(*sections: str) -> str:
    """Return where to read on, as "see "All weights are small" in "Troubleshooting by symptom"."""
    names = " and ".join(f'"{section}"' for section in dict.fromkeys(sections))
    return f'see {names} in the documentation\'s "{PAGE}"'
