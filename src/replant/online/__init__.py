"""The identifier that learns sample by sample.

`identifier` is its interface, `estimate` what is read from it, `lifecycle` how it starts and goes on.  It starts by
`startup` and `begin_recursion`; at growing counts, at an alarm and at the end `revision` and `change_response` ask
again which model holds.  `ensemble` and `ensemble_members` step many at once; `miso_identifier` is that of several
inputs and one output.  `saving` and `resume` write and read checkpoints, whose bytes are those of `checkpoint`.
"""
