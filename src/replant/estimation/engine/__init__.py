"""The kernels' arrays: how they are laid out, filled and read, and which kernel steps them."""
