"""The model of a whole recording, from nothing.

* `identify`: the way from y and u to a model; made of
* `recordings`: what was recorded as arrays: one recording or several, gaps in u, times that jump,
* `several`: one model of several recordings,
* `state_space`, `subspace`: a state-space model of several outputs, and where its search begins,
* `feedback`: whether the inputs follow the output,
* `grey_box`: parameters of physics,
* `outputs`: what breaks a recording of several outputs, beside states or equations,
* `level`, `trend`: steps and ramps of y by evidence, and a motion that never dies,
* `estimate`: one model of one output, in the units of the recording,
* `excitation_check`: whether the recording can tell the parameters,
* `starts`: where to begin without a guess,
* `prediction_error`: the search for the least robust loss,
* `cleaning`: outliers that the regressor holds,
* `missing`: outputs that it holds and nobody measured; `neighbours`: the algebra of what couples them,
* `search`: all of these together, and which of several ends to believe;
* `limits`: parameters that are fixed, or between bounds;
* `focus`, `focus_of_states`: a fit that counts one band of frequencies;
* `profile`: intervals where the loss is not quadratic;
* `wandering`: and where cancelling poles may be anywhere;
* `wraps`: an output that comes back at the other end of its range;
* `threads`: one thread of linear algebra, since the matrices are small.

Imports from below: `models`.
"""
