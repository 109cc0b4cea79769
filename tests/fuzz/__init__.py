"""Checkpoints, files and arguments that someone made who means it: see `mutation`, `files` and `trial`."""
