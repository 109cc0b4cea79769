"""Plain loops on NumPy arrays, compiled to a native library when the package is built.

Kernels get arrays and give arrays; of the rest of replant they know its errors alone.  All state of an identifier lies
in five arrays, of which kernels have each number by its name: ``s.alarm``, ``s.theta[i]``, as `schema` lists them.  A
few flat arrays instead of many small ones keep a call near 0.3 µs, and no model order needs its own compilation.

A reader starts with `step.gradient.take`: what happens to one sample, from its arrival to the new estimate.  `native`
says how Python calls them; tools/translator/__init__.py, what of Python they may use.
benchmarks/kernels.py measures them beside C.
"""
