"""Long runs: hours of rig time with faults, and a day through a session."""
