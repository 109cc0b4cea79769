"""How the kernels are compiled: decorators, pointers, SIMD vectors."""
