"""`fit` and `run` on public logs of real rigs, beside an independent output-error fit."""
