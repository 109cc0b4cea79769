"""Plain loops on NumPy arrays, compiled by Numba; importing this package compiles or loads them.

Nothing here knows the rest of replant but its errors: kernels get arrays and give arrays.  All state of an identifier
lies in three arrays, laid out by `layout`: ``ints`` (int64), ``reals`` (float64) and ``buffer`` (float64, one stored
sample a row).  One flat array instead of many small ones keeps the cost of a call near 0.3 µs, and no model order needs
its own compilation.

Many identifiers at once go through `lanes`, sixteen in a vector (see `vector`), by the same arithmetic.

A reader starts with `step.take_by_gradient`: what happens to one sample, from its arrival to the new estimate.
`compiled` and `pointer` say what makes it fast; benchmarks/kernels.py measures it beside C.
"""
