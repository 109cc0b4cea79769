"""One sample from its arrival to the new estimate, one file for each compiled variant.

============  ======================================================  ============================================
file          what it is for                                          what holds its bits equal
============  ======================================================  ============================================
shared        every optimizer, filter and clock: the plain reading    NumPy twins, tests/support/references.py
fixed_filter  gradient family, fixed filter, regular clock, neither   tests/kernels/step/test_fixed_filter.py beside
              instruments nor dead time                               shared
ensemble      sixteen of these at once, one in each SIMD lane         tests/online/test_ensemble.py beside single
                                                                      members
by_address    the same kernels, their arrays given once, so that a    tests/online/test_identifier.py, chunks beside
              call from Python costs less                             single samples
============  ======================================================  ============================================

The variants are written apart because a branch, an argument or an array less in the loop of one sample is most of their
gain; docs/performance.md has the figures.
"""
