"""The identifier that learns sample by sample.

`identifier` is its interface, `estimate` its read-only part, `identification` what identifiers of all kinds share,
`lifecycle` its start and the work between samples, which `background` leaves to a second Python.
`startup` and `begin_recursion` start it; `revision` and `change_response` test again which model holds, at growing
counts, at an alarm and at the end.  `ensemble` and `ensemble_members` step many at once; `bank` runs several structures
side by side; `miso_identifier` is for several inputs and one output.  `saving` and `resume` read checkpoints:
`checkpoint` has their format, `checkpoint_file` keeps their file complete at every moment.
"""
