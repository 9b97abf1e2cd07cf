"""Which model to believe.

* `select`: its orders and its delay, by an information criterion, as a `selection`; `grid`: which orders are tried.
* `validate`: whether anything is left in its residuals.
* `compare`: which of several models is the best.
* `judged`, `score`: residuals of any kind of model; how large their correlations are by chance.

Imports from below: `models`, `estimation`.
"""
