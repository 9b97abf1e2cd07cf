"""The model of a whole recording, from nothing.

* `identify`: the way from y and u to a model; made of
* `recordings`: what was recorded as arrays: one recording or several, gaps in u, times that jump,
* `state_space`, `subspace`: a state-space model of several outputs, and where its search begins,
* `feedback`: whether the inputs follow the output,
* `grey_box`: parameters of physics,
* `outputs`: the one driver of a model beside levels that break: p outputs, k recordings, any kind of model; `level`,
  `trend`: how the levels are found; `levelled`: a model together with their sizes;
* `colour`: how residuals follow one another, which evidence and standard deviations count;
* `estimate`: one model of one output, in the units of the recording,
* `excitation_check`: whether the recording can tell the parameters,
* `starts`: where to begin without a guess,
* `prediction_error`: the search for the least robust loss,
* `cleaning`: outliers that the regressor holds,
* `missing`: outputs that it holds and nobody measured; `neighbours`: the algebra of what couples them,
* `search`: all of these together, and which of several ends to believe;
* `limits`: parameters that are fixed, or between bounds;
* `profile`: intervals where the loss is not quadratic;
* `wandering`: and where cancelling poles may be anywhere;
* `wraps`: an output that comes back at the other end of its range;
* `threads`: one thread of linear algebra, since the matrices are small.

Imports from below: `models`.
"""
