"""Fleets: a generator of rigs as partitioned Parquet, and what `replant fleet` makes of them."""
