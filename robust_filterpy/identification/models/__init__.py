"""Models: which signals a regressor is made of, a model of a recording, and what follows from it.

* `structures`: orders, and which signals the regressor phi is made of; the usual ones.
* `regressor`: the regressor of one sample, from what is remembered; polynomials and transfer functions made of theta,
  and keeping those stable that feed back the model's own output.
* `signals`: recordings as arrays; the time axis of those that come as pandas objects, and results on the same axis.
* `polynomial_model`: residuals of all structures and their derivatives, of one recording and of several.
* `state_space`: several outputs, residuals and model.
* `recording`: what was recorded, read and checked once: one or several, gaps in u, times that jump or come at will;
  which samples are no measurements.
* `grey_box`: equations in continuous time, their residuals and their model of a recording.
* `model`: what `identify` returns: predictions through outliers, how a simulation begins; a transfer function of
  python-control in its place.
* `noise`: the noise that residuals show, of one output and of several, and how well a model agrees with a recording.
* `dependence`: whether the plant is still the model's, and other things that a model leaves, such as a closed loop.
* `responses`: what any system tells: responses, poles and zeros, with bands and regions.
* `results`: what trackers return, parameters as a table with intervals, predictions and fits of what was identified.

Imports from below: `influence`, `correction`, `filters`.
"""
