"""Progress bars, where somebody looks at a terminal."""

from __future__ import annotations

import sys
from typing import Any


def progress_bar(total: int | None, progress: bool | None, unit: str) -> Any:
    """Return tqdm's bar, or something that takes its calls and shows nothing."""
    shown = sys.stderr is not None and sys.stderr.isatty() if progress is None else progress
    if shown:
        try:
            from tqdm import tqdm

            return tqdm(total=total, unit=unit)
        except ImportError as error:
            if progress:
                raise ImportError("progress=True needs tqdm; use pip install tqdm") from error
    return _NoBar()


class _NoBar:
    """Stand in for a progress bar."""

    def update(self) -> None:
        """Ignore a finished run."""

    def set_postfix(self, **_: Any) -> None:
        """Ignore a count."""

    def close(self) -> None:
        """Have nothing to close."""
