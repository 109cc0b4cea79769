"""Checkpoint: an identifier as bytes, the check of these bytes, and a file that is complete at every moment.

`encoding` writes and reads the bytes, `miso` those of an identifier of several inputs, `bank` those of a bank, and
`settings_json` the settings in them; `earlier_versions` turns older ones into these.  `content_check` is the check,
`files` the file.  `replant.online.saving` uses them to save an identifier and to load it again.
"""
