"""From the kernels' Python to a native library: the build, and what edits of a kernel go through in a clone.

`program` collects the functions that the entries need, `function` and `expressions` translate one function, `records`
the tables of the schema, `kinds` has the types, `library` compiles.

Kernels are plain Python functions over NumPy arrays: the interpreter runs them as
they are, a thousand times as slowly. `tools/translator` makes C of them, one function each, with the names of the
schema and the comments of the source; the C is not kept (`make build ARGS="--keep out/c"` shows it). A C compiler
makes a library of 0.25 MB from it in some seconds: `cc`, else the clang of the package `ziglang`. The library is
linked with no Python, so that one serves every version.

* A state `s` is a struct over its arrays, made from the schema: `s.alarm` is `s->ints->alarm`, `s.theta` is
  `state_theta(s)`. Python gives its five arrays, `*state.arrays`; the interpreter makes a `Fields` of them.
* What Python calls is marked by `@kernel(...)` of `kernels/native.py`. Annotations say what its arguments are, and
  the conditions in the brackets what must hold of their lengths. The library checks both before the kernel runs.
* `@inlined` melts a small function into its callers, where a call would cost more than it does. `@short_loops` keeps
  gcc from computing several passes of a loop at once where there are a few only; `for i in side_by_side(P)` asks any
  compiler for it, as each pass has its own elements: of the optimizers that take roots and divide. `in_turn(1, P)`
  keeps clang from it.
* After an edit of a kernel `make build` makes the library anew. Where that was forgotten, the first call says so and
  does it: the library carries the hash of all that it was made from.
* `tests/kernels/test_compiled.py` holds C and Python equal to the bit, on every function. Each product and each sum
  is rounded by itself (`-ffp-contract=off`), so that the bits depend neither on the compiler nor on the processor;
  `log`, `pow`, `sin` and `cos` are those of the system's library.

What kernels may use of Python: `int`, `float`, `bool` and `np.uint64`; arrays of float64 and int64 of one to three
dimensions in C order, their `size` and `shape`, another shape of one, `array.reshape(n, m)`; elements, rows and parts,
`array[i]`, `matrix[i, j]`, `array[a:b]`; fields of the state and of its parts, `s.theta[i]`, `s.noise.models[j, i]`, in
a loop over names by `getattr` and `setattr`; tuples that are taken apart; `for` over a `range` or a constant tuple,
`while`, `if`, `break`, `continue`, `return`;
`+ - * / // %`, powers of a float, comparisons, `and`, `or`, `not`, `x if c else y`; `abs`, `min`, `max`, `int`,
`float` and of `math` `sqrt`, `log`, `sin`, `cos`, `isnan`, `isinf`, `isfinite`; constants of modules; calls of other
such functions, also of those given as an argument. Arrays are made by the caller. What is outside of it is named with
file and line. An index counts from the beginning, and is checked by nobody.
"""
