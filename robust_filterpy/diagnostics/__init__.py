"""What is wrong when a filter does badly, in words.

* `findings`: `diagnose`, the symptoms and their likely cause.
* `recording`: what a filter met, as arrays; figures of its innovations with the bands they should lie in.
* `search`: changed models, and the one that explains a recording best.

Imports from below: `influence`, `correction`.
"""

from __future__ import annotations

from robust_filterpy.diagnostics.findings import diagnose

__all__ = ["diagnose"]
