"""Which model to believe.

* `select`: its orders and its delay, by an information criterion.
* `validate`: whether anything is left in its residuals.
* `compare`: which of several models is the best.

Imports from below: `models`, `estimation`.
"""
