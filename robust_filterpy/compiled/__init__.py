"""The recursion compiled by numba, and when it serves.

* `dispatch`: whether the loops can be used, and the way to them.
* `filter_loop`, `correction`, `inverse_root`, `influence`: the recursion.
* `products`, `simd`, `workspace`: what it is made of.

Imports from below: `influence`, `correction.options`.
"""
