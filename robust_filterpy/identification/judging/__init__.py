"""Which model to believe.

* `select`: its orders and its delay, by an information criterion; which orders are tried, and their table.
* `validate`: whether anything is left in its residuals, and how large correlations are by chance; `compare`: which of
  several models is the best.

Imports from below: `models`, `estimation`.
"""
