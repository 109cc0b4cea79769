"""Live identification: samples come in over a wire, the estimate is watched while it moves."""
