"""Checkpoint: an identifier as bytes, and the check of these bytes.

`encoding` writes and reads the bytes, `bank_and_row` those of a bank and of an identifier of several inputs, and
`settings_json` the settings in them; `earlier_versions` turns older ones into these.  `content_check` is the check.
`replant.online.checkpoint_file` keeps the file complete at every moment, `replant.online.saving` loads it again.
"""
