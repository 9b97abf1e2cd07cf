"""Let property tests draw the same examples in every run."""

from hypothesis import settings

# A run that fails must fail again; `pytest --hypothesis-profile search` draws others, and finds new defects.
settings.register_profile("repeatable", derandomize=True)
settings.register_profile("search", derandomize=False)
settings.load_profile("repeatable")
