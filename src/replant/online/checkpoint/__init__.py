"""Checkpoint: an identifier as bytes, the check of these bytes, and a file that is complete at every moment.

`encoding` writes and reads the bytes, `bank_and_row` those of a bank and of an identifier of several inputs, and
`settings_json` the settings in them; `earlier_versions` turns older ones into these.  `content_check` is the check,
`files` the file.  `replant.online.saving` uses them to load an identifier again.
"""
