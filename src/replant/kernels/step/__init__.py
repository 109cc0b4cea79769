"""One sample from its arrival to the new estimate, one file for each compiled variant."""
