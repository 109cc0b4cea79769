"""Plain loops on NumPy arrays, compiled by Numba; importing them compiles or loads them.

Kernels get arrays and give arrays; of the rest of replant they know its errors alone.  All state of an identifier lies
in five arrays, listed in `schema`.  A few flat arrays instead of many small ones keep the cost of a call near 0.3 µs,
and no model order needs its own compilation.

A reader starts with `step.gradient.take`: what happens to one sample, from its arrival to the new estimate.
`codegen.decorators` and `codegen.pointer` say what makes it fast; benchmarks/kernels.py measures it beside C.
"""
