"""The model of a whole record, the search for its structure, and what has changed in a record.

`fit` takes `samples` and gives a `fit_result`.  `solve` leaves out `bad_samples`; the estimate is `srivc`, by steps of
`srivc_steps`, chosen by the `specification_test` and told by `refined`.  `structure_search` compares structures by
`structure_evidence`.  `contest` compares suppositions of what has changed, by what was `known_before` and the
`residual_likelihood`; `change_search` finds when.  `row_fit` and its steps are for several inputs.
"""
