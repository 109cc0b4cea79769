"""Replay: the buffer of past samples from which each update batch is drawn, the article's Algorithm 3."""

from __future__ import annotations

from dataclasses import dataclass

from replant.arguments import keep, whole

LARGEST_BATCH = 100_000  # updates a sample at the most: they take some milliseconds, which nothing interrupts [count]


@dataclass(frozen=True)
class Replay:
    """Experience replay: each new sample is learned together with samples drawn from those kept.

    A batch is ``batch_size - 1`` rows drawn uniformly, with replacement, from the filled part of the buffer (the new
    sample included), then the new sample itself, one update a row.

    Parameters
    ----------
    capacity : int
        Samples kept; the newest replaces the oldest once the buffer is full.
    batch_size : int
        Updates a sample, up to 100000.
    warmup : int
        Batches begin once the buffer holds more than this many samples, or is full; before that, one update a sample.
    seed : int
        Of the random stream, 0 or more; the stream is part of the identifier's state.

    Notes
    -----
    Algorithm 3 as printed sets ``current_buffer_size`` from ``buffer_index``, which returns to zero when the buffer
    wraps: from then on only the newest few samples could be drawn until the buffer refills.  Here a full buffer stays
    full.  The article prints a batch of 20; its tables come out with 10 (see `replant.paper`).

    References
    ----------
    Bernat and Kolota (2023), section 2.2 and Algorithm 3.

    Examples
    --------
    >>> Replay(capacity=5000, batch_size=20).warmup
    20
    """

    capacity: int = 20_000
    batch_size: int = 20
    warmup: int = 20
    seed: int = 0

    def __post_init__(self) -> None:
        keep(self, "capacity", whole, 1, 2**31 - 1)
        keep(self, "batch_size", whole, 1, LARGEST_BATCH)
        keep(self, "warmup", whole, 0, 2**63 - 1)
        keep(self, "seed", whole, 0, 2**63 - 1)
