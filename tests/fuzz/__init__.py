"""Checkpoints and arguments that someone made who means it: see `fuzz.mutation` and `fuzz.trial`."""
