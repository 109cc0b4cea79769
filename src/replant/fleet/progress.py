"""Progress of a fleet: rigs done and failed so far, and the work that is left."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Progress:
    """How far a fleet is.

    Attributes
    ----------
    rigs, done, failed : int
        All rigs; those that are done, with those of an earlier run; how many of these failed in this run.
    samples : int
        Samples used in this run.
    part : float
        Part of the work that is done, by the plan, up to 1.
    """

    rigs: int
    done: int
    failed: int
    samples: int
    part: float
