"""One sample from its arrival to the new estimate, one file for each compiled variant.

============  ======================================================  ============================================
file          what it is for                                          what holds its bits equal
============  ======================================================  ============================================
shared        every optimizer, filter and clock: the plain reading    NumPy twins, tests/support/references.py
fixed_filter  gradient family, fixed filter, regular clock, neither   tests/kernels/step/test_fixed_filter.py beside
              instruments nor dead time: half of the time             shared
ensemble      sixteen of these at once, one in each SIMD lane: a      tests/online/test_ensemble.py beside single
              quarter of the time of each                             members
by_address    the same kernels, their arrays given once: a third of   tests/online/test_identifier.py, chunks beside
              the time of a call from Python                          single samples
============  ======================================================  ============================================

The variants are written apart because a branch, an argument or an array less in the loop of one sample is most of their
gain; docs/performance.md has the figures.
"""
