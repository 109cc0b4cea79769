"""Fleets: a model of every rig of thousands, and sweeps over records, on the executors of one machine or of many.

See docs/fleet.md.
"""

from replant.fleet.fit import fit
from replant.fleet.results import Fleet, load

__all__ = ["Fleet", "fit", "load"]
