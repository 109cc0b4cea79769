"""One sample from its arrival to the new estimate, one file for each variant.

============  ======================================================  ==================================================
file          what it serves                                          what holds its bits equal
============  ======================================================  ==================================================
collecting    the start-up: samples are kept until there are          tests/online/test_startup.py, chunks beside single
              settings and a first model                              samples
gradient      the gradient family: any filter, any clock              NumPy twins, tests/support/references.py
covariance    optimizers with a covariance, outputs examined          NumPy twins, tests/support/references.py
fixed_filter  the gradient family, a fixed filter, a regular clock,   tests/kernels/step/test_fixed_filter.py beside
              neither instruments nor dead time                       gradient
ensemble      eight of these at once, one in each SIMD lane           tests/online/test_ensemble.py beside single
                                                                      members
ensemble_     eight of `covariance` with a refined filter at once;    tests/online/test_ensemble_members.py beside
covariance    what is not ordinary by `covariance` itself             single members
============  ======================================================  ==================================================

Arguments of all kernels: the state s, as `kernels.schema` describes it; u and y in the units of the record, the time
stamp t in s, the reference r in a unit of its own; of kernels for K samples also errors (K,) in the unit of y, and
parameters (K, P) in physical units, both written.

`stages` has the stages that all of them use; a variant is the list of its stages.  What is written twice, and why:

==========================  ========================  ==================================================================
what                        where                     why
==========================  ========================  ==================================================================
the order of the stages     `take` of each variant    variants differ in most stages: one function for all would be
                                                      branches throughout
`update_estimate`           stages, fixed_filter,     the general one calls its parts as functions, that of the fixed
                            ensemble_members          filter has them in its loop; vectors have no branch on data, so an
                                                      update is undone lane by lane
the loop over samples       `stages.take_many`,       the arrays of the fixed filter are cut once a call, not once a
                            fixed_filter              sample
an ordinary sample          covariance,               vectors have no branch on data: the stages without those, and
                            ensemble_ordinary         marks where one would have been taken
filters and regressor       `filters.chain`,          one bank, one interval and held inputs need neither a search for a
                            fixed_filter              discretisation nor pieces of a dead time
counting                    `take`, ensemble_members  level members are counted once for all
==========================  ========================  ==================================================================
"""
