"""The model of a whole recording, from nothing.

* `identify`: the way from y and u to a model, and the model of one output; those of states and of physics:
* `outputs`; each found by
* `disturbances`, the one driver of a model with levels that break and outliers of u: p outputs, k recordings.
* `estimate`: one model of one output, in the units of the recording, and how sure its parameters are, by
* `search`: from several `starts` down to the least loss (`prediction_error`, with parameters that are fixed, or between
  bounds), and which end to believe;
* `outliers`: which outputs in the regressor are outliers, drawn, with those that nobody measured.

Imports from below: `models`.
"""
