"""One sample from its arrival to the new estimate, one file for each variant.

============  ======================================================  ==================================================
file          case                                                    test that its results are equal to the bit
============  ======================================================  ==================================================
single        the start-up: samples are kept until there are          tests/online/test_startup.py, chunks beside single
              settings and a first model; the gradient family and     samples; NumPy twins, tests/support/references.py
              optimizers with a covariance: any filter, any clock
fixed_filter  the gradient family, a fixed filter, a regular clock,   tests/kernels/step/test_fixed_filter.py beside
              neither instruments nor dead time                       single
ensemble      `LANES` members of `fixed_filter` at once, one in each  tests/online/test_ensemble.py beside single
              SIMD lane                                               members
ensemble_     `LANES` members of `single` with a covariance and a     tests/online/test_ensemble_members.py beside
covariance    refined filter at once; `single` takes the exceptions   single members
============  ======================================================  ==================================================

All kernels take the state s (see `kernels.schema`), u and y in the units of the record, the time stamp t in s, and the
reference r in its own unit.  Kernels for K samples also write errors (K,), in the unit of y, and parameters (K, P), in
physical units.

`stages` has the stages that all variants share; a variant is a list of stages.  Code that exists twice, and why:

==========================  ========================  ==================================================================
code                        where                     why
==========================  ========================  ==================================================================
the order of the stages     each variant              variants differ in most stages: one function for all would branch
                                                      everywhere
`update_estimate`           stages, fixed_filter,     the general one calls functions; the fixed filter inlines them in
                            ensemble_members          its loop; vectors cannot branch on data, so an update is undone
                                                      lane by lane
the loop over samples       `stages.take_many`,       the fixed filter cuts its arrays once a call, not once a sample
                            fixed_filter
an ordinary sample          single,                   vectors cannot branch on data: the vector stages mark each lane
                            ensemble_ordinary         that would have branched
filters and regressor       `filters.chain`,          one bank, one interval and held inputs need neither a search for a
                            fixed_filter              discretisation nor the pieces of a dead time
counting                    single, ensemble_members  level members share one set of counters
==========================  ========================  ==================================================================
"""
