"""Plain loops on NumPy arrays, compiled to a native library when the package is built.

Kernels take and return arrays; of the rest of replant they import the errors alone.  All state of an identifier lies in
five arrays.  Kernels access each number by the name that `schema` gives it: ``s.alarm``, ``s.theta[i]``.  A few flat
arrays instead of many small ones keep a call near 0.3 µs, and no model order needs its own compilation.

Start reading at `step.single.take_gradient`: it takes one sample from its arrival to the new estimate.  `native`
defines how Python calls kernels; tools/translator/__init__.py lists the subset of Python that they may use.
benchmarks/kernels.py measures them beside C.
"""
