"""From the kernels' Python to a native library: the build, and what edits of a kernel go through in a clone.

`program` collects the functions that the entries need, `function` and `expressions` translate one function, `kinds` has
the types, `library` compiles.  What the kernels may use of Python is listed in docs/architecture.md.
"""
