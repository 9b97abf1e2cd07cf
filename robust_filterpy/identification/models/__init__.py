"""Models: which signals a regressor is made of, a model of a recording, and what follows from it.

* `structures`: orders, and which signals the regressor phi is made of; `constructors`: the usual ones.
* `regressor`: the regressor of one sample, from what is remembered.
* `coefficients`: polynomials and transfer functions made of theta.
* `guard`: keeping a model that feeds back its own output stable.
* `signals`, `time_axis`: recordings as arrays; pandas objects in, results on the same index.
* `polynomial_model`: residuals of all structures and their derivatives.
* `several_recordings`: the same for several recordings of one plant.
* `beginnings`: how a simulation begins.
* `state_space_structure`, `state_space`, `state_space_system`, `state_space_residuals`: several outputs; their poles
  and responses.
* `noise_of_outputs`: noise of each of them.
* `continuous`: the system in continuous time whose samples a model gives; `reduction`: one with fewer states.
* `grey_box`, `grey_box_model`, `grey_box_recording`, `grey_box_residuals`: equations in continuous time, and the model
  that is found.
* `prediction`: predictions through outliers.
* `learnt_noise`: the noise that residuals show.
* `model`: what `identify` returns.
* `transfer_model`: a transfer function of python-control in the place of a model.
* `findings`: what a recording has beside a model: fill values, level steps, ..; `unmeasured`: which of its samples are
  no measurements.
* `dependence`: what is left of a model that follows its inputs; `gain`: whether its gain is still the plant's.
* `fit`: how well a model agrees with a recording.
* `responses`: responses, poles and zeros of a model or tracker, as `response_records`; with bands by `banded` and
  `uncertainty`.
* `estimated`: what anything with parameters tells of them: intervals, a table, a transfer function.
* `results`, `summary`: what trackers return, and parameters as a table.

Imports from below: `influence`, `correction`, `filters`.
"""
